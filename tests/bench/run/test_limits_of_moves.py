"""What is applied of a move, and what the fallback does, worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dpbench import condense, load_scenario
from dpbench.bench.record.cell import Fallback
from dpbench.bench.run.fallback import FallbackLaw, limit_move, limit_of
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.scenario.scenario import Scenario

LIMITED = [
    # force before, move, lower limit, upper limit: force applied (Δu_max is 10)
    (0.0, 4.0, -50.0, 80.0, 4.0),
    (0.0, 10.0, -50.0, 80.0, 10.0),
    (0.0, 11.0, -50.0, 80.0, 10.0),
    (0.0, -99.0, -50.0, 80.0, -10.0),
    # Both limits
    (75.0, 9.0, -50.0, 80.0, 80.0),
    (-45.0, -9.0, -50.0, 80.0, -50.0),
    (-45.0, -5.0, -50.0, 80.0, -50.0),
    (-45.0, -4.5, -50.0, 80.0, -49.5),
    # A limit that has dropped beyond what the rate allows, on either side
    (80.0, 5.0, -50.0, 60.0, 70.0),
    (80.0, -10.0, -50.0, 60.0, 70.0),
    (-50.0, -5.0, -20.0, 80.0, -40.0),
    (-50.0, 3.0, -20.0, 80.0, -40.0),
    (-50.0, 10.0, -20.0, 80.0, -40.0),
    # One that has dropped within it
    (80.0, 0.0, -50.0, 75.0, 75.0),
    (-50.0, 0.0, -45.0, 80.0, -45.0),
    # No force at all any more
    (-4.0, -4.0, 0.0, 0.0, 0.0),
    (4.0, 4.0, 0.0, 0.0, 0.0),
]


def limited(
    u: list[float], du: list[float], low: list[float], high: list[float]
) -> tuple[list[float], bool]:
    """Return what is applied with a largest increment of 10, and whether that is another move."""
    applied = np.full(len(u), np.nan)
    vectors = (np.array(vector) for vector in (u, du, low, high))
    clipped = limit_move(np.full(len(u), 10.0), *vectors, applied)
    return applied.tolist(), bool(clipped)


@pytest.mark.parametrize(("u", "du", "low", "high", "applied"), LIMITED)
def test_rate_first_then_amplitude_on_both_sides(
    u: float, du: float, low: float, high: float, applied: float
) -> None:
    """No force leaves its limits, nor the rate for them; a change of the move is told."""
    assert limited([u], [du], [low], [high]) == ([applied], applied != u + du)


def test_every_axis_has_its_own_limits() -> None:
    """One that is cut is enough for a move that is not applied as it was."""
    given = [0.0, 75.0, -45.0], [3.0, 9.0, -9.0], [-50.0] * 3, [80.0] * 3
    assert limited(*given) == ([3.0, 80.0, -50.0], True)


def test_a_cut_within_rounding_is_none() -> None:
    """A billionth of an increment: 9e-9 of 10 is applied on the limit and not told."""
    assert limited([70.0], [10.0 + 9e-9], [-50.0], [80.0]) == ([80.0], False)
    assert limited([70.0], [10.0 + 2e-8], [-50.0], [80.0]) == ([80.0], True)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("calm")


@pytest.fixture(scope="module")
def builder(scenario: Scenario) -> CondensedQP:
    return condense(scenario)


def test_a_controller_of_forces_limits_axis_by_axis(builder: CondensedQP) -> None:
    """By its own largest increments, 32 736 N, 11 008 N, 475 200 N·m."""
    applied = np.empty(3)
    low, high = np.full(3, -1e9), np.full(3, 1e9)
    assert limit_of(builder)(np.zeros(3), np.full(3, -1e8), low, high, applied)
    np.testing.assert_allclose(applied, [-32736.0, -11008.0, -475200.0])


def moves_of(kind: Fallback, builder: CondensedQP, steps: int) -> list[list[float]]:
    """Return the moves of steps without an answer, after a plan of 1, 2, 3, 4, 5 in surge."""
    law = FallbackLaw(kind, builder)
    plan = np.zeros((5, 3))
    plan[:, 0] = [1.0, 2.0, 3.0, 4.0, 5.0]
    assert law.remember(plan).tolist() == [1.0, 0.0, 0.0]
    assert not law.acted
    still = np.zeros(9), np.zeros(3), np.zeros(3)
    moves = [law.move(*still).tolist() for _ in range(steps)]
    assert law.acted
    return moves


def test_the_shifted_plan_is_followed_to_its_end(builder: CondensedQP) -> None:
    """The second move in the first step without an answer; after the last the force is held."""
    moves = moves_of("shifted_plan", builder, 6)
    assert [move[0] for move in moves] == [2.0, 3.0, 4.0, 5.0, 0.0, 0.0]


def test_hold_moves_nothing(builder: CondensedQP) -> None:
    """Whatever plan there was."""
    assert moves_of("hold", builder, 2) == [[0.0] * 3] * 2


def test_clip_is_the_first_move_of_the_unconstrained_optimum(scenario: Scenario) -> None:
    """−E⁻¹ F_k of the condensed problem in N and N·m, its first three entries."""
    si = condense(replace(scenario, N_p=6, N_c=2), units="si")
    x, y_ref = np.array([0.1, -0.2, 0.01, 0.02, 0.03, 0.004, 1.5, -2.0, 0.3]), np.ones(3)
    step = si.emit(x, y_ref, np.zeros(3))
    expected = -np.linalg.solve(si.problem(step).P, step.q)[:3]
    law = FallbackLaw("clip", si)
    np.testing.assert_allclose(law.move(x, y_ref, np.zeros(3)), expected, rtol=1e-9)
    assert law.acted
