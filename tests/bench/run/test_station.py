"""The reference loop keeps its ship on station."""

from typing import Any

import numpy as np
import pytest

from dpbench.bench.run.exact_loop import (
    ExactLoop,
    compute_station_metrics,
    mask_arrived_samples,
    solve_loop_exactly,
)
from dpbench.scenario.scenario import Scenario, load_scenario
from dpbench.scenario.variation import copy_scenario_with_values


def loop_along(scenario: Scenario, east_m: Any, active: Any = False) -> ExactLoop:
    """A reference loop whose ship is these offsets east of the origin [m]."""
    K = len(east_m) - 1
    state = np.zeros((K + 1, 6))
    state[:, 4] = east_m
    tau, none = np.zeros((K, 3)), np.zeros((K, 0))
    flags = np.broadcast_to(np.asarray(active, dtype=bool), K)
    return ExactLoop(np.zeros((K, 16)), state, tau, none, np.zeros((K, 15)), flags, [])


def test_a_ship_that_drifts_off_leaves_at_the_first_sample_outside() -> None:
    calm = load_scenario("calm")
    east = np.append(np.linspace(0.0, 10.0, 11), [37.0, 36.0])
    found = compute_station_metrics(calm, loop_along(calm, east, np.arange(12) % 4 == 0), 12)
    assert found["exact_left_s"] == pytest.approx(6 * calm.sample_s)
    assert found["exact_offset_max_m"] == 37.0 and found["exact_offset_end_m"] == 36.0
    assert found["exact_offset_max_s"] == pytest.approx(11 * calm.sample_s)
    assert found["exact_active_share"] == 0.25


def test_only_the_steps_asked_for_count() -> None:
    calm = load_scenario("calm")
    found = compute_station_metrics(calm, loop_along(calm, np.linspace(0.0, 10.0, 11)), 4)
    assert found["exact_steps"] == 4.0 and found["exact_offset_max_m"] == 4.0
    assert np.isnan(found["exact_left_s"])


def test_a_transfer_is_no_departure_and_its_overshoot_neither() -> None:
    """It starts 25 m off, overshoots by 10.8 m, and then stays: offsets count from its arrival."""
    move = load_scenario("move")
    found = compute_station_metrics(move, solve_loop_exactly(move), move.steps)
    assert np.isnan(found["exact_left_s"])
    assert found["exact_offset_max_m"] < 1.0 and found["exact_offset_end_m"] < 0.1
    assert found["exact_transfer_offset_max_m"] == pytest.approx(25.0, abs=0.5)
    assert found["exact_transfer_s"] > 30.0


def test_the_turn_of_the_report_is_a_transfer() -> None:
    """Its state, sample by sample: outside 5 m and 5° until 73.5 s, up to 17.0 m off."""
    turn = load_scenario("turn").truncate(450)
    exact = solve_loop_exactly(turn)
    found = compute_station_metrics(turn, exact, turn.steps)
    offset = np.hypot(exact.state[:, 3], exact.state[:, 4])
    heading = np.degrees(np.abs(exact.state[:, 5] - np.pi / 2.0))
    last_outside = np.flatnonzero((offset > 5.0) | (heading > 5.0)).max()
    assert found["exact_transfer_s"] == pytest.approx((last_outside + 1) * turn.sample_s)
    assert found["exact_transfer_offset_max_m"] == offset.max() == pytest.approx(17.0, abs=0.05)


