"""`dpbench capability`: the table within 80 columns, JSON, solvers judged, and bad input."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from dpbench.bench.capability import frontier
from dpbench.bench.capability.frontier import FROM_DEG, Capability, WindLimit
from dpbench.bench.sequences.sequence_file import load_sequence
from dpbench.cli.ship.capability import format_wind_table
from dpbench.scenario.problem_files import find_problem_path
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.thrusters import ThrusterSet
from dpbench.solvers import table
from dpbench.solvers.table import Availability
from tests.cli.conftest import Say

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def _place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_the_table_fits_a_terminal_and_names_what_is_assumed(say: Say) -> None:
    """36 rows, the notation, the groups, and the hull's keys that the file leaves out."""
    lines = say("capability", "osv").splitlines()
    assert max(map(len, lines)) <= 80
    rows = [line for line in lines if line[:4].strip().isdigit() and line[4] == "°"]
    assert [int(row[:4]) for row in rows] == [int(from_deg) for from_deg in FROM_DEG]
    text = "\n".join(lines)
    for said in (
        "DP capability-L1(",
        "Failure board A: bow 1 and stern port are lost.",
        "Assumed: hull data",
    ):
        assert said in text
    # Ahead this ship holds all the weather the standard knows.
    assert "32.6+ 11" in rows[0]


def test_it_names_the_closed_loop_that_a_static_balance_does_not_replace(say: Say) -> None:
    """The sea is the largest that is held near the bow, of those that `init` knows."""
    assert say("capability", "osv").splitlines()[-2:] == [
        "ship can still leave its station in closed loop. To simulate it:",
        "  dpbench run smoke --scenario thrusters@osv",
    ]
    Path("here").mkdir()
    Path("here/mine.toml").write_text(
        find_problem_path("vessels", "osv").read_text("utf-8"), "utf-8"
    )
    text = say("capability", "here/mine.toml")
    number = min(9, int(text.split("capability-L1(")[1].split(",")[0]))
    assert text.splitlines()[-2:] == [
        f"  dpbench init mine --sea {number} --out here",
        f"  dpbench run here/mine_sea{number}_suite.toml",
    ]
    say("init", "mine", "--sea", str(number), "--out", "here")
    assert Path(f"here/mine_sea{number}_suite.toml").is_file()


def test_json_and_a_figure_say_the_same_as_the_table(say: Say) -> None:
    document = json.loads(say("capability", "osv", "--json", "--figure", "rose.svg"))
    assert [case["name"] for case in document["cases"]] == ["intact", "board A", "board B"]
    assert document["cases"][1]["lost"] == ["bow 1", "stern port"]
    assert document["from_deg"] == list(FROM_DEG)
    least = min(document["cases"][0]["number"])
    assert document["notation"].startswith("DP capability-L1(")
    assert document["notation"].split(", ")[1] == str(least)
    assert Path("rose.svg").read_text(encoding="utf-8").startswith("<svg")


def test_many_groups_are_told_by_the_worst() -> None:
    held = {
        case: tuple(WindLimit(20.0 - i, 7) for _ in FROM_DEG)
        for i, case in enumerate(["intact", *"abcde"])
    }
    capability = Capability("osv", None, held, dict.fromkeys(held, ()), ())
    lines = format_wind_table(capability, load_vessel("osv"))
    (head,) = (line for line in lines if line.startswith(" from"))
    assert head.split() == ["from", "intact", "worst", "failure"]
    assert "15.0" in next(line for line in lines if line.startswith("   0°"))


def test_what_controllers_plan_with_is_beside_each_case_within_80_columns() -> None:
    """Four cases in winds of two digits; a zero is explained.

    No columns where the controllers plan with the whole circle of each azimuth.
    """
    held, half = (
        {case: tuple(WindLimit(wind, 0) for _ in FROM_DEG) for case in ("intact", *"abc")}
        for wind in (32.66, 10.68)
    )
    no_loss = dict.fromkeys(held, ())
    plots = (Capability("osv", None, winds, no_loss, ()) for winds in (held, half))
    capability, planned = plots
    osv = load_vessel("osv")
    plain = format_wind_table(capability, osv, planned)
    (row,) = (line for line in plain if line.startswith("   0°"))
    assert row.split()[1:] == ["32.6", "0"] * 4
    assert osv.thrusters is not None
    wide = [
        replace(one, sector_rad=(0.0, 4.0)) if one.kind == "azimuth" else one
        for one in osv.thrusters.thrusters
    ]
    ship = replace(osv, thrusters=ThrusterSet(tuple(wide)))
    lines = format_wind_table(capability, ship, planned)
    assert max(map(len, lines)) <= 80
    (row,) = (line for line in lines if line.startswith("   0°"))
    assert row.split()[1:] == ["32.6", "0", "10.6"] * 4
    text = " ".join(lines)
    assert "planned: the wind held with the half turn of each azimuth" in text
    assert "stern port pushes 0° to 229.18° (race 180° to 49.18°), barred 229.18° to 360°" in text
    assert "barred 229.18°" not in " ".join(plain)
    same = "planned: the same, as controllers plan with all directions of each azimuth."
    assert same in " ".join(plain)
    assert "Number 0: not even number 1 is held, a wind of 1.5 m/s" in text


