"""The weather of the DP capability numbers (DNV-ST-0111, table 2-1), and of any wind between them.

Wind, waves and current come from one direction.
"""

from dataclasses import dataclass

import numpy as np

DP_CONDITIONS = {
    1: (1.5, 0.1, 3.5, 0.25),
    2: (3.4, 0.4, 4.5, 0.5),
    3: (5.4, 0.8, 5.5, 0.75),
    4: (7.9, 1.3, 6.5, 0.75),
    5: (10.7, 2.1, 7.5, 0.75),
    6: (13.8, 3.1, 8.5, 0.75),
    7: (17.1, 4.2, 9.0, 0.75),
    8: (20.7, 5.7, 10.0, 0.75),
    9: (24.4, 7.4, 10.5, 0.75),
    10: (28.4, 9.5, 11.5, 0.75),
    11: (32.6, 12.1, 12.0, 0.75),
}
"""Wind [m/s], Hs [m], Tp [s], current [m/s] of each DP capability number; 0 is calm."""

CALM = (0.0, 0.0, DP_CONDITIONS[1][2], 0.0)
"""The standard gives calm water no period; that of number 1 stands in for it."""

_TABLE = np.array([CALM, *DP_CONDITIONS.values()])


@dataclass(frozen=True)
class Condition:
    """Weather of a DP capability number: mean wind [m/s], waves Hs [m], Tp [s], current [m/s]."""

    wind_mps: float
    hs_m: float
    tp_s: float
    current_mps: float

    @property
    def zero_crossing_s(self) -> float:
        """Mean zero-crossing period [s] of a Pierson-Moskowitz spectrum, from its peak period."""
        return self.tp_s / 1.4049


def interpolate_condition_at_wind_speed(wind_mps: float) -> Condition:
    """Return the waves and current for a wind speed; interpolation in the table is ours."""
    columns = (float(np.interp(wind_mps, _TABLE[:, 0], column)) for column in _TABLE.T[1:])
    return Condition(wind_mps, *columns)