def test_a_transfer_ends_at_the_last_sample_outside() -> None:
    """8 m, 4 m and 6 m off: from the fourth sample on within 5 m, for the 100 samples of 30 s."""
    calm = load_scenario("calm")
    east = [8.0, 4.0, 6.0, *[1.0] * 110]
    found = compute_station_metrics(calm, loop_along(calm, east), len(east) - 1)
    assert found["exact_transfer_s"] == pytest.approx(3 * calm.sample_s)
    assert found["exact_transfer_offset_max_m"] == 8.0 and found["exact_offset_max_m"] == 1.0
    at_rest = compute_station_metrics(calm, loop_along(calm, [4.0, 2.0, 1.0]), 2)
    assert np.isnan(at_rest["exact_transfer_s"])
    assert np.isnan(at_rest["exact_transfer_offset_max_m"])
    under_way = compute_station_metrics(calm, loop_along(calm, [9.0, 8.0, 1.0]), 2)
    assert np.isnan(under_way["exact_transfer_s"])
    assert under_way["exact_transfer_offset_max_m"] == 9.0


@pytest.mark.parametrize(
    ("name", "samples"), [("calm", 33), ("squall@cybership2", None)], ids=["full", "model"]
)
def test_the_trend_is_over_the_last_10_s_at_full_scale(name: str, samples: int | None) -> None:
    """10 s are 33 samples of 0.3 s; of a model ship, whose times are shorter, as many."""
    scenario = load_scenario(name)
    scale = 1.0 / np.sqrt(float(scenario.files["vessel"]["model_scale"]))
    last = samples or round(10.0 * scale / scenario.sample_s)
    unit = 0.01 if samples is None else 1.0
    east = unit * np.array([3.0, *[0.5] * (60 - last), 1.0, *[2.0] * (last - 1), 2.5])
    found = compute_station_metrics(scenario, loop_along(scenario, east), len(east) - 1)
    assert found["exact_offset_rise_m"] == pytest.approx(1.5 * unit)
    short = compute_station_metrics(scenario, loop_along(scenario, unit * east[:2] / unit), 1)
    assert short["exact_offset_rise_m"] == pytest.approx(unit * (0.5 - 3.0))


def test_a_squall_that_carries_the_ship_off_for_a_while_is_a_departure() -> None:
    squall = load_scenario("squall")
    found = compute_station_metrics(squall, solve_loop_exactly(squall), squall.steps)
    assert 100.0 < found["exact_left_s"] < found["exact_offset_max_s"] < 130.0
    assert found["exact_offset_max_m"] > 5.0 > found["exact_offset_end_m"]


def test_a_model_ship_has_a_station_of_its_own_size() -> None:
    model = load_scenario("squall@cybership2")
    found = compute_station_metrics(model, loop_along(model, [0.0, 0.05, 0.08]), 2)
    assert found["station_radius_m"] == pytest.approx(5.0 / 70.0, rel=0.05)
    assert found["exact_left_s"] == pytest.approx(2 * model.sample_s)


