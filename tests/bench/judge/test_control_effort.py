"""Effort, cost, deviation and limit figures of runs worked by hand."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from dpbench.bench.record.schema import FORCES
from dpbench.mpc.thruster_rows import build_limit_rows_of_thrusters
from dpbench.mpc.thrusters.attainable_set import AttainableSet
from dpbench.scenario.controllers.controller import ThrusterControl
from dpbench.scenario.controllers.kinds import JointForceController
from dpbench.scenario.scenario import Scenario
from dpbench.ship.thrusters import Thruster, ThrusterSet
from tests.bench.judge.known_runs import (
    Rows,
    exact_loop,
    metrics_of,
    round_ship,
    thruster_ship,
    with_controller,
)

STILL = [0.0, 0.0, 0.0]
ULP = float(np.spacing(200.0))
"""Unit in the last place of the largest surge force: 2.8e-14 N."""


def test_effort_variation_and_work_of_a_known_run() -> None:
    """The figures of two samples of 0.5 s ignore the velocity after the last sample."""
    found = metrics_of(
        [STILL] * 3,
        [[100, 25, -5], [-100, 25, 5]],
        velocity=[[1, -2, 0.1], [1, 1, 1], [99, 99, 99]],
    )
    # Largest forces 200, 50, 20: (0.25 + 0.25 + 0.0625) of both samples, times 0.5 s
    assert found["effort_s"] == pytest.approx(0.5625)
    # From zero 0.5 + 0.5 + 0.25, then 200/200 + 0/50 + 10/20
    assert found["total_variation"] == pytest.approx(2.75)
    # |100 - 50 - 0.5| = 49.5 W and |-100 + 25 + 5| = 70 W, times 0.5 s
    assert found["work_J"] == pytest.approx(59.75)


def test_work_has_no_sign_and_is_that_of_all_axes_together() -> None:
    braked = metrics_of([STILL] * 2, [[-10, 0, 0]], velocity=[[2, 0, 0], STILL])
    assert braked["work_J"] == 10.0
    across = metrics_of([STILL] * 2, [[10, 10, 0]], velocity=[[2, -2, 0], STILL])
    assert across["work_J"] == 0.0


Q = np.array([[2.0, 1.0, 0.0], [1.0, 4.0, 0.0], [0.0, 0.0, 8.0]])
R = np.diag([0.5, 1.0, 2.0])
REFERENCE = [[5, 5, 0.5], [6, 7, 0.25], [4, 4, 0.5], [50, 50, 5], [60, 60, 6]]
# Errors (95, -5, 2.5), then (1, 2, 0.5) and (-1, 0, 1).
POSE = [[100, 0, 3], [7, 9, 0.75], [3, 4, 1.5]]
FORCE = [[2, 0, 1], [2, -1, 0]]


def test_cost_of_a_known_run() -> None:
    """The cost takes errors at the ends of the samples and the first increment from zero.

    (1, 2, 0.5): 2 + 2·1·2 + 16 + 2 = 24; (-1, 0, 1): 2 + 8 = 10; increments (2, 0, 1): 2 + 2 = 4,
    (0, -1, -1): 1 + 2 = 3; half of the sum 41.
    """
    found = metrics_of(POSE, FORCE, reference=REFERENCE, scenario=round_ship(Q=Q, R=R))
    assert found["closed_loop_cost"] == pytest.approx(20.5)


def test_cost_of_the_exactly_solved_loop_is_that_of_its_first_steps() -> None:
    """The exact cost takes as many steps of the exact loop as the run has.

    (0, 1, 0): 4; (1, 0, -0.5): 2 + 2 = 4; increments (4, 0, 0): 8, (0, 3, 1): 9 + 2 = 11; half of
    27.
    """
    exact = exact_loop(
        [[0, 0, 0], [6, 8, 0.25], [5, 4, 0], [9, 9, 9], [9, 9, 9]],
        [[4, 0, 0], [4, 3, 1], [7, 7, 7], [9, 9, 9]],
    )
    ship = round_ship(Q=Q, R=R)
    found = metrics_of(POSE, FORCE, reference=REFERENCE, exact=exact, scenario=ship)
    assert found["exact_cost"] == pytest.approx(13.5)
    assert found["closed_loop_cost"] == pytest.approx(20.5)


def with_thrusters() -> Scenario:
    """Return the ship with a main propeller and tunnel thrusters 10 m ahead and 20 m astern."""
    thrusters = ThrusterSet(
        (
            Thruster("main", "main", 0.0, 0.0, 200.0, 10.0),
            Thruster("bow", "tunnel", 10.0, 0.0, 50.0, 10.0),
            Thruster("stern", "tunnel", -20.0, 0.0, 50.0, 10.0),
        )
    )
    W = np.diag([1.0, 2.0, 4.0])
    return thruster_ship(
        ThrusterControl(thrusters, build_limit_rows_of_thrusters(thrusters, 4), W), R
    )


def test_cost_of_steered_thrusters_has_their_weight() -> None:
    """The cost of thruster forces (2, 1, 0) and (3, 1, -1) has a term ½ Σ uᵀWu.

    Increments (2, 1, 0): 2 + 1 = 3; (1, 0, -1): 0.5 + 2 = 2.5. Weight 4 + 2 = 6 and
    9 + 2 + 4 = 15. Half of 26.5. The exact loop gives 4 N by the main propeller: increments 8,
    weight 16 + 16, half of 40.
    """
    exact = exact_loop([STILL] * 3, [STILL] * 2, [[4, 0, 0], [4, 0, 0]])
    found = metrics_of([STILL] * 3, [[2, 1, 0], [3, 1, -1]], exact=exact, scenario=with_thrusters())
    assert found["closed_loop_cost"] == pytest.approx(13.25)
    assert found["exact_cost"] == pytest.approx(20.0)


def test_the_force_of_steered_thrusters_is_what_they_make_together() -> None:
    """Thruster forces (100, 30, -20) make surge 100, sway 10 and yaw 300 + 400 = 700.

    Effort ((100/200)² + (10/50)² + (700/20)²)·0.5 s; deviation from a loop that gives
    (-20, 10, ·): 120 N.
    """
    exact = exact_loop([STILL] * 2, [[-20, 10, 0]], [[0, 0, 0]])
    found = metrics_of([STILL] * 2, [[100, 30, -20]], exact=exact, scenario=with_thrusters())
    assert found["effort_s"] == pytest.approx((0.25 + 0.04 + 1225.0) * 0.5)
    assert found["dev_force_max_N"] == pytest.approx(120.0)
    assert "limit_violations" not in found, "the thrusters' own metrics count them"


def test_distance_from_the_exactly_solved_loop() -> None:
    """Deviations are sizes at equal samples, without the moment and the last state.

    Distances (3, -4): 5 m, (0, 0): 0 m; 2° and -4°; forces -30 N in surge and 50 N in sway: 50 N,
    then 0 and -10 N: 10 N.
    """
    deg = math.pi / 180.0
    exact = exact_loop(
        [[1, 1, 0.5], [2, 2, 0.25], [7, 7, 7], [8, 8, 8]], [[40, 10, 0], [5, 5, 0], [9, 9, 9]]
    )
    found = metrics_of(
        [[4, -3, 0.5 + 2 * deg], [2, 2, 0.25 - 4 * deg], [70, 70, 0]],
        [[10, 60, 15], [5, -5, -20]],
        exact=exact,
    )
    assert found["dev_position_max_m"] == pytest.approx(5.0)
    # √((25 + 0)/2)
    assert found["dev_position_rms_m"] == pytest.approx(3.5355339059327378)
    assert found["dev_heading_max_deg"] == pytest.approx(4.0)
    # √((4 + 16)/2)
    assert found["dev_heading_rms_deg"] == pytest.approx(3.1622776601683795)
    assert found["dev_force_max_N"] == pytest.approx(50.0)
    # √((2500 + 100)/2)
    assert found["dev_force_rms_N"] == pytest.approx(36.05551275463989)


def test_shares_of_steps_at_a_rate_limit() -> None:
    """An increment within 1e-6 of ±10, ±5 or ±2 is at the rate limit."""
    found = metrics_of(
        [STILL] * 5, [[10, 5, 0], [0, 5, 0], [9.999991, 5, 1.9], [10.0, 0.00001, -0.1]]
    )
    # Surge +10, -10, +9.999991, 0; sway +5, 0, 0, -4.99999; yaw 0, 0, 1.9, -2
    assert [found[f"at_rate_{axis}"] for axis in FORCES] == [0.75, 0.25, 0.25]


def test_shares_of_steps_at_an_amplitude_limit() -> None:
    """A force within 1e-6 increments of either limit of its sample is at the limit."""
    low = [[-200, -40, -20]] * 3 + [[-200, -40, 0.0]]
    high = [[8, 50, 20], [8, 50, 2], [8, 4, 2], [8, 4, 2], [0, 0, 0]]
    low.append([0, 0, 0])
    found = metrics_of(
        [STILL] * 5,
        [[8, 4, 2], [7.99999, 4, 2.0], [7.9, 4.000001, 1.9], [7.999995, 3.9, 0.000001]],
        limits=(low, high),
    )
    # Surge at 8 but for 7.9: 3 of 4. Sway at 4, in force from the third sample: 1 of 4, 4.000001
    # included. Yaw at 2 in the second sample, at the lower limit 0 in the fourth: 2 of 4.
    assert [found[f"at_amplitude_{axis}"] for axis in FORCES] == [0.75, 0.25, 0.5]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_margin_of_a_limit_belongs_to_it(side: float) -> None:
    """Increments and forces exactly 1e-6 increments from their limits are at them."""
    near = [du - 1e-6 * du for du in (10.0, 5.0, 2.0)]
    limits = (
        [[side * most for most in (10.0, 5.0, 2.0)]],
        [[side * -200.0, side * -50.0, side * -20.0]],
    )
    high, low = (np.maximum(*limits), np.minimum(*limits))
    found = metrics_of(
        [STILL] * 2, [[side * force for force in near]], limits=(low.tolist(), high.tolist())
    )
    assert [found[f"at_rate_{axis}"] for axis in FORCES] == [1.0] * 3
    assert [found[f"at_amplitude_{axis}"] for axis in FORCES] == [1.0] * 3


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_increment_beyond_the_rate_is_a_violation(axis: int, side: float) -> None:
    du_max = [10.0, 5.0, 2.0][axis]
    rounding = float(np.spacing([200.0, 50.0, 20.0][axis]))
    for beyond, violations in ((0.0, 0), (rounding, 0), (1e-9, 1), (1.0, 1)):
        force = list(STILL)
        force[axis] = side * (du_max + beyond)
        assert metrics_of([STILL] * 2, [force])["limit_violations"] == violations


def test_a_step_beyond_several_limits_is_one_violation() -> None:
    found = metrics_of([STILL] * 4, [[11, 6, 3], [11, 6, 3], [30, 6, 0]])
    assert found["limit_violations"] == 2.0
    low, high = [[-9, -4, -1]] * 3, [[9, 4, 1]] * 3
    forces = [[10, 5, 2], [9, 4, 1], [20, -10, -2]]
    found = metrics_of([STILL] * 4, forces, limits=(low, high))
    assert found["limit_violations"] == 2.0


DROPPED = [
    # before, upper limit now, force now, violations: 50 - 10 = 40 is what the rate leaves
    (50.0, 10.0, 40.0, 0),
    (50.0, 10.0, 40.001, 1),
    (50.0, 45.0, 45.0, 0),
    (50.0, 45.0, 44.0, 0),
    (50.0, 45.0, 45.001, 1),
    (50.0, 55.0, 55.0, 0),
    (50.0, 55.0, 55.001, 1),
    (50.0, 55.0, 55.0 + 8 * ULP, 1),
]


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("before", "limit", "now", "violations"), DROPPED)
def test_a_limit_that_drops_leaves_what_the_rate_leaves(
    side: float, before: float, limit: float, now: float, violations: int
) -> None:
    raised = [[side * part, 0.0, 0.0] for part in (10.0, 20.0, 30.0, 40.0, before, now)]
    high, low = [[100.0, 50.0, 20.0]] * 6, [[-200.0, -40.0, -20.0]] * 6
    if side > 0:
        high = [*high[:5], [limit, 50.0, 20.0]]
    else:
        low = [*low[:5], [-limit, -40.0, -20.0]]
    found = metrics_of([STILL] * 7, raised, limits=(low, high))
    assert found["limit_violations"] == violations


HIGH = [100.0, 40.0, 10.0]
BOX = AttainableSet(np.eye(3), (np.array(list(product(*[(-h, h) for h in HIGH]))),))


def set_metrics(u: Rows, shares: list[float]) -> dict[str, float]:
    """Return the metrics of forces limited to these shares of the set, sample by sample.

    The largest increments are 10, 5 and 2.
    """
    high = np.multiply.outer(shares, HIGH)
    limits = (-high).tolist(), high.tolist()
    rows = BOX.to_linear_limit_rows()
    problem = replace(round_ship().problem, thrusters=rows, u_min=rows.low, u_max=rows.high)
    ship = with_controller(JointForceController, problem)
    return metrics_of([STILL] * (len(u) + 1), u, limits=limits, scenario=ship)


def ramp(to: float) -> list[list[float]]:
    """Return surge forces that rise by 10 N per sample up to a force."""
    steps = round(abs(to) / 10)
    return [[10.0 * (i + 1) * (1 if to > 0 else -1), 0.0, 0.0] for i in range(steps)]


def test_columns_of_the_set_take_the_place_of_those_of_its_axes() -> None:
    found = set_metrics([[10.0, 0.0, 2.0], [10.0, 0.0, 4.0]], [1.0, 1.0])
    assert [found[f"at_rate_{axis}"] for axis in FORCES] == [0.5, 0.0, 1.0]
    assert not [name for name in found if name.startswith("at_amplitude")]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_share_of_steps_at_the_set(side: float) -> None:
    """A force within 1e-6 increments of the set in force is at its limit."""
    forces = [[0, 0, 2], [0, 0, 4], [0, 0, 6], [0, 0, 8], [0, 0, 10 - 1e-6], [0, 0, 10 - 1e-5]]
    turned = [[side * part for part in force] for force in forces]
    assert set_metrics(turned, [1.0] * 6)["at_limit_thrusters"] == pytest.approx(1 / 6)
    assert set_metrics(turned, [0.8, 0.8, 0.8, 0.8, 1, 1])["at_limit_thrusters"] == pytest.approx(
        2 / 6
    )


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_margin_of_the_set_belongs_to_it(side: float) -> None:
    """A force exactly 1e-6 increments, of 2 in yaw, from the set is at its limit."""
    ramped = [[0, 0, side * moment] for moment in (2, 4, 6, 8, 10 - 1e-6 * 2)]
    assert set_metrics(ramped, [1.0] * 5)["at_limit_thrusters"] == pytest.approx(1 / 5)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("shares", "last", "violations"),
    [
        # The set stays: 50 N lies within it, 50.1 N beyond 0.5 of it
        ([0.5] * 6, 50.0, 0),
        ([0.5] * 6, 50.001, 1),
        ([1.0] * 6, 59.0, 0),
        # It has shrunk below the force before, 50 N: a smaller share is on its way, a larger not
        ([1.0] * 5 + [0.2], 40.0, 0),
        ([1.0] * 5 + [0.2], 49.9, 0),
        ([1.0] * 5 + [0.2], 50.1, 1),
        # Beyond the rate, within and outside
        ([1.0] * 6, 60.1, 1),
        ([1.0] * 5 + [0.2], 39.0, 1),
        ([1.0] * 5 + [0.2], 60.1, 1),
    ],
)
def test_a_set_that_shrinks(side: float, shares: list[float], last: float, violations: int) -> None:
    run = [*ramp(side * 50.0), [side * last, 0.0, 0.0]]
    assert set_metrics(run, shares)["limit_violations"] == violations


def test_the_share_is_that_of_the_axis_that_needs_most() -> None:
    """The largest share over the axes decides, here from 0.25 at (20, 10, 0).

    (28, 9, 0) needs 0.28 and is further out; (24, 8, 0) needs 0.24 and is nearer.
    """
    start = [[10.0, 5.0, 0.0], [20.0, 10.0, 0.0]]
    shares = [1.0, 1.0, 0.1]
    assert set_metrics([*start, [28.0, 9.0, 0.0]], shares)["limit_violations"] == 1.0
    assert set_metrics([*start, [24.0, 8.0, 0.0]], shares)["limit_violations"] == 0.0
