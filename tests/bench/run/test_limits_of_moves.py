"""Applied forces and moves of the fallback, worked by hand."""

from dataclasses import replace

import numpy as np
import pytest

from dpbench import load_scenario
from dpbench.bench.run.backup import FALLBACKS
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.law import UnconstrainedLaw
from dpbench.mpc.move_limits import ThrusterLimit, write_limited_command
from dpbench.mpc.thruster_rows import Limits, build_limit_rows_of_thrusters
from dpbench.scenario.scenario import Scenario
from dpbench.ship.thrusters import Thruster, ThrusterSet

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
    """Return the applied force for Δu_max = 10, and whether the move was clipped."""
    applied = np.full(len(u), np.nan)
    vectors = (np.array(vector, dtype=float) for vector in (u, du, low, high))
    clipped = write_limited_command(np.full(len(u), 10.0), *vectors, applied)
    return applied.tolist(), bool(clipped)


@pytest.mark.parametrize(("u", "du", "low", "high", "applied"), LIMITED)
def test_rate_then_amplitude(u: float, du: float, low: float, high: float, applied: float) -> None:
    assert limited([u], [du], [low], [high]) == ([applied], applied != u + du)


def test_every_axis_has_its_own_limits() -> None:
    low, high = [-50.0] * 3, [80.0] * 3
    assert limited([0, 75, -45], [3, 9, -9], low, high) == ([3.0, 80.0, -50.0], True)
    assert limited([75, 0, 0], [9, 3, -3], low, high) == ([80.0, 3.0, -3.0], True)
    assert limited([70, 0, 0], [9, 3, -3], low, high) == ([79.0, 3.0, -3.0], False)


def test_a_cut_within_rounding_is_not_marked() -> None:
    """A cut of 9e-9 of 10 ends on the limit and is not marked as clipped."""
    assert limited([70.0], [10.0 + 9e-9], [-50.0], [80.0]) == ([80.0], False)
    assert limited([70.0], [10.0 + 2e-8], [-50.0], [80.0]) == ([80.0], True)


# 400 N ahead, 200 N astern, 20 N a sample; two tunnel thrusters of 50 N, 5 N a sample.
THRUSTERS = ThrusterSet(
    (
        Thruster("main", "main", 0.0, 0.0, 400.0, 10.0, astern=0.5),
        Thruster("bow", "tunnel", 10.0, 0.0, 50.0, 5.0),
        Thruster("stern", "tunnel", -10.0, 0.0, 50.0, 5.0),
    )
)
ROWS = build_limit_rows_of_thrusters(THRUSTERS, 4)


@pytest.mark.parametrize(
    ("f", "df", "lost", "applied"),
    [
        ([0, 0, 0], [20, -5, 4], set(), [20, -5, 4]),
        ([0, 0, 0], [-99, 99, 4], set(), [-20, 5, 4]),
        # The limit ahead and the one astern, which is nearer
        ([395, 48, -48], [20, 5, -5], set(), [400, 50, -50]),
        ([-195, 0, 0], [-20, 0, 0], set(), [-200, 0, 0]),
        ([-195, 0, 0], [-4, 0, 0], set(), [-199, 0, 0]),
        # The main propeller is lost at 5 increments, a share of 0.5 astern and 0.25 ahead: its
        # limits close in by 0.9 of an increment. A full one is nearer, and allowed.
        ([-100, 9, 0], [0, 1, 0], {0}, [-82, 10, 0]),
        ([-100, 9, 0], [-20, 1, 0], {0}, [-82, 10, 0]),
        ([-100, 9, 0], [50, 1, 0], {0}, [-80, 10, 0]),
        ([-100, 9, 0], [19, 1, 0], {0}, [-81, 10, 0]),
        ([100, 9, 0], [0, 1, 0], {0}, [82, 10, 0]),
        ([100, 9, 0], [-19, 1, 0], {0}, [81, 10, 0]),
        # What is less than an increment is gone at once
        ([-15, 0, 0], [-20, 0, 0], {0}, [0, 0, 0]),
        ([0, 4, 0], [0, 3, 0], {1}, [0, 0, 0]),
    ],
)
def test_every_thruster_is_limited_as_a_whole(
    f: list[float], df: list[float], lost: set[int], applied: list[float]
) -> None:
    found, move = np.full(3, np.nan), np.array(df, dtype=float)
    limit = ThrusterLimit(ROWS, THRUSTERS.largest_force_changes_per_sample(0.5))
    clipped = limit(
        np.array(f, dtype=float), move, ROWS.limits_after_loss_of_thrusters(lost), found
    )
    np.testing.assert_allclose(found, applied, atol=1e-6)
    assert clipped is (applied != [a + b for a, b in zip(f, df, strict=True)])


