"""The paper's method as a controller uses it, beside bare calls of DAQP, on recorded sequences."""

from collections.abc import Callable

import daqp
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from dpbench import load_scenario, open_workspace
from dpbench.bench.run.exact_loop import ExactLoop, rebuild_sequence, solve_loop_exactly
from dpbench.embedded.count import count_instructions_along_sequence
from dpbench.embedded.recipe import select_recipes
from dpbench.embedded.toolchain import TARGETS, has_extra
from dpbench.qp.program import QPSequence
from dpbench.scenario.scenario import Scenario

OWN = ("paper_active_set", "hildreth")
"""Solvers whose C is part of dpbench."""
CORES = ("m7", "x86")


@pytest.fixture(scope="module", params=["paper", "rough"])
def loop(request: pytest.FixtureRequest) -> tuple[Scenario, ExactLoop]:
    """The first 200 steps of a scenario, solved exactly."""
    scenario = load_scenario(request.param).truncate(200)
    return scenario, solve_loop_exactly(scenario)


@pytest.fixture(scope="module")
def sequence(loop: tuple[Scenario, ExactLoop]) -> QPSequence:
    """Its QPs."""
    return rebuild_sequence(*loop)


def count_instructions(solver: str, sequence: QPSequence, exact: ExactLoop) -> dict[str, int]:
    """Count what the C of one of dpbench's solvers executes on emulated cores along a sequence.

    Such counts need no quiet machine. They are empty without the extra `embedded`.
    """
    if solver not in OWN or not has_extra():
        return {}
    (recipe,) = select_recipes([solver])
    counts = {
        name: count_instructions_along_sequence(
            recipe, sequence, TARGETS[name], optima=exact.optima
        )
        for name in CORES
    }
    return {
        f"instructions_{name}": int(one.steps["instructions"].sum()) for name, one in counts.items()
    }


def bare_daqp(sequence: QPSequence) -> Callable[[], int]:
    """Update and solve of one model, on arrays made beforehand; nothing is read."""
    base = sequence.base
    model = daqp.Model()
    upper, lower = np.concatenate([base.ub, base.u]), np.concatenate([base.lb, base.l])
    model.setup(
        base.P.copy(),
        base.q.copy(),
        base.A.copy(),
        upper,
        lower,
        np.zeros(upper.size, dtype=np.int32),
    )
    steps = [
        (
            sequence.q[k].copy(),
            np.concatenate([base.ub, sequence.u[k]]),
            np.concatenate([base.lb, sequence.l[k]]),
        )
        for k in range(len(sequence))
    ]

    def replay() -> int:
        iterations = 0
        for q, high, low in steps:
            model.update(f=q, bupper=high, blower=low)
            iterations += model.solve()[3]["iterations"]
        return iterations

    return replay


def own(solver: str, sequence: QPSequence) -> Callable[[], int]:
    """Update, solve and read of a workspace that starts from the step before."""
    workspace = open_workspace(solver, route="native", policy="warm")
    workspace.setup(sequence.base)
    steps = [sequence.step(k) for k in range(len(sequence))]

    def replay() -> int:
        iterations = 0
        for step in steps:
            workspace.update(step)
            workspace.solve()
            iterations += workspace.read().iterations
        return iterations

    return replay


@pytest.mark.benchmark(group="warm steps, 200 of a scenario", min_rounds=50)
@pytest.mark.parametrize("solver", ["daqp, bare", "daqp", *OWN])
def test_warm_steps(
    benchmark: BenchmarkFixture,
    exactly: Callable[..., None],
    loop: tuple[Scenario, ExactLoop],
    sequence: QPSequence,
    solver: str,
) -> None:
    """A whole pass over the sequence; divide by 200 for a step."""
    replay = bare_daqp(sequence) if solver == "daqp, bare" else own(solver, sequence)
    replay()  # the second pass starts warm from the end of the first, as all later ones do
    iterations = replay()
    instructions = count_instructions(solver, sequence, loop[1])
    rows = sequence.base.m + sequence.base.n
    exactly(replay, iterations=iterations, rows=rows, **instructions)
    benchmark(replay)
