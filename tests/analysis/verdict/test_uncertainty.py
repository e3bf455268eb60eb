"""The uncertainty of times from the medians of the rounds of replays."""

import json
from typing import Any

import numpy as np
import pytest

from dpbench.analysis.verdict.lateness import (
    Uncertainty,
    compute_factor_quantile,
    estimate_uncertainty,
)


def _replay(records: Any, solver: str, rounds_us: tuple[float, ...], **columns: Any) -> None:
    """A replay of 300 steps whose rounds take so long a step."""
    columns = {"sequence": "paper", "steps": 300} | columns
    records.replay(solver, rounds=len(rounds_us), median_us=1.0, spread=0.0, **columns)
    frame = records._steps[-1]
    for r, us in enumerate(rounds_us, 1):
        frame.loc[frame["repeat"] == r, "total_ns"] = round(1000 * us)


def _of(records: Any) -> tuple[Uncertainty, list[tuple[float, float, float]]]:
    """The uncertainty and, by configuration, the factors of the middle, slow and slowest round."""
    found = estimate_uncertainty(records.view())
    factors = zip(found.middle.values(), found.slow.values(), found.slowest.values(), strict=True)
    return found, list(factors)


@pytest.mark.parametrize(
    ("rounds_us", "expected"),
    [
        ((16.0, 10.0, 11.0, 20.0, 12.0), (1.2, 1.6, 2.0)),  # quantiles 12, 16, 20 over 10
        ((10.0, 14.0), (1.2, 1.3, 1.4)),  # quantiles 12, 13, 14 over 10
    ],
)
def test_factors(records: Any, rounds_us: tuple[float, ...], expected: tuple[float, ...]) -> None:
    _replay(records, "daqp", rounds_us)
    found, factors = _of(records)
    assert factors == [pytest.approx(expected)]
    assert found.usual == pytest.approx(1.2)


def test_the_largest_factors_of_the_replays_of_a_configuration(records: Any) -> None:
    _replay(records, "daqp", (10.0, 16.0, 16.0))
    _replay(records, "daqp", (10.0, 11.0, 40.0), sequence="calm")
    _replay(records, "daqp", (10.0, 10.0, 10.0), settings="high")
    found, factors = _of(records)
    assert factors == [pytest.approx((1.6, 2.55, 4.0)), pytest.approx((1.0, 1.0, 1.0))]
    assert found.usual == pytest.approx(1.0 + 0.95 * 0.6)


def test_a_usual_factor_has_a_least_value(records: Any) -> None:
    """Equal rounds still leave an uncertainty of 5 %."""
    _replay(records, "daqp", (10.0, 10.0))
    assert _of(records)[0].usual == 1.05


@pytest.mark.parametrize(
    "columns",
    [
        {"units": "si"},
        {"done": 0},
        {"concurrency": 2.0},
        {"cell": json.dumps({"source": {"kind": "hardest", "of": 450}})},
    ],
)
def test_replays_that_show_no_uncertainty(records: Any, columns: dict[str, Any]) -> None:
    _replay(records, "daqp", (10.0, 30.0), sequence="calm", **columns)
    found, factors = _of(records)
    assert (factors, found.usual) == ([], 1.5)
    _replay(records, "daqp", (10.0, 14.0))
    assert _of(records)[1] == [pytest.approx((1.2, 1.3, 1.4))]


def test_one_round_shows_no_uncertainty(records: Any) -> None:
    _replay(records, "daqp", (10.0,))
    _replay(records, "scs", (10.0, 14.0))
    assert _of(records)[1] == [pytest.approx((1.2, 1.3, 1.4))]


def test_the_factor_of_a_run(records: Any) -> None:
    _replay(records, "daqp", (10.0, 10.0, 10.0))
    records.loop("daqp")
    records.loop("scs")
    replay, loop, other = records.view().runs
    known = replay.configuration.moved_to_common_formulation
    found = Uncertainty({known: 1.25}, {known: 1.5}, {known: 9.0}, usual=1.125)
    assert [found.get_factor_of_run(run) for run in (replay, loop, other)] == [1.25, 1.5, 1.125]
    larger = Uncertainty({known: 1.25}, {known: 1.5}, {known: 9.0}, usual=1.375)
    assert [larger.get_factor_of_run(run) for run in (replay, loop, other)] == [1.375, 1.5, 1.375]


def test_the_usual_factor_is_a_quantile_of_95_percent() -> None:
    """The factor of 1.00, 1.01, ..., 2.00 is 1.95."""
    assert compute_factor_quantile(1.0 + np.arange(101) / 100.0) == pytest.approx(1.95)