# An azimuth of 100 N, 5 N an entry and sample, with |X| + |Y| ≤ 100 N; a lost one may shrink to
# 1 - 0.9/s of itself, s its increments.
AZIMUTH = ThrusterSet(
    (
        Thruster("azimuth", "azimuth", -10.0, 0.0, 100.0, 10.0),
        Thruster("bow", "tunnel", 10.0, 0.0, 50.0, 5.0),
    )
)


@pytest.mark.parametrize(
    ("f", "df", "lost", "applied"),
    [
        # X + Y from 98 N towards 108 N: a fifth of the move
        ([60, 38, 0], [5, 5, 0], set(), [61, 39, 0]),
        ([-60, -38, 0], [-5, -5, 0], set(), [-61, -39, 0]),
        # The same while the other one is lost
        ([60, 38, 9], [5, 5, 0], {1}, [61, 39, 4.5]),
        # (30, 40): s = √(6² + 8²) = 10, X + Y ≤ 0.91·70 = 63.7 N. From 0.9·(30, 40) = (27, 36) by
        # (8, 9) towards (35, 45): 0.7 of 17 N are free.
        ([30, 40, 0], [5, 5, 0], {0}, [27 + 8 * 0.7 / 17, 36 + 9 * 0.7 / 17, 0]),
    ],
)
def test_an_azimuth_is_cut_along_its_move(
    f: list[float], df: list[float], lost: set[int], applied: list[float]
) -> None:
    rows, found = build_limit_rows_of_thrusters(AZIMUTH, 4), np.full(3, np.nan)
    limit = ThrusterLimit(rows, AZIMUTH.largest_force_changes_per_sample(0.5))
    move = np.array(df, dtype=float)
    assert limit(np.array(f, dtype=float), move, rows.limits_after_loss_of_thrusters(lost), found)
    np.testing.assert_allclose(found, applied, atol=1e-6)


@pytest.mark.parametrize("error", [1e-6, 1e-3, 4e-3])
def test_a_small_error_does_not_stop_a_move_along_a_limit(error: float) -> None:
    """From (60, 40) N on |X| + |Y| = 100 N: what is beyond a limit alone is cut."""
    rows, found = build_limit_rows_of_thrusters(AZIMUTH, 4), np.full(3, np.nan)
    limit = ThrusterLimit(rows, AZIMUTH.largest_force_changes_per_sample(0.5))
    limits, outwards = rows.limits_after_loss_of_thrusters(set()), 5.0 * error
    for along in (4.0, 5.0):  # 5 N is the maximum increment
        move = np.array([along + outwards, outwards - along, 0.0])
        assert limit(np.array([60.0, 40.0, 0.0]), move, limits, found)
        np.testing.assert_allclose(found, [60.0 + along, 40.0 - along, 0.0], atol=outwards)
        assert (rows.G @ found <= limits.high + 1e-6).all()


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("calm")


def test_a_controller_of_forces_limits_axis_by_axis(scenario: Scenario) -> None:
    """The largest increments are 32 736 N, 11 008 N and 475 200 N·m."""
    applied = np.empty(3)
    limits, limit = (
        Limits(np.full(3, -1e9), np.full(3, 1e9)),
        scenario.controller.make_increment_limiter(),
    )
    assert limit(np.zeros(3), np.full(3, -1e8), limits, applied)
    np.testing.assert_allclose(applied, [-32736.0, -11008.0, -475200.0])


def test_clip_is_the_first_move_of_the_unconstrained_optimum(scenario: Scenario) -> None:
    """The move is the first three entries of −P⁻¹ q of the QP in SI units."""
    short = replace(scenario.problem, N_p=6, N_c=2)
    si = CondensedQP(short, units="si")
    x, y_ref = np.array([0.1, -0.2, 0.01, 0.02, 0.03, 0.004, 1.5, -2.0, 0.3]), np.ones(3)
    step = si.emit(x, y_ref, np.zeros(3))
    expected = -np.linalg.solve(si.problem(step).P, step.q)[:3]
    law = FALLBACKS["clip"](2, 3, UnconstrainedLaw(si))
    np.testing.assert_allclose(law.move(x, y_ref, np.zeros(3)), expected, rtol=1e-9)
    assert law.acted
