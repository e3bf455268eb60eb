"""Thrust, power, wear and limit figures of thrusters in runs worked by hand."""

import json
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from dpbench.bench.judge.control_metrics import (
    compute_thruster_metrics,
    compute_used_thrust_and_power_shares,
    describe_thruster_use_as_json,
)
from dpbench.mpc.thruster_rows import Limits, build_limit_rows_of_thrusters
from dpbench.mpc.thrusters.azimuth_turning import AzimuthTurning
from dpbench.scenario.controllers.controller import ThrusterControl, TurningThrusterControl
from dpbench.scenario.scenario import Scenario
from dpbench.ship.thrusters import Thruster, ThrusterSet
from tests.bench.judge.known_runs import thruster_ship

# Full thrusts 100, 25, 400 N; in a sample of 0.5 s an entry changes by 5, 5, 1.25, 20 N at most.
THRUSTERS = ThrusterSet(
    (
        Thruster("azimuth", "azimuth", -10.0, 0.0, 100.0, 10.0),
        Thruster("bow", "tunnel", 10.0, 0.0, 25.0, 10.0),
        Thruster("main", "main", -10.0, 0.0, 400.0, 10.0, astern=0.5),
    )
)
# With four sides the azimuth is limited by |X| + |Y| ≤ 100 N.
ROWS = build_limit_rows_of_thrusters(THRUSTERS, 4)
BOW, MAIN = 2, 3
"""Rows of the tunnel and the main thruster, behind the two rows of the azimuth."""
Forces = Sequence[Sequence[float]]


def ship(turning: AzimuthTurning | None = None) -> Scenario:
    own = THRUSTERS, ROWS, np.eye(4)
    return thruster_ship(
        ThrusterControl(*own) if turning is None else TurningThrusterControl(*own, turning)
    )


def metrics_of(
    f: Forces,
    low: np.ndarray | None = None,
    high: np.ndarray | None = None,
    turning: AzimuthTurning | None = None,
    lost: Sequence[int] = (),
) -> dict[str, float]:
    """Return the metrics of a run, by default with the limits of the intact thrusters."""
    sides = ROWS.low if low is None else low, ROWS.high if high is None else high
    tables = [np.vstack([np.broadcast_to(s, (len(f), 4)), np.zeros((1, 4))]) for s in sides]
    states = [np.zeros(3, dtype=bool)] * (len(f) - 1) + [np.isin(np.arange(3), lost)] * 2
    limits = [Limits(*of_step) for of_step in zip(*tables, states, strict=True)]
    return compute_thruster_metrics(ship(turning), np.array(f, dtype=float), limits)


def test_shares_of_full_thrust_and_power() -> None:
    """Forces of 25, 16 and 81 N of 100, 25 and 400 N have powers of 125, 64 and 729."""
    f = [[15, -20, -16, 81], [0, 0, 0, 0]]
    of_steps = compute_used_thrust_and_power_shares(ship(), np.array(f, dtype=float))
    # 122/525, and 918 of 1000 + 125 + 8000
    assert of_steps["thrust_share"] == pytest.approx([122 / 525, 0.0])
    assert of_steps["power_share"] == pytest.approx([918 / 9125, 0.0])
    found = metrics_of(f)
    assert found["thrust_share"] == pytest.approx(61 / 525)
    assert found["power_share"] == pytest.approx(459 / 9125)


def test_wear_is_the_change_of_every_entry() -> None:
    """The variation is 0.15 + 0.2 + 0.64 + 0.2025 up, and 0.99 down again."""
    found = metrics_of([[15, -20, -16, 81], [0, 0, 0, 81]])
    assert found["thrust_variation"] == pytest.approx(1.1925 + 0.99)


