"""Judgement is of the QP given and the answer returned, whatever a solver does with either."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench import load_scenario, open_workspace, record_sequence, replay
from dpbench.bench.judge.evaluation import EVALUATION, evaluate_replay_log
from dpbench.bench.judge.timing import window_p99_ns
from dpbench.bench.record.cell import CONTROLLER, Formulation, HardestSource
from dpbench.bench.record.raw_log import RawLog, make_replay_layout
from dpbench.bench.run.exact_loop import ExactWorkspace
from dpbench.bench.run.formulation import formulate_sequence
from dpbench.bench.run.replay import ReplayRun
from dpbench.bench.run.timed_solver import TimedSolver
from dpbench.qp.program import QPSequence, QPStep, QuadraticProgram
from dpbench.qp.solution import Solution, Status
from dpbench.scenario.scenario import Scenario
from dpbench.solvers.contract import Workspace
from dpbench.solvers.function import FunctionWorkspace


@dataclass
class Lazy:
    """Computes its numbers for 20 ms when somebody wants them."""

    values: Any

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        time.sleep(0.02)
        return np.asarray(self.values, dtype)


class LazyArray(np.ndarray):
    """An array whose own memory holds nothing and whose methods compute for 20 ms."""

    def sum(self, *args: Any, **kwargs: Any) -> Any:
        return self.tolist() and float(np.sum(np.zeros(self.shape)))

    def __getattribute__(self, name: str) -> Any:
        if name in ("sum", "tobytes", "reshape", "dot"):
            time.sleep(0.02)
        return super().__getattribute__(name)


class LazySolution(Solution):
    """A solution that solves when it is asked for z, for 20 ms."""

    def __getattribute__(self, name: str) -> Any:
        if name == "z":
            time.sleep(0.02)
        return super().__getattribute__(name)


class Planted(Workspace):
    """A right answer at every step, and what `spoil` makes of it at step `AT` of a pass."""

    def __init__(self, spoil: Callable[[Solution], Any], inside: Workspace | None = None) -> None:
        super().__init__("planted", "native", "reuse")
        self._spoil, self._inside, self._asked = spoil, inside or ExactWorkspace(), -1

    def setup(self, qp: QuadraticProgram) -> None:
        self._inside.setup(qp)

    def update(self, step: QPStep) -> None:
        self._inside.update(step)
        self._asked += 1

    def solve(self) -> None:
        self._inside.solve()

    def read(self) -> Solution:
        found = self._inside.read()
        return self._spoil(found) if self._asked == AT else found  # type: ignore[no-any-return] # the fault

    def reset(self) -> None:
        self._inside.reset()
        if self._asked != AT:
            self._asked = -1


def _with(**changes: Any) -> Callable[[Solution], Any]:
    return lambda found: replace(found, **changes)


def _z(make: Callable[[Any], Any]) -> Callable[[Solution], Any]:
    return lambda found: replace(found, z=make(found.z))


STEPS, AT = 8, 5
MALFORMED: dict[str, tuple[Callable[[Solution], Any], str]] = {
    "list": (_z(list), "z is of type list, not an array"),
    "complex": (_z(lambda z: z + 0j), "z is complex128 of shape (15,), not float64"),
    "single precision": (_z(lambda z: z.astype(np.float32)), "z is float32 of shape (15,)"),
    "integers": (_z(lambda z: z.astype(int)), "z is int64 of shape (15,)"),
    "objects": (_z(lambda z: z.astype(object)), "z is object of shape (15,)"),
    "scalar": (_with(z=1.0), "z is of type float, not an array"),
    "array of no dimension": (_with(z=np.array(0.5)), "z is float64 of shape ()"),
    "too short": (_z(lambda z: z[:-1]), "z is float64 of shape (14,), not float64 of shape (15,)"),
    "too long": (_z(lambda z: np.append(z, 0.0)), "z is float64 of shape (16,)"),
    "column": (_z(lambda z: z[:, None]), "z is float64 of shape (15, 1)"),
    "no z": (_with(z=None), "z is None, not an array"),
    "no y": (_with(y=None), "y is None, not an array"),
    "y of one number": (_with(y=np.zeros(1)), "y is float64 of shape (1,)"),
    "y_box of text": (_with(y_box="none"), "y_box is of type str, not an array"),
    "lazy": (_z(Lazy), "z is of type Lazy, not an array"),
    "no status": (_with(status=None), "status is None, not a Status"),
    "status a number": (_with(status=0), "status is of type int, not a Status"),
    "status a word": (_with(status="solved"), "status is of type str, not a Status"),
    "half an iteration": (_with(iterations=2.5), "iterations is of type float, not an integer"),
    "no iterations": (_with(iterations=None), "iterations is None, not an integer"),
    "too many iterations": (_with(iterations=2**64), "iterations is beyond 64 bits"),
    "time in words": (_with(reported_ns="1 ms"), "reported_ns is of type str, not an integer"),
    "detail a list": (_with(detail=["a"]), "detail is of type list, not text"),
    "nothing": (lambda found: None, "None in place of a Solution"),
    "a pair": (lambda found: (found.z, found.y), "of type tuple in place of a Solution"),
}


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("paper").truncate(STEPS)


@pytest.fixture(scope="module")
def recorded(scenario: Scenario) -> QPSequence:
    return record_sequence(scenario)


def _replayed(sequence: QPSequence, workspace: Workspace, formulation: Formulation) -> pd.DataFrame:
    run = replay(sequence, workspace, repeats=1, warmup_steps=STEPS, formulation=formulation)
    return run.steps


@pytest.mark.parametrize("name", MALFORMED)
def test_a_malformed_answer_is_one_failed_step_of_a_round(name: str, recorded: QPSequence) -> None:
    formulated = formulate_sequence("condensed_box", recorded)[1]
    spoil, words = MALFORMED[name]
    timed_solver = TimedSolver(Planted(spoil), formulated, time.perf_counter_ns)
    log = RawLog.in_memory(make_replay_layout(2, STEPS, 15, 15))
    configuration = ReplayRun(
        recorded,
        timed_solver,
        log,
        warmup_steps=STEPS,
        limit_ns=2**62,
        clock=time.perf_counter_ns,
        preroll=0,
    )
    assert configuration.run_round(0) and configuration.run_round(1)
    assert (log.status == Status.ERROR).sum(axis=1).tolist() == [1, 1]
    assert np.isnan(log.z[1, AT]).all()
    (detail,) = timed_solver.details
    assert detail.startswith(f"malformed answer: {words}") and timed_solver.details[detail] == 2


@pytest.mark.parametrize("formulation", ["condensed_stacked", "sparse"])
@pytest.mark.parametrize("name", ["list", "too short", "no y"])
def test_answers_before_mapping(name: str, formulation: Formulation, recorded: QPSequence) -> None:
    solver = Planted(MALFORMED[name][0], open_workspace("piqp", route="native", policy="reuse"))
    steps = _replayed(recorded, solver, formulation)
    assert (steps[steps["repeat"] == 1]["status"] == "ERROR").sum() == 1


def test_what_an_answer_does_when_it_is_taken_is_inside_the_clock(recorded: QPSequence) -> None:
    def lazy(found: Solution) -> Solution:
        return LazySolution(found.status, found.z, found.y, found.y_box)

    steps = _replayed(recorded, Planted(lazy), "condensed_box")
    (lazily_read,) = steps.index[(steps["repeat"] == 1) & (steps["k"] == AT)]
    # A sleep is never shorter than asked, whatever else the machine does.
    assert steps.loc[lazily_read, "read_ns"] >= 20_000_000
    assert steps.loc[lazily_read, "status"] == "SOLVED" and steps.loc[lazily_read, "true_1e6"]


def test_an_array_of_another_class_gives_what_lies_in_its_memory(recorded: QPSequence) -> None:
    spoil = _z(lambda z: np.zeros(15).view(LazyArray))
    steps = _replayed(recorded, Planted(spoil), "condensed_box")
    row = steps[(steps["repeat"] == 1) & (steps["k"] == AT)].iloc[0]
    assert row["status"] == "SOLVED" and not row["true"] and row["error_move"] > 1e-3


@pytest.mark.parametrize("count", [np.int16(3), np.uint64(3), True, np.int64(3)])
def test_integers_of_any_type_are_counts(count: Any, recorded: QPSequence) -> None:
    steps = _replayed(recorded, Planted(_with(iterations=count)), "condensed_box")
    row = steps[(steps["repeat"] == 1) & (steps["k"] == AT)].iloc[0]
    assert (row["status"], row["iterations"]) == ("SOLVED", int(count))


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (None, "None in place of a Solution"),
        (3.0, "of type float in place of a Solution"),
        (Solution(Status.SOLVED, None, None, None), "z is None, not an array"),  # type: ignore[arg-type] # the fault
    ],
)
def test_a_function_that_gives_no_solution_is_told_what_it_gave(found: Any, words: str) -> None:
    workspace = FunctionWorkspace("planted", "fresh", lambda qp: found, {})
    workspace.setup(_sequence().base)
    workspace.solve()
    answer = workspace.read()
    assert answer.status is Status.ERROR and words in answer.detail


def _sequence(steps: int = 4) -> QPSequence:
    """½‖z‖² + qᵀz in a box, z = −q inside it."""
    eye, one = np.eye(3), np.ones(3)
    q = np.linspace(-0.9, 0.9, 3 * steps).reshape(steps, 3)
    base = QuadraticProgram(eye, q[0], eye, -2 * one, 2 * one, -one, one)
    rows = np.ones((steps, 3))
    return QPSequence("made up", base, q, -2 * rows, 2 * rows)


def test_the_status_is_part_of_an_answer() -> None:
    sequence = _sequence(1)
    log = RawLog.in_memory(make_replay_layout(3, 1, 3, 3))
    log.z[:], log.y[:], log.y_box[:] = -sequence.q, 0.0, 0.0
    log.status[:, 0] = (Status.SOLVED, Status.SOLVED, Status.PRIMAL_INFEASIBLE)
    log.done[:] = 1
    evaluated = evaluate_replay_log(log, sequence, 1.0)
    assert evaluated.columns["evaluations"][:, EVALUATION.index("true")].tolist() == [1.0, 1.0, 0.0]
    assert evaluated.metrics["bit_identical_share"] == 0.0


def test_the_p99_of_a_window_is_that_of_its_stretch() -> None:
    """Two of 200 steps are slower than 7 among 9, 8, 7 and 1; of 500 more than the window has."""
    best = np.array([1.0, 9.0, 7.0, 8.0])
    assert window_p99_ns(best, HardestSource("turn", of=200)) == 7.0
    assert window_p99_ns(best, HardestSource("turn", of=500)) == 1.0
    assert np.isnan(window_p99_ns(best, CONTROLLER))
