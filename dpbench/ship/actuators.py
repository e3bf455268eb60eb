"""Lost thrust, dead time and lag between a commanded force and the hull.

    τ_hull(k) = efficiency · τ(k − delay),   τ = 0 before the start

With a lag T, the delivered force f follows the command τ over each sample Δt as T df/dt = τ − f,
and the hull gets the mean of f over the sample.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from dpbench.arrays import Indices, Matrix, Vector
from dpbench.ship.layout import AXES
from dpbench.ship.thrusters import ThrusterSet, Trips


@dataclass(frozen=True, eq=False)
class Actuators:
    """Thrust losses, dead time [samples] and lag [samples] between a force and the hull."""

    efficiency: Vector = field(default_factory=lambda: np.ones(AXES))
    delay_samples: int = 0
    lag_samples: float = 0.0

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


class FirstOrderLag:
    """Forces that follow a target, constant over each sample, with a time constant in samples."""

    def __init__(self, lag_samples: float, entries: int) -> None:
        self.f = np.zeros(entries)
        self._left = math.exp(-1.0 / lag_samples) if lag_samples > 0.0 else 0.0
        self._mean = lag_samples * (1.0 - self._left)

    def advance_and_return_mean(self, target: Vector) -> Vector:
        """Advance f by one sample towards a target; return the mean force over the sample."""
        behind = self.f - target
        self.f = target + self._left * behind
        mean: Vector = target + self._mean * behind
        return mean


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
        is_lagging = actuators.lag_samples > 0.0
        self._lag = FirstOrderLag(actuators.lag_samples, AXES) if is_lagging else None
        self._delivered = np.zeros(AXES)

    def force_on_hull_for_command(self, tau: Vector) -> Vector:
        """Store a commanded force tau (3,); return the force that reaches the hull (3,)."""
        due = self._delay.store_command_and_return_due_one(tau)
        if self._lag is not None:
            due = self._lag.advance_and_return_mean(due)
        np.multiply(self._efficiency, due, out=self._delivered)
        return self._delivered


class ThrusterForces:
    """State of commanded thrusters in one run.

    The command passes the rate limit and the circle first; the force follows the result with the
    lag, so that a thruster on its way to full thrust is late by the lag and not slower.
    """

    def __init__(self, commanded: CommandedThrusters) -> None:
        thrusters, behind = commanded.thrusters, commanded.behind
        self._lag = FirstOrderLag(commanded.lag_s / commanded.sample_s, thrusters.n_f)
        self._target = np.zeros(thrusters.n_f)
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

    @property
    def f(self) -> Vector:
        """Present forces (n_f,) of the thrusters [N]."""
        return self._lag.f

    def force_on_hull_for_command(self, command: Vector) -> Vector:
        """Advance thrusters one sample to a command (n_f,); return the force on the hull (3,)."""
        goal, last = self._delay.store_command_and_return_due_one(command), self._target
        if self._trips:
            stopped = self._update_and_list_stopped_entries()
            last[stopped] = self.f[stopped] = 0.0
        target = np.clip(goal, last - self._step_max, last + self._step_max)
        for at, thrust_N in self._circles:
            size = float(np.sqrt((target[at] ** 2).sum()))
            if size > thrust_N:
                target[at] *= thrust_N / size
        target[self._stopped] = 0.0
        self._target = target
        return self._efficient @ self._lag.advance_and_return_mean(target)

    def _update_and_list_stopped_entries(self) -> Indices:
        """Count one sample; return the entries of f that have stopped by then."""
        entries = self._trips.get(self._k)
        if entries is not None:
            self._stopped = np.union1d(self._stopped, entries)
        self._k += 1
        return self._stopped
