"""Routes and policies chosen on the command line, in place of those of a suite."""

from pathlib import Path

import pytest

from dpbench.bench.plan.run_request import RunRequest
from dpbench.errors import PolicyError

SUITE = """
title = "Call modes"
solvers = ["osqp", "quadprog"]

[[closed_loop]]
scenarios = ["paper"]
steps = 5

[[replay]]
scenario = "paper"
steps = 5
policies = ["fresh", "reuse"]
"""


@pytest.fixture
def suite(tmp_path: Path) -> str:
    path = tmp_path / "modes.toml"
    path.write_text(SUITE)
    return str(path)


def test_a_chosen_call_mode_replaces_those_of_every_table(suite: str) -> None:
    plan = RunRequest(suite, routes=["native"], policies=["warm"]).make_plan()
    found = {
        (p.cell.mode, p.cell.solver, p.cell.route, p.cell.policy, bool(p.refused))
        for p in plan.cells
    }
    assert found == {
        (mode, solver, "native", "warm", solver == "quadprog")
        for mode in ("closed_loop", "replay")
        for solver in ("osqp", "quadprog")
    }
    assert plan.part
    assert plan.remarks[0] == (
        'quadprog does not run: it does not support route and policy "native warm"'
    )


def test_solvers_without_chosen_settings_are_named(suite: str) -> None:
    text = Path(suite).read_text()
    Path(suite).write_text(f"{text}\n[settings.mine.osqp]\nrho = 1.0\n")
    chosen = ["default", "high_polished", "mine"]
    plan = RunRequest(suite, settings=chosen, solvers=["osqp", "quadprog"]).make_plan()
    assert [text for text in plan.remarks if text.startswith("solvers")] == [
        f"solvers not run with settings {name}, as they do not have them: quadprog"
        for name in ("high_polished", "mine")
    ]
    alone = RunRequest(suite, settings=["default", "high_polished"], solvers=["osqp"]).make_plan()
    assert not [text for text in alone.remarks if text.startswith("solvers")]


@pytest.mark.parametrize(
    ("steps", "hardest", "judged"),
    [
        (5, 0, "5 steps, too few for a p99; the longest step is judged instead"),
        (19, 0, "19 steps, too few for a p99; the longest step is judged instead"),
        (20, 0, "20 steps, too few for a p99; the p50 and the longest step are judged instead"),
        (200, 0, "200 steps, too few for a p99; the p95 and the longest step are judged instead"),
        (99, 4, "4 steps, too few for a p99; the longest step is judged instead"),
        (
            450,
            4,
            "4 steps, too few for a p99; the p99 of 450 steps, estimated from a window of 4, is",
        ),
    ],
)
def test_a_remark_says_what_is_judged_in_place_of_a_p99(
    suite: str, steps: int, hardest: int, judged: str
) -> None:
    """A window has the p99 of the steps that it is chosen from."""
    replays = f"steps = {steps}\nhardest = {hardest}\npolicies"
    Path(suite).write_text(SUITE.replace("steps = 5\npolicies", replays))
    (remark,) = RunRequest(suite).make_plan().remarks
    assert remark.startswith("the replays have at most ") and judged in remark


def test_runs_of_other_than_the_requested_steps_are_named(suite: str) -> None:
    """Those with fewer, and those of no loop, which are not shortened; none where all have them."""
    recorded = '[[recorded]]\nsequence = "calm-30-5"\n'
    Path(suite).write_text(f"{SUITE}\n{recorded}", encoding="utf-8")
    few, whole, _ = RunRequest(suite, steps=9).make_plan().remarks
    assert few == "fewer than the 9 requested steps: paper (5)"
    assert whole.startswith("not shortened to 9 steps, as only closed loops")
    assert whole.endswith(": calm-30-5[:300:4] (75)")
    (only,) = RunRequest(suite, scenarios=["paper"], steps=5).make_plan().remarks[1:]
    assert only.startswith("the replays have at most 5 steps")


def test_a_policy_alone_keeps_the_routes_of_the_suite(suite: str) -> None:
    cells = [
        p.cell for p in RunRequest(suite, solvers=["osqp"], policies=["warm"]).make_plan().cells
    ]
    assert {(cell.route, cell.policy) for cell in cells} == {("qpsolvers", "warm")}


@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        ({"routes": ["nativ"]}, "`routes`: found 'nativ'; allowed: .*native"),
        ({"policies": ["hot"]}, "`policies`: found 'hot'; allowed: fresh, reuse, warm"),
        (
            {"routes": ["native"], "policies": ["warm"], "solvers": ["quadprog"]},
            "`routes`: found route and policy native warm, which quadprog does not support; "
            "allowed: ",
        ),
        (
            {"policies": ["warm"], "solvers": ["quadprog", "ecos"]},
            "warm, which none of the 2 solvers supports; allowed: a route and policy that one of "
            "them supports",
        ),
    ],
)
def test_a_call_mode_that_does_not_exist_is_refused(
    suite: str, chosen: dict[str, list[str]], message: str
) -> None:
    with pytest.raises(PolicyError, match=message):
        RunRequest(suite, **chosen).make_plan()  # type: ignore[arg-type] # mypy cannot type ** of one type


def test_a_choice_of_scenarios_names_what_it_leaves_out() -> None:
    chosen = RunRequest("thrusters", solvers=["daqp"], scenarios=["thrusters_move"]).make_plan()
    assert "not run, because scenarios are selected: [[capability]]" in chosen.remarks
    everything = RunRequest("thrusters", solvers=["daqp"]).make_plan()
    assert not [remark for remark in everything.remarks if "left out" in remark]


@pytest.mark.parametrize(("scenario", "is_other"), [("thrusters_loss", False), ("thrusters", True)])
def test_a_window_of_consequence_analysis_is_said_not_to_apply_to_other_scenarios(
    tmp_path: Path, scenario: str, is_other: bool
) -> None:
    path = tmp_path / "window.toml"
    path.write_text(
        'title = "Window"\nsolvers = ["daqp"]\n[[replay]]\nscenario = "thrusters_loss"\n'
        "consequence = true\nfirst = 200\nsteps = 100\n"
    )
    plan = RunRequest(str(path), scenarios=[scenario]).make_plan()
    said = [text for text in plan.remarks if text.startswith("the consequence analysis begins")]
    assert bool(said) is is_other
