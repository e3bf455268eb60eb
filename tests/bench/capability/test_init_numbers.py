"""The DP capability number that `dpbench init` chooses, beside that of `dpbench capability`."""

import math
from dataclasses import replace

import pytest

from dpbench.bench.capability.frontier import CapabilityPlot
from dpbench.scenario.own_ship import (
    DP_NUMBERS,
    Particulars,
    ThrustLimits,
    find_largest_bearable_dp_number,
    find_most_similar_library_vessel,
    scale_library_vessel_to_own_ship,
)
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.thrusters import Thruster, ThrusterSet
from dpbench.ship.vessel import Vessel

NEAR_BOW_DEG = (-30, -20, -10, 0, 10, 20, 30)


def build_ship(own: Particulars, azimuth_kN: float, tunnel_kN: float) -> Vessel:
    """A ship by `init` with two azimuths astern and two tunnels in the bow.

    Its force sideways is the largest that leaves no moment, as a user of `init` knows it.
    """
    L, B = own.length_m, own.breadth_m
    thrusters = ThrusterSet(
        (
            Thruster("port", "azimuth", -0.47 * L, -0.25 * B, 1e3 * azimuth_kN, 10.0),
            Thruster("starboard", "azimuth", -0.47 * L, 0.25 * B, 1e3 * azimuth_kN, 10.0),
            Thruster("bow 1", "tunnel", 0.43 * L, 0.0, 1e3 * tunnel_kN, 10.0),
            Thruster("bow 2", "tunnel", 0.46 * L, 0.0, 1e3 * tunnel_kN, 10.0),
        )
    )
    ahead_N, _, yaw_Nm = thrusters.least_and_largest_force_by_axis()[1]
    bow, stern = (2e3 * tunnel_kN, 0.445 * L), (2e3 * azimuth_kN, 0.47 * L)
    sway_N = min(one[0] * (1.0 + one[1] / other[1]) for one, other in ((bow, stern), (stern, bow)))
    ship = scale_library_vessel_to_own_ship(
        find_most_similar_library_vessel(own), own, ThrustLimits(ahead_N, sway_N, yaw_Nm)
    )
    return replace(ship, thrusters=thrusters)


def capability_number(ship: Vessel) -> int:
    """The least number within 30° of the bow, intact, up to the largest that `init` has."""
    plot = CapabilityPlot(ship)
    intact = plot.intact_and_failure_cases[0]
    numbers = [plot.find_wind_limit(intact, math.radians(deg)).number for deg in NEAR_BOW_DEG]
    return min(*numbers, max(DP_NUMBERS))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("own", "azimuth_kN", "tunnel_kN"),
    [
        (Particulars(110.0, 22.0, 7.0, 14e6), 560.0, 250.0),
        (Particulars(110.0, 22.0, 7.0, 14e6), 250.0, 120.0),
        (Particulars(80.0, 18.0, 6.0, 6e6), 150.0, 50.0),
        (Particulars(76.2, 18.0, 5.0, 4.591e6), 400.0, 150.0),
        (Particulars(30.0, 8.0, 3.0, 0.45e6), 30.0, 12.0),
        (Particulars(160.0, 30.0, 9.0, 30e6), 600.0, 300.0),
        (Particulars(120.0, 14.2, 4.5, 4.4e6), 120.0, 80.0),
        (Particulars(30.0, 8.5, 2.0, 0.4e6), 18.0, 9.0),
    ],
)
def test_the_number_is_within_one_of_the_capability(
    own: Particulars, azimuth_kN: float, tunnel_kN: float
) -> None:
    """By the same loads, against limits in place of the thrusters themselves."""
    ship = build_ship(own, azimuth_kN, tunnel_kN)
    number = capability_number(ship)
    assert number > 1
    assert abs(find_largest_bearable_dp_number(ship) - number) <= 1


@pytest.mark.slow
def test_the_number_of_a_ship_with_main_propellers_is_within_one() -> None:
    """110 m and 14 000 t with 1120 kN ahead and 540 kN of tunnels abeam."""
    own = Particulars(110.0, 22.0, 7.0, 14e6)
    mains = [Thruster(f"main {y:g}", "main", -52.0, y, 560e3, 10.0) for y in (-5.0, 5.0)]
    tunnels = [Thruster(f"at {x:g}", "tunnel", x, 0.0, 180e3, 10.0) for x in (45.0, 48.0, -42.0)]
    ship = scale_library_vessel_to_own_ship(
        find_most_similar_library_vessel(own), own, ThrustLimits(1120e3, 540e3)
    )
    number = capability_number(replace(ship, thrusters=ThrusterSet((*mains, *tunnels))))
    assert number == 7
    assert abs(find_largest_bearable_dp_number(ship) - number) <= 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["osv", "ratownik"])
def test_the_number_of_a_library_ship_is_within_one(name: str) -> None:
    """By what its thrusters make; `osv` has limits of the paper's ship besides."""
    ship = load_vessel(name)
    assert ship.thrusters is not None
    low, high = ship.thrusters.least_and_largest_force_by_axis()
    number = find_largest_bearable_dp_number(replace(ship, tau_min=low, tau_max=high))
    assert abs(number - capability_number(ship)) <= 1
