"""`dpbench check` takes what `dpbench run` takes, and says what is wrong in one line."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from qpsolvers import Problem

from dpbench.bench.sequences.source import read_sequence
from dpbench.cli.ship import check_ship
from dpbench.scenario.problem_files import find_problem_path, list_shipped_problem_names
from tests.cli.conftest import Say


def save(path: Path, *, q: float = -3.0, u: float = 1.0) -> None:
    """min x² + q·x − 2y + y²  with  x + y ≤ u."""
    P, G = 2.0 * np.eye(2), np.ones((1, 2))
    Problem(P, np.array([q, -2.0]), G, np.array([u])).save(str(path))


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with a folder of two problems, one problem, and a scenario."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "robot"
    folder.mkdir()
    save(folder / "step_2.npz")
    save(folder / "step_10.npz", q=-4.0)
    save(tmp_path / "alone.npz", u=50.0)
    text = find_problem_path("scenarios", "rough").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    return tmp_path


@pytest.fixture(autouse=True)
def _quick_trials(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a tuning hold 1 m; `test_check_ship` tries real loops."""
    monkeypatch.setattr(
        check_ship, "can_recover_from_offset", lambda trial, offset_m, sides: offset_m <= 1.0
    )


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ("robot", "robot: 2 QPs, n = 2, m = 1; certificates: 2 linear; largest error bound "),
        ("robot/", "robot: 2 QPs, n = 2, m = 1; certificates: 2 linear; largest error bound "),
        (
            "alone.npz",
            "alone.npz: 1 QP, n = 2, m = 1; certificates: 1 linear; largest error bound",
        ),
        ("rough@osv", "rough@osv: a scenario of 2000 steps with vessel osv"),
        ("mine.toml@osv", "mine.toml@osv: a scenario of 2000 steps with vessel osv"),
        ("rough", "a scenario of 2000 steps with vessel "),
        ("osv", "osv.toml: a vessel, "),
        ("ratownik", "ratownik.toml: a vessel, "),
        ("smoke", "smoke.toml: a suite of "),
        ("paper-30-5", "paper-30-5.npz: "),
    ],
)
def test_check_takes_what_run_takes(asked: str, said: str, place: Path, say: Say) -> None:
    assert said in say("check", asked).splitlines()[0]


@pytest.mark.slow
@pytest.mark.parametrize("suite", list_shipped_problem_names("suites"))
def test_check_takes_every_suite(suite: str, say: Say) -> None:
    text = " ".join(say("check", suite).split())
    about, _, rest = text.partition(": a suite of ")
    assert about.endswith(f"{suite}.toml") and int(rest.split(" cells")[0]) > 0
    counts = (
        r" cells(, \d+ with the baseline law)?"
        r"(, \d+ refused \(reasons: dpbench run SUITE --dry-run\))?"
        r"(; \d+ rows in runs.parquet)?"
    )
    expected = (
        counts
        + r" Estimated time: (at least )?[\d.]+ (s|min|h) on this machine with .*\. "
        + r"Tables: [\d.]+ MB\."
    )
    assert re.search(expected, rest)


@pytest.mark.slow
def test_check_and_run_count_the_same_cells(say: Say) -> None:
    """Those to run and the refused ones of `run --dry-run` are the cells of `check`."""
    shown = " ".join(say("check", "thrusters", "--quick").split())
    checked = re.search(r"a suite of (\d+) cells, .*?(\d+) refused ", shown)
    dry = re.search(
        r"([\d ]+) cells to run and ([\d ]+) refused", say("run", "thrusters", "--dry-run")
    )
    assert checked is not None and dry is not None
    to_run, refused = (int(text.replace(" ", "")) for text in dry.groups())
    assert (int(checked[1]), int(checked[2])) == (to_run + refused, refused)


