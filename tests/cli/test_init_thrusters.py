"""`dpbench init --thrusters`: the files of a ship with its thrusters, and what is refused."""

import io
import json
import math
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dpbench import run_closed_loop
from dpbench.bench.capability.frontier import FROM_DEG, CapabilityPlot
from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.suite import load_path_and_suite
from dpbench.cli.main import main
from dpbench.scenario.controllers.kinds import JointForceController
from dpbench.scenario.own_ship import DP_NUMBERS, compute_limit_share_of_dp_number
from dpbench.scenario.own_thrusters import LOADING_KW_PER_M2
from dpbench.scenario.scenario import load_scenario, load_vessel
from dpbench.ship.thrusters import format_sector

pytestmark = pytest.mark.slow
PARTICULARS = ["--length", "80", "--breadth", "18", "--draught", "6", "--displacement", "6000"]
TABLE = """kind,x_m,y_m,power_kW,group
main,-38,-4,2000,board A
main,-38,4,2000,board B
tunnel,33,,800,board A
tunnel,30,,800,board B
azimuth,-30,0,1200,board B
"""
FILES = ("my_ship.toml", "my_ship_weather.toml", "my_ship_thrusters.toml", "my_ship_suite.toml")


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def init(table: str, *more: str) -> int:
    Path("mine.csv").write_text(table, encoding="utf-8")
    return main(["init", "my_ship", *PARTICULARS, "--thrusters", "mine.csv", *more])


