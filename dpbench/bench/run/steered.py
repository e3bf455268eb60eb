"""System that a closed loop steers: the scenario's ship in its weather, or one's own plant."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from dpbench.arrays import Vector
from dpbench.bench.run.formulation import Case
from dpbench.errors import InputError
from dpbench.scenario.plants.contract import (
    Plant,
    PlantError,
    PlantMaker,
    refuse_loads_on_own_plant,
)
from dpbench.scenario.plants.linear_mpc import LinearMPC
from dpbench.scenario.scenario import Scenario
from dpbench.ship.environment import WeatherDraw
from dpbench.ship.estimation.estimator import shift_heading_near
from dpbench.ship.layout import HEADING, POSE, STATE
from dpbench.ship.plant import SUBSTEPS, Sensors, ShipPlant

Result = TypeVar("Result")

plant_observers: list[Callable[[bool], None]] = []
"""Called with True before and with False after each call of a custom plant."""


class Steered(ABC):
    """System under control, one instance a run: advanced by inputs, measured at each sample.

    state : the true state now, logged at each sample.
    first_input : (n_u,) input before the first sample.
    """

    state: Vector
    first_input: Vector

    @abstractmethod
    def write_model_state(self, k: int, tau: Vector, x: Vector) -> None:
        """Write the state x = [Δx_m; y] of the incremental model at sample k.

        tau : input that acted over the sample before, for an estimator.
        """

    @abstractmethod
    def advance(self, k: int, command: Vector) -> None:
        """Advance by sample k under a command, held over the sample."""


class SteeredShip(Steered):
    """The ship of a scenario, with its weather, sensors and estimator.

    A `plant` of one's own replaces the ship; the scenario's actuators, sensors and estimator stay.
    Its heading may wrap: that of `state` does not.
    """

    def __init__(
        self, scenario: Scenario, drawn: WeatherDraw | None, plant: "ObservedPlant | None"
    ) -> None:
        sea, steps, sample_s = scenario.environment, scenario.steps, scenario.sample_s
        self.first_input = np.zeros(scenario.problem.model.n_u)
        self._sense = Sensors(sea, steps, sample_s).measure_state
        self._estimator = scenario.estimator()
        self._own, self._actuators = plant, None
        if plant is not None:
            refuse_loads_on_own_plant(sea, f"scenario {scenario.name}")
            actuators = scenario.actuators
            self._actuators = None if actuators is None else actuators.make_state_at_rest()
            self.state = plant.state
            return
        self._sea = sea.build_weather_table_at_stages(steps, sample_s, SUBSTEPS, drawn)
        self._ship = ShipPlant(
            scenario.true_ship,
            scenario.first_state,
            sample_s,
            loads=sea.wind_and_drift_coefficients(scenario.vessel),
            actuators=scenario.actuators,
        )
        self.state = self._ship.state

    def write_model_state(self, k: int, tau: Vector, x: Vector) -> None:
        """Write the estimated [Δν, Δη, η] of the ship at sample k to x (9,)."""
        true = self.state if self._own is None else self._own.measure()
        x[STATE:] = self._estimator.update_and_return_state(self._sense(true, k), tau)[POSE]
        x[:STATE] = self._estimator.change

    def advance(self, k: int, command: Vector) -> None:
        """Advance the ship by sample k under a force (3,) or thruster forces (n_f,)."""
        if self._own is None:
            self._ship.advance_by_one_sample(command, self._sea[k])
            return
        if self._actuators is not None:
            command = self._actuators.force_on_hull_for_command(command)
        self._own.step(command)
        heading, self.state = self.state[HEADING], self._own.state
        self.state[HEADING] = shift_heading_near(self.state[HEADING], heading)


class SteeredPlant(Steered):
    """A custom plant, steered by a linear MPC."""

    def __init__(self, mpc: LinearMPC, plant: "ObservedPlant") -> None:
        self._plant, self._C = plant, mpc.model.C
        self.first_input, self.state = mpc.first_input, plant.state
        self._before: Vector | None = None

    def write_model_state(self, k: int, tau: Vector, x: Vector) -> None:
        """Write the change of the measured state and the outputs at sample k to x."""
        measured = self._plant.measure()
        n = len(measured)
        x[:n] = 0.0 if self._before is None else measured - self._before
        x[n:] = self._C @ measured
        self._before = measured

    def advance(self, k: int, command: Vector) -> None:
        """Advance the plant by sample k under the input (n_u,)."""
        self._plant.step(command)
        self.state = self._plant.state


class ObservedPlant:
    """A custom plant whose answers are checked; `plant_observers` know when it is called.

    size : of its state and of its measurement.
    """

    def __init__(self, make: PlantMaker, size: int) -> None:
        if not callable(make):
            maker = type(make).__name__
            found = f"an object of class {maker}"
            allowed = f"a class or a function that makes a plant, such as plant={maker}"
            raise TypeError(f"plant: found {found}; allowed: {allowed}")
        self._plant: Plant = self._call(make)
        self.name = str(getattr(self._plant, "name", f"plant {type(self._plant).__name__}"))
        # A property that raises AttributeError is present, and its own error is shown.
        for member in ("state", "step", "measure"):
            if member not in dir(self._plant) and not hasattr(self._plant, member):
                sentence = f"{member} is missing; a plant has state, step(u) and measure()"
                raise PlantError(self.name, sentence)
        self._shape, self._samples = (size,), 0
        self.state = self._checked("state", self._plant.state)

    def step(self, u: Vector) -> None:
        """Advance the plant by one sample; PlantError for a state that is not finite."""
        try:
            self._call(self._plant.step, u.copy())
        except Exception as error:  # whatever the plant raises; it is raised again with a note
            error.add_note(f"{self.name}: step(u) of sample {self._samples}, u = {u}")
            raise
        self.state = self._checked("state", self._plant.state, u)
        self._samples += 1

    def measure(self) -> Vector:
        """Return a copy of the measurement; PlantError for a wrong shape or NaN."""
        return self._checked("measure()", self._call(self._plant.measure))

    def close(self) -> None:
        """Close the plant where it has a method for that, as an FMU has."""
        close = getattr(self._plant, "close", None)
        if close is not None:
            self._call(close)

    def _call(self, function: Callable[..., Result], *args: object) -> Result:
        """Call a function of the plant, observed."""
        for observe in plant_observers:
            observe(True)
        result = function(*args)
        for observe in plant_observers:
            observe(False)
        return result

    def _checked(self, what: str, values: object, u: Vector | None = None) -> Vector:
        """Return a copy of an array of the plant; PlantError for another shape or NaN.

        u : the input of the step that it follows; None for a measurement or the first state.
        """
        array = np.array(values, dtype=np.float64)
        # A fifth of the time of numpy.isfinite; squares beyond 1e308 are no state of a plant.
        if array.shape == self._shape and math.isfinite(array.dot(array)):
            return array
        when = f" in sample {self._samples}" if self._samples else ""
        if u is not None:
            when = f" after step(u) of sample {self._samples}"
        fault = f"has shape {array.shape}, not {self._shape}{when}"
        if array.shape == self._shape:
            fault = f"is not finite{when}: {what} = {array}"
            fault += "" if u is None else f", u = {u}"
        raise PlantError(self.name, f"{'the ' * (what == 'state')}{what} {fault}")


def build_steered_system(
    case: Case, make: PlantMaker | None, drawn: WeatherDraw | None = None
) -> tuple[Steered, ObservedPlant | None]:
    """Return what a closed loop steers, and the custom plant in it, if any.

    make : of a custom plant; by default the scenario's FMU, if it has one, or its ship.
    InputError for a linear MPC without a plant; PlantError where the plant fails or does not fit.
    """
    if isinstance(case, LinearMPC):
        if make is None:
            raise InputError(
                case.name, "plant", "nothing", "a plant, as a LinearMPC has no simulator"
            )
        own = ObservedPlant(make, case.model.n_x)
        return SteeredPlant(case, own), own
    if make is None and case.fmu is not None:
        make = case.fmu.make_plant_maker(case.first_state, case.sample_s)
    if make is None:
        return SteeredShip(case, drawn, None), None
    own = ObservedPlant(make, STATE)
    return SteeredShip(case, drawn, own), own