@pytest.mark.parametrize(("policy", "warned"), [("warm", False), ("reuse", True)])
def test_a_suite_in_which_nothing_can_pass_is_said_to_be(
    policy: str, warned: bool, place: Path, say: Say
) -> None:
    """A verdict needs a closed loop and a replay of one configuration."""
    (place / "suite.toml").write_text(
        'title = "x"\nsolvers = ["daqp"]\n'
        '[[closed_loop]]\nscenarios = ["paper"]\nroutes = ["native"]\npolicies = ["warm"]\n'
        f'[[replay]]\nscenario = "paper"\nroutes = ["native"]\npolicies = ["{policy}"]\n',
        encoding="utf-8",
    )
    text = " ".join(say("check", "suite.toml").split())
    assert "suite.toml: a suite of 2 cells Estimated time: " in text
    assert ("both a closed loop and a replay, so none can pass" in text) is warned


def test_a_first_run_is_that_of_the_checked_scenario(place: Path, say: Say) -> None:
    """A copy that the suite beside it does not contain replaces the suite's own."""
    (place / "mine_gale.toml").write_bytes((place / "mine.toml").read_bytes())
    (place / "mine_suite.toml").write_text(
        'title = "x"\nsolvers = ["daqp"]\n[[closed_loop]]\nscenarios = ["mine.toml"]\n',
        encoding="utf-8",
    )
    run, rest = "dpbench run mine_suite.toml", "--solver daqp --settings default --out results"
    for file in ("mine.toml", "mine_suite.toml"):
        assert f"{run} {rest}/first" in " ".join(say("check", file, "--quick").split())
    text = " ".join(say("check", "mine_gale.toml", "--quick").split())
    assert f"{run} --scenario mine_gale.toml {rest}/first-mine_gale" in text


def test_the_loops_of_a_suite_that_are_unstable_without_limits_are_named(
    place: Path, say: Say
) -> None:
    """`rough` at N_p = 20 has |λ| = 1.0091 by paper eq. 35, at 60 below 1."""
    (place / "suite.toml").write_text(
        'title = "x"\nsolvers = ["daqp"]\n'
        '[[study]]\nbase = "rough"\nproduct = { "controller.prediction_horizon" = [60, 20] }\n',
        encoding="utf-8",
    )
    text = " ".join(say("check", "suite.toml").split())
    assert text.count("unstable") == 1
    assert ": a suite of 4 cells, 2 with the baseline law Estimated time: " in text
    assert (
        "suite.toml: rough, point 1: unstable without limits at `prediction_horizon = 20` "
        "(largest |λ| 1.0091, paper eq. 35)"
    ) in text


def test_the_tables_of_a_suite_are_named(place: Path, refuse: Say) -> None:
    (place / "else.toml").write_text('title = "x"', encoding="utf-8")
    tables = "[[study]], [[replay]], [[recorded]], [[random]], [[capability]]"
    line = refuse("check", "else.toml")
    assert tables in line and "[[thrusters]] (a vessel)" in line
    assert "found no vessel, scenario or suite, only the key title; required:" in line


def test_a_plug_in_is_not_read_as_toml(refuse: Say) -> None:
    found = refuse("check", "mysolv.py")
    assert found.endswith("dpbench run smoke --solver-module mysolv.py --solver NAME`")
    assert "TOML" not in found


def test_a_vessel_with_a_hull_and_misspelt_limits_is_no_suite(place: Path, refuse: Say) -> None:
    """A vessel has one table [capability], a suite a list of them."""
    (place / "hull.toml").write_text("[limitz]\n[capability]\nbreadth_m = 18.0\n", encoding="utf-8")
    line = refuse("check", "hull.toml")
    assert "only the keys limitz, capability; required: [limits] or [[thrusters]]" in line


def spoil(name: str, **arrays: object) -> Callable[[Path], None]:
    def apply(place: Path) -> None:
        path = place / name
        with np.load(path, allow_pickle=True) as found:
            kept = dict(found)
        np.savez(path, **kept | arrays)

    return apply


def cut(place: Path) -> None:
    path = place / "alone.npz"
    path.write_bytes(path.read_bytes()[:200])


