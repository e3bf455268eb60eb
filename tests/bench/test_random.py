"""Random problems as cells of a suite: planned, replayed, judged and reported."""

import re
from pathlib import Path

import pandas as pd
import pytest

from dpbench import load_results
from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.random_claims import RandomClaims
from dpbench.bench.plan.cells import SEMIDEFINITE_REFUSAL
from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.suite import RandomTable, ReplayTable, SuiteFile, load_path_and_suite
from dpbench.bench.record.result_folder import Results
from dpbench.errors import InputError
from dpbench.qp.random_sequence import FAMILIES
from dpbench.report.write import write_report
from dpbench.solvers import plugins
from tests.bench.deterministic import run_suite, suite_toml

# What else runs could use up a limit of one second, which one of its solvers is to reach.
pytestmark = pytest.mark.alone

PLUGIN = Path(__file__).with_name("faulty_plugin.py")
STEPS = 6
SUITE = suite_toml(
    **{"solvers": ["quadprog", "daqp"], "rounds": 1, "warmup_steps": 0, "cell_limit_s": 1.0},
    random=[
        {
            **{"families": ["no_rows"], "sizes": [[n, 0] for n in range(3, 9)]},
            **{"steps": STEPS, "routes": ["native"]},
        },
        {
            **{"families": ["infeasible_steps"], "sizes": [[4, 6]]},
            **{"steps": STEPS, "routes": ["native"], "policies": ["fresh", "warm"]},
        },
    ],
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign of two sound solvers and one that lies, dies and hangs."""
    base = tmp_path_factory.mktemp("random")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plugins, "_LOADED", {})
        solvers = ["quadprog", "daqp", "faulty"]
        out = run_suite(base, SUITE, solvers=solvers, solver_module=PLUGIN)
        write_report(out)
    return out


@pytest.fixture(scope="module")
def results(folder: Path) -> Results:
    return load_results(folder)


def outcome(results: Results, n: int) -> str:
    runs = results.runs
    of = runs[(runs["solver"] == "faulty") & (runs["sequence"] == f"no_rows-n{n}-m0-s1-steps6")]
    return str(of["outcome"].iloc[0])


def test_a_lie_is_a_row(results: Results) -> None:
    runs = results.runs
    assert (runs["scenario"] == "").all() and (runs["mode"] == "replay").all()
    row = runs[(runs["solver"] == "faulty") & (runs["sequence"] == "no_rows-n4-m0-s1-steps6")]
    assert row["claimed_not_true"].tolist() == [STEPS]
    steps = results.steps[results.steps["run_id"] == row["run_id"].iloc[0]]
    assert steps["claimed"].all() and not steps["true"].any()
    # Bounds lie within ±1.5, so a plan of nines is off by more than 7.
    assert (steps["error_plan"] > 7.0).all()


def test_sound_solvers_have_no_false_claim(results: Results) -> None:
    claims = RandomClaims(Records(results))
    for solver in ("quadprog", "daqp"):
        tally = claims.sum_tallies_by_columns("solver")[(solver,)]
        assert tally.wrong_count == 0 and tally.nothing == 0
        assert tally.steps == tally.right_claims + tally.right_refusals
    assert (
        claims.sum_tallies_by_columns("solver", "family")["daqp", "infeasible_steps"].right_refusals
        == 2 * 2
    )


def test_every_step_is_counted_once(results: Results) -> None:
    tally = RandomClaims(Records(results)).sum_tallies_by_columns("solver")[("faulty",)]
    seen = (
        tally.right_claims
        + tally.false_claims
        + tally.not_claimed
        + tally.right_refusals
        + tally.wrong_refusals
    )
    assert tally.steps == seen + tally.nothing
    assert tally.steps + tally.missed == 7 * STEPS
    # n = 4 without rows, and all six steps of the sequence with infeasible ones: also n = 4.
    assert (tally.false_claims, tally.wrong_refusals) == (2 * STEPS, STEPS)


def test_a_crash_or_a_hang_costs_only_its_own_cell(results: Results) -> None:
    found = {n: outcome(results, n) for n in range(3, 9)}
    usual = dict.fromkeys(range(3, 9), "finished")
    assert found == usual | {6: "crashed", 7: "timed_out"}


def test_the_report_shows_who_lied(folder: Path) -> None:
    text = (folder / "report.md").read_text(encoding="utf-8")
    answer = text.splitlines()[4]
    # Of the cell whose every step hangs some are there.
    assert re.search(r"false claims on 12\d certified steps: \d+ by faulty", answer)
    lies = pd.read_csv(folder / "tables" / "random.csv").set_index("solver")["false claims"]
    assert lies.index[0] == "faulty"
    assert lies.to_dict() == {"faulty": 3 * STEPS, "daqp": 0, "quadprog": 0}
    html = (folder / "report.html").read_text(encoding="utf-8")
    answer = html.split('<section id="answer">')[1].split("</section>")[0]
    assert "18 by faulty" in answer and '<section id="matrix">' not in html


def suite(**tables: object) -> SuiteFile:
    return SuiteFile(title="x", solvers=["quadprog", "daqp"], baseline_law=False, **tables)  # type: ignore[arg-type] # lists of tables


def test_a_choice_of_scenarios_leaves_random_problems_out() -> None:
    random = [RandomTable(families=["plain"], sizes=[[4, 6]])]
    both = suite(random=random, replay=[ReplayTable(scenario="paper", steps=20)])
    assert len(plan_suite(both)) == 4
    assert {planned.cell.sequence for planned in plan_suite(both, scenarios=["paper"])} == {"paper"}
    with pytest.raises(InputError, match="none, as the suite has no scenario"):
        plan_suite(suite(random=random), scenarios=["paper"])


def test_a_solver_that_needs_a_definite_cost_is_refused_a_semidefinite_one() -> None:
    planned = plan_suite(suite(random=[RandomTable(families=["semidefinite"], sizes=[[4, 6]])]))
    assert {p.cell.solver: p.refused for p in planned} == {
        "quadprog": SEMIDEFINITE_REFUSAL,
        "daqp": "",
    }


def test_an_impossible_recipe_of_a_suite_is_refused_before_anything_runs(tmp_path: Path) -> None:
    for families, sizes in ((["plane"], [[4, 6]]), (["degenerate"], [[8, 4]])):
        with pytest.raises(InputError, match="random recipe"):
            plan_suite(suite(random=[RandomTable(families=families, sizes=sizes)]))


def test_the_random_suite_has_all_families_and_sizes() -> None:
    _, shipped = load_path_and_suite("random")
    recipes = [recipe for table in shipped.random for recipe in table.list_random_recipes()]
    assert {recipe.family for recipe in recipes} == set(FAMILIES)
    assert {2, 120} <= {recipe.n for recipe in recipes}
    assert {0, 300} <= {recipe.m for recipe in recipes}
    cells = plan_suite(shipped)
    keys = [planned.cell.to_json() for planned in cells]
    assert len(keys) == len(set(keys))
