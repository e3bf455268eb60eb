"""Lost thrust and dead time between a commanded force and the hull.

τ_hull(k) = efficiency · τ(k − delay),   τ = 0 before the start
"""

from dataclasses import dataclass, field

import numpy as np

from dpbench.arrays import Indices, Matrix, Vector
from dpbench.ship.layout import AXES
from dpbench.ship.thrusters import ThrusterSet, Trips


@dataclass(frozen=True, eq=False)
class Actuators:
    """Thrust losses and dead time between the commanded force and the hull."""

    efficiency: Vector = field(default_factory=lambda: np.ones(AXES))
    delay_samples: int = 0

    def make_state_at_rest(self) -> "DelayedThrust":
        """Return the actuators' state at the start of a run, without thrust."""
        return DelayedThrust(self)


@dataclass(frozen=True, eq=False)
class CommandedThrusters:
    """Thrusters with lag, dead time and losses; trips : those without force from a sample on."""

    thrusters: ThrusterSet
    sample_s: float
    lag_s: float
    behind: Actuators
    trips: Trips = ()

    def make_state_at_rest(self) -> "ThrusterForces":
        """Return the thrusters' state at the start of a run, without thrust."""
        return ThrusterForces(self)


class DelayLine:
    """Ring buffer that delays commands by a number of samples."""

    def __init__(self, samples: int, entries: int) -> None:
        self._ring, self._newest = np.zeros((samples + 1, entries)), 0

    def store_command_and_return_due_one(self, command: Vector) -> Vector:
        """Store the newest command and return a view of the one that is due now."""
        self._ring[self._newest] = command
        self._newest = (self._newest + 1) % len(self._ring)
        # After the step the place to be written next holds the oldest command.
        arrived: Vector = self._ring[self._newest]
        return arrived


class DelayedThrust:
    """State of the actuators in one run: commands under way, and the delivered force."""

    def __init__(self, actuators: Actuators) -> None:
        self._efficiency = actuators.efficiency
        self._delay = DelayLine(actuators.delay_samples, AXES)
        self._delivered = np.zeros(AXES)

    def force_on_hull_for_command(self, tau: Vector) -> Vector:
        """Store a commanded force tau (3,); return the delayed, reduced force on the hull (3,)."""
        np.multiply(
            self._efficiency, self._delay.store_command_and_return_due_one(tau), out=self._delivered
        )
        return self._delivered


class ThrusterForces:
    """State of commanded thrusters in one run; f (n_f,) are their present forces [N]."""

    def __init__(self, commanded: CommandedThrusters) -> None:
        thrusters, behind = commanded.thrusters, commanded.behind
        self.f = np.zeros(thrusters.n_f)
        self._k, self._trips = 0, dict(commanded.trips)
        self._stopped: Indices = np.zeros(0, dtype=np.intp)
        self._efficient: Matrix = behind.efficiency[:, np.newaxis] * thrusters.T_e
        self._step_max = thrusters.largest_force_changes_per_sample(commanded.sample_s)
        self._delay = DelayLine(behind.delay_samples, thrusters.n_f)
        self._circles = [
            (at, thruster.thrust_N)
            for thruster, at in zip(
                thrusters.thrusters, thrusters.slices_in_force_vector, strict=True
            )
            if thruster.kind == "azimuth"
        ]
        lag = commanded.lag_s / commanded.sample_s
        self._left = np.exp(-1.0 / lag) if lag > 0.0 else 0.0
        self._mean = lag * (1.0 - self._left)

    def force_on_hull_for_command(self, command: Vector) -> Vector:
        """Advance thrusters one sample to a command (n_f,); return the force on the hull (3,)."""
        goal, f = self._delay.store_command_and_return_due_one(command), self.f
        if self._trips:
            f[self._update_and_list_stopped_entries()] = 0.0
        target = np.clip(goal, f - self._step_max, f + self._step_max)
        for at, thrust_N in self._circles:
            size = float(np.sqrt((target[at] ** 2).sum()))
            if size > thrust_N:
                target[at] *= thrust_N / size
        target[self._stopped] = 0.0
        behind = f - target
        self.f = target + self._left * behind
        return self._efficient @ (target + self._mean * behind)

    def _update_and_list_stopped_entries(self) -> Indices:
        """Count one sample; return the entries of f that have stopped by then."""
        entries = self._trips.get(self._k)
        if entries is not None:
            self._stopped = np.union1d(self._stopped, entries)
        self._k += 1
        return self._stopped