def test_the_notation_is_that_of_the_standard() -> None:
    """Least numbers: within 30° of the bow and all round, intact and after the worst failure."""
    numbers = [5 if from_deg == 90.0 else 7 + (from_deg > 180.0) for from_deg in FROM_DEG]
    intact = tuple(WindLimit(10.0 + n, n) for n in numbers)
    failures = {
        "a": tuple(WindLimit(held.wind_mps - 2.0, held.number - 1) for held in intact),
        "b": tuple(WindLimit(9.0, 4) if k == 3 else held for k, held in enumerate(intact)),
    }
    capability = Capability("some", None, {"intact": intact, **failures}, {}, ())
    assert capability.dp_capability_numbers == (7, 5, 4, 4)
    assert capability.notation == "DP capability-L1(7, 5, 4, 4)"


def test_solvers_are_asked_at_the_edge_and_judged(
    say: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frontier, "DIRECTIONS", 4)
    for module in ("bench.capability.frontier", "bench.capability.edge_qps", "cli.ship.capability"):
        monkeypatch.setattr(f"dpbench.{module}.FROM_DEG", (20.0, 110.0, 200.0, 290.0))
    words = "capability osv --sides 12 --solver quadprog --out edge"
    table = say(*words.split()).split("QPs at the wind limit")[1]
    (row,) = (line.split() for line in table.splitlines() if line.startswith("quadprog"))
    (balanced, feasible), (refused, infeasible) = (cell.split("/") for cell in row[1:3])
    assert (balanced, refused, row[3]) == (feasible, infeasible, "0")
    assert int(infeasible) > 12
    assert int(feasible) + int(infeasible) == len(load_sequence("edge/capability.npz"))
    assert Path("edge/run/runs.parquet").is_file()
    assert max(map(len, table.splitlines())) <= 80


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["supply_mss"], "thrusters: missing; required: a [[thrusters]] table for each thruster"),
        (["nowhere"], "vessel name: found 'nowhere'; allowed: "),
        (["osv", "--sides", "5"], "--sides: found 5; allowed: an even number, 4 or more"),
        (
            ["osv", "--figure", "rose.jpg"],
            "--figure: found rose.jpg; allowed: a file name that ends",
        ),
        (["osv", "--sides", "8", "--solver", "nobody"], "'nobody'"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_input_is_one_line(words: list[str], said: str, refuse: Say) -> None:
    assert said in refuse("capability", *words)
    assert list(Path().iterdir()) == []


def test_a_solver_that_is_not_installed_is_named(
    refuse: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    missing = Availability(False, reason="not installed")
    monkeypatch.setattr(table, "find_solver_availability", lambda solver: missing)
    line = refuse("capability", "osv", "--solver", "quadprog")
    assert line.endswith("solver quadprog: not installed; run `pip install quadprog`")
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("breadth_m = 18.0\ndraught_m", "draught_m", "capability.breadth_m: missing"),
        ("draught_m = 5.0", "draught_m = -5.0", "capability.draught_m: found -5.0"),
        ("[capability]", "[capability]\nbow_angle_deg = 95.0", "capability.bow_angle_deg"),
        (
            "[windage]\nfrontal_m2 = 344.0\nlateral_m2 = 830.0\n",
            "",
            "allowed: [capability] only with [windage]",
        ),
        (
            "thrust_kN = 420.0",
            "thrust_kN = 420.0\nheight_m = 1.0",
            "height_m only together with power_kW",
        ),
    ],
    ids=lambda text: text.splitlines()[0] if text else "nothing",
)
def test_a_bad_hull_is_named(old: str, new: str, said: str, refuse: Say) -> None:
    text = find_problem_path("vessels", "osv").read_text(encoding="utf-8")
    assert old in text
    Path("mine.toml").write_text(text.replace(old, new), encoding="utf-8")
    complaint = refuse("capability", "mine.toml")
    assert complaint.startswith("dpbench: mine.toml") and said in complaint
