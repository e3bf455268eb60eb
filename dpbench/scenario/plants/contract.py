"""The contract of a plant: a custom simulator, which a controller steers."""

from collections.abc import Callable
from typing import Protocol

from dpbench.arrays import Vector
from dpbench.errors import InputError, SituationError
from dpbench.ship.environment import Environment

PlantMaker = Callable[[], "Plant"]
"""Function, or class, that returns a new plant at the start of a run."""


class PlantError(SituationError):
    """A fault of a custom plant, such as a failed call; never charged to a solver.

    Examples
    --------
    >>> issubclass(PlantError, InputError)
    True
    """


class Plant(Protocol):
    """Custom simulator, which a controller steers for one run.

    For a ship: `u` (3,) is the force in surge, sway and yaw [N, N, N·m]; `state` and measurement
    are [u, v, r, n, e, ψ] (6,) in m/s, m/s, rad/s, m, m, rad, where ψ may wrap. For a `LinearMPC`:
    `u` (n_u,) and `state` (n_x,) are those of its model, in its units; `measure()` returns all n_x
    states, measured or estimated, not the n_y outputs.

    Examples
    --------
    >>> import numpy as np
    >>> class Integrator:
    ...     def __init__(self):
    ...         self.state = np.zeros(1)
    ...
    ...     def step(self, u):
    ...         self.state = self.state + 0.1 * u
    ...
    ...     def measure(self):
    ...         return self.state
    >>> plant: Plant = Integrator()
    """

    @property
    def state(self) -> Vector:
        """True state of the plant now, which the records show.

        Examples
        --------
        >>> import numpy as np
        >>> class Moored:
        ...     state = np.zeros(6)
        >>> Moored().state.shape
        (6,)
        """

    def step(self, u: Vector) -> None:
        """Advance the plant by one sample under the input u, held over the sample.

        Examples
        --------
        >>> import numpy as np
        >>> class Integrator:
        ...     state = np.zeros(1)
        ...
        ...     def step(self, u):
        ...         self.state = self.state + 0.1 * u
        >>> plant = Integrator()
        >>> plant.step(np.ones(1))
        >>> plant.state
        array([0.1])
        """

    def measure(self) -> Vector:
        """Return the state that the controller gets at this sample, measured or estimated.

        Examples
        --------
        >>> import numpy as np
        >>> class Biased:
        ...     state = np.zeros(1)
        ...
        ...     def measure(self):
        ...         return self.state + 0.01
        >>> Biased().measure()
        array([0.01])
        """


def refuse_loads_on_own_plant(environment: Environment, where: str) -> None:
    """Raise InputError for weather that would push a ship which dpbench does not simulate."""
    sea, current = environment, environment.current
    loads = {
        "mean_kN": sea.mean.any(),
        "amplitude_kN": sea.amplitude.any(),
        "squalls": sea.squalls,
        "wind": sea.wind is not None,
        "current": current is not None and current.speed_mps,
        "waves.drift": sea.drift is not None,
    }
    for key, is_load in loads.items():
        if is_load:
            allowed = "none, as a custom plant simulates its own weather"
            raise InputError(where, f"environment.{key}", "a load on the ship", allowed)
