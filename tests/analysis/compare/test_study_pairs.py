"""Runs of a study are paired by point and realisation, not by their scenario's name."""

import pytest

from dpbench.analysis.compare.pairs import pair_runs_of_folders
from tests.conftest import MadeRecords

KEY = "start.east_m"


def _make_study(points: tuple[float, ...], realisations: int) -> MadeRecords:
    records = MadeRecords()
    for i, east_m in enumerate(points):
        for replicate in range(1, realisations + 1):
            records.sea("daqp", i, replicate, {KEY: east_m}, error=1e-9)
    return records


def test_every_point_and_realisation_of_a_study_has_its_partner() -> None:
    view = _make_study((0.0, 3.0), 4).view()
    found = pair_runs_of_folders(view, view, ("A", "B"))
    assert len(found.pairs) == 8
    assert not (found.only_a or found.only_b or found.changed or found.lost)


def test_a_longer_study_is_compared_on_the_common_points_and_realisations() -> None:
    """The point 3.0 is the second of one study and the first of the other."""
    short, long = _make_study((3.0,), 2).view(), _make_study((0.0, 3.0), 3).view()
    found = pair_runs_of_folders(short, long, ("A", "B"))
    assert [(p.a.x[KEY], p.b.x[KEY]) for p in found.pairs] == [(3.0, 3.0)] * 2
    assert [p.a.replicate for p in found.pairs] == [p.b.replicate for p in found.pairs] == [1, 2]
    assert len(found.only_b) == 4 and not found.changed
    assert f"paper, {KEY} = 0.0, realisation 1" in found.only_b[0]


@pytest.mark.parametrize("points", [(0.0,), (0.0, 3.0)])
def test_a_study_has_no_partner_in_another_of_other_points(points: tuple[float, ...]) -> None:
    a, b = _make_study((0.0, 3.0), 1), _make_study(points, 1)
    a.replay("daqp")
    b.replay("daqp")
    found = pair_runs_of_folders(a.view(), b.view(), ("A", "B"))
    assert len(found.pairs) == 1 + len(points) and len(found.only_a) == 2 - len(points)