def test_two_mains_two_tunnels_and_an_azimuth_on_two_boards(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Board B leaves a main and a tunnel, which hold no wind: its loss has its own scenario."""
    assert init(TABLE) == 0
    said = capsys.readouterr().out
    assert all(name in said for name in (*FILES, "my_ship_capability.svg"))
    assert "DP capability-L1(8, 5, 0, 0)" in said
    words = " ".join(said.split())
    assert (
        "board A (my_ship_thrusters.toml, the worst after which a sea is held), "
        "board B (my_ship_loss_board_B.toml)"
    ) in words
    assert (
        "CAUTION: according to level 1, the thrusters do not hold this sea without board B."
        in words
    )
    beyond = "a wind of 1.5 m/s from 30°, is held without board B: a smaller --sea does not help."
    assert f"Not even DP capability number 1, {beyond}" in words
    assert "After the loss of board B: no tunnel or azimuth is left at the stern; put one" in words
    assert "harder:" not in said
    (other,) = load_scenario("my_ship_loss_board_B.toml").files["scenario"]["faults"]
    assert other["lost"] == ["board B"] and other["loss"] == "trip"
    vessel, scenario = load_vessel(FILES[0]), load_scenario(FILES[2])
    assert vessel.thrusters is not None
    low, high = vessel.thrusters.least_and_largest_force_by_axis()
    np.testing.assert_allclose(vessel.tau_min, low)
    np.testing.assert_allclose(vessel.tau_max, high)
    assert vessel.thrusters.indices_by_failure_group == {"board A": (0, 2), "board B": (1, 3, 4)}
    tunnel = vessel.thrusters.thrusters[2].screw
    assert tunnel is not None
    assert 800.0 / tunnel.diameter_m**2 == pytest.approx(LOADING_KW_PER_M2["tunnel"], rel=1e-2)
    assert scenario.files["scenario"]["controller"]["kind"] == "thrusters"
    (fault,) = scenario.files["scenario"]["faults"]
    assert fault["lost"] == ["board A"] and fault["loss"] == "trip"
    forces = load_scenario(FILES[1]).controller
    assert isinstance(forces, JointForceController)
    path, suite = load_path_and_suite(FILES[3])
    cells = plan_suite(suite, solvers=["daqp"], beside=path.parent)
    assert {cell.cell.mode for cell in cells} == {"closed_loop", "replay"}
    assert {"reuse", "warm"} <= {cell.cell.policy for cell in cells}
    assert suite.closed_loop[1].scenarios == ["my_ship_thrusters.toml", "my_ship_loss_board_B.toml"]
    assert any(table.consequence for table in suite.replay)
    assert Path("my_ship_capability.svg").read_text(encoding="utf-8").startswith("<svg")


def test_a_capability_plot_is_not_written_over(capsys: pytest.CaptureFixture[str]) -> None:
    """The plot belongs to the ship: another sea leaves it as it is, and prints its notation."""
    plot = Path("my_ship_capability.svg")
    plot.write_text("mine", encoding="utf-8")
    assert init(TABLE) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert "my_ship_capability.svg exists; " in line and not Path(FILES[0]).exists()
    assert init(TABLE, "--force") == 0
    plot.write_text("mine", encoding="utf-8")
    capsys.readouterr()
    assert main(["init", "my_ship", "--sea", "3"]) == 0
    notation = "DP capability-L1(8, 5, 0, 0) without rudders"
    assert f"\n{notation}\nwrote my_ship_sea3.toml" in capsys.readouterr().out
    assert plot.read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    ("zones", "power_kW", "said"),
    [
        (
            ",240,300,",
            2000,
            r"without barred zones (\S+) m/s would be held; narrow the zones, or add",
        ),
        (
            ",240,300,azimuth 4",
            2000,
            r"the cause is the half turn of azimuth \d \(controller_sector_deg\); in the "
            r"capability plot, with all directions, (\S+) m/s is held. To hold a sea with the "
            r"half turn, add",
        ),
        (",,,", 30, "the thrusters left at bow and stern are too weak; add a stronger thruster"),
    ],
)
def test_a_loss_after_which_bow_and_stern_have_thrusters_has_another_remedy(
    zones: str, power_kW: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Narrower zones where that is enough: the wind is that of the ship without any zone.

    A zone that is open after the loss is no cause, but the half turn, which the controller keeps.
    """
    starboard = zones.replace("240,300", "60,120").replace("azimuth 4", "azimuth 3")
    rows = ["kind,x_m,y_m,power_kW,group,barred_from_deg,barred_to_deg,barred_protects"]
    rows += ["tunnel,33,,800,board A,,,", f"tunnel,30,,{min(800, power_kW)},board B,,,"]
    rows += [f"azimuth,-35,-3,2000,board A{zones}", f"azimuth,-35,3,2000,board B{starboard}"]
    if power_kW < 800:
        rows[3:] = ["azimuth,-35,-3,30,board A,,,", "azimuth,-35,3,2000,board B,,,"]
        rows[1:3] = ["tunnel,33,,800,board B,,,", "tunnel,30,,30,board A,,,"]
    assert init("\n".join(rows) + "\n") == 0
    words = " ".join(capsys.readouterr().out.split())
    found = re.search(f"After the loss of board [AB]: {said}", words)
    assert found is not None and "put one on every" not in words
    if found.groups():
        vessel = load_vessel(FILES[0])
        assert vessel.thrusters is not None
        turning = (
            replace(t, sector_rad=None, controller_sector_rad=None)
            for t in vessel.thrusters.thrusters
        )
        free = replace(vessel, thrusters=replace(vessel.thrusters, thrusters=tuple(turning)))
        plot = CapabilityPlot(vessel if "azimuth 4" in zones else free)
        (case,) = (c for c in plot.intact_and_failure_cases if c.name == "board B")
        assert float(found[1]) == pytest.approx(
            plot.find_wind_limit(case, math.radians(330.0)).wind_mps - 0.05, abs=0.051
        )


def test_what_is_assumed_of_thrusters_is_printed_and_marked(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """By value and thruster; not what the table gives."""
    rows = TABLE.replace("power_kW,group", "power_kW,group,diameter_m,astern")
    given = rows.replace("main,-38,-4,2000,board A", "main,-38,-4,2000,board A,3.2,0.6")
    assert init(given) == 0
    said = " ".join(capsys.readouterr().out.split())
    sizes = "3.81 m (main 2), 1.64 m (tunnel 3, tunnel 4), 2.95 m (azimuth 5)"
    assert f"Diameters, from the power as on the rescue ship Ratownik: {sizes}." in said
    assert "Ratio of thrust astern to thrust ahead: 0.79 (main 2)." in said
    _, first, second, *_ = Path(FILES[0]).read_text(encoding="utf-8").split("[[thrusters]]\n")
    assert "diameter_m = 3.2\n" in first and "astern = 0.6\n" in first
    assert "diameter_m = 3.81  # assumed\n" in second and "astern = 0.79  # assumed\n" in second
    source = tomllib.loads(Path(FILES[0]).read_text(encoding="utf-8"))["source"]
    assert "section IV" not in source
    assumed = source.partition("; limits: computed from the thrusters; assumed: ")[2]
    assert assumed.startswith("rise times ") and f"; diameters {sizes}; " in assumed
    windage = tomllib.loads(Path(FILES[0]).read_text(encoding="utf-8"))["windage"]
    areas = f"wind areas {windage['frontal_m2']:.0f} m² in front, {windage['lateral_m2']:.0f} m²"
    assert (
        f"; ratio of thrust astern to thrust ahead 0.79 (main 2); {areas} on the side, " in assumed
    )
    assert f"assumed: {areas} on the side, scaled from " in said
    assert "; enter yours in [windage] of my_ship.toml (frontal_m2, lateral_m2)" in said


def test_capability_prints_the_wind_areas_of_the_file(capsys: pytest.CaptureFixture[str]) -> None:
    """Assumed ones as `init` wrote them, and others once the file has them."""
    assert init(TABLE) == 0
    capsys.readouterr()
    assert main(["capability", FILES[0]]) == 0
    scaled = " ".join(capsys.readouterr().out.split())
    assert "; wind areas 304 m² in front, 772 m² on the side, scaled from " in scaled
    file = Path(FILES[0])
    text = re.sub(r"frontal_m2 = \S+", "frontal_m2 = 350.0", file.read_text(encoding="utf-8"))
    text = re.sub(r"lateral_m2 = \S+", "lateral_m2 = 1000.0", text)
    file.write_text(text, encoding="utf-8")
    assert main(["capability", FILES[0]]) == 0
    own = " ".join(capsys.readouterr().out.split())
    assert "Wind areas as given: 350 m² in front, 1000 m² on the side." in own
    assert "304 m²" not in own and "772 m²" not in own
    assert "Assumed: rise times " in own


SMALL = """kind,x_m,y_m,power_kW,group
main,-21,-3,900,board A
main,-21,3,900,board B
tunnel,18,,300,board A
tunnel,-18,,300,board B
azimuth,16,0,400,board B
azimuth,-15,0,400,board A
"""
"""A ship of 45 m that a move weight of 0.1 loses at a lag of 2 s."""


@pytest.mark.parametrize("kind", ["weather", "thrusters"])
def test_the_controller_holds_the_ship_with_twice_the_lag_that_is_written(kind: str) -> None:
    """Lag of 1 s at 76.2 m, by Froude's law; the plant with lag is tested in `test_actuators`."""
    small = ["--length", "45", "--breadth", "12", "--draught", "4", "--displacement", "1400"]
    Path("small.csv").write_text(SMALL, encoding="utf-8")
    assert main(["init", "small", *small, "--thrusters", "small.csv"]) == 0
    scenario = load_scenario(f"small_{kind}.toml")
    lag_s = scenario.files["scenario"]["plant"]["thruster_lag_s"]
    assert lag_s == pytest.approx(math.sqrt(45.0 / 76.2), abs=5e-3)
    for factor in (1.0, 2.0):
        lagging = scenario.with_keys({"plant.thruster_lag_s": factor * lag_s})
        found = run_closed_loop(lagging, "daqp").summary
        assert math.isnan(found["exact_left_s"])
        assert found["exact_offset_end_m"] < 0.1


def test_turning_rates_that_nothing_limits_are_said_to_be_unused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows = TABLE.replace("power_kW,group", "power_kW,group,turning_degps")
    assert init(rows.replace("-30,0,1200,board B", "-30,0,1200,board B,12")) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "turning_degps of azimuth 5 is not used: neither the controller nor the" in said
    assert main(["check", FILES[2], "--quick"]) == 0
    said = capsys.readouterr().out
    assert "turning_degps is not used without azimuth_turning = true in the controller." in said


@pytest.mark.parametrize("kind", ["azimuth", "tunnel"])
def test_rudders_are_said_not_to_count_where_mains_alone_push_aft(
    capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    """By `init` and `capability`; where a tunnel pushes aft, too, only after its board is lost."""
    said = (
        "of midships only main propellers push. Rudders are not modelled: with its rudders, the "
        "ship may hold more wind. Power limits are not counted: with them, it may hold less."
    )
    when = "Aft" if kind == "azimuth" else "After the loss of board B, aft"
    place = "20" if kind == "azimuth" else "-30"
    assert init(TABLE.replace("azimuth,-30", f"{kind},{place}")) == 0
    notation = r"DP capability-L1\(\d+, \d+, \d+, \d+\) without rudders"
    shown = " ".join(capsys.readouterr().out.split())
    assert re.match(f"{when} {said} wrote my_ship_capability.svg: {notation} wrote ", shown)
    assert shown.count(said) == 1
    assert "Rudders are not modelled; those of a finished ship may hold a sea." in shown
    assert main(["capability", FILES[0]]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert re.search(f" {when} {said} {notation}: smallest number", shown)
    assert shown.count(said) == 1


def test_losses_come_after_settling_from_rest_and_are_simulated_for_400_s() -> None:
    """Without the approach, which still rings at 180 s; a ship may leave its station slowly."""
    assert init(TABLE) == 0
    for file in (*find_losses(), Path("my_ship_weak_side.toml")):
        scenario = load_scenario(file)
        (fault,) = scenario.files["scenario"]["faults"]
        assert not scenario.files["scenario"]["start"]["north_m"]
        assert fault["at_s"] >= 180.0
        assert scenario.steps * scenario.sample_s >= fault["at_s"] + 400.0
        assert "starts at rest" in scenario.shows
    assert load_scenario(FILES[1]).files["scenario"]["start"]["north_m"] > 0.0
    replays = load_path_and_suite(FILES[3])[1].replay
    assert [(replay.first, replay.steps) for replay in replays[1:]] == [(0, 1000), (500, 100)]


@pytest.mark.parametrize("astern", ["azimuth,-30,0,1200,board B\n", ""])
def test_the_weak_side_is_simulated_in_a_scenario_of_its_own(
    astern: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the largest sea up to the suite's that is held from there, after the loss if one is."""
    assert init(TABLE.replace("azimuth,-30,0,1200,board B\n", astern)) == 0
    said = " ".join(capsys.readouterr().out.split())
    plot = CapabilityPlot(load_vessel(FILES[0]))
    intact, board_A, _ = plot.intact_and_failure_cases
    case = board_A if load_scenario(FILES[2]).files["scenario"]["faults"] else intact
    assert (case is board_A) == bool(astern)
    limits = [plot.find_wind_limit(case, math.radians(deg)) for deg in FROM_DEG]
    winds = [round(limit.wind_mps, 3) for limit in limits]
    worst = winds.index(min(winds))
    bow_mps = load_scenario(FILES[2]).files["scenario"]["environment"]["wind"]["speed_mps"]
    weak = load_scenario("my_ship_weak_side.toml").files["scenario"]
    sea, faults = weak["environment"], weak["faults"]
    assert sea["wind"]["from_deg"] == sea["waves"]["from_deg"] == FROM_DEG[worst]
    held_mps = DP_NUMBERS[max(1, limits[worst].number)][0]
    assert sea["wind"]["speed_mps"] == min(bow_mps, held_mps)
    assert f"{math.floor(10 * winds[worst]) / 10:.1f} m/s from {FROM_DEG[worst]:g}°" in said
    assert "my_ship_weak_side.toml" in said
    assert [fault["lost"] for fault in faults] == ([["board A"]] if astern else [])
    tables = load_path_and_suite(FILES[3])[1].closed_loop
    in_suite = ["my_ship_weak_side.toml"] in [table.scenarios for table in tables]
    assert in_suite == (limits[worst].number > 0)
    assert in_suite != ("not in the suite: dpbench run smoke --scenario my_ship_weak" in said)


def test_the_intact_ship_is_simulated_in_the_sea_of_her_capability_number(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Without a loss, in the largest sea held off the bow: above that of the losses."""
    assert init(TABLE) == 0
    said = " ".join(capsys.readouterr().out.split())
    intact = load_scenario("my_ship_intact.toml")
    document = intact.files["scenario"]
    wind, faults = document["environment"]["wind"], document["faults"]
    plot = CapabilityPlot(load_vessel(FILES[0]))
    limit = plot.find_wind_limit(plot.intact_and_failure_cases[0], math.radians(wind["from_deg"]))
    assert wind == {"speed_mps": DP_NUMBERS[limit.number][0], "from_deg": 30.0, "gusts": "norsok"}
    assert limit.number > 5 and not faults
    assert intact.steps * intact.sample_s >= 600.0
    assert f"DP capability number {limit.number}, wind {wind['speed_mps']:g} m/s from 30°" in said
    tables = load_path_and_suite(FILES[3])[1].closed_loop
    assert ["my_ship_intact.toml"] in [table.scenarios for table in tables]
    assert main(["init", "my_ship", "--sea", str(limit.number)]) == 0
    assert not Path(f"my_ship_sea{limit.number}_intact.toml").exists()


def test_the_worst_group_is_lost_where_the_others_hold(capsys: pytest.CaptureFixture[str]) -> None:
    """A second azimuth on the other board: the sea is one that is held without board B."""
    assert init(TABLE + "azimuth,-25,0,1200,board A\n") == 0
    assert "without board" not in Path(FILES[2]).read_text(encoding="utf-8")
    lost = [load_scenario(file).files["scenario"]["faults"][0]["lost"] for file in find_losses()]
    assert sorted(lost) == [["board A"], ["board B"]]
    assert "do not hold" not in capsys.readouterr().out
    assert main(["init", "my_ship", "--sea", "9"]) == 0
    assert "my_ship_sea9_thrusters.toml" in capsys.readouterr().out
    assert not load_scenario("my_ship_sea9_thrusters.toml").files["scenario"]["faults"]
    files = sorted(Path().glob("my_ship_sea9_loss_*.toml"))
    assert [load_scenario(file).files["scenario"]["faults"][0]["lost"] for file in files] == [
        ["board A"],
        ["board B"],
    ]


def find_losses() -> list[Path]:
    """Return the scenario files of `my_ship` in which a group is lost."""
    return [Path(FILES[2]), *Path().glob("my_ship_loss_*.toml")]


def test_a_sea_beyond_the_thrusters_is_named_and_losses_are_simulated_there(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The wind of number 9 is 24.4 m/s."""
    assert init(TABLE, "--sea", "9") == 0
    said = " ".join(capsys.readouterr().out.split())
    held_mps = re.search(r"the wind of 24.4 m/s is beyond the (\S+) m/s that the thrusters", said)
    assert held_mps is not None and float(held_mps[1]) < 24.4
    assert "do not hold this sea without board B or without board A." in said
    assert re.search(r"DP capability number \d is held without board A: --sea \d\.", said)
    suite = load_path_and_suite(Path("my_ship_sea9_suite.toml"))[1]
    assert suite.closed_loop[1].scenarios == [
        "my_ship_sea9_thrusters.toml",
        "my_ship_sea9_loss_board_B.toml",
        "my_ship_sea9_loss_board_A.toml",
    ]


def test_of_many_failure_groups_three_are_lost_and_the_others_named(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """On the terminal and in the suite. Names that differ in other letters have files each."""
    rows = ["kind,x_m,y_m,power_kW,name", "main,-38,-4,2000,a", "main,-38,4,2000,b"]
    rows += ["tunnel,33,,800,bow/1", "tunnel,32,,800,bow 1", "azimuth,-30,0,1200,bow-1"]
    assert init("\n".join(rows) + "\n") == 0
    files = find_losses()
    assert len(files) == 3
    lost = {load_scenario(file).files["scenario"]["faults"][0]["lost"][0] for file in files}
    assert len(lost) == 3
    (said,) = re.findall(
        r"not simulated: the loss of (\S+|\S+ \S+) and (\S+|\S+ \S+) \(simulated: the 3 losses "
        r"with the least wind held\)",
        " ".join(capsys.readouterr().out.split()),
    )
    assert lost | set(said) == {"a", "b", "bow/1", "bow 1", "bow-1"}
    comments = " ".join(Path(FILES[3]).read_text(encoding="utf-8").replace("#", "").split())
    assert (
        f"Not simulated: the loss of {said[0]} and {said[1]} (simulated: the 3 losses" in comments
    )


def test_a_force_that_the_thrusters_cannot_make_is_no_share_of_the_limits(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Without an azimuth only the bow pushes sideways, by less than the limits of that axis."""
    bow_alone = "".join(TABLE.splitlines(keepends=True)[:-1])
    assert init(bow_alone, "--sea", "5") == 0
    said = " ".join(capsys.readouterr().out.split())
    share = re.search(r"mean force of level 1 needs (\d+) % of the thrust", said)
    assert share is not None
    assert int(share[1]) > 100 * compute_limit_share_of_dp_number(load_vessel(FILES[0]), 5)
    assert (
        "cannot hold station in this sea. Give it more force (--thrusters) or choose a smaller sea"
        in said
    ) == (int(share[1]) > 100)


def test_thrusters_with_a_sector_are_limited_axis_by_axis() -> None:
    """The attainable set of forces knows no sector."""
    rows = TABLE.replace("power_kW,group", "power_kW,group,sector_from_deg,sector_to_deg")
    assert init(rows.rstrip("\n") + ",-90,90\n") == 0
    assert not isinstance(load_scenario(FILES[1]).controller, JointForceController)


def test_barred_directions_leave_the_sector_and_both_are_printed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """By `init`, `check` and the comment of the file: none can take one for the other."""
    rows = TABLE.replace("power_kW,group", "power_kW,group,barred_from_deg,barred_to_deg")
    assert init(rows.rstrip("\n") + ",150,30\n") == 0
    said = (
        "azimuth 5 pushes 30° to 150° (race 210° to 330°), barred 150° to 30° (race 330° to 210°)"
    )
    assert said in " ".join(capsys.readouterr().out.split())
    text = Path(FILES[0]).read_text(encoding="utf-8")
    assert "sector_deg = [30.0, 150.0]  # from and to: the directions in which it pushes" in text
    barred = text.replace("sector_deg = [30.0, 150.0]", "barred_deg = [150, 30]")
    wrapped = text.replace("sector_deg = [30.0, 150.0]", "sector_deg = [390, 150]")
    sectors = []
    for same in (text, barred, wrapped):
        Path("same.toml").write_text(same, encoding="utf-8")
        thrusters = load_vessel("same.toml").thrusters
        assert thrusters is not None
        sectors.append(np.degrees(thrusters.thrusters[-1].sector_rad).tolist())
        assert main(["check", "same.toml", "--quick"]) == 0
        assert said in " ".join(capsys.readouterr().out.split())
    np.testing.assert_allclose(sectors, [[30.0, 150.0], [30.0, 150.0], [390.0, 510.0]])
    number = "barred_deg: found [150]; allowed: two numbers, from and to"
    for wrong, found in (("barred_deg = [150]", number), (None, "either sector_deg or")):
        both = "barred_deg = [150, 30]\nsector_deg = [30.0, 150.0]"
        spoilt = text.replace("sector_deg = [30.0, 150.0]", wrong or both)
        Path("same.toml").write_text(spoilt, encoding="utf-8")
        assert main(["check", "same.toml", "--quick"]) == 2
        assert found in capsys.readouterr().err


def test_a_narrow_barred_zone_stays_and_controllers_get_a_half_turn(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Barred astern, which the mains do better: the plot is that of a whole circle.

    The half turn from the zone to port of astern makes no force to starboard.
    """
    rows = TABLE.replace("power_kW,group", "power_kW,group,barred_from_deg,barred_to_deg")
    assert init(rows.rstrip("\n") + ",150,210\n") == 0
    shown = capsys.readouterr().out
    said = " ".join(shown.split())
    assert "DP capability-L1(8, 5, 0, 0)" in said
    assert "with the half turns of the controllers: DP capability-L1(" in said
    tried = re.search(r"azimuth 5: controllers plan with (\S+ to \S+)\. Of three half turns", said)
    assert tried is not None
    text = Path(FILES[0]).read_text(encoding="utf-8")
    assert "sector_deg = [210.0, 150.0]  # from and to" in text
    (heads,) = [line for line in shown.splitlines() if line.startswith("  wind held [m/s] ")]
    halves = ["270° to 90°", "210° to 30°", "330° to 150°"]
    assert re.split(r"  +", heads.strip())[1:] == halves
    cells = re.findall(r"^  (intact|after board [AB]) +(\S+) +(\S+) +(\S+)$", shown, re.MULTILINE)
    assert [case for case, *_ in cells] == ["intact", "after board A", "after board B"]
    by_half = zip(*([float(wind) for wind in row[1:]] for row in cells), strict=True)
    # The worst loss first, as they are compared.
    winds = {half: [*sorted(lost), mps] for half, (mps, *lost) in zip(halves, by_half, strict=True)}
    thrusters = load_scenario(FILES[2]).vessel.thrusters
    assert thrusters is not None
    azimuth = thrusters.thrusters[-1]
    assert azimuth.convex_sector_rad == azimuth.controller_sector_rad
    best = format_sector(azimuth.controller_sector_rad)
    assert winds[best] == max(winds.values())
    assert best == tried[1]
    for file in Path().glob("my_ship_*.toml"):
        comment = file.read_text(encoding="utf-8").replace("\n# ", " ")
        level_1 = comment.count("according to level 1")
        assert level_1 == comment.count("according to level 1 with the half turns of controllers")
        assert level_1 or "_suite" in file.name
    assert f"barred 150° to 210° (race 330° to 30°); controllers plan with {best}" in said
    plan = f"azimuth 5 {best} of 210° to 150°"
    assert main(["capability", FILES[0], "--planned", "--json"]) == 0
    planned = json.loads(capsys.readouterr().out)["planned"]
    assert plan in planned["about"][0]
    vessel = load_vessel(FILES[0])
    assert vessel.thrusters is not None
    half = replace(vessel, thrusters=vessel.thrusters.copy_with_convex_sectors())
    alone = CapabilityPlot(half)
    k, case = 12, alone.intact_and_failure_cases[1]
    limit = alone.find_wind_limit(case, math.radians(FROM_DEG[k]))
    assert planned["cases"][1]["wind_mps"][k] == pytest.approx(limit.wind_mps, abs=1e-3)


def test_of_equal_half_turns_the_middle_one_is_taken_and_the_tie_printed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """An azimuth of 10 W changes no wind by 0.1 m/s."""
    rows = TABLE.replace("power_kW,group", "power_kW,group,barred_from_deg,barred_to_deg")
    small = rows.rstrip("\n").replace("-30,0,1200,board B", "-30,0,0.01,board B,150,210")
    assert init(small) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "azimuth 5: controllers plan with 270° to 90°." in said
    assert "270° to 90°, 210° to 30° and 330° to 150° are equal within 0.1 m/s. Ties" in said


def test_printed_commands_name_the_files_in_the_output_folder(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """An azimuth with a barred zone adds a command for its half turn."""
    rows = TABLE.replace("power_kW,group", "power_kW,group,barred_from_deg,barred_to_deg")
    small = rows.rstrip("\n").replace("-30,0,1200,board B", "-30,0,0.01,board B,150,210")
    assert init(small, "--out", "bar") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "dpbench capability bar/my_ship.toml --planned" in said
    files = re.findall(r"dpbench \w+ (?:smoke --scenario )?([\w/]+\.toml)", said)
    assert len(files) >= 3 and all(Path(file).is_file() for file in files)


@pytest.mark.parametrize("of_race", [False, True])
def test_a_zone_that_bars_the_push_towards_a_thruster_but_not_the_race_is_warned_of(
    of_race: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    """By `init`, `check` and in the JSON of `capability`, whose title is the ship's own."""
    head = "name,kind,x_m,y_m,power_kW,group,barred_from_deg,barred_to_deg"
    port, starboard = ("240,300", "60,120") if of_race else ("60,120", "240,300")
    rows = [head, f"port,azimuth,-35,-5,1200,board A,{port}"]
    rows += [f"starboard,azimuth,-35,5,1200,board B,{starboard}"]
    rows += ["bow 1,tunnel,33,,800,board A,,", "bow 2,tunnel,30,,800,board B,,"]
    said = "may send its race there. To bar the race, set barred_deg = [240, 300]."
    assert init("\n".join(rows) + "\n") == 0
    assert (said in " ".join(capsys.readouterr().out.split())) != of_race
    figure = Path("my_ship_capability.svg").read_text(encoding="utf-8")
    assert "my_ship, 80 x 18 x 6 m, 6000 t: largest wind held" in figure
    assert main(["check", FILES[0], "--quick"]) == 0
    shown = capsys.readouterr().out
    assert (said in " ".join(shown.split())) != of_race
    assert shown.splitlines()[-1].startswith("  dpbench run my_ship_suite.toml --solver daqp")
    assert main(["capability", FILES[0], "--json"]) == 0
    assert (said in " ".join(json.loads(capsys.readouterr().out)["cautions"])) != of_race


def test_a_zone_kept_after_a_loss_is_named_until_the_file_says_what_it_protects(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """In the same group both are lost at once, and nothing is printed."""
    head = "name,kind,x_m,y_m,power_kW,group,barred_from_deg,barred_to_deg,barred_protects"
    kept = "The barred zone of `port` stays in force after the loss of `starboard`."
    opened = "after the loss of starboard, the capability plot counts all directions"
    for board, protects in (("B", ""), ("A", ""), ("B", "starboard")):
        rows = [head, f"port,azimuth,-35,-5,1200,board A,240,300,{protects}"]
        rows += [
            f"starboard,azimuth,-35,5,1200,board {board},,,",
            "bow 1,tunnel,33,,800,board A,,,",
        ]
        rows += ["bow 2,tunnel,30,,800,board B,,,"]
        assert init("\n".join(rows) + "\n", "--force") == 0
        said = " ".join(capsys.readouterr().out.split())
        assert (kept in said) == (board == "B" and not protects)
        assert (opened in said) == bool(protects)
    assert load_vessel(FILES[0]).thrusters.thrusters[0].barred_protects == "starboard"


@pytest.mark.parametrize("port", [-1, 1])
def test_the_sea_comes_from_the_side_of_the_bow_from_which_less_is_held(
    port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same sea on both sides: a ship and its mirror image."""
    rows = ["kind,x_m,y_m,power_kW,group"]
    rows += [f"main,-38,{4 * port},2000,board A", f"main,-38,{-4 * port},2000,board B"]
    rows += ["tunnel,33,,800,board A", "tunnel,30,,800,board B"]
    rows += [f"azimuth,-30,{3 * port},1200,board B", f"azimuth,-30,{-3 * port},1200,board A"]
    assert init("\n".join(rows) + "\n") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert (
        f"sea: DP capability number 5, wind 10.7 m/s from {330 if port > 0 else 30}°. The mean "
        "force of level 1 needs 28 % of the thrust; at most 72 % (0.9 / 1.25) is allowed. For "
        "another direction, edit from_deg and towards_deg in the scenario files."
    ) in said
    worse = ("port (330°)", "starboard (30°)")[::port]
    why = f"weather from {worse[0]}: there the ship holds less, 12.2 m/s without board A, than from"
    assert f"{why} {worse[1]}, 12.6 m/s without board B. " in said
    for file in FILES[1:3]:
        sea = load_scenario(file).files["scenario"]["environment"]
        assert sea["wind"]["from_deg"] == sea["waves"]["from_deg"] == (30.0 if port < 0 else 330.0)
        assert sea["current"]["towards_deg"] == (210.0 if port < 0 else 150.0)
        assert ("bow, to port;" in load_scenario(file).shows) == (port > 0)


def test_thrusters_are_asked_for(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """By power or, where that is empty, by thrust; an empty kind ends."""
    answers = ["azimuth", "-30", "-4", "", "200", "A", "azimuth", "-30", "4", "1500", "B", ""]
    monkeypatch.setattr("sys.stdin", io.StringIO("\n".join([*answers, ""])))
    assert main(["init", "my_ship", *PARTICULARS, "--thrusters", "-"]) == 0
    thrusters = load_vessel(FILES[0]).thrusters
    assert thrusters is not None
    assert [t.name for t in thrusters.thrusters] == ["azimuth 1", "azimuth 2"]
    assert thrusters.largest_thrusts_N[0] == 2e5
    assert "thruster 3, kind" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("table", "more", "said"),
    [
        ("kind,place\n", (), "'place': found an unknown column"),
        ("kind,power_kW\nmain,3\n", (), "first row: column x_m is missing; required: kind"),
        ("kind,x_m\n", (), "found 0 thrusters"),
        (TABLE.replace("800", "many", 1), (), "mine.csv, thruster 3: power_kW: found 'many'"),
        (TABLE.replace("800", "", 1), (), "thruster 3"),
        (TABLE.replace("800", "nan", 1), (), "thruster 3: power_kW: found nan"),
        (TABLE.replace("800", "-5", 1), (), "thruster 3: power_kW: found -5"),
        (TABLE.replace("-38", "-380", 1), (), "thruster 1: x_m: found -380; allowed: -48 to 48"),
        (TABLE.replace("azimuth", "pod"), (), "thruster 5: kind: found 'pod'"),
        (TABLE.replace("2000", "2000000"), (), "10 times the ship's weight"),
        (TABLE.replace("2000", "2").replace("00,board", ",board"), (), "0.0001 to 0.5 times the w"),
        (TABLE.replace(",", ";"), (), "first row: found columns separated by ';'; allowed: a com"),
        (
            "kind,x_m,thrust_kN\nmain,-38,100\n",
            (),
            "found main 1; allowed: thrusters that",
        ),
        ("kind,x_m,power_kW\nazimuth,-30,3000\n", (), "found azimuth 1; allowed: thrusters that"),
        (
            "kind,x_m,thrust_kN,sector_from_deg,sector_to_deg\n"
            "azimuth,-30,100,-60,60\nazimuth,30,100,-60,60\n",
            (),
            "to one side of an axis only",
        ),
        (
            TABLE.replace("group\n", "group,barred_from_deg,barred_to_deg\n").replace(
                "-30,0,1200,board B", "-30,0,1200,board B,150,"
            ),
            (),
            "thruster 5: barred_to_deg: missing",
        ),
        (TABLE, ("--thrust", "300"), "--thrusters and --thrust exclude each other"),
        (TABLE + "main,1,2,3,board A,more\n", (), "thruster 6: found 6 cells"),
    ],
)
def test_bad_tables_are_one_line(
    table: str, more: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the thruster's number and what is allowed; nothing is written."""
    assert init(table, *more) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert said in line
    assert [path.name for path in Path().iterdir()] == ["mine.csv"]