@pytest.mark.parametrize(
    ("azimuth", "travel_deg"),
    [
        # From nothing to any direction, and from below 1 N: no travel
        ([[10, 0], [10, 0]], 0.0),
        ([[10, 0], [0, 10]], 90.0),
        ([[10, 0], [0, -10], [0, -20], [-3, -3]], 135.0),
        # Past 180° the short way round: 150° to 210°
        ([[-math.sqrt(3), 1], [-math.sqrt(3), -1]], 60.0),
        ([[10, 0], [0, 0.9], [-10, 0]], 0.0),
        # Exactly 1 % of the full thrust is not yet pushing
        ([[10, 0], [0, 1.0]], 0.0),
        ([[10, 0], [0, 1.001]], 90.0),
        ([[0, 1.0], [10, 0]], 0.0),
        ([[10, 0], [-10, 0]], 180.0),
    ],
)
def test_travel_of_an_azimuth_while_it_pushes(azimuth: Forces, travel_deg: float) -> None:
    """Only angles between forces above 1 % of the full thrust count."""
    found = metrics_of([[*force, 0, 0] for force in azimuth])
    assert found["azimuth_travel_deg"] == pytest.approx(travel_deg)
    assert found["thrust_reversals"] == 0.0


def test_travel_of_all_azimuths_is_added_up() -> None:
    """The sum is 90° of one azimuth and 180° of another."""
    names = ("port", "starboard", "bow")
    arms = zip(names, (-5.0, 5.0, 0.0), strict=True)
    three = ThrusterSet(tuple(Thruster(n, "azimuth", 9.0, y, 100.0, 10.0) for n, y in arms))
    control = ThrusterControl(three, build_limit_rows_of_thrusters(three, 4), np.eye(6))
    f = np.array([[10.0, 0, 0, 10, 5, 0], [0, 10, 10, 0, 5, 0], [0, 10, 0, -10, 5, 0]])
    limits = [Limits(np.full(6, -1e3), np.full(6, 1e3), np.zeros(3, dtype=bool))] * 3
    found = compute_thruster_metrics(thruster_ship(control), f, limits)
    assert found["azimuth_travel_deg"] == pytest.approx(270.0)


def test_reversals_of_thrusters_without_an_azimuth() -> None:
    """Changes of sign count between forces above 1 % of the full thrust."""
    bow = [10, 0.1, 10, -0.25, -10, 0.2, -5, 5]
    main = [-9, -9, 4, 9, 3, -4.1, -9, -9]
    # Tunnel + + - - +: 2. Main - - + + - - - with 4 N and 3 N left out: 2.
    found = metrics_of([[0, 0, b, m] for b, m in zip(bow, main, strict=True)])
    assert found["thrust_reversals"] == 4.0
    assert found["azimuth_travel_deg"] == 0.0


def test_share_of_steps_at_a_rate_limit() -> None:
    """One entry within 1e-6 of its largest increment is enough."""
    found = metrics_of(
        [
            [5.0, 0, 0, 0],
            [5.0, -4.9999951, 0, 0],
            [5.0, -4.9999951, 1.2499975, 0],
            [5.0, -4.9999951, 1.2499975, -20],
        ]
    )
    assert found["at_rate_thrusters"] == 0.75


def test_share_of_steps_at_a_side_of_a_limit() -> None:
    """A force within 1e-6 increments of either side of a row is at its limit."""
    near = 2.5e-6
    assert metrics_of([[60, 40, 0, 0]])["at_limit_thrusters"] == 1.0
    assert metrics_of([[60, 39.9, 0, 0]])["at_limit_thrusters"] == 0.0
    assert metrics_of([[-50, -50, 0, 0]])["at_limit_thrusters"] == 1.0
    # Within 1e-6 of the increment of 1.25 N, and 2.5e-6 N away
    inside = [[0, 0, 25 - 1.2e-6, 0], [0, 0, 25 - near, 0], [0, 0, -25, 0], [0, 0, 0, -200]]
    assert metrics_of(inside)["at_limit_thrusters"] == 0.75


