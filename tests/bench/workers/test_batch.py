"""Cells of one configuration in one process: whatever becomes of one, the others do not change."""

from pathlib import Path

import pandas as pd
import pytest

from dpbench import load_results, run_campaign
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.result_folder import Results
from dpbench.bench.workers.jobs import CellJob, split_into_batches
from dpbench.solvers import plugins
from dpbench.solvers.table import Availability
from tests.bench.deterministic import deterministic, suite_file, suite_toml

pytestmark = pytest.mark.slow

STEPS, CELLS, PER_PROCESS = 6, 24, 6
"""A single slot shares cells out to four processes at least."""
EAST_M = [0.5 * (i + 1) for i in range(CELLS)]
SUITE = suite_toml(
    solvers=["clipping"],
    study=[{"base": "paper", "steps": STEPS, "product": {"start.east_m": EAST_M}}],
)
CLIPPING = """
import os
from itertools import count
from pathlib import Path
import numpy as np
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.function import opener
from dpbench.solvers.plugins import solver_record

CALLS, FATE = count(), Path(__file__).with_name("fate")
LEAVE = {"exit": lambda: os._exit(0), "abort": os.abort}

def solve(qp):
    call = next(CALLS)
    if FATE.exists():
        last, way = FATE.read_text().split()
        if call == int(last):
            FATE.unlink()
            LEAVE[way]()
    z = np.clip(-np.linalg.solve(qp.P, qp.q), qp.lb, qp.ub)
    return Solution(Status.MAX_ITERATIONS, z, np.zeros(qp.m), np.zeros(qp.n))

RECORD = solver_record("clipping", method="none", module="quadprog", distribution="quadprog")
open = opener("clipping", solve)
"""


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = suite_file(tmp_path_factory.mktemp("batch"), SUITE)
    (path.parent / "clipping.py").write_text(CLIPPING, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def undisturbed(suite: Path) -> Results:
    return run(suite, suite.parent / "undisturbed")


def run(suite: Path, out: Path, fate: str = "") -> Results:
    """A campaign; `fate` is the call at which the solver ends its process, once, and how."""
    note = suite.with_name("fate")
    if fate:
        note.write_text(fate, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plugins, "_LOADED", {})
        run_campaign(suite, out, solver_module=suite.with_name("clipping.py"), jobs=1)
    assert not note.exists()
    return load_results(out)


@pytest.mark.parametrize("way", ["exit", "abort"])
@pytest.mark.parametrize(("cell", "step"), [(0, 0), (2, 3), (PER_PROCESS - 1, STEPS - 1)])
def test_a_crash_in_the_midst_of_a_batch_costs_one_cell(
    cell: int, step: int, way: str, suite: Path, undisturbed: Results, tmp_path: Path
) -> None:
    results = run(suite, tmp_path / "out", f"{cell * STEPS + step} {way}")
    assert list(results.runs["run_id"]) == list(undisturbed.runs["run_id"])
    assert list(undisturbed.runs["outcome"]) == ["finished"] * CELLS
    crashed = results.runs.loc[results.runs["outcome"] != "finished"]
    assert (crashed.index == [cell], list(crashed["outcome"])) == (True, ["crashed"])
    assert list(crashed["steps_done"]) == [step]
    (runs, steps), (all_runs, all_steps) = deterministic(results), deterministic(undisturbed)
    others = runs["cell"] != runs["cell"].iloc[cell]
    assert others.sum() == CELLS - 1
    pd.testing.assert_frame_equal(runs[others], all_runs[others], check_exact=True)
    name = crashed["run_id"].iloc[0]
    found, wanted = (table[table["run_id"] != name] for table in (steps, all_steps))
    found, wanted = (table.reset_index(drop=True) for table in (found, wanted))
    pd.testing.assert_frame_equal(found, wanted, check_exact=True)
    kept, first = (table[table["run_id"] == name] for table in (steps, all_steps))
    kept, first = kept.reset_index(drop=True), first.head(step).reset_index(drop=True)
    pd.testing.assert_frame_equal(kept, first, check_exact=True)


def job(solver: str, seed: int, steps: int) -> CellJob:
    cell = Cell(
        mode="closed_loop",
        scenario={"seed": seed},
        steps=steps,
        solver=solver,
        route="native",
        policy="fresh",
        settings="default",
        formulation="condensed_box",
    )
    return CellJob(PlannedCell(cell), f"{solver} {seed}", Availability(ok=True), "")


def batches_of(jobs: list[CellJob], slots: int) -> list[list[str]]:
    return [batch.names for batch in split_into_batches("closed loops", jobs, slots)]


def test_configurations_meet_a_sea_at_about_the_same_time() -> None:
    jobs = [job(solver, sea, 3000) for solver in "abc" for sea in range({"a": 1}.get(solver, 2))]
    found = [name for names in batches_of(jobs, 1) for name in names]
    assert found == ["a 0", "b 0", "c 0", "b 1", "c 1"]


def test_a_batch_is_worth_a_process_and_costs_little() -> None:
    # A cell takes 9 ms and 0.25 ms a step: 11, 109 and 2509 ms here.
    assert {len(names) for names in batches_of([job("a", i, 8) for i in range(60)], 512)} == {10}
    assert max(map(len, batches_of([job("a", i, 8) for i in range(900)], 1))) == 32
    assert {len(names) for names in batches_of([job("a", i, 400) for i in range(90)], 2)} == {9}
    assert {len(names) for names in batches_of([job("a", i, 10**4) for i in range(9)], 2)} == {1}
    both = [job(solver, i, 8) for i in range(5) for solver in "ab"]
    assert [{name[0] for name in names} for names in batches_of(both, 1)] == [{"a"}, {"b"}]