@pytest.mark.slow
def test_slacks_at_rest_are_no_active_limits() -> None:
    """In still water at its setpoint the ship with soft limits has none that is active."""
    circle = load_scenario("watch_circle")
    active = solve_loop_exactly(circle).active
    assert active[0] and not active[circle.steps // 2 :].any()


def test_a_lost_thruster_is_no_active_limit() -> None:
    """In a weak current the other thrusters never reach a limit, before the loss and after it."""
    values = {"environment": {"current": {"speed_mps": 0.2, "towards_deg": 220.0}, "ramp_s": 60.0}}
    weak = copy_scenario_with_values(
        load_scenario("thrusters_loss").truncate(400), values, "weak current"
    )
    exact = solve_loop_exactly(weak)
    assert np.abs(exact.thrust[-1]).max() > 1e3
    assert not exact.active.any()
    assert any(np.abs(optimum.y).max() > 1e-9 for optimum in exact.optima[301:])


@pytest.mark.parametrize(
    ("distance", "moved", "arrived"),
    [
        ([0, 0, 2, 3, 0], [], [1, 1, 1, 1, 1]),
        ([5, 4, 3, 2, 1], [], [0, 0, 0, 0, 0]),
        ([3, 1, 2, 1, 1], [], [0, 0, 0, 0, 1]),
        ([0, 2, 2, 1, 1], [1], [1, 0, 0, 0, 1]),
        ([3, 3, 3, 4, 9], [], [1, 1, 1, 1, 1]),
        ([0, 2, 3, 4, 9], [1, 2, 3, 4], [1, 0, 0, 0, 0]),
        ([0, 2, 3, 4, 9], [1, 2], [1, 0, 1, 1, 1]),
    ],
)
def test_when_a_ship_has_arrived(
    distance: list[float], moved: list[int], arrived: list[int]
) -> None:
    """Beyond 1 it is outside; it arrives by two samples inside, or by drifting off."""
    jumps = np.isin(np.arange(5), moved)
    found = mask_arrived_samples(np.array(distance, dtype=float), jumps, 2)
    np.testing.assert_array_equal(found, np.array(arrived, dtype=bool))


@pytest.mark.parametrize(
    ("since_loss", "swing_m"),
    [
        ([0, 1, -1, 1, -1, 1, -1, 1, -1], 2.0),
        ([0, 1, -1, 1, -1, 1, -0.9, 0.9, -0.9], 1.8),
        ([0, 1, -1, 1, -1, 1, -0.89, 0.89, -0.89], 0.0),
        ([0, 1, -1, 1, -1, 1, 1, 1, 1], 0.0),
        ([0, 1, 2, 3, 3, 3, 3, 3, 3], 0.0),
        ([], np.nan),
    ],
)
def test_a_swing_that_does_not_decay_after_a_loss(since_loss: list[float], swing_m: float) -> None:
    """From 1 m east to 1 m west: of the last three samples nine tenths are left, or fewer."""
    faults = [{"at_s": 1.2, "limit_share": [1.0, 0.5, 1.0]}]
    lossy = copy_scenario_with_values(load_scenario("calm"), {"faults": faults}, "a loss")
    east = [4.0, 0.0, 0.0, 0.0, *since_loss]
    found = compute_station_metrics(lossy, loop_along(lossy, east), len(east) - 1)
    assert found["exact_loss_swing_m"] == pytest.approx(swing_m, nan_ok=True)


@pytest.mark.parametrize(("before_m", "swing_m"), [(0.5, 2.0), (0.51, 0.0)])
def test_a_swing_as_before_a_loss_is_not_due_to_it(before_m: float, swing_m: float) -> None:
    """2 m after the loss, and 1 m or more before it; the first half of that time is not counted."""
    faults = [{"at_s": 1.8, "limit_share": [1.0, 0.5, 1.0]}]
    lossy = copy_scenario_with_values(load_scenario("calm"), {"faults": faults}, "a loss")
    east = [3.0, 0.0, 0.0, before_m, -before_m, before_m, *[1.0, -1.0] * 5]
    found = compute_station_metrics(lossy, loop_along(lossy, east), len(east) - 1)
    assert found["exact_loss_swing_m"] == pytest.approx(swing_m)


def test_offsets_after_a_loss_count_from_it_on() -> None:
    """Four samples at rest, a loss at the fifth, and 3 m off at most; nothing without a loss."""
    calm = load_scenario("calm")
    east = [4.0, 0.0, 0.0, 0.0, 1.0, 3.0, 2.0]
    faults = [{"at_s": 1.2, "limit_share": [1.0, 0.5, 1.0]}]
    lossy = copy_scenario_with_values(calm, {"faults": faults}, "a loss")
    found = compute_station_metrics(lossy, loop_along(lossy, east), 6)
    assert found["exact_loss_offset_max_m"] == 3.0 and found["exact_offset_max_m"] == 4.0
    assert found["exact_loss_heading_max_deg"] == 0.0
    assert np.isnan(
        compute_station_metrics(lossy, loop_along(lossy, east), 3)["exact_loss_offset_max_m"]
    )
    assert np.isnan(
        compute_station_metrics(calm, loop_along(calm, east), 6)["exact_loss_offset_max_m"]
    )
