"""Output of `dpbench check` for a ship: short, aligned, and equal to that of the loop itself."""

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog

from dpbench.bench.capability.utilisation import ThrusterReach
from dpbench.bench.design import (
    can_recover_from_offset,
    find_bracket_in_still_water,
    find_bracket_of_recovery,
)
from dpbench.cli.check import check_file
from dpbench.cli.ship import check_ship
from dpbench.scenario.own_ship import compute_mean_force_of_dp_number
from dpbench.scenario.problem_files import find_problem_path, list_shipped_problem_names
from dpbench.scenario.scenario import Scenario, load_scenario, load_vessel
from dpbench.scenario.variation import copy_scenario_with_values
from dpbench.ship.characteristics import compute_mean_weather_force
from dpbench.ship.thrusters import Thruster, ThrusterSet


def up_to(monkeypatch: pytest.MonkeyPatch, offset_m: float) -> None:
    """Every tuning holds what is not beyond `offset_m`."""
    monkeypatch.setattr(
        check_ship, "can_recover_from_offset", lambda trial, offset, sides: offset <= offset_m
    )


def read_stored_text(name: str) -> str:
    """Return the text for a library vessel."""
    return check_ship.describe_checked_vessel(find_problem_path("vessels", name), load_vessel(name))


@pytest.mark.parametrize("name", list_shipped_problem_names("vessels"))
@pytest.mark.parametrize("offset_m", [0.0, 1.7, 100.0])
def test_a_vessel_fits_a_terminal(
    name: str, offset_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At most 14 lines of 80 columns, the four columns of the table below each other."""
    up_to(monkeypatch, offset_m)
    lines = read_stored_text(name).splitlines()
    assert len(lines) <= 14
    assert max(map(len, lines)) <= 80
    for line in lines[2:7]:
        assert all(line[at - 1] == " " and line[at] != " " for at in (22, 41, 60)), line


def test_quick_simulates_nothing_and_names_what_is_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The rest of the text is the same."""
    up_to(monkeypatch, 1.7)
    whole = {}
    for name in ("osv", "rough@osv"):
        whole[name] = check_file(name).splitlines()
    monkeypatch.setattr(check_ship, "can_recover_from_offset", None)
    for name, lines in whole.items():
        *same, last = check_file(name, quick=True).splitlines()
        assert same == [line for line in lines if not line.startswith("tuning ")]
        assert (
            last == "not simulated (--quick): the sideways offsets from which each tuning recovers"
        )


@pytest.mark.parametrize("name", list_shipped_problem_names("scenarios"))
def test_a_scenario_fits_a_terminal(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sixteen lines at most, up to six on mean loads by level 1, and two on a loss."""
    up_to(monkeypatch, 1.7)
    lines = check_ship.describe_checked_scenario(name, load_scenario(name)).splitlines()
    most = 22 if any(line.startswith("DNV-ST-0111, level 1") for line in lines) else 16
    assert len(lines) <= most + 2 * ("After the loss of" in " ".join(lines))
    assert max(map(len, lines)) <= 80


def test_the_numbers_of_the_papers_ship(monkeypatch: pytest.MonkeyPatch) -> None:
    """M/D of surge 105.7 s, 1240 kN over 5312 t, 417 kN over 272 t/s, and what 1 m/s takes."""
    up_to(monkeypatch, 1.65)
    text = read_stored_text("supply_fs99")
    for said in ("-980 to 1240 kN", "±417 kN", "±18000 kN·m", "11.4 s", "106 s", "233 mm/s²"):
        assert said in text
    assert re.search(r"\ndrag at 1 m/s, °/s +50\.2 kN +272 kN +", text)
    assert "The ship holds a current of 1.5 m/s abeam." in " ".join(text.split())
    assert "tuning paper 30/5     recovers from 1.62 m abeam in calm water, not 1.69 m" in text


@pytest.mark.parametrize(
    ("offset_m", "said"),
    [
        (0.0, "does not recover from 0.25 m abeam in calm water"),
        (100.0, "recovers from at least 64 m abeam in calm water"),
    ],
)
def test_a_tuning_that_holds_nothing_or_everything(
    offset_m: float, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    up_to(monkeypatch, offset_m)
    assert read_stored_text("osv").count(said) == 2


def test_a_drift_beyond_linear_damping_has_no_number(monkeypatch: pytest.MonkeyPatch) -> None:
    """By D alone MSS osv would drift at 22 m/s ahead and 6 sideways; 0.2 of Froude is 5.7 m/s."""
    up_to(monkeypatch, 1.0)
    ship = replace(load_vessel("osv"), drag=None)
    text = check_ship.describe_checked_vessel(find_problem_path("vessels", "osv"), ship)
    assert "> 5.7 m/s          > 5.7 m/s          0.296 °/s" in text
    assert "holds a current of > 5.7 m/s abeam." in " ".join(text.split())


def test_a_weather_that_is_too_much_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """417 kN of sway force: a mean of 330 kN is 79 % of it, one of 500 kN cannot be held."""
    up_to(monkeypatch, 1.0)
    assert (
        "mean force: surge 11 %, sway 79 %, yaw 14 % of the limits\n"
        in check_ship.describe_checked_scenario("extreme", load_scenario("extreme"))
    )
    text = find_problem_path("scenarios", "extreme").read_text(encoding="utf-8")
    path = tmp_path / "worse.toml"
    path.write_text(text.replace("330.0", "500.0"), encoding="utf-8")
    text = check_ship.describe_checked_scenario(path, load_scenario(path))
    assert "sway 120 %, yaw 14 % of the limits; the ship cannot hold it" in " ".join(text.split())


def test_mean_loads_are_compared_with_those_of_level_1(tmp_path: Path) -> None:
    """In weather from 30° off the bow; the simulated ship has no Munk moment of the current."""
    text = find_problem_path("scenarios", "calm").read_text(encoding="utf-8")
    head, _, controller = text.partition("[environment]")
    weather = (
        "[environment.wind]\nspeed_mps = 7.9\nfrom_deg = 330.0\n"
        "[environment.current]\nspeed_mps = 0.75\ntowards_deg = 150.0\n"
        "[environment.waves]\nhs_m = 1.3\ntp_s = 6.5\nfrom_deg = 330.0\n"
    )
    path = tmp_path / "sea.toml"
    path.write_text(
        head.replace("supply_fs99", "osv") + weather + controller[controller.index("\n[") :],
        encoding="utf-8",
    )
    scenario = load_scenario(path)
    vessel = scenario.vessel
    assert vessel.capability is not None
    load = compute_mean_force_of_dp_number(vessel, 4, 330.0) / 1e3
    said = check_ship.describe_checked_scenario(path, scenario, quick=True)
    (row,) = [line for line in said.splitlines() if line.startswith("DNV-ST-0111, level 1 ")]
    shown = [float(number) for number in re.findall(r"(\S+) kN", row)]
    assert shown == pytest.approx(load, rel=6e-3)
    assert "simulated             " in said
    assert re.search(r"All axes together need \d+ % of the\sthrust\s\(simulated\) or \d+ %", said)
    words = " ".join(said.split())
    assert "CAUTION: the mean load in yaw differs by more than a factor of 2 between" in words
    assert "Munk moment" in words
    calm = path.read_text(encoding="utf-8").replace("0.75", "0.0")
    path.write_text(calm, encoding="utf-8")
    words = " ".join(
        check_ship.describe_checked_scenario(path, load_scenario(path), quick=True).split()
    )
    assert "level 1" in words and "Munk" not in words


@pytest.mark.parametrize(("vessel", "whole"), [("osv", "thrust"), ("supply_mss", "limits")])
def test_a_load_above_the_share_of_level_1_has_a_caution(
    vessel: str, whole: str, tmp_path: Path
) -> None:
    text = find_problem_path("scenarios", "calm").read_text(encoding="utf-8")
    head, _, controller = text.partition("[environment]")
    controller = controller[controller.index("\n[") :]
    said = []
    for wind_mps in (2.0, 60.0):
        wind = f"[environment.wind]\nspeed_mps = {wind_mps}\nfrom_deg = 330.0\n"
        path = tmp_path / "sea.toml"
        path.write_text(head.replace("supply_fs99", vessel) + wind + controller, encoding="utf-8")
        lines = check_ship.compare_with_level_1(load_scenario(path))
        said.append(" ".join(line for line in lines if "at most 72 % is allowed" in line))
    assert said[0] == ""
    assert re.fullmatch(rf"CAUTION: the level-1 load needs [\d.]+ % of the {whole}; .*", said[1])


def test_the_load_is_compared_with_the_thrust_left_after_a_loss() -> None:
    scenario = load_scenario("thrusters_loss")
    lines = check_ship.describe_checked_scenario("thrusters_loss", scenario, quick=True)
    thrusters = scenario.vessel.thrusters
    assert thrusters is not None
    left = ThrusterSet(tuple(one for one in thrusters.thrusters if one.group != "board A"))
    load = compute_mean_weather_force(scenario.vessel, scenario.environment, 0.0)
    share = ThrusterReach(left).find_least_thrust_share(-load)
    assert (
        "These shares are those of the intact ship. After the loss of board A at 90 s, the mean "
        f"load needs {100 * share:.0f} % (simulated) or 61 % (level 1) of the remaining "
        "thrust."
    ) in " ".join(lines.split())
    larger, cautions = check_ship._describe_shares_after_losses(
        scenario, {"simulated": 10.0 * load}
    )
    assert not cautions and "CAUTION: after the loss" not in lines
    assert "needs more than 100 % (simulated) of the remaining thrust. The ship then" in larger
    assert larger.endswith("cannot hold the mean load (simulated).") and "cannot" not in lines


def test_a_load_above_the_share_of_level_1_after_a_loss_has_a_caution() -> None:
    """Its wind of 13.8 m/s needs 61 % of the thrust left, one of 17 m/s 74 %."""
    scenario = load_scenario("thrusters_loss")
    said = []
    for wind_mps in (13.8, 17.0, 60.0):
        values = {"environment.wind.speed_mps": wind_mps}
        lines = check_ship.compare_with_level_1(copy_scenario_with_values(scenario, values, "wind"))
        said.append(" ".join(lines).partition("CAUTION: after the loss of board A at 90 s, ")[2])
    assert said[0] == ""
    needs = re.match(
        r"the level-1 load needs (\S+) % of the remaining thrust; at most 72 % is allowed\.",
        said[1],
    )
    assert needs is not None and 72.0 < float(needs[1]) < 100.0
    assert said[2].startswith("the level-1 load needs more than 100 % of the remaining thrust;")


def test_thrusters_show_what_they_make_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tunnels in the bow alone: 200 kN sideways, of which mains 4 m off hold 44 kN straight."""
    up_to(monkeypatch, 1.0)
    mains = [Thruster(f"main {y}", "main", -30.0, y, 200e3, 10.0, astern=0.5) for y in (-4.0, 4.0)]
    thrusters = ThrusterSet((*mains, Thruster("bow", "tunnel", 18.0, 0.0, 200e3, 10.0)))
    low, high = thrusters.least_and_largest_force_by_axis()
    ship = replace(load_vessel("osv"), thrusters=thrusters, tau_min=low, tau_max=high)
    text = check_ship.describe_checked_vessel(find_problem_path("vessels", "osv"), ship)
    assert "\nlargest force alone   -200 to 400 kN     ±44.4 kN           ±800 kN·m\n" in text
    assert "\nwith other axes       -200 to 400 kN     ±200 kN            ±" in text
    assert re.search(r"\ndrag at 1 m/s, °/s +\S+ kN +143 kN +", text)
    assert "The ship holds a current of 0.5" in text


@pytest.mark.slow
def test_what_the_paper_holds_is_what_the_loop_holds() -> None:
    """About 1.65 m of the paper's ship, and from both sides as from the one that is tried."""
    scenario = load_scenario("paper")
    tried: list[tuple[float, ...]] = []

    def holds(trial: Scenario, offset_m: float, sides: Sequence[float]) -> bool:
        tried.append(tuple(sides))
        return can_recover_from_offset(trial, offset_m, sides)

    one_side = find_bracket_in_still_water(scenario, holds)
    assert set(tried) == {(1.0,)}
    both = find_bracket_in_still_water(
        scenario, lambda trial, offset_m, _: can_recover_from_offset(trial, offset_m)
    )
    assert one_side == both
    assert both.fails_m is not None and 1.5 < both.holds_m < both.fails_m < 1.8
    assert both == find_bracket_of_recovery(lambda offset_m: offset_m <= both.holds_m)


def test_forces_in_half_turns_are_those_of_a_linear_program() -> None:
    """The largest force astern without sway force and yaw moment, of azimuths in half turns.

    Each thruster shares its thrust among the directions that it may take, half a degree apart.
    """
    vessel = load_vessel("osv")
    assert vessel.thrusters is not None
    starts_deg = {"stern port": -60.0, "stern starboard": -120.0}
    every, columns, owners = [], [], []
    for i, one in enumerate(vessel.thrusters.thrusters):
        angles, changed = np.radians([90.0, 270.0]), one
        if (start_deg := starts_deg.get(one.name)) is not None:
            half = np.radians([start_deg, start_deg + 180.0])
            angles = np.linspace(*half, 361)
            wide = half if start_deg == -60.0 else half - math.radians(120.0)
            sector = float(wide[0]), float(wide[0] + math.radians(300.0))
            planned = float(half[0]), float(half[1])
            changed = replace(one, sector_rad=sector, controller_sector_rad=planned)
        every.append(changed)
        force = one.thrust_N * np.array([np.cos(angles), np.sin(angles)])
        columns.append(np.vstack([force, one.x_m * force[1] - one.y_m * force[0]]))
        owners += [i] * len(angles)
    surge, sway, yaw = np.hstack(columns)
    shares = np.equal.outer(np.arange(len(every)), owners).astype(float)
    found = linprog(surge, shares, np.ones(len(every)), np.array([sway, yaw]), np.zeros(2))
    ship = replace(vessel, thrusters=ThrusterSet(tuple(every)))
    lines = check_ship.format_limits_by_axis(ship)
    (line,) = (line for line in lines if line.startswith("alone, in half turns"))
    assert float(line.split()[4]) == pytest.approx(found.fun / 1e3, rel=2e-3)
    assert f"largest force alone   {line.split()[4]}" not in "\n".join(lines)
