"""The one typed description of a run, in SI: vessel, tuning, environment, reference, duration."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from dpbench.arrays import Matrix, Vector
from dpbench.display import fields_html, numbers_text
from dpbench.errors import InputError, UnknownNameError
from dpbench.mpc.condense import ControlProblem, UnitSystem
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.mpc.reference import ReferenceFilter, reference_table
from dpbench.scenario.controllers.controller import Controller
from dpbench.scenario.controllers.kinds import CONTROLLERS
from dpbench.scenario.controllers.specification import ControllerSpec
from dpbench.scenario.estimation import EstimatorChoice, estimator_choice
from dpbench.scenario.problem_files import (
    ScenarioDocuments,
    VesselDocuments,
    parse_model,
    problem_path,
    read_model,
)
from dpbench.scenario.tables.scenario_file import ScenarioFile
from dpbench.scenario.tables.vessel_file import VesselFile
from dpbench.ship.actuators import Actuators, CommandedThrusters
from dpbench.ship.environment import Environment
from dpbench.ship.estimation.estimator import Estimator
from dpbench.ship.froude import Froude
from dpbench.ship.vessel import Vessel

MAX_STEPS = 1_000_000
"""A run keeps every step in memory; a million of them is 83 hours of the paper's ship."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """A run in SI units.

    Parameters
    ----------
    name : name of the file; title, shows : what it is and what it is for.
    vessel : the ship as the controller knows it; true_ship : as it is; actuators : what is lost or
        late on the way from a command to its hull, None for nothing.
    environment : the weather; estimation : how the controller gets to know its state.
    steps, sample_s : how many samples of what length [s].
    start, reference : (3,) poses [n, e, ψ] in m, m, rad.
    velocity : (3,) of the start, [u, v, r] over ground along the ship's axes in m/s, m/s, rad/s.
    smoothed, preview : reference filter, and whether the controller sees the reference coming.
    controller : what steers the ship: its QPs, its limits, what it commands.
    files : the documents it was made from, from which `scenario_of` makes it again.
    """

    name: str
    title: str
    shows: str
    vessel: Vessel
    true_ship: Vessel
    actuators: Actuators | CommandedThrusters | None
    environment: Environment
    estimation: EstimatorChoice
    steps: int
    sample_s: float
    start: Vector
    velocity: Vector
    reference: Vector
    smoothed: ReferenceFilter | None
    preview: bool
    controller: Controller
    files: ScenarioDocuments

    def __repr__(self) -> str:
        return (
            f"<Scenario {self.name}: {self.vessel.id}, {self.controller.description}, "
            f"{self.steps} steps of {self.sample_s:.4g} s>"
        )

    def _repr_html_(self) -> str:
        units = ("m", "m", "rad")
        fields = {
            "shows": self.shows,
            "vessel": f"{self.vessel.title} ({self.vessel.id})",
            "controller": self.controller.description,
            "length": f"{self.steps} steps of {self.sample_s:.4g} s",
            "start": numbers_text(self.start, units),
            "reference": numbers_text(self.reference, units),
            "most in one step": numbers_text(self.force_step_max, ("N", "N", "N·m")),
            "state": self.estimation.kind,
            "amplitude limits": self.controller.amplitude,
        }
        return fields_html(f"{self.name}: {self.title}", fields)

    @property
    def problem(self) -> ControlProblem:
        """What the controller wants and may do: model, horizons, weights, limits in SI."""
        return self.controller.problem

    @property
    def force_step_max(self) -> Vector:
        """The largest change of the force in one sample (3,) [N, N, N·m], axis by axis."""
        return self.vessel.step_max(self.sample_s)

    @property
    def first_state(self) -> Vector:
        """(6,) [u, v, r, n, e, ψ] at the first sample."""
        return np.concatenate([self.velocity, self.start])

    def reference_table(self, samples: int) -> Matrix:
        """The reference at each sample (samples, 3), heading unwrapped from the start's."""
        return reference_table(self.start, self.reference, samples, self.sample_s, self.smoothed)

    def estimator(self) -> Estimator:
        """A new estimator, which starts in the state the run starts in."""
        estimator = self.estimation.make(self.vessel, self.sample_s)
        estimator.start(self.first_state)
        return estimator

    def first(self, steps: int) -> Scenario:
        """The same run cut to its first `steps` samples; InputError below 1."""
        if steps < 1:
            raise InputError(f"scenario {self.name}", "steps", steps, "1 or more")
        return replace(self, steps=min(steps, self.steps))


