"""Use of each thruster in words and as a table, from what a run has recorded."""

import json
from typing import Any

import pytest

from dpbench.analysis.verdict.ship_results import ShipResult, find_ship_results
from dpbench.errors import ResultsError
from dpbench.report.report import Report
from dpbench.report.ship.ship_text import summarise_ships
from dpbench.report.ship.thrust_text import (
    explain_departure,
    list_thruster_uses,
    tabulate_thruster_use,
)
from dpbench.scenario.scenario import load_scenario

LOST = {"exact_left_s": 150.0, "exact_offset_max_m": 37.0, "exact_offset_end_m": 36.0}
THRUSTERS = load_scenario("thrusters_loss").vessel.thrusters
assert THRUSTERS is not None
NAMES = [thruster.name for thruster in THRUSTERS.thrusters]


def ship_with_use(records: Any, of: dict[str, list[float]], **columns: Any) -> ShipResult:
    """Return the ship of a loop with a loss at 90 s in which thrusters are used so."""
    use = {"window_s": [90.0, 150.0], "thrust": [0.2, 0.62], "thrusters": of}
    stored = {"exact_thruster_use": json.dumps(use)} | columns
    records.loop("daqp", "thrusters_loss", steps=600, **stored)
    (ship,) = find_ship_results(Report.from_results(records.results()).data.records)
    return ship


def test_a_thruster_at_its_limit_is_named_as_the_ship_leaves(records: Any) -> None:
    busy = {NAMES[0]: [0.97, 1.0, 0.92, 0.0], NAMES[1]: [0.3, 0.4, 0.49, 0.5]}
    assert summarise_ships([ship_with_use(records, busy, **LOST)]).warning.endswith(
        "From 90 to 150 s in `thrusters_loss`, it uses 62 % of the remaining thrust at most, 20 % "
        f"on average; at a limit of thrust or sector: `{NAMES[0]}` in 92 % of the steps."
    )


@pytest.mark.parametrize(
    ("left", "reason"),
    [
        (NAMES, "the remaining thrusters balance the mean load, but the loop does not settle."),
        (NAMES[:1], "the remaining thrusters cannot balance the mean load in all axes at once."),
        ([], "the remaining thrusters cannot balance the mean load in all axes at once."),
    ],
)
def test_a_ship_that_leaves_with_thrust_to_spare(
    records: Any, left: list[str], reason: str
) -> None:
    """One thruster makes no surge, sway and yaw independently; all of them hold this weather."""
    of = {name: [0.1, 0.3, 0.1, 0.0] for name in left}
    warning = summarise_ships([ship_with_use(records, of, **LOST)]).warning
    assert warning.endswith(
        f"No thruster is at a limit of thrust or sector in most steps: {reason}"
    )


@pytest.mark.parametrize("rate", [0.34, 0.09])
def test_without_a_loss_all_thrust_counts_and_the_rate_limit_is_named(
    records: Any, rate: float
) -> None:
    """The window begins at the start: no thruster is remaining. A rate limit below 10 % is none."""
    of = {name: [0.1, 0.3, 0.1, rate * (name == NAMES[0])] for name in NAMES}
    use = {"window_s": [0.0, 150.0], "thrust": [0.2, 0.98], "thrusters": of}
    records.loop("daqp", "thrusters", steps=600, exact_thruster_use=json.dumps(use), **LOST)
    (ship,) = find_ship_results(Report.from_results(records.results()).data.records)
    named = f", but `{NAMES[0]}` is at its rate limit in 34 %" * (rate > 0.1)
    text = explain_departure(ship)
    assert text.startswith("From 0 to 150 s in `thrusters`, it uses 98 % of the thrust at most,")
    assert f"limit of thrust or sector in most steps{named}: the thrusters " in text
    assert text.endswith("balance the mean load, with little thrust left for its variation.")


@pytest.mark.parametrize(("end_s", "is_explained"), [(26.8, False), (30.0, True)])
def test_no_cause_is_named_while_the_weather_rises(
    records: Any, end_s: float, is_explained: bool
) -> None:
    """The weather of the scenario rises for 30 s."""
    cell = json.dumps({"scenario": records.scenario("thrusters").files})
    assert json.loads(cell)["scenario"]["scenario"]["environment"]["ramp_s"] == 30.0
    thrusters = {name: [0.1, 0.3, 0.1, 0.0] for name in NAMES}
    use = {"window_s": [0.0, end_s], "thrust": [0.2, 0.66], "thrusters": thrusters}
    stored = {"exact_thruster_use": json.dumps(use)}
    records.loop("daqp", "thrusters", steps=600, cell=cell, **stored, **LOST)
    (ship,) = find_ship_results(Report.from_results(records.results()).data.records)
    rises = "The weather still rises then (ramp_s = 30): no cause is found."
    assert explain_departure(ship).endswith(rises) is not is_explained


def test_each_thruster_has_a_row_and_its_part_of_a_line(records: Any) -> None:
    of = {"bow": [0.12, 0.16, 0.0, 0.0], "port main": [0.05, 0.364, 0.25, 0.07]}
    ship = ship_with_use(records, of)
    assert [*list_thruster_uses([ship])] == [
        "thrusters_loss, 90 to 150 s: bow 12 / 16 % (0 %), port main 5 / 36 % (25 %)"
    ]
    table = tabulate_thruster_use([ship])
    assert table is not None
    assert table.rows[1] == ("thrusters_loss", "90 to 150", "port main", "5", "36", "25", "7")
    assert "From 90" not in summarise_ships([ship]).text


def test_a_folder_of_an_earlier_release_has_no_use(records: Any) -> None:
    records.loop("daqp", "thrusters_loss", steps=600, **LOST)
    ships = find_ship_results(Report.from_results(records.results()).data.records)
    assert tabulate_thruster_use(ships) is None and [*list_thruster_uses(ships)] == []
    assert "it uses" not in summarise_ships(ships).warning


def test_a_damaged_use_is_refused(records: Any) -> None:
    ship = ship_with_use(records, {"bow": [0.1, 0.2]})
    with pytest.raises(ResultsError, match=r"exact_thruster_use.*thrusters"):
        _ = ship.thruster_use