@pytest.mark.parametrize(("left_s", "end"), [(math.nan, 4), (1.5, 3)])
def test_use_of_each_thruster_since_the_last_loss(left_s: float, end: int) -> None:
    """The tunnel is lost at 0.5 s, step 1; the ship leaves at step 3 or stays for 4 steps."""
    scenario = ship()
    fault = {"at_s": 0.5, "lost": ["bow"]}
    document = scenario.files["scenario"] | {"faults": [fault, fault | {"at_s": 9.0}]}
    scenario = replace(scenario, files=scenario.files | {"scenario": document})
    f = np.array([[0, 0, 25, 400], [60, 40, 0, 400], [65, 30, 0, 385], [0, 0.5, 0, 380]], float)
    limits = [ROWS.intact, *3 * [ROWS.limits_after_loss_of_thrusters({1})]]
    use = json.loads(describe_thruster_use_as_json(scenario, f, limits, left_s))
    azimuth = [math.hypot(60, 40) / 100, math.hypot(65, 30) / 100, 0.005][: end - 1]
    main = [1.0, 385 / 400, 380 / 400][: end - 1]
    count = end - 1
    assert use["window_s"] == [0.5, end * 0.5] and list(use["thrusters"]) == ["azimuth", "main"]
    # |X| + |Y| = 100 N once; increments of 60, 10 and 65 N exceed the 5 N of an entry.
    assert use["thrusters"]["azimuth"][:3] == pytest.approx(
        [np.mean(azimuth), max(azimuth), 1 / count]
    )
    assert use["thrusters"]["main"] == pytest.approx([np.mean(main), 1.0, 1 / count, 0.0])
    total = [(100 * a + 400 * m) / 500 for a, m in zip(azimuth, main, strict=True)]
    assert use["thrust"] == pytest.approx([np.mean(total), max(total)])


def test_an_idle_azimuth_in_the_corner_of_its_sector_is_at_no_limit() -> None:
    """At 1 N of 100 N it is idle; at 50 N along the edge of its half turn it is at a limit."""
    half = Thruster("azimuth", "azimuth", -10.0, 0.0, 100.0, 10.0, sector_rad=(0.0, math.pi))
    own = ThrusterSet((half, *THRUSTERS.thrusters[1:]))
    rows = build_limit_rows_of_thrusters(own, 4)
    scenario = thruster_ship(ThrusterControl(own, rows, np.eye(4)))
    f = np.array([[0, 0, 0, 0], [1.0, 0, 0, 0], [50, 0, 0, 0], [30, 20, 0, 0]], dtype=float)
    use = json.loads(describe_thruster_use_as_json(scenario, f, 4 * [rows.intact], math.nan))
    assert use["thrusters"]["azimuth"][2] == 0.25


def test_a_lost_thruster_is_at_no_limit() -> None:
    limits = [ROWS.limits_after_loss_of_thrusters({1})] * 2
    for main, share in ((0.0, 0.0), (400.0, 0.5)):
        run = np.array([[0, 0, 0, main], [0, 0, 0, 0]])
        assert compute_thruster_metrics(ship(), run, limits)["at_limit_thrusters"] == share


@pytest.mark.parametrize(
    ("step", "violations"),
    [
        ([5.0, -5.0, 1.25, -20.0], 0),
        ([5.0 + 1e-6, 0, 0, 0], 1),
        ([0, -5.0 - 1e-6, 0, 0], 1),
        ([0, 0, -1.25 - 1e-6, 0], 1),
        ([0, 0, 0, 20.0 + 1e-6], 1),
        # 1e-12 of an increment is rounding
        ([5.0 * (1 + 5e-13), 0, 0, 0], 0),
        ([5.0 * (1.0 + 1e-12), 0, 0, 0], 0),
        ([5.0 * (1 + 2e-12), 0, 0, 0], 1),
        ([6.0, 6.0, 2.0, 30.0], 1),
    ],
)
def test_an_increment_beyond_the_rate_is_a_violation(step: list[float], violations: int) -> None:
    assert metrics_of([step])["limit_violations"] == violations


