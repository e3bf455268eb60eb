"""Whatever a solver writes over what it is given, it is judged against what it was asked."""

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench import (
    load_results,
    load_scenario,
    open_workspace,
    record_sequence,
    replay,
    run_closed_loop,
)
from dpbench.bench.record.cell import Formulation
from dpbench.mpc.condense import UnitSystem
from dpbench.qp.program import QPSequence, QPStep, QuadraticProgram
from dpbench.qp.solution import Solution, Status
from dpbench.scenario.scenario import Scenario
from dpbench.solvers.contract import Policy, Workspace
from tests.bench.deterministic import run_suite, suite_toml

PLUGIN = Path(__file__).with_name("spoiling_plugin.py")
WAYS: list[tuple[str, Policy, Formulation, UnitSystem, str]] = [
    ("quadprog", "reuse", "condensed_box", "scaled", "paper"),
    ("quadprog", "fresh", "condensed_box", "scaled", "paper"),
    ("quadprog", "reuse", "condensed_box", "si", "paper"),
    ("quadprog", "fresh", "condensed_stacked", "scaled", "paper"),
    ("quadprog", "reuse", "condensed_stacked", "scaled", "paper"),
    ("piqp", "reuse", "sparse", "scaled", "paper"),
    ("piqp", "fresh", "sparse", "scaled", "paper"),
    ("quadprog", "reuse", "condensed_box", "scaled", "turn_unequal"),
    ("quadprog", "fresh", "condensed_box", "scaled", "turn"),
    ("quadprog", "reuse", "condensed_stacked", "scaled", "turn"),
]
"""Solver, policy, formulation, units, scenario; the last three bring other matrices."""


def _scenario(name: str) -> Scenario:
    return load_scenario(name).truncate(12)


def _spoiling(solver: str, policy: Policy, *, spoil: bool) -> Any:
    around = runpy.run_path(str(PLUGIN))["Spoiling"]
    return around(open_workspace(solver, route="native", policy=policy), spoil=spoil)


def _answers(steps: pd.DataFrame) -> pd.DataFrame:
    """All columns that no clock enters."""
    timed = [name for name in steps if str(name).endswith("_ns")]
    return steps.drop(columns=[*timed, "disturbed", "counts", "late"])


def _bytes(sequence: QPSequence) -> list[bytes]:
    parts: list[Any] = [sequence, sequence.base]
    found = [
        getattr(part, name) for part in parts for name in ("P", "q", "A", "l", "u", "lb", "ub")
    ]
    return [b"" if array is None else np.asarray(array).tobytes() for array in found]


@pytest.mark.slow
@pytest.mark.parametrize("way", WAYS)
def test_a_replay_judges_by_what_no_solver_can_reach(way: Any) -> None:
    solver, policy, formulation, units, name = way
    sequence = record_sequence(_scenario(name), units=units)
    before = _bytes(sequence)
    found = [
        replay(
            sequence,
            _spoiling(solver, policy, spoil=spoil),
            repeats=2,
            warmup_steps=12,
            formulation=formulation,
        )
        for spoil in (True, False)
    ]
    assert _bytes(sequence) == before
    pd.testing.assert_frame_equal(_answers(found[0].steps), _answers(found[1].steps))
    assert found[0].summary["true_share"] == 1.0
    assert found[0].summary["bit_identical_share"] == 1.0


@pytest.mark.parametrize("way", WAYS)
def test_a_loop_judges_by_what_no_solver_can_reach(way: Any) -> None:
    solver, policy, formulation, units, name = way
    found = [
        run_closed_loop(
            _scenario(name),
            _spoiling(solver, policy, spoil=spoil),
            units=units,
            formulation=formulation,
        )
        for spoil in (True, False)
    ]
    pd.testing.assert_frame_equal(_answers(found[0].steps), _answers(found[1].steps))
    assert found[0].summary["true_share"] == 1.0


class Zero(Workspace):
    """Makes the cost zero, of which zero is the optimum."""

    def setup(self, qp: QuadraticProgram) -> None:
        self._zero = np.zeros(qp.n)

    def update(self, step: QPStep) -> None:
        step.q[:] = 0.0

    def solve(self) -> None:
        pass

    def read(self) -> Solution:
        return Solution(Status.SOLVED, self._zero, self._zero, self._zero)


def test_the_zero_answer_to_a_cost_made_zero_is_wrong() -> None:
    sequence = record_sequence(_scenario("paper"))
    run = replay(sequence, Zero("zero", "native", "reuse"), repeats=2)
    assert run.summary["true_share"] == 0.0 and not run.steps["true"].any()


SUITE = suite_toml(
    **{"solvers": ["quadprog"], "rounds": 2, "warmup_steps": 12},
    closed_loop=[{"scenarios": ["paper"], "steps": 12}],
    replay=[
        {
            **{"scenario": "paper", "steps": 12},
            **{"routes": ["native"], "policies": ["fresh", "reuse"]},
        }
    ],
    random=[
        {"families": ["infeasible_steps"], "sizes": [[4, 6]], "steps": 6, "routes": ["native"]}
    ],
)


@pytest.mark.slow
def test_a_worker_hands_over_the_same_qps_in_every_round(tmp_path: Path) -> None:
    out = run_suite(tmp_path, SUITE, solvers=["spoiling"], solver_module=PLUGIN)
    runs = load_results(out).runs
    assert (runs["outcome"] == "finished").all(), runs["outcome_detail"].tolist()
    assert (runs["true_share"] == 1.0).all() and (runs["failed_steps"] == 0).all()
