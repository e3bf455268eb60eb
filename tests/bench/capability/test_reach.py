"""The forces that thrusters make together, beside hand calculation and the attainable polytope."""

import numpy as np
import pytest

from dpbench.bench.capability.utilisation import ThrusterReach
from dpbench.mpc.thrusters.attainable_set import build_attainable_force_polytope
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.thrusters import Thruster, ThrusterSet


def test_a_tunnel_in_the_bow_alone_is_held_straight_by_the_mains() -> None:
    """A tunnel 18 m ahead; mains 4 m off, with 100 kN astern each, balance a moment of 800 kN·m."""
    mains = [Thruster(f"main {y}", "main", -30.0, y, 200e3, 10.0, astern=0.5) for y in (-4.0, 4.0)]
    reach = ThrusterReach(ThrusterSet((*mains, Thruster("bow", "tunnel", 18.0, 0.0, 100e3, 10.0))))
    low, high = reach.find_least_and_largest_pure_forces()
    # Ahead on one side is at most what the other gives astern: no force in surge is left.
    np.testing.assert_allclose(high, [400e3, 2 * 100e3 * 4.0 / 18.0, 2 * 100e3 * 4.0], rtol=1e-6)
    np.testing.assert_allclose(low, [-200e3, -high[1], -high[2]], rtol=1e-6)
    assert reach.find_least_thrust_share(np.array([0.0, 44.4e3, 0.0])) < 1.0
    assert reach.find_least_thrust_share(np.array([0.0, 44.5e3, 0.0])) > 1.0


def test_the_share_is_that_of_the_attainable_polytope() -> None:
    """The polytope has 48 sides an azimuth, which lose 0.2 % of the thrust, for forces in any
    direction."""
    thrusters = load_vessel("ratownik").thrusters
    assert thrusters is not None
    rows = build_attainable_force_polytope(thrusters, 48).to_linear_limit_rows()
    reach, rng = ThrusterReach(thrusters), np.random.default_rng(3)
    for direction in rng.normal(size=(20, 3)) * [1e5, 1e5, 1e6]:
        along = rows.G @ direction
        expected = np.max(np.where(along > 0.0, along / rows.high, along / rows.low))
        assert reach.find_least_thrust_share(direction) == pytest.approx(expected, rel=3e-3)


def test_a_sector_that_excludes_a_force_leaves_none_of_it() -> None:
    """Two azimuths in line that may push ahead only make no force astern."""
    sector = (-0.5, 0.5)
    bow, stern = (
        Thruster(f"at {x}", "azimuth", x, 0.0, 1e5, 10.0, sector_rad=sector) for x in (30.0, -30.0)
    )
    low, high = ThrusterReach(ThrusterSet((bow, stern))).find_least_and_largest_pure_forces()
    assert low[0] == 0.0
    assert high[0] == pytest.approx(2e5, rel=3e-3)
