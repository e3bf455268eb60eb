"""The weather of a DP capability number, and the largest that leaves a ship thrust to spare."""

from __future__ import annotations

import numpy as np

from dpbench.scenario.tables.weather import CurrentTable, EnvironmentTable, WavesTable, WindTable
from dpbench.ship.capability.conditions import DP_CONDITIONS
from dpbench.ship.characteristics import mean_load
from dpbench.ship.froude import Froude
from dpbench.ship.vessel import Vessel

DP_NUMBERS = {number: DP_CONDITIONS[number] for number in range(1, 10)}
"""Wind [m/s], Hs [m], Tp [s], current [m/s] of the DP capability numbers up to a strong gale, the
most that a scenario of one's own ship is made for."""

FROM_DEG = 30.0
"""Wind and waves come from the bow, not quite ahead: a heading a ship may choose."""

CURRENT_SHARE = 0.4
"""Of the standard's current. Linear damping is meant for some cm/s; on the supply ship of Fossen &
Strand D·0.3 m/s abeam is the force that the standard gives to its 0.75 m/s (section 3.6)."""

RAMP_S = 60.0
SPARE = 0.5
"""Share of the limits that the mean force may take: gusts and drift need the rest."""


def sea_state(number: int) -> EnvironmentTable:
    """Wind, waves and current of a DP number from `FROM_DEG`, at full size."""
    wind_mps, hs_m, tp_s, current_mps = DP_NUMBERS[number]
    return EnvironmentTable(
        ramp_s=RAMP_S,
        seed=1,
        wind=WindTable(speed_mps=wind_mps, from_deg=FROM_DEG),
        current=CurrentTable(
            speed_mps=round(CURRENT_SHARE * current_mps, 3), towards_deg=FROM_DEG + 180.0
        ),
        waves=WavesTable(hs_m=hs_m, tp_s=tp_s, from_deg=FROM_DEG),
    )


def load_share(vessel: Vessel, number: int) -> float:
    """The mean force of that sea over the limits, in the axis where it is largest.

    Raises InputError where the vessel has no hull data for wind or drift.
    """
    load = mean_load(vessel, sea_state(number).environment(Froude()))
    # What pushes astern is met with force ahead.
    limit = np.where(load < 0.0, vessel.tau_max, -vessel.tau_min)
    return float(np.max(np.abs(load) / limit))


def largest_sea(vessel: Vessel) -> int:
    """The largest DP number whose mean force takes no more than `SPARE`; 1 where none does so."""
    return max((n for n in DP_NUMBERS if load_share(vessel, n) <= SPARE), default=1)
