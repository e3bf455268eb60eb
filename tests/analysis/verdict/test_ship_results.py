"""The state of a ship by hand: at the edge of its station, beyond it, and without a loop."""

import math
from typing import Any

import pytest

from dpbench.analysis.verdict.ship_results import find_ship_results, tabulate_ship_results

EDGE = {"station_radius_m": 5.0, "exact_left_s": math.nan}


@pytest.mark.parametrize(
    ("columns", "state"),
    [
        ({"exact_offset_end_m": 5.0, "exact_heading_end_deg": 5.0}, "on station"),
        ({"exact_offset_end_m": 1.0, "exact_heading_end_deg": 1.0}, "on station"),
        ({"exact_offset_end_m": 5.001, "exact_heading_end_deg": 1.0}, "not there"),
        ({"exact_offset_end_m": 1.0, "exact_heading_end_deg": 5.001}, "not there"),
        ({"exact_offset_end_m": 6.0, "exact_heading_end_deg": 1.0, "exact_left_s": 0.0}, "leaves"),
        ({"exact_offset_end_m": 1.0, "exact_heading_end_deg": 9.0, "exact_left_s": 0.0}, "leaves"),
        (
            {"exact_offset_end_m": 1.0, "exact_heading_end_deg": 1.0, "exact_left_s": 0.0},
            "leaves and returns",
        ),
        ({"exact_steps": 0.0}, "not run"),
        ({"exact_steps": math.nan}, "not run"),
    ],
)
def test_the_state_of_a_ship(records: Any, columns: dict[str, float], state: str) -> None:
    """On station is at most 5 m and 5° away at the end, and never outside before."""
    records.loop("daqp", "rough", **EDGE | columns)
    (ship,) = find_ship_results(records.view())
    assert ship.state == state
    assert tabulate_ship_results([ship])["ship"].tolist() == [state]


def test_a_scenario_names_its_horizons_where_it_has_several(records: Any) -> None:
    records.loop("daqp", "rough", N_p=30.0, N_c=5.0)
    records.loop("daqp", "rough", N_p=60.0, N_c=10.0)
    records.loop("daqp", "calm", N_p=60.0, N_c=10.0)
    names = [ship.name for ship in find_ship_results(records.view())]
    assert sorted(names) == ["calm", "rough 30/5", "rough 60/10"]


def test_qps_without_horizons_are_no_second_ship(records: Any) -> None:
    """A consequence analysis of a scenario beside its loop; alone it names its scenario."""
    records.replay("daqp", "calm", N_p=math.nan, N_c=math.nan)
    records.replay("daqp", "rough", N_p=math.nan, N_c=math.nan, exact_steps=90.0, **EDGE)
    records.loop("daqp", "rough", N_p=60.0, N_c=10.0)
    assert sorted(ship.name for ship in find_ship_results(records.view())) == ["calm", "rough"]