def ramped(to: float, increment: float) -> list[list[float]]:
    """Return forces of the tunnel thruster that rise from zero by one increment a sample."""
    steps = round(abs(to) / increment)
    return [[0, 0, math.copysign(increment * (i + 1), to), 0] for i in range(steps)]


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("last", "violations"), [(25.0, 0), (25.0 + 1e-6, 1), (25.5, 1)])
def test_a_force_beyond_its_limit_is_a_violation(side: float, last: float, violations: int) -> None:
    """The tunnel thruster gives at most 25 N."""
    run = [*ramped(side * 25.0, 1.25), [0, 0, side * last, 0]]
    assert metrics_of(run)["limit_violations"] == violations


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("limit", "last", "violations"),
    [
        # From 10 N, 8 increments, the way back is 0.9 of an increment: 10 - 0.9·1.25 = 8.875
        (5.0, 8.875, 0),
        (5.0, 8.8751, 1),
        (5.0, 9.5, 1),
        (5.0, 8.75, 0),
        # A limit that is reachable holds as it is
        (9.5, 9.5, 0),
        (9.5, 9.51, 1),
        # Lost: the same way back
        (0.0, 8.875, 0),
        (0.0, 8.8751, 1),
    ],
)
def test_the_way_back_from_a_limit(side: float, limit: float, last: float, violations: int) -> None:
    """A force beyond a limit that has just dropped may return at 0.9 of its rate."""
    run = [*ramped(side * 10.0, 1.25), [0, 0, side * last, 0]]
    low, high = (np.tile(of_rows, (len(run), 1)) for of_rows in (ROWS.low, ROWS.high))
    low[-1, BOW], high[-1, BOW] = -limit, limit
    lost = () if limit else (1,)
    assert metrics_of(run, low, high, lost=lost)["limit_violations"] == violations


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("beyond", "violations"), [(1.9e-8, 0), (2.1e-8, 1)])
def test_rounding_is_a_share_of_the_increment(side: float, beyond: float, violations: int) -> None:
    """From 100 N the main thruster returns to 100 - 0.9·20 = 82 N; 1e-9 of 20 N are rounding."""
    run = [[0, 0, 0, side * 20.0 * i] for i in range(1, 6)]
    run.append([0, 0, 0, side * (82.0 + beyond)])
    low, high = (np.tile(of_rows, (6, 1)) for of_rows in (ROWS.low, ROWS.high))
    low[-1, MAIN], high[-1, MAIN] = -50.0, 50.0
    assert metrics_of(run, low, high)["limit_violations"] == violations


def test_a_step_beyond_several_limits_is_one_violation() -> None:
    run = [[0, 0, 1.25 * i, 20.0 * i] for i in range(1, 6)]
    run.append([0, 0, 6.25, 100])
    low, high = (np.tile(of_rows, (6, 1)) for of_rows in (ROWS.low, ROWS.high))
    low[-1, BOW:], high[-1, BOW:] = -1.0, 1.0
    assert metrics_of(run, low, high)["limit_violations"] == 1.0
    run[-1] = [0, 0, 9.0, 100]
    assert metrics_of(run, low, high)["limit_violations"] == 1.0


@pytest.mark.parametrize(("across", "violations"), [(1.0, 0), (1.1, 1), (-1.0, 0), (-1.1, 1)])
def test_an_azimuth_that_turns_too_fast_is_a_violation(across: float, violations: int) -> None:
    """An azimuth at 50 N that turns by 0.02 rad a sample moves across by at most 1 N."""
    run = [[5.0 * (i + 1), 0, 0, 0] for i in range(10)]
    run.append([50.0, across, 0, 0])
    slow = AzimuthTurning(np.array([0]), np.array([0.02]), np.array([5.0]))
    assert metrics_of(run, turning=slow)["limit_violations"] == violations
    assert metrics_of(run)["limit_violations"] == 0.0


@pytest.mark.parametrize(("share", "violations"), [(1e-6, 0), (1.01e-6, 1)])
def test_a_millionth_of_an_increment_is_no_turning(share: float, violations: int) -> None:
    """An azimuth that cannot turn may move across by 1e-6 of its increment of 5 N."""
    run = [[5.0, 0, 0, 0], [5.0, share * 5.0, 0, 0]]
    fixed = AzimuthTurning(np.array([0]), np.array([0.0]), np.array([5.0]))
    assert metrics_of(run, turning=fixed)["limit_violations"] == violations
