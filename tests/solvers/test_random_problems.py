"""Random problems: the paper's method never claims what is not true, and settings do what they say.

Truth comes from the planted optimum, which is exact, and from no solver.
"""

import numpy as np
import pytest

from dpbench.qp.random_sequence import (
    FAMILIES,
    PlantedSequence,
    RandomRecipe,
    generate_random_sequence_with_optima,
)
from dpbench.qp.referee.farkas import is_farkas_vector_proof
from dpbench.qp.residuals import are_answers_correct, residuals
from dpbench.qp.solution import Status
from dpbench.solvers.contract import Policy
from dpbench.solvers.open import open_workspace
from tests.solvers.conftest import solve_next

# It needs P > 0 and says so where P is only semidefinite.
STRICT = [name for name, family in FAMILIES.items() if not family.semidefinite]
SIZES = [(2, 4, 0), (5, 10, 5), (12, 30, 0), (12, 28, 3), (30, 60, 2)]
"""n, m, block: without a block a start is kept as it is, with one it is shifted."""
SEEDS: dict[Policy, range] = {"fresh": range(4), "reuse": range(4, 8), "warm": range(8, 12)}
"""Each policy has problems of its own."""


def answers(problem, policy, solver="paper_active_set", settings="default"):
    sequence = problem.sequence
    workspace = open_workspace(solver, route="native", policy=policy, settings=settings)
    workspace.setup(sequence.base)
    for k in range(len(sequence)):
        answer = solve_next(workspace, sequence.step(k))
        yield sequence.problem(k), answer
        if not answer.status.is_usable:
            workspace.reset()


def check(problem: PlantedSequence, policy: Policy) -> None:
    """Every feasible step is solved and true at 1e-6, every other one proven infeasible."""
    for k, (qp, answer) in enumerate(answers(problem, policy)):
        where = f"{problem.sequence.name}, {policy}, step {k}: {answer.status.name} {answer.detail}"
        if problem.feasible[k]:
            assert answer.status is Status.SOLVED, where
            error = float(np.abs(answer.z - problem.z[k]).max())
            assert are_answers_correct(qp.q[np.newaxis], residuals(qp, answer), error, 1e-6), where
        else:
            assert answer.status is Status.PRIMAL_INFEASIBLE, where
            assert is_farkas_vector_proof(qp, answer.y, answer.y_box), where


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["fresh", "reuse", "warm"])
@pytest.mark.parametrize("family", STRICT)
def test_it_solves_every_random_problem_and_claims_nothing_untrue(
    family: str, policy: Policy
) -> None:
    """At cond(P) ≤ 1e8 and rows of unit norm every answer is true at 1e-6, whatever the family."""
    for n, m, block in SIZES:
        for seed in SEEDS[policy]:
            rows = 0 if family == "no_rows" else m
            check(
                generate_random_sequence_with_optima(
                    RandomRecipe(family, n, rows, seed, block=block)
                ),
                policy,
            )


@pytest.mark.parametrize("policy", ["fresh", "reuse", "warm"])
@pytest.mark.parametrize("family", STRICT)
def test_the_same_at_the_largest_size(family: str, policy: Policy) -> None:
    rows = 0 if family == "no_rows" else 300
    check(generate_random_sequence_with_optima(RandomRecipe(family, 120, rows, 1, steps=9)), policy)


@pytest.mark.parametrize("policy", ["fresh", "reuse", "warm"])
def test_high_settings_tighten_the_proximal_steps_of_daqp(policy: Policy) -> None:
    """Answers for a semidefinite P are right to 1e-5 at `high`, and not at `default`."""
    problem = generate_random_sequence_with_optima(RandomRecipe("semidefinite", 12, 30, 2, block=2))

    def worst(settings: str) -> float:
        pairs = zip(answers(problem, policy, "daqp", settings), problem.z, strict=True)
        return max(float(np.abs(answer.z - z).max()) for (_, answer), z in pairs)

    assert worst("high") <= 1e-5 < worst("default")
