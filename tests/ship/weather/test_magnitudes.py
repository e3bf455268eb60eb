"""Wind, drift and current in the sea states of DNV-ST-0111 against the forces of its level 1.

The table is for a hull of 76 m. Breadth 18 m, draught 6 m and areas of 290 and 700 m² are usual
for such a supply ship; the coefficients are those of the standard.
"""

import numpy as np
import pytest

from dpbench.ship.environment import Current, Environment
from dpbench.ship.vessel import Vessel
from dpbench.ship.weather import Sea, WaveDrift, Wind

# DP number: wind [m/s], Hs [m], Tp [s], force beam-on [kN], head-on [kN]; current 0.75 m/s.
TABLE = {
    4: (7.9, 1.3, 6.5, 138, 17),
    5: (10.7, 2.1, 7.5, 194, 31),
    6: (13.8, 3.1, 8.5, 268, 50),
    7: (17.1, 4.2, 9.0, 377, 77),
    8: (20.7, 5.7, 10.0, 503, 109),
    9: (24.4, 7.4, 10.5, 694, 157),
}
CURRENT_MPS = 0.75
LENGTH_M, BREADTH_M, DRAUGHT_M = 76.2, 18.0, 6.0


def weather(dp: int, to_rad: float) -> Environment:
    """Wind, waves and current of a DP number, all to one direction."""
    wind_mps, hs_m, tp_s, _, _ = TABLE[dp]
    zero = np.zeros(3)
    return Environment(
        zero,
        zero,
        np.ones(3),
        zero,
        wind=Wind(wind_mps, to_rad, "none"),
        current=Current(CURRENT_MPS, to_rad),
        drift=WaveDrift(Sea(hs_m, tp_s, to_rad)),
    )


def mean_loads_kN(ship: Vessel, dp: int) -> np.ndarray:
    """Head-on and beam-on force and quartering moment of wind and drift at rest: (3,) kN, kN·m."""
    wind_mps, hs_m, _, _, _ = TABLE[dp]
    loads = weather(dp, 0.0).wind_and_drift_coefficients(ship)
    assert loads is not None
    # The law takes V² and |Z|², whose mean is Hs²/8.
    return (loads[:3] * wind_mps**2 + loads[3:] * hs_m**2 / 8) / 1000


def standard_current_kN() -> np.ndarray:
    """Head-on and beam-on current force of the standard, section 3.6: (2,) kN."""
    pressure = 0.5 * 1026 * CURRENT_MPS**2 / 1000
    return pressure * np.array([0.07 * BREADTH_M * DRAUGHT_M, 0.6 * LENGTH_M * DRAUGHT_M])


@pytest.mark.parametrize("dp", TABLE)
def test_mean_forces_are_those_of_the_standard(dp: int, hull: Vessel) -> None:
    """Wind and drift, with the standard's own current, give the table's forces within 4 %."""
    head, beam = mean_loads_kN(hull, dp)[:2] + standard_current_kN()
    assert beam == pytest.approx(TABLE[dp][3], rel=0.04)
    assert head == pytest.approx(TABLE[dp][4], rel=0.04)


@pytest.mark.parametrize("dp", TABLE)
def test_the_linear_damping_of_the_model_overstates_the_current(dp: int, hull: Vessel) -> None:
    beam = mean_loads_kN(hull, dp)[1] + hull.D[1, 1] * CURRENT_MPS / 1000
    assert 1.0 < beam / TABLE[dp][3] < 2.0


def test_the_yaw_moment_is_under_three_meganewton_metres(hull: Vessel) -> None:
    """In the quarters wind and drift of DP number 9 turn the ship with 1 to 3 MN·m."""
    assert 1e3 < mean_loads_kN(hull, 9)[2] < 3e3
