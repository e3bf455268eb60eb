"""The state of a ship by hand: at the edge of its station, beyond it, and without a loop."""

import json
import math
from typing import Any

import pytest

from dpbench.analysis.verdict.ship_results import find_ship_results, tabulate_ship_results
from dpbench.scenario.dotted_keys import copy_documents_with_values
from dpbench.scenario.scenario import load_scenario

EDGE = {"station_radius_m": 5.0, "exact_left_s": math.nan}


@pytest.mark.parametrize(
    ("columns", "state"),
    [
        ({"exact_offset_end_m": 5.0, "exact_heading_end_deg": 5.0}, "on station"),
        ({"exact_offset_end_m": 1.0, "exact_heading_end_deg": 1.0}, "on station"),
        ({"exact_offset_end_m": 5.001, "exact_heading_end_deg": 1.0}, "not arrived"),
        ({"exact_offset_end_m": 1.0, "exact_heading_end_deg": 5.001}, "not arrived"),
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


@pytest.mark.parametrize(
    ("largest_m", "largest_s", "end_m", "after_loss_m", "moves", "is_unsettled"),
    [
        (0.5, 27.0, 0.45, 0.5, True, True),
        (0.5, 26.9, 0.45, 0.5, False, False),
        (0.5, 27.0, 0.449, 0.5, False, False),
        (0.499, 30.0, 0.499, 0.499, False, True),
        (0.5, 9.0, 0.225, 0.25, False, True),
        (0.5, 9.0, 0.224, 0.25, False, False),
        (0.5, 30.0, 0.5, 0.0, True, False),
        (0.5, 30.0, 0.5, math.nan, True, True),
        (0.1, 30.0, 0.1, math.nan, False, True),
        (0.099, 30.0, 0.099, math.nan, False, False),
    ],
)
def test_a_ship_that_moves_when_its_run_ends(
    records: Any,
    largest_m: float,
    largest_s: float,
    end_m: float,
    after_loss_m: float,
    moves: bool,
    is_unsettled: bool,
) -> None:
    """Its largest offset is at 27 s or later of 30 s, of which nine tenths are left at the end.

    It moves away from 0.5 m on, of 5 m, and has not settled from 0.1 m on, after a loss or not.
    """
    columns = {
        "exact_steps": 100,
        "exact_offset_max_m": largest_m,
        "exact_offset_max_s": largest_s,
        "exact_offset_end_m": end_m,
        "exact_loss_offset_max_m": after_loss_m,
    }
    records.loop("daqp", "rough", **EDGE | columns)
    (ship,) = find_ship_results(records.view())
    assert (ship.is_moving_away, ship.is_unsettled) == (moves, is_unsettled)


@pytest.mark.parametrize(
    ("rise_m", "is_growing"), [(0.03, True), (math.nan, True), (0.0, False), (-0.03, False)]
)
def test_a_ship_that_comes_back_at_the_end_is_settling(
    records: Any, rise_m: float, is_growing: bool
) -> None:
    """The largest offset is at 29.7 s of 30 s; without a trend the ship counts as moving out."""
    end = {"exact_offset_max_m": 0.6, "exact_offset_max_s": 29.7, "exact_offset_end_m": 0.59}
    columns = {"exact_steps": 100, "exact_offset_rise_m": rise_m} | end
    records.loop("daqp", "rough", **EDGE | columns)
    (ship,) = find_ship_results(records.view())
    assert (ship.is_moving_away, ship.is_unsettled) == (is_growing, is_growing)


@pytest.mark.parametrize(("horizon", "radius"), [(20, 1.0091), (60, math.nan), (None, math.nan)])
def test_a_ship_in_a_loop_that_is_unstable_without_limits(
    records: Any, horizon: int | None, radius: float
) -> None:
    """At 60 its largest |λ| is 0.967; a run without its documents has none."""
    files = load_scenario("rough").files
    values = {"controller.prediction_horizon": horizon}
    cell = {"scenario": copy_documents_with_values(files, values, "test")} if horizon else {}
    records.loop("daqp", "rough", cell=json.dumps(cell), **EDGE)
    (ship,) = find_ship_results(records.view())
    assert ship.unstable_radius == pytest.approx(radius, abs=1e-4, nan_ok=True)


@pytest.mark.parametrize(("heading_deg", "share"), [(4.5, 0.9), (2.0, 0.8)])
def test_the_used_share_of_the_station(records: Any, heading_deg: float, share: float) -> None:
    """The larger of 4 m of 5 m and of a heading error of so much of 5°."""
    largest = {"exact_offset_max_m": 4.0, "exact_heading_max_deg": heading_deg}
    records.loop("daqp", "rough", **EDGE | largest)
    (ship,) = find_ship_results(records.view())
    assert ship.used_share_of_station_limits == pytest.approx(share)


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