def load_scenario(name_or_path: str | Path, *, beside: Path | None = None) -> Scenario:
    """A scenario by name (a file under `problems/scenarios/`) or TOML path.

    `scenario@vessel` is the scenario with another vessel than its own. A relative path is looked
    for in the folder `beside` first, then in the working folder.

    Raises
    ------
    InputError : one line naming file, key, what was found and what is allowed.
    """
    name, at, other = str(name_or_path).partition("@")
    path = problem_path("scenarios", name, beside)
    scenario = read_model(path, ScenarioFile)
    vessel = other if at else scenario.vessel
    try:
        vessel_path = problem_path("vessels", vessel, beside=path.parent)
    except InputError as error:
        raise UnknownNameError(str(path), "vessel", repr(vessel), error.allowed) from error
    files: ScenarioDocuments = {
        "name": f"{path.stem}@{vessel_path.stem}" if other else path.stem,
        "scenario": scenario.model_dump(),
        **vessel_files(vessel_path),
    }
    return scenario_of(files, where=str(path), vessel_where=str(vessel_path))


def load_vessel(name_or_path: str | Path) -> Vessel:
    """A vessel by name (a file under `problems/vessels/`) or TOML path."""
    path = problem_path("vessels", name_or_path)
    return read_model(path, VesselFile).vessel(path.stem, str(path))


def vessel_files(name_or_path: str | Path, *, beside: Path | None = None) -> VesselDocuments:
    """What of `Scenario.files` is the vessel's; a relative path as in `load_scenario`."""
    path = problem_path("vessels", name_or_path, beside)
    return {"vessel_name": path.stem, "vessel": read_model(path, VesselFile).model_dump()}


def vessel_of(files: VesselDocuments, where: str = "vessel") -> Vessel:
    """The vessel of such documents."""
    return parse_model(files["vessel"], VesselFile, where).vessel(files["vessel_name"], where)


def scenario_of(
    files: ScenarioDocuments, where: str = "scenario", vessel_where: str = "vessel"
) -> Scenario:
    """The scenario of the documents in `files` (`Scenario.files`, JSON-compatible)."""
    spec = parse_model(files["scenario"], ScenarioFile, where)
    ship_file = parse_model(files["vessel"], VesselFile, vessel_where)
    vessel = ship_file.vessel(files["vessel_name"], vessel_where)
    scale = Froude(ship_file.model_scale)
    plant = spec.plant
    sample_s = spec.sample_s * scale.time
    if not 1 <= spec.steps <= MAX_STEPS:
        allowed = f"1 to {MAX_STEPS} samples of {spec.sample_s:g} s"
        raise InputError(where, "duration_s", spec.duration_s, allowed)
    true_ship = replace(vessel, where=f"{where}: plant").with_mismatch(
        plant.mass_percent, plant.damping_percent
    )
    environment = spec.environment.environment(scale)
    made_from = ControllerSpec(spec, vessel, sample_s, scale, where)
    controller = CONTROLLERS[spec.controller.kind](made_from)
    # Said here, before anything runs: wind and drift need to know the hull.
    environment.load_coefficients(vessel)
    return Scenario(
        name=files["name"],
        title=spec.title,
        shows=spec.shows,
        vessel=vessel,
        true_ship=true_ship,
        actuators=_actuators(spec, controller, sample_s, scale),
        environment=environment,
        estimation=estimator_choice(spec, scale, where),
        steps=spec.steps,
        sample_s=sample_s,
        start=spec.start.pose() * scale.pose,
        velocity=spec.start.velocity() * scale.velocity,
        reference=spec.reference.pose() * scale.pose,
        smoothed=spec.reference.smoothed(scale),
        preview=spec.reference.preview,
        controller=controller,
        files=files,
    )


def scenario_once(files: ScenarioDocuments) -> Scenario:
    """As `scenario_of`, for documents of which many cells ask the same: made once a process, in
    whatever seas."""
    weather = files["scenario"].get("environment", {})
    if not isinstance(weather.get("seed"), int):
        return _made(json.dumps(files, sort_keys=True))
    calm = {**files, "scenario": {**files["scenario"], "environment": {**weather, "seed": 0}}}
    scenario = _made(json.dumps(calm, sort_keys=True))
    sea = replace(scenario.environment, seed=weather["seed"])
    return replace(scenario, environment=sea, files=files)


@lru_cache(maxsize=64)
def _made(files: str) -> Scenario:
    return scenario_of(json.loads(files))


def _actuators(
    spec: ScenarioFile, controller: Controller, sample_s: float, scale: Froude
) -> Actuators | CommandedThrusters | None:
    """Return what is between commands and the hull; None for nothing."""
    plant = spec.plant
    loss = np.array(plant.thrust_loss_percent)
    behind = Actuators(1.0 - loss / 100.0, plant.delay_samples)
    if controller.commanded is not None:
        lag_s = plant.thruster_lag_s * scale.time
        return CommandedThrusters(controller.commanded.thrusters, sample_s, lag_s, behind)
    if not loss.any() and plant.delay_samples == 0:
        return None
    return behind


def condense(scenario: Scenario, *, units: UnitSystem = "scaled") -> CondensedQP:
    """The builder of the scenario's QPs, in scaled units or SI."""
    return scenario.controller.build_qp(units)
