"""A library vessel at another size: back to its own size, by Froude's law, beside regressions."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from dpbench.errors import InputError
from dpbench.scenario.own_ship import (
    DP_NUMBERS,
    LIBRARY,
    NOT_CHOSEN,
    SPARE,
    LibraryShip,
    Particulars,
    ThrustLimits,
    choose_speed_of_damping_fit_mps,
    compute_limit_share_of_dp_number,
    estimate_added_mass_by_regression,
    find_largest_bearable_dp_number,
    find_most_similar_library_vessel,
    scale_library_vessel_to_own_ship,
)
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.characteristics import compute_axis_time_constants_s
from dpbench.ship.froude import Froude
from dpbench.ship.weather import WATER_DENSITY


def own_size(ship: LibraryShip, factor: float = 1.0) -> Particulars:
    """The library ship itself, or all its lengths times a factor."""
    lengths = factor * ship.length_m, factor * ship.breadth_m, factor * 6.0
    return Particulars(*lengths, factor**3 * ship.mass_kg)


@pytest.mark.parametrize("name", LIBRARY)
def test_a_library_vessel_at_its_own_size_is_itself(name: str) -> None:
    vessel, ship = load_vessel(name), LIBRARY[name]
    same = scale_library_vessel_to_own_ship(name, own_size(ship), ThrustLimits(vessel.tau_max[0]))
    for key in ("M", "tau_min", "tau_max", "rate_max"):
        np.testing.assert_allclose(getattr(same, key), getattr(vessel, key), rtol=1e-12)
    np.testing.assert_allclose(np.diag(same.D)[::2], np.diag(vessel.D)[::2], rtol=1e-12)
    # The couplings keep their share of the geometric mean of sway and yaw damping.
    shares = [D[1, 2] / np.sqrt(D[1, 1] * D[2, 2]) for D in (same.D, vessel.D)]
    assert shares[0] == pytest.approx(shares[1], rel=1e-12)
    assert same.length_m == vessel.length_m
    assert same.windage == vessel.windage
    assert same.reflection is not None and same.reflection.breadth_m == ship.breadth_m


@pytest.mark.slow
@given(name=st.sampled_from(sorted(LIBRARY)), factor=st.floats(0.05, 20.0))
def test_a_larger_ship_of_one_form_follows_froudes_law(name: str, factor: float) -> None:
    vessel, ship, law = load_vessel(name), LIBRARY[name], Froude(1.0 / factor)
    thrust = ThrustLimits(vessel.tau_max[0] * law.force_and_moment_factors[0])
    large = scale_library_vessel_to_own_ship(name, own_size(ship, factor), thrust)
    small = scale_library_vessel_to_own_ship(name, own_size(ship), ThrustLimits(vessel.tau_max[0]))
    arm = np.array([1.0, 1.0, law.length_factor])
    by_mass = law.length_factor**3 * np.outer(arm, arm)
    np.testing.assert_allclose(large.M, by_mass * vessel.M, rtol=1e-9)
    np.testing.assert_allclose(large.D, by_mass * small.D / law.time_and_speed_factor, rtol=1e-9)
    np.testing.assert_allclose(
        large.tau_max, law.force_and_moment_factors * vessel.tau_max, rtol=1e-9
    )
    np.testing.assert_allclose(
        large.tau_min, law.force_and_moment_factors * vessel.tau_min, rtol=1e-9
    )
    np.testing.assert_allclose(
        large.rate_max,
        law.force_and_moment_factors / law.time_and_speed_factor * vessel.rate_max,
        rtol=1e-9,
    )
    times = (
        compute_axis_time_constants_s(large),
        law.time_and_speed_factor * compute_axis_time_constants_s(small),
    )
    np.testing.assert_allclose(*times, rtol=1e-7)
    gain = large.accelerations_at_force_limits() / vessel.accelerations_at_force_limits()
    np.testing.assert_allclose(gain[:, :2], 1.0, rtol=1e-9)
    np.testing.assert_allclose(gain[:, 2], 1.0 / factor, rtol=1e-9)
    assert large.windage is not None and vessel.windage is not None
    areas = large.windage.frontal_m2, large.windage.lateral_m2
    grown = factor**2 * vessel.windage.frontal_m2, factor**2 * vessel.windage.lateral_m2
    np.testing.assert_allclose(areas, grown, rtol=1e-9)


@pytest.mark.slow
@given(heavier=st.floats(0.5, 2.0), stronger=st.floats(0.1, 10.0))
def test_a_heavier_ship_of_one_length_keeps_its_time_constants(
    heavier: float, stronger: float
) -> None:
    """In the Bis system mass scales inertia and damping alike, but for the damping of sway, which
    is of the hull in the water; thrust has no part in either."""
    vessel, ship = load_vessel("supply_mss"), LIBRARY["supply_mss"]
    own = Particulars(ship.length_m, ship.breadth_m, 6.0, heavier * ship.mass_kg)
    heavy = scale_library_vessel_to_own_ship(
        "supply_mss", own, ThrustLimits(stronger * vessel.tau_max[0])
    )
    np.testing.assert_allclose(heavy.M, heavier * vessel.M, rtol=1e-9)
    np.testing.assert_allclose(np.diag(heavy.D)[::2], heavier * np.diag(vessel.D)[::2], rtol=1e-9)
    # ½ρ C_d L T at B/2T = 1.5, and 0.018 √(gL) = 0.492 m/s.
    drag_N = 0.5 * 1026.0 * 0.72 * 76.2 * 6.0 * 0.492**2
    assert heavy.D[1, 1] * 0.492 == pytest.approx(drag_N, rel=2e-3)
    np.testing.assert_allclose(heavy.tau_max, stronger * vessel.tau_max, rtol=1e-12)


def test_the_model_and_the_drag_agree_at_the_fitted_speed() -> None:
    """For 110 m and 14 000 t by hand: B/2T = 1.57, C_d = 0.705, 278 kN abeam at 1 m/s."""
    own = Particulars(110.0, 22.0, 7.0, 14e6)
    ship = scale_library_vessel_to_own_ship(
        find_most_similar_library_vessel(own), own, ThrustLimits(1120e3, 540e3)
    )
    speed = choose_speed_of_damping_fit_mps(110.0)
    assert speed == pytest.approx(0.591, abs=1e-3)
    assert ship.D[1, 1] == pytest.approx(165e3, rel=0.01)
    drag = ship.force_to_keep_velocity(np.array([0.0, speed, 0.0]))[1]
    assert drag == pytest.approx(ship.D[1, 1] * speed, rel=0.02)
    assert ship.force_to_keep_velocity(np.array([0.0, 1.0, 0.0]))[1] == pytest.approx(
        278e3, rel=0.01
    )


def test_forces_that_are_given_are_taken() -> None:
    own = own_size(LIBRARY["supply_fs99"])
    given_ = scale_library_vessel_to_own_ship("supply_fs99", own, ThrustLimits(3e5, 2e5, 5e6))
    np.testing.assert_allclose(given_.tau_max, [3e5, 2e5, 5e6])
    np.testing.assert_allclose(given_.tau_min[1:], [-2e5, -5e6])
    half = scale_library_vessel_to_own_ship("supply_fs99", own, ThrustLimits(3e5, 417e3 / 2))
    assert half.tau_max[2] == pytest.approx(9e6)
    rise_s = given_.tau_max / given_.rate_max
    vessel = load_vessel("supply_fs99")
    np.testing.assert_allclose(rise_s, vessel.tau_max / vessel.rate_max)


@pytest.mark.parametrize("name", [name for name in LIBRARY if name not in NOT_CHOSEN])
def test_the_nearest_ship_of_a_library_ship_is_itself(name: str) -> None:
    assert find_most_similar_library_vessel(own_size(LIBRARY[name])) == name
    assert find_most_similar_library_vessel(own_size(LIBRARY[name], 1.01)) == name


def test_the_regressions_of_a_ship_worked_out_by_hand() -> None:
    """L 100, B 20, T 5 m, C_B 0.6: π(T/L)² = 7.854e-3, brackets 1.18 and 0.058133."""
    own = Particulars(100.0, 20.0, 5.0, 0.6 * WATER_DENSITY * 1e4)
    assert own.block_coefficient == pytest.approx(0.6)
    # Surge: 2.7 · 1026 · 6000^(5/3) / 1e4, and 6000^(5/3) = 1.98116e6.
    by_hand = [5.4881e5, 4.7543e6, 2.3422e9]
    np.testing.assert_allclose(estimate_added_mass_by_regression(own), by_hand, rtol=1e-4)


@pytest.mark.parametrize("name", LIBRARY)
def test_the_largest_sea_leaves_thrust_to_spare(name: str) -> None:
    """Its mean force is within the share, that of the next beyond it, and loads grow."""
    vessel = scale_library_vessel_to_own_ship(name, own_size(LIBRARY[name]), ThrustLimits(8e5))
    shares = [compute_limit_share_of_dp_number(vessel, number) for number in DP_NUMBERS]
    assert shares == sorted(shares)
    number = find_largest_bearable_dp_number(vessel)
    assert compute_limit_share_of_dp_number(vessel, number) <= SPARE
    assert compute_limit_share_of_dp_number(vessel, number + 1) > SPARE


def test_the_share_of_a_ship_worked_out_by_hand() -> None:
    """Sway in DP capability number 5 from 30°: wind 10.7 m/s, current 0.75 m/s, waves of 2.1 m."""
    own = Particulars(76.2, 18.0, 5.0, 4.591e6)
    ship = scale_library_vessel_to_own_ship("supply_fs99", own, ThrustLimits(1240e3, 417e3))
    wind = 0.5 * 1.226 * 10.7**2 * 0.9 * 700.0
    current = 0.5 * 1026.0 * 0.75**2 * 0.6 * 76.2 * 5.0
    # T' = 7.5/1.4049/(0.75 √18) = 1.678; T'⁻³ e^(1 − T'⁻³) = 0.466.
    waves = 0.09 * 0.5 * 1026.0 * 9.81 * 2.1**2 * 76.2 * 0.466
    sway = 0.5 * (wind + current + waves)
    # Arms of level 1 at γ'/π = 1/6: 0.3 · 2/3 L, 0.25 L at most, (0.05 − 0.14/6) L.
    moment = 0.5 * 76.2 * (0.2 * wind + 0.25 * current + 0.02667 * waves)
    assert compute_limit_share_of_dp_number(ship, 5) == pytest.approx(
        sway / 417e3 + moment / 18e6, rel=1e-3
    )


def test_a_ship_that_no_sea_suits_gets_the_smallest() -> None:
    """A thousandth of the thrust."""
    own = own_size(LIBRARY["supply_fs99"])
    weak = scale_library_vessel_to_own_ship("supply_fs99", own, ThrustLimits(1e3))
    assert compute_limit_share_of_dp_number(weak, 1) > SPARE
    assert find_largest_bearable_dp_number(weak) == 1


def test_a_vessel_without_a_hull_below_the_water_has_no_share() -> None:
    """As one that was written by hand."""
    with pytest.raises(InputError, match="capability"):
        compute_limit_share_of_dp_number(load_vessel("supply_fs99"), 3)
