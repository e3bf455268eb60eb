"""The bound of an answer's error by a point that satisfies its limits to the last bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpbench.bench.sequences.sequence_file import load_recorded
from dpbench.qp.program import QuadraticProgram
from dpbench.qp.random_recipe import RandomRecipe
from dpbench.qp.random_sequence import plant_sequence
from dpbench.qp.referee.joint import JointQP
from dpbench.qp.referee.referee import certify
from dpbench.scenario.problem_files import sequence_path
from dpbench.solvers.open import open_workspace
from dpbench.solvers.own import paper_active_set
from dpbench.solvers.own.exact_point import LARGEST, error_bound, is_regular_vertex
from tests.solvers.conftest import solve_next
from tests.solvers.own.random_costs import INF, unlimited


def bound_of(qp, z, y, y_box):
    return error_bound(JointQP.of(qp), z, np.concatenate([y, y_box]))


@pytest.mark.slow
@given(st.sampled_from(["plain", "equal", "free", "infinite_bounds"]), st.integers(1, 10**6))
def test_an_optimum_is_bounded_to_rounding(family, seed):
    found = plant_sequence(RandomRecipe(family, 5, 8, seed=seed, steps=1))
    qp = found.sequence.problem(0)
    z, y, y_box = found.z[0], found.y[0], found.y_box[0]
    assert bound_of(qp, z, y, y_box) <= 1e-9
    for size in (1e-12, 1e-6, 1e-3):
        moved = z + size * np.random.default_rng(seed).normal(size=qp.n)
        assert bound_of(qp, moved, y, y_box) >= np.abs(moved - z).max()


def lines(third):
    """Three half-planes whose borders pass through, or near, (1, 1): z0 ≤ 1, z1 ≤ 1 and a third."""
    A = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    return unlimited(np.eye(2), [-3.0, -3.0], A, [-INF] * 3, [1.0, 1.0, third])


def test_limits_that_rounding_sets_apart_leave_no_exact_point():
    """At (1, 1) the third limit is met, missed by one unit of rounding, or overstepped by one."""
    z, y, y_box = np.ones(2), np.array([2.0, 2.0, 0.0]), np.zeros(2)
    one = np.spacing(2.0)
    for third in (2.0, 2.0 + one):
        assert bound_of(lines(third), z, y, y_box) <= 1e-14
    assert bound_of(lines(2.0 - one), z, y, y_box) == INF
    # Where that limit is the one with the multiplier, there is a point.
    along = np.array([0.0, 0.0, 2.0])
    assert bound_of(lines(2.0 - one), z, along, y_box) <= 1e-7


def test_a_multiplier_of_a_limit_there_is_not_proves_nothing():
    """λ < 0 names the lower limit, which is −∞ here."""
    assert bound_of(lines(3.0), np.ones(2), np.array([2.0, -2.0, 0.0]), np.zeros(2)) == INF


def test_more_equations_than_exact_arithmetic_has_time_for_are_not_judged():
    n = LARGEST + 1
    none = np.full(n, INF)
    qp = QuadraticProgram(np.eye(n), -2.0 * np.ones(n), np.zeros((0, n)), [], [], -none, np.ones(n))
    assert np.isnan(bound_of(qp, np.ones(n), np.zeros(0), np.ones(n)))
    assert certify(qp).kind == "linear"


@pytest.mark.parametrize(("angle", "regular"), [(1.0, True), (1e-3, True), (1e-5, False)])
def test_limits_are_regular_if_they_meet_at_an_angle(angle, regular):
    A = np.array([[1.0, 0.0], [np.cos(angle), np.sin(angle)], [1.0, 1.0]])
    qp = unlimited(np.eye(2), np.ones(2), A, [-INF] * 3, [0.0, 0.0, 1.0])
    assert is_regular_vertex(JointQP.of(qp), np.zeros(2)) is regular


def test_more_limits_than_variables_are_not_regular():
    assert not is_regular_vertex(JointQP.of(lines(2.0)), np.ones(2))
    assert is_regular_vertex(JointQP.of(lines(3.0)), np.ones(2))


def test_a_long_horizon_alone_raises_no_doubt(monkeypatch):
    """cond(P) is 4e7 at 200/40, yet rounding leaves the answer near the certified optimum."""
    recorded = load_recorded(sequence_path("paper-200-40"))
    monkeypatch.setattr(
        paper_active_set, "moves_under_small_shifts", lambda *_: pytest.fail("was in doubt")
    )
    workspace = open_workspace("paper_active_set", policy="warm")
    workspace.setup(recorded.sequence.base)
    for k, optimum in enumerate(recorded.optima):
        answer = solve_next(workspace, recorded.sequence.step(k))
        assert answer.claimed
        # What `is_near` allows; the optimum itself is known to 1e-10.
        np.testing.assert_allclose(answer.z, optimum.z, rtol=0, atol=5e-7)