def other_size(place: Path) -> None:
    Problem(np.eye(1), np.ones(1)).save(str(place / "robot" / "step_11.npz"))


def empty(place: Path) -> None:
    (place / "hollow").mkdir()


@pytest.mark.parametrize(
    ("asked", "harm", "parts"),
    [
        ("alone.npz", spoil("alone.npz", q=np.array([1.0, np.nan])), ["q[1]", "nan"]),
        ("alone.npz", spoil("alone.npz", P=np.array([[1.0, 2.0], [0.0, 1.0]])), ["symmetric"]),
        (
            "alone.npz",
            spoil("alone.npz", spam=np.ones(1)),
            ["spam", "allowed: the arrays P, q"],
        ),
        ("alone.npz", cut, ["a damaged file"]),
        ("robot", spoil("robot/step_10.npz", h=np.ones(3)), ["step_10.npz", "h", "(3,)"]),
        ("robot", other_size, ["step_11.npz", "found 1 variable, 0 rows; allowed: 2 variables, "]),
        ("hollow", empty, ["no .npz, .json or .mat file"]),
        ("rough@ovs", None, ["vessel", "'ovs'", "osv"]),
        ("ruogh@osv", None, ["'ruogh'", "rough"]),
        ("rough@", None, ["vessel", "''"]),
        ("@osv", None, ["scenario name", "''"]),
        ("ruogh", None, ["'ruogh'", "rough"]),
        ("no/such/folder", None, ["no such file or folder"]),
        ("none.npz", None, ["none.npz", "no such file or folder"]),
    ],
)
def test_what_is_wrong_is_one_line_and_exit_2(
    asked: str,
    harm: Callable[[Path], None] | None,
    parts: list[str],
    place: Path,
    say: Say,
    refuse: Say,
) -> None:
    if harm is not None:
        # Whole before.
        (refuse if harm is empty else say)("check", asked)
        harm(place)
    line = refuse("check", asked)
    assert all(part in line for part in parts), line


def test_a_problem_that_cannot_be_met_is_certified_so(place: Path, say: Say) -> None:
    rows = np.array([[1.0, 0.0], [-1.0, 0.0]])
    Problem(np.eye(2), np.zeros(2), rows, np.array([-1.0, -1.0])).save("never.npz")
    assert "certificates: 1 infeasible" in say("check", "never.npz")


def test_one_problem_is_a_sequence_of_one_step(place: Path) -> None:
    sequence = read_sequence(Path("alone.npz")).sequence
    assert (sequence.name, len(sequence)) == ("alone", 1)
    assert sequence.base.u.tolist() == [50.0] and sequence.base.l.tolist() == [-np.inf]


def test_a_suite_with_counts_on_embedded_cores(place: Path, say: Say, refuse: Say) -> None:
    suite = 'title = "t"\nsolvers = ["daqp"]\n[embedded]\nsequences = ["paper:0:STEPS"]\n'
    suite += 'solvers = ["daqp", "osqp", "quadprog"]\n[[replay]]\nscenario = "paper"\nsteps = 5\n'
    (place / "counts.toml").write_text(suite.replace("STEPS", "9"))
    assert (
        say("check", "counts.toml").splitlines()[-1]
        == "also 3 instruction counts on embedded cores"
    )
    (place / "counts.toml").write_text(suite.replace("STEPS", "1001"))
    line = refuse("check", "counts.toml")
    assert "counts.toml: embedded.sequences: found 'paper:0:1001'" in line


def test_the_list_of_scenarios_names_what_each_draws_at_random(say: Say) -> None:
    """`rough` has sines and ramps alone; `weather` has gusts and a sea."""
    text = " ".join(say("list", "scenarios").split())
    about = {name: text.partition(f" {name} vessel ")[2][:120] for name in ("rough", "weather")}
    assert "steps; random: none" in about["rough"]
    assert "steps; random: gusts, waves" in about["weather"]
