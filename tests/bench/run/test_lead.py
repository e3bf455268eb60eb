"""Windows and stretches of a run: their first step has the warm start that it has in the whole."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dpbench import load_scenario, load_sequence, open_workspace
from dpbench.arrays import Ints
from dpbench.bench.record.cell import Cell, Formulation
from dpbench.bench.record.raw_log import RawLog, make_replay_layout
from dpbench.bench.run.exact_loop import solve_loop_exactly
from dpbench.bench.run.formulation import formulate_sequence
from dpbench.bench.run.replay import ReplayRun
from dpbench.bench.run.timed_solver import TimedSolver
from dpbench.bench.sequences.source import LEAD_STEPS, ReplayInput, read_replay
from dpbench.solvers.contract import Policy

FIRST, STEPS = 8, 4


def count_iterations(
    given: ReplayInput,
    solver: str,
    policy: Policy = "warm",
    formulation: Formulation = "condensed_box",
) -> Ints:
    """Return the iterations of each step in the second of two rounds."""
    sequence, clock = given.sequence, time.perf_counter_ns
    made, formulated = formulate_sequence(formulation, sequence)
    timed = TimedSolver(open_workspace(solver, route="native", policy=policy), formulated, clock)
    log = RawLog.in_memory(make_replay_layout(2, len(sequence), sequence.base.n, sequence.base.m))
    lead = None if given.lead is None else formulate_sequence(formulation, given.lead)[0]
    run = ReplayRun(made, timed, log, warmup_steps=1, limit_ns=2**62, clock=clock, lead=lead)
    run.run_all_rounds()
    return np.array(log.iterations[1])


@pytest.mark.parametrize("name", ["paper", "turn"])
@pytest.mark.parametrize("solver", ["daqp", "paper_active_set"])
def test_a_stretch_takes_the_iterations_of_the_whole_run(
    solver: str, name: str, tmp_path: Path
) -> None:
    """Without the lead its first step starts cold and takes more; in `turn` the matrices change."""
    scenario, path = load_scenario(name), tmp_path / "loop.npz"
    solve_loop_exactly(scenario.truncate(FIRST + STEPS)).save(path)
    cell = Cell("replay", scenario.files, solver, "native", "warm", "default", FIRST + STEPS)
    whole = read_replay(cell, path)
    stretch = read_replay(replace(cell, first=FIRST, steps=STEPS), path)
    assert whole.lead is None and stretch.lead is not None
    for k in range(LEAD_STEPS):
        before = whole.sequence.problem(FIRST - LEAD_STEPS + k)
        np.testing.assert_array_equal(stretch.lead.problem(k).q, before.q)
    expected = count_iterations(whole, solver)[FIRST:]
    assert count_iterations(stretch, solver).tolist() == expected.tolist()
    assert count_iterations(replace(stretch, lead=None), solver)[0] > expected[0]


@pytest.mark.parametrize("formulation", ["condensed_stacked", "sparse"])
def test_the_lead_has_the_formulation_of_the_replay(
    formulation: Formulation, tmp_path: Path
) -> None:
    scenario, path = load_scenario("paper"), tmp_path / "loop.npz"
    solve_loop_exactly(scenario.truncate(FIRST + STEPS)).save(path)
    cell = Cell("replay", scenario.files, "piqp", "native", "reuse", "default", FIRST + STEPS)
    whole = count_iterations(read_replay(cell, path), "piqp", "reuse", formulation)
    stretch = read_replay(replace(cell, first=FIRST, steps=STEPS), path)
    found = count_iterations(stretch, "piqp", "reuse", formulation)
    assert found.tolist() == whole[FIRST:].tolist() and found.min() > 1


@pytest.mark.parametrize("solver", ["osqp", "scs"])
def test_every_round_after_a_lead_is_the_same_computation(solver: str) -> None:
    """OSQP and SCS adapt a step size, which a later round would take over without a reset."""
    stored, clock = load_sequence("rough-60-10"), time.perf_counter_ns
    made, formulated = formulate_sequence("condensed_box", stored)
    workspace = open_workspace(solver, route="native", policy="reuse", settings="high")
    timed = TimedSolver(workspace, formulated, clock)
    count, rounds = len(stored), 4
    log = RawLog.in_memory(make_replay_layout(rounds, count, stored.base.n, stored.base.m))
    run = ReplayRun(made, timed, log, warmup_steps=count, limit_ns=2**62, clock=clock, lead=made)
    run.run_all_rounds()
    iterations = np.array(log.iterations)
    assert iterations.shape == (rounds, count) and iterations.min() > 0
    np.testing.assert_array_equal(iterations[1:], iterations[:-1])
