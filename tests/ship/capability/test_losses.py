"""Losses of thrust: the published factors of a ship, hand-worked cases of the standard's rules."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from dpbench.ship.capability.loads import (
    DP_CONDITIONS,
    CapabilityHull,
    Condition,
    interpolate_condition_at_wind_speed,
)
from dpbench.ship.capability.losses import (
    MISCELLANEOUS,
    caution_on_wash,
    compute_thrust_share_when_vented,
    find_forbidden_thrust_directions,
    list_losses_at_dead_thrusters,
    list_losses_at_skegs,
)
from dpbench.ship.thrusters import Screw, Thruster, ThrusterSet


def azimuth(x_m: float, y_m: float, diameter_m: float = 2.0, propeller: str = "open") -> Thruster:
    screw = Screw(diameter_m, propeller, 1.0)  # type: ignore[arg-type] # a word of a test
    return Thruster(f"at {x_m} {y_m}", "azimuth", x_m, y_m, 1e5, 10.0, screw=screw)


def test_factors_are_the_published_ones(
    hull: CapabilityHull, thrusters: ThrusterSet, published: pd.DataFrame
) -> None:
    """β_misc β_vent β_skeg of five thrusters and 36 directions, to two digits and a degree."""
    for row in published.itertuples():
        condition = Condition(*DP_CONDITIONS[row.number])
        for i, thruster in enumerate(thrusters.thrusters):
            vented = compute_thrust_share_when_vented(
                thruster, hull, condition, math.radians(row.from_deg)
            )
            skeg, allowed = 1.0, 0.0051
            if i < 2:
                # Counter-clockwise there, clockwise here; so port is −y there and here the first.
                pushed = -math.radians(float(getattr(row, f"angle_{i + 1}")))
                skeg = min(
                    loss.thrust_share_in_direction(pushed)
                    for loss in list_losses_at_skegs(thruster, hull)
                )
                allowed = 0.03 if skeg < 1.0 else allowed
            found = MISCELLANEOUS * vented * skeg
            assert found == pytest.approx(getattr(row, f"loss_{i + 1}"), abs=allowed), (row, i)


def test_waves_take_more_the_higher_they_are_and_nothing_unknown(
    hull: CapabilityHull, thrusters: ThrusterSet
) -> None:
    """β_vent falls with the wind; a thruster whose screw is not known loses nothing."""
    for thruster in thrusters.thrusters:
        shares = [
            compute_thrust_share_when_vented(
                thruster, hull, interpolate_condition_at_wind_speed(w), 1.5
            )
            for w in (5, 15, 25, 32)
        ]
        assert (np.diff(shares) <= 0.0).all()
    bare = Thruster("bare", "tunnel", 30.0, 0.0, 1e5, 8.0)
    assert (
        compute_thrust_share_when_vented(bare, hull, interpolate_condition_at_wind_speed(32.0), 1.5)
        == 1.0
    )


def test_a_working_thruster_is_not_flushed() -> None:
    """By hand: 11 m abeam, D = 3 m: 90° off its side, ± arctan(0.1 + 3/11) = 20.44°."""
    port, starboard = azimuth(-40.0, -5.5, 3.0), azimuth(-40.0, 5.5, 3.0)
    both = [port, starboard]
    (to_port,), (to_starboard,) = (find_forbidden_thrust_directions(one, both) for one in both)
    half = math.degrees(math.atan(0.1 + 3.0 / 11.0))
    assert half == pytest.approx(20.44, abs=0.005)
    # Pushing to port it sends its race to starboard, onto the other.
    np.testing.assert_allclose(np.degrees(to_port), [-90.0 - half, -90.0 + half])
    np.testing.assert_allclose(np.degrees(to_starboard), [90.0 - half, 90.0 + half])


def test_only_near_ones_that_are_no_tunnels_forbid_a_direction() -> None:
    """15 diameters of the flushing thruster; a tunnel may be flushed."""
    near, far = azimuth(0.0, 0.0), azimuth(29.9, 0.0)
    assert len(find_forbidden_thrust_directions(near, [near, far])) == 1
    assert find_forbidden_thrust_directions(near, [near, azimuth(30.0, 0.0)]) == []
    tunnel = Thruster("tunnel", "tunnel", 5.0, 0.0, 1e5, 8.0, screw=Screw(2.0, "tunnel"))
    assert find_forbidden_thrust_directions(near, [near, tunnel]) == []
    assert list_losses_at_dead_thrusters(near, [tunnel]) == []


def test_a_dead_thruster_takes_thrust_along_a_straight_line() -> None:
    """By hand: 5 diameters astern, β = 1 − 1/2.95 = 0.661, φ = arctan 0.12 = 6.843°."""
    (loss,) = list_losses_at_dead_thrusters(azimuth(0.0, 0.0), [azimuth(-10.0, 0.0)])
    assert math.degrees(loss.end) == pytest.approx(6.843, abs=5e-4)
    assert loss.thrust_share_in_direction(0.0) == pytest.approx(1.0 - 1.0 / 2.95)
    angle = np.linspace(0.0, loss.end, 40)[:-1]
    edge = np.array(
        [loss.thrust_share_in_direction(a) * np.array([math.cos(a), math.sin(a)]) for a in angle]
    )
    along = np.diff(edge, axis=0)
    turned = along[1:, 0] * along[:-1, 1] - along[1:, 1] * along[:-1, 0]
    np.testing.assert_allclose(turned, 0.0, atol=1e-12)
    assert loss.thrust_share_in_direction(loss.end) == loss.thrust_share_in_direction(2.0) == 1.0
    assert list_losses_at_dead_thrusters(azimuth(0.0, 0.0), [azimuth(-16.0, 0.0)]) == []
    assert (
        list_losses_at_dead_thrusters(azimuth(0.0, 0.0, 2.0, "nozzle"), [azimuth(-8.0, 0.0)]) == []
    )


def test_a_skeg_takes_thrust_of_both_sides_alike(
    hull: CapabilityHull, thrusters: ThrusterSet
) -> None:
    """The tables for port and starboard are mirror images; the least is 2 α/π − 1."""
    (port,), (starboard,) = (list_losses_at_skegs(t, hull) for t in thrusters.thrusters[:2])
    for angle in np.linspace(0.0, 2.0 * np.pi, 721):
        assert port.thrust_share_in_direction(-angle) == pytest.approx(
            starboard.thrust_share_in_direction(angle)
        )
    flush = math.pi / 2 + math.atan(3.276 / 4.69)
    worst = flush + math.atan(0.6 * 3.1 / math.hypot(3.276, 4.69))
    assert starboard.worst == pytest.approx(worst)
    assert starboard.thrust_share_in_direction(worst) == pytest.approx(2.0 * worst / math.pi - 1.0)
    assert list_losses_at_skegs(thrusters.thrusters[2], hull) == []


def test_a_skeg_right_beside_a_thruster_is_no_division_by_zero() -> None:
    beside = CapabilityHull(
        80.0, 18.0, 5.0, 80.0, 0.0, 0.4, 1.0, 300.0, 900.0, 0.0, 400.0, 0.0, ((30.0, 0.0),)
    )
    for y_m in (-1.0, 1.0):
        (loss,) = list_losses_at_skegs(azimuth(22.0, y_m, 4.0), beside)
        shares = [
            loss.thrust_share_in_direction(angle) for angle in np.linspace(-np.pi, np.pi, 361)
        ]
        assert 0.0 <= min(shares) <= max(shares) == 1.0


def test_azimuths_that_may_hit_each_other_are_cautioned_of() -> None:
    """Until a zone bars the race of both: to port the push of one, to starboard that of the other.

    A propeller of 2 m reaches 30 m. One of unknown size is not barred in the capability plot.
    """
    port, starboard = azimuth(-30.0, -3.0), azimuth(-30.0, 3.0)
    (caution,) = caution_on_wash(ThrusterSet((port, starboard, azimuth(30.0, 0.0))))
    assert "(at -30.0 -3.0 and at -30.0 3.0, 6 m apart); the capability plot bars" in caution
    assert "at most half a turn, on one side of it, which may not hold the ship" in caution
    push_to_starboard = replace(port, sector_rad=(0.0, math.pi))
    push_to_port = replace(starboard, sector_rad=(math.pi, 2.0 * math.pi))
    assert caution_on_wash(ThrusterSet((push_to_starboard, starboard)))
    assert not caution_on_wash(ThrusterSet((port, azimuth(0.5, 0.0))))
    away = (
        replace(port, sector_rad=(math.radians(-60.0), math.radians(60.0))),
        replace(starboard, sector_rad=(math.radians(-60.0), math.radians(60.0))),
    )
    assert not caution_on_wash(ThrusterSet(away))
    assert caution_on_wash(ThrusterSet((push_to_starboard, push_to_port))) == []
    (caution,) = caution_on_wash(ThrusterSet((replace(port, screw=None), starboard)))
    assert "nor does the capability plot" in caution
