"""Sentences of `dpbench init --thrusters` on assumed values and on the side of the weather."""

from pathlib import Path
from typing import Any

import pytest

from dpbench.bench.capability.frontier import INTACT, WindLimit
from dpbench.cli.ship.own_ship import _suggest_harder_sea
from dpbench.cli.ship.own_thrusters import (
    HeldSea,
    WeakSide,
    _explain_side,
    describe_losses,
)
from dpbench.scenario.own_thrusters import (
    Berth,
    complete_thruster_values,
    describe_assumed_values,
)
from dpbench.scenario.scenario import load_vessel

BOW = {"name": "bow", "kind": "tunnel", "x_m": "30", "power_kW": "800", "group": "A"}
ROWS = (
    {"name": "port", "kind": "main", "x_m": "-38", "y_m": "-4", "power_kW": "900", "group": "A"},
    {"name": "starboard", "kind": "main", "x_m": "-38", "y_m": "4", "power_kW": "900"},
    BOW,
)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ((), "Shaft heights (height_m) are unknown: "),
        (("bow",), "Shaft heights of port, starboard (height_m) are unknown: "),
        (("port", "starboard", "bow"), ""),
    ],
)
def test_thrusters_without_a_shaft_height_are_named(names: tuple[str, ...], said: str) -> None:
    rows = [row | ({"height_m": "2"} if row["name"] in names else {}) for row in ROWS]
    tables, _ = complete_thruster_values(rows, Berth(80.0, 18.0, 11.6), "mine.csv")
    found = [text for text in describe_assumed_values(rows, tables) if "ventilation" in text]
    assert [text.partition("loss of thrust")[0] for text in found] == ([said] if said else [])


@pytest.mark.parametrize(
    ("worst", "alike"),
    [
        ((0.0, 0.0), " From both sides alike, it holds 0.0 m/s without A."),
        ((0.0, 5.0), ""),
    ],
)
def test_losses_that_leave_the_same_wind_on_both_sides_are_named(
    worst: tuple[float, float], alike: str
) -> None:
    by_side = {
        from_deg: {
            case: WindLimit(wind, 1) for case, wind in {INTACT: 12.0, "A": a, "B": b}.items()
        }
        for from_deg, a, b in ((30.0, worst[0], 6.0), (330.0, worst[1], 6.24))
    }
    case, winds = ("B", ("6.0", "6.2")) if alike else ("A", ("0.0", "5.0"))
    assert _explain_side(by_side) == (
        f"weather from starboard (30°): there the ship holds less, {winds[0]} m/s without {case}, "
        f"than from port (330°), {winds[1]} m/s without {case}.{alike}"
    )


def test_the_command_for_a_weak_side_that_is_not_held_names_the_file_in_its_folder() -> None:
    none = WindLimit(0.0, 0)
    said = WeakSide(90.0, none, "A", (90.0, none)).describe(1, Path("bar/own_weak_side.toml"))
    assert "dpbench run smoke --scenario bar/own_weak_side.toml" in said


def _hold(intact_mps: float, losses: dict[str, int]) -> HeldSea:
    """Return what thrusters hold; after each loss, by group, a DP capability number."""
    other: Any = None
    lost = next(iter(losses))
    return HeldSea(
        other, losses[lost], lost, losses, intact_mps, "", 30.0, "side", other, {}, other
    )


@pytest.mark.parametrize(
    ("number", "losses", "suggested"),
    [
        (
            9,
            {"B": 6, "C": 7, "A": 7},
            ["8 is held intact", "6 is held without B", "7 is held without C or without A"],
        ),
        (8, {"B": 7, "A": 7}, ["7 is held without B or without A"]),
        (8, {"B": 7, "A": 8}, ["7 is held without B"]),
        (7, {"B": 7, "A": 7}, []),
    ],
)
def test_each_smaller_sea_is_suggested_once_and_the_one_of_the_intact_ship_too(
    number: int, losses: dict[str, int], suggested: list[str]
) -> None:
    """Intact, the ship holds number 8 (20.7 m/s), not 9 (24.4 m/s)."""
    lines = describe_losses(_hold(23.9, losses), number, 180.0, {"B": Path("b.toml")})
    assert [line for line in lines if "--sea" in line] == [
        f"DP capability number {sea}: --sea {sea[0]}." for sea in suggested
    ]


def test_no_smaller_sea_is_suggested_for_an_intact_ship_that_holds_none() -> None:
    lines = describe_losses(_hold(1.4, {"A": 1}), 1, 180.0, {"A": Path("a.toml")})
    assert any("is beyond the 1.4 m/s" in line for line in lines)
    assert not any("--sea" in line for line in lines)


@pytest.mark.parametrize(
    ("losses", "said"),
    [
        ({"B": 7, "A": 7}, "; not held after any loss)"),
        ({"B": 7, "A": 8}, "; not held after some losses)"),
        ({"B": 8, "A": 8}, "of the thrust)"),
    ],
)
def test_the_losses_after_which_a_harder_sea_is_not_held(losses: dict[str, int], said: str) -> None:
    lines = _suggest_harder_sea(Path(), load_vessel("osv"), 7, _hold(23.9, losses))
    assert " ".join(" ".join(lines).split()).endswith(said)
