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
from dpbench.mpc.condense import ControlProblem, Terminal, UnitSystem
from dpbench.mpc.condensed_qp import Amplitude, CondensedQP, Form
from dpbench.mpc.model import StateSpace, prediction_model
from dpbench.mpc.outputs import OutputBounds
from dpbench.mpc.reference import ReferenceFilter, reference_table
from dpbench.mpc.relinearised import RelinearisedQP
from dpbench.mpc.staged_qp import StagedQP
from dpbench.mpc.thruster_rows import ThrusterRows
from dpbench.mpc.thrusters.attainable_set import AttainableSet
from dpbench.mpc.thrusters.azimuth_turning import TurningQP
from dpbench.scenario.commanded_thrusters import (
    Allocation,
    ThrusterControl,
    actuators_of,
    allocation_of,
    attainable_of,
    faults_of,
    limit_tables_of,
    thruster_control,
)
from dpbench.scenario.estimation import EstimatorChoice, estimator_choice
from dpbench.scenario.problem_files import (
    ScenarioDocuments,
    VesselDocuments,
    parse_model,
    problem_path,
    read_model,
)
from dpbench.scenario.tables.scenario_file import ControllerTable, ScenarioFile
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
    N_p, N_c, Q, R, psi0_rad : horizons, weights in SI, of outputs (3, 3) and of moves (n_u, n_u),
        heading of the model.
    steered : thrusters, whose forces are then u (n_u,); None where u is the force (3,).
    attainable : the set that limits the force as a whole; None for a limit an axis.
    allocation : of a cascade, how thrusters make the force u; None else.
    relinearised : whether the model is linearised anew at each step.
    amplitude, outputs, terminal : policy of the amplitude limits, bounds on position and speed,
        cost at the end of the horizon.
    faults : (sample, least, most) from which on these limits of the rows of u (r,) hold, in order
        of time.
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
    N_p: int
    N_c: int
    Q: Matrix
    R: Matrix
    psi0_rad: float
    steered: ThrusterControl | None
    attainable: AttainableSet | None
    allocation: Allocation | None
    relinearised: bool
    amplitude: Amplitude
    outputs: OutputBounds | None
    terminal: Terminal
    faults: tuple[tuple[int, Vector, Vector], ...]
    tuning: str
    files: ScenarioDocuments

    def __repr__(self) -> str:
        return (
            f"<Scenario {self.name}: {self.vessel.id}, {self._controller}, "
            f"{self.steps} steps of {self.sample_s:.4g} s>"
        )

    def _repr_html_(self) -> str:
        units = ("m", "m", "rad")
        fields = {
            "shows": self.shows,
            "vessel": f"{self.vessel.title} ({self.vessel.id})",
            "controller": self._controller,
            "length": f"{self.steps} steps of {self.sample_s:.4g} s",
            "start": numbers_text(self.start, units),
            "reference": numbers_text(self.reference, units),
            "most in one step": numbers_text(self.force_step_max, ("N", "N", "N·m")),
            "state": self.estimation.kind,
            "amplitude limits": self.amplitude,
        }
        return fields_html(f"{self.name}: {self.title}", fields)

    @property
    def _controller(self) -> str:
        steers = "" if self.steered is None else ", thrusters"
        allocates = "" if self.allocation is None else ", cascade"
        return f"tuning {self.tuning} {self.N_p}/{self.N_c}{steers}{allocates}"

    @property
    def commanded(self) -> ThrusterControl | None:
        """The thrusters that are told what to give, planned or allocated; None where none are."""
        return self.steered if self.allocation is None else self.allocation.control

    @property
    def force_step_max(self) -> Vector:
        """The largest change of the force in one sample (3,) [N, N, N·m], axis by axis."""
        return self.vessel.step_max(self.sample_s)

    @property
    def du_max(self) -> Vector:
        """Δu_max (n_u,) of what is steered: of the force, or of the entries of f [N]."""
        if self.steered is None:
            return self.force_step_max
        return self.steered.thrusters.step_max(self.sample_s)

    def forces(self, u: Matrix) -> Matrix:
        """The forces on the ship τ (..., 3) of what is steered, u (..., n_u)."""
        if self.steered is None:
            return u
        forces: Matrix = u @ self.steered.thrusters.T_e.T
        return forces

    @property
    def first_state(self) -> Vector:
        """(6,) [u, v, r, n, e, ψ] at the first sample."""
        return np.concatenate([self.velocity, self.start])

    def control_problem(self) -> ControlProblem:
        """What the controller is given: the model at ψ0, horizons, weights, limits."""
        ship, W = self.vessel, None
        model = prediction_model(ship.M, ship.D, self.psi0_rad, self.sample_s)
        if self.steered is not None:
            model = StateSpace(model.A, model.B @ self.steered.thrusters.T_e, model.C)
            W = self.steered.W
        horizons = self.N_p, self.N_c, self.Q, self.R
        limits = *self._own_limits, self.du_max
        return ControlProblem(model, *horizons, *limits, self.terminal, self._rows, W)

    @property
    def _rows(self) -> ThrusterRows | None:
        """The rows of u that are limited; None where each axis of it is."""
        if self.attainable is not None:
            return self.attainable.rows()
        return None if self.steered is None else self.steered.rows

    @property
    def _own_limits(self) -> tuple[Vector, Vector]:
        """Limits of u, or of its rows, while nothing has failed."""
        rows, ship = self._rows, self.vessel
        return (ship.tau_min, ship.tau_max) if rows is None else (rows.low, rows.high)

    def reference_table(self, samples: int) -> Matrix:
        """The reference at each sample (samples, 3), heading unwrapped from the start's."""
        return reference_table(self.start, self.reference, samples, self.sample_s, self.smoothed)

    def limit_tables(self, samples: int) -> tuple[Matrix, Matrix]:
        """The limits in force at each sample, of τ (samples, 3) or of the thrusters' rows."""
        return limit_tables_of(self._own_limits, self.faults, samples)

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
    controller, plant = spec.controller, spec.plant
    sample_s = spec.sample_s * scale.time
    if not 1 <= spec.steps <= MAX_STEPS:
        allowed = f"1 to {MAX_STEPS} samples of {spec.sample_s:g} s"
        raise InputError(where, "duration_s", spec.duration_s, allowed)
    true_ship = replace(vessel, where=f"{where}: plant").with_mismatch(
        plant.mass_percent, plant.damping_percent
    )
    environment = spec.environment.environment(scale)
    control = thruster_control(controller, vessel, sample_s, where)
    steered = control if controller.kind == "thrusters" else None
    allocation = allocation_of(spec, control, vessel, sample_s, where)
    attainable = attainable_of(controller, vessel, where)
    # Said here, before anything runs: wind and drift need to know the hull.
    environment.load_coefficients(vessel)
    return Scenario(
        name=files["name"],
        title=spec.title,
        shows=spec.shows,
        vessel=vessel,
        true_ship=true_ship,
        actuators=actuators_of(spec, control, sample_s, scale),
        environment=environment,
        estimation=estimator_choice(spec, scale, where),
        steps=spec.steps,
        sample_s=sample_s,
        start=spec.start.pose() * scale.pose,
        velocity=spec.start.velocity() * scale.velocity,
        reference=spec.reference.pose() * scale.pose,
        smoothed=spec.reference.smoothed(scale),
        preview=spec.reference.preview,
        N_p=controller.prediction_horizon,
        N_c=controller.control_horizon,
        Q=np.diag(np.array(controller.output_weight) / scale.pose**2),
        R=np.diag(_move_weight(controller, vessel, sample_s, scale)),
        psi0_rad=float(np.radians(controller.model_heading_deg)),
        steered=steered,
        attainable=attainable,
        allocation=allocation,
        relinearised=controller.linearisation == "each_step",
        amplitude=controller.amplitude,
        outputs=_outputs(controller, scale, sample_s),
        terminal=controller.terminal,
        faults=faults_of(spec, vessel, steered or attainable, where),
        tuning=controller.tuning,
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


def _move_weight(
    controller: ControllerTable, vessel: Vessel, sample_s: float, scale: Froude
) -> Vector:
    if controller.kind == "thrusters" and controller.thrusters is not None:
        assert vessel.thrusters is not None, "steered thrusters are known by now"
        steps = vessel.thrusters.step_max(sample_s)
        relative: Vector = controller.thrusters.move_weight_relative / steps**2
        return relative
    if controller.move_weight_relative is not None:
        return np.array(controller.move_weight_relative) / vessel.step_max(sample_s) ** 2
    assert controller.move_weight is not None, "the table demands one of the two"
    return np.array(controller.move_weight) / scale.force**2


def _outputs(controller: ControllerTable, scale: Froude, sample_s: float) -> OutputBounds | None:
    table = controller.outputs
    if table is None:
        return None
    return OutputBounds(
        sample_s,
        None if table.radius_m is None else table.radius_m * scale.length,
        None if table.speed_mps is None else table.speed_mps * scale.time,
    )


def condense(scenario: Scenario, *, units: UnitSystem = "scaled") -> CondensedQP:
    """The builder of the scenario's QPs, in scaled units or SI."""
    problem = scenario.control_problem()
    form: Form = {"units": units, "amplitude": scenario.amplitude, "outputs": scenario.outputs}
    if scenario.relinearised:
        return RelinearisedQP(problem, psi0_rad=scenario.psi0_rad, **form)
    turning = None if scenario.steered is None else scenario.steered.turning
    if turning is not None:
        return TurningQP(problem, turning, **form)
    return CondensedQP(problem, **form)


def no_stages(scenario: Scenario) -> str:
    """Why the QPs of a scenario have no formulation with the states kept; "" where they have."""
    if scenario.relinearised:
        return "sparse: the model is linearised anew at each step, and its stages with it"
    if scenario.steered is not None and scenario.steered.turning is not None:
        return "sparse: the directions of azimuths are other ones at each step, and so are rows"
    if scenario.amplitude == "soft" or scenario.outputs is not None:
        return "sparse: soft limits and output bounds are layers on the condensed problem"
    return ""


def no_delay(scenario: Scenario) -> str:
    """Why late answers on a slow computer are not simulated in a scenario; "" where they are."""
    return "" if scenario.allocation is None else "slowdown: not of a cascade, whose QPs are two"


def keep_states(scenario: Scenario, *, units: UnitSystem = "scaled") -> StagedQP:
    """The builder of the same QPs as `condense`, in stages; InputError where there are none."""
    why = no_stages(scenario)
    if why or scenario.amplitude == "soft":
        allowed = "a scenario without layers and with one model"
        raise InputError(f"scenario {scenario.name}", "formulation", why, allowed)
    return StagedQP(scenario.control_problem(), units=units, amplitude=scenario.amplitude)
