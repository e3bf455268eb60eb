"""Keys, units (kN, kN·m, degrees) and bounds of scenario files but for the weather."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from dpbench.arrays import Vector
from dpbench.scenario.problem_files import FileModel, KeysError
from dpbench.scenario.tables import key_types as keys
from dpbench.scenario.tables.weather import EnvironmentTable
from dpbench.ship.froude import Froude

if TYPE_CHECKING:
    from dpbench.mpc.reference import ReferenceFilter


class EstimatorTable(FileModel):
    """Settings of the state estimator between the sensors and the controller.

    `measured`: nothing. The filters take period and size of the wave motion from the weather where
    the file does not give them.
    """

    kind: Literal["measured", "kalman", "passive"] = "measured"
    """measured: the controller gets the measurement itself; kalman, passive: a filtered one."""
    wave_filter: bool = True
    """Remove wave-frequency motion from the measurement."""
    peak_period_s: keys.Positive | None = None
    """Peak period of the waves for the filter [s]; by default that of the scenario's waves."""


class FmuInputsTable(FileModel):
    """Inputs of an FMU that are the force on the ship, in any unit that the FMU declares."""

    surge: str
    """Input that is the force ahead."""
    sway: str
    """Input that is the force to starboard."""
    yaw: str
    """Input that is the turning moment, clockwise."""


class FmuOutputsTable(FileModel):
    """Outputs of an FMU that are the state of the ship, in any unit that the FMU declares."""

    north: str
    """Output that is the position north."""
    east: str
    """Output that is the position east."""
    heading: str
    """Output that is the heading, clockwise from north; it may wrap."""
    surge: str
    """Output that is the speed ahead, over ground."""
    sway: str
    """Output that is the speed to starboard, over ground."""
    yaw: str
    """Output that is the rate of turn, clockwise."""


class FmuStartTable(FileModel):
    """Variables of an FMU that are set to the initial state of the scenario."""

    north: str | None = None
    """Variable of the initial position north."""
    east: str | None = None
    """Variable of the initial position east."""
    heading: str | None = None
    """Variable of the initial heading."""
    surge: str | None = None
    """Variable of the initial speed ahead."""
    sway: str | None = None
    """Variable of the initial speed to starboard."""
    yaw: str | None = None
    """Variable of the initial rate of turn."""


class FmuTable(FileModel):
    """Co-simulation FMU (2.0 or 3.0) that replaces dpbench's own ship.

    It is code: it runs with all rights of the user. Every run has an instance of its own.
    """

    later_keys: ClassVar[frozenset[str]] = frozenset({"sha256"})

    file: str
    """The FMU; a relative path starts at the folder of this file."""
    step_s: keys.Seconds | None = None
    """Communication step of the FMU [s]: the sample time divided by a whole number; by default the
    sample time."""
    inputs: FmuInputsTable
    """Names of its inputs."""
    outputs: FmuOutputsTable
    """Names of its outputs."""
    start: FmuStartTable = FmuStartTable()
    """Names of the variables for its initial state; without them it must equal the scenario's."""
    parameters: dict[str, keys.Number] = {}
    """Values of its parameters, in its units."""
    sha256: str = ""
    """SHA-256 of the file, entered when the scenario is read; any other file is refused."""


class PlantTable(FileModel):
    """Differences of the simulated ship from the controller's model, or an FMU in its place."""

    later_keys: ClassVar[frozenset[str]] = frozenset({"thruster_lag_s", "fmu"})

    mass_percent: keys.Percent = 0.0
    """Excess of the simulated ship's M over that of the controller's model [%]."""
    damping_percent: keys.Percent = 0.0
    """Excess of the simulated ship's D over that of the controller's model [%]."""
    thrust_loss_percent: keys.ThreeLosses = [0.0, 0.0, 0.0]
    """Share of the command in surge, sway and yaw that is not delivered [%]."""
    delay_samples: keys.Count = 0
    """Samples by which a command arrives late."""
    thruster_lag_s: keys.NotNegative = 0.0
    """Time constant [s] with which the thrusters follow their commands."""
    fmu: FmuTable | None = None
    """FMU in place of dpbench's own ship; it must simulate its own weather."""

    @model_validator(mode="after")
    def _refuse_mismatch_of_fmu(self) -> PlantTable:
        """Return the table itself; ValueError for a mismatch of a ship that an FMU replaces."""
        if self.fmu is not None and (self.mass_percent or self.damping_percent):
            key = "mass_percent" if self.mass_percent else "damping_percent"
            allowed = "either fmu, which replaces the ship, or mass_percent and damping_percent"
            raise KeysError(f"{key} together with fmu", allowed)
        return self


class FaultTable(FileModel):
    """Fault known to the controller: force limits reduced to a share, or thrusters lost."""

    later_keys: ClassVar[frozenset[str]] = frozenset({"lost", "loss"})

    at_s: keys.NotNegative
    """Time of the fault [s]."""
    limit_share: keys.ThreeShares | None = None
    """Remaining share of the limits in surge, sway and yaw; only if forces are planned."""
    lost: list[str] | None = None
    """Lost thrusters or failure groups; only if thrusters limit the force or are commanded. In a
    cascade, the loss changes the allocation but not the plan."""
    loss: Literal["ramp_down", "trip"] = "ramp_down"
    """Fall of a lost thruster's force to zero. ramp_down: within its rate limit, as when it is
    taken out of service; trip: at once, as when its breaker opens (commanded thrusters only)."""

    @model_validator(mode="after")
    def _require_limit_share_or_lost(self) -> FaultTable:
        """Return the fault itself; ValueError unless it gives just one of limit_share and lost."""
        if (self.limit_share is None) == (self.lost is None):
            raise ValueError("exactly one of limit_share and lost")
        if self.loss == "trip" and self.lost is None:
            raise ValueError('loss = "trip" only together with lost')
        return self


class OutputsTable(FileModel):
    """Soft bounds on the predicted output: a watch circle around the reference, and speed."""

    radius_m: keys.Positive | None = None
    """Radius of the watch circle around the reference [m]; none by default."""
    speed_mps: keys.Positive | None = None
    """Largest speed over ground [m/s]; none by default."""

    @model_validator(mode="after")
    def _require_radius_or_speed_bound(self) -> OutputsTable:
        """Return the table itself; ValueError where neither a radius nor a speed is bounded."""
        if self.radius_m is None and self.speed_mps is None:
            raise ValueError("at least one of radius_m and speed_mps")
        return self


class ThrusterControlTable(FileModel):
    """Settings for commanding thrusters: polygons for their limits, and weights of their forces."""

    later_keys: ClassVar[frozenset[str]] = frozenset({"slack_weight_relative", "allocation"})

    polygon_sides: keys.PolygonSides = 16
    """Sides of the polygon inside the circle of an azimuth's thrust; even."""
    thrust_weight_relative: keys.NotNegative
    """W in multiples of 1/T², with the largest thrust T of each thruster."""
    azimuth_turning: bool = False
    """Respect the turning rate of azimuths in every move; A then changes at every step."""
    move_weight_relative: keys.Positive
    """R in multiples of 1/Δf_max², with the maximum increment Δf_max of each thruster."""
    slack_weight_relative: keys.Positive | None = None
    """Weight Ω of requested force that is not delivered, in multiples of 1/Δτ_max²; for a cascade.
    Make it larger than the other weights, so that the thrusters deliver what they can."""
    allocation: Literal["qp", "pseudo_inverse"] | None = None
    """Allocation of forces in a cascade. qp (default): a second QP at each sample, by the same
    solver; pseudo_inverse: W⁻¹T_eᵀ(T_e W⁻¹T_eᵀ)⁻¹ with the result clipped. The pseudo-inverse also
    acts if the second QP has no usable solution."""


class ControllerTable(FileModel):
    """MPC settings: horizons and weights; move weight R in SI or in multiples of 1/Δu_max²."""

    later_keys: ClassVar[frozenset[str]] = frozenset(
        {"kind", "thrusters", "limits", "attainable_sides"}
    )

    kind: Literal["forces", "thrusters", "cascade"] = "forces"
    """forces: the QP's variables are moves of the force in surge, sway and yaw, as in the paper;
    thrusters: moves of the forces of the vessel's thrusters; cascade: the QP of forces, then a
    second one at each sample that allocates the force to the thrusters."""
    thrusters: ThrusterControlTable | None = None
    """Required with kind = "thrusters" or "cascade", and allowed only there."""

    tuning: str
    """Name of the horizons and weights in tables."""
    prediction_horizon: keys.Horizon
    """N_p, number of predicted samples."""
    control_horizon: keys.Horizon
    """N_c, number of planned moves; each has one QP variable per input. At most N_p."""
    output_weight: keys.ThreeNotNegative
    """Diagonal of Q: north, east [1/m²], heading [1/rad²]."""
    # Positive move weights keep the QP strictly convex.
    move_weight: keys.ThreePositive | None = None
    """Diagonal of R: surge, sway [1/N²], yaw [1/(N·m)²]. Either this or move_weight_relative."""
    move_weight_relative: keys.ThreePositive | None = None
    """Diagonal of R in multiples of 1/Δu_max², with the maximum increment Δu_max."""
    limits: Literal["box", "attainable"] = "box"
    """Amplitude limits of the force. box: the vessel's; attainable: those of its thrusters."""
    attainable_sides: keys.PolygonSides = 8
    """Sides of the azimuths' polygons in the attainable set; rows grow with the square of this."""
    model_heading_deg: keys.Degrees = 0.0
    """Heading at which the model is linearised [°]."""
    linearisation: Literal["fixed", "each_step"] = "fixed"
    """Linearisation of the model: once, or at each measured heading (each_step), so P changes."""
    amplitude: Literal["reachable", "hard", "soft"] = "reachable"
    """Amplitude limits. reachable: widened to what the rate limit can reach; hard: unchanged, so
    a QP may be infeasible; soft: slacks with an exact penalty."""
    terminal: Literal["none", "riccati"] = "none"
    """Cost beyond the horizon; riccati: that of the unconstrained regulator."""
    outputs: OutputsTable | None = None
    """Soft bounds on predicted position and speed; none by default."""

    @model_validator(mode="after")
    def _require_keys_of_controller_kind(self) -> ControllerTable:
        """Return the table itself; ValueError where keys do not fit the controller's kind."""
        of_forces = (self.move_weight is not None) + (self.move_weight_relative is not None)
        plans_thrusters = self.kind == "thrusters"
        if (self.kind != "forces") != (self.thrusters is not None):
            if self.thrusters is None:
                raise KeysError(f'kind = "{self.kind}" without [controller.thrusters]', "both")
            found = 'kind = "forces" with [controller.thrusters]'
            raise KeysError(found, 'this table with kind = "thrusters" or "cascade"')
        if of_forces != (not plans_thrusters):
            if plans_thrusters:
                name = "move_weight_relative" if self.move_weight is None else "move_weight"
                raise KeysError(
                    f'{name} with kind = "thrusters"',
                    "move_weight_relative in [controller.thrusters]",
                )
            both = "both move_weight and" if of_forces else "neither move_weight nor"
            raise KeysError(f"{both} move_weight_relative", "one of the two")
        if plans_thrusters and self.limits != "box":
            allowed = '"box" with kind = "thrusters", as thrusters have limits of their own'
            raise KeysError(f'"{self.limits}"', allowed, "limits")
        if plans_thrusters and self.terminal != "none":
            raise KeysError(f'"{self.terminal}"', '"none" with kind = "thrusters"', "terminal")
        if self.thrusters is not None:
            self._refuse_unfit_allocation_keys(self.thrusters)
        return self

    def _refuse_unfit_allocation_keys(self, table: ThrusterControlTable) -> None:
        """Raise ValueError for allocation keys that do not fit the controller's kind."""
        if self.kind == "thrusters":
            for key in ("slack_weight_relative", "allocation"):
                if getattr(table, key) is not None:
                    found = f'{key} with kind = "thrusters"'
                    raise KeysError(found, f'{key} with kind = "cascade" only', "thrusters")
        elif table.slack_weight_relative is None or table.thrust_weight_relative == 0.0:
            lacks_slack = table.slack_weight_relative is None
            found = "no slack_weight_relative" if lacks_slack else "thrust_weight_relative = 0"
            allowed = "slack_weight_relative, and a thrust_weight_relative above 0,"
            raise KeysError(found, f'{allowed} with kind = "cascade"', "thrusters")
        elif table.azimuth_turning:
            found = 'azimuth_turning = true with kind = "cascade"'
            raise KeysError(found, 'azimuth_turning with kind = "thrusters" only', "thrusters")

    @field_validator("control_horizon")
    @classmethod
    def _require_valid_control_horizon(cls, N_c: int, info: ValidationInfo) -> int:
        """Return the control horizon; ValueError where it exceeds the prediction horizon."""
        N_p = info.data.get("prediction_horizon", N_c)
        if N_c > N_p:
            raise ValueError(f"1 to prediction_horizon ({N_p})")
        return N_c


class PoseTable(FileModel):
    """Position (north, east) and heading."""

    north_m: keys.Number = 0.0
    """North [m]."""
    east_m: keys.Number = 0.0
    """East [m]."""
    heading_deg: keys.Degrees = 0.0
    """Heading, clockwise from north [°]."""

    def to_pose_vector(self) -> Vector:
        """Return north, east and heading as the vector [n, e, ψ] in m, m, rad."""
        return np.array([self.north_m, self.east_m, np.radians(self.heading_deg)])


class StartTable(PoseTable):
    """Position and heading of the ship at the first sample, and its velocity over ground."""

    later_keys: ClassVar[frozenset[str]] = frozenset({"surge_mps", "sway_mps", "yaw_degps"})

    surge_mps: keys.Speed = 0.0
    """Speed ahead over ground [m/s]."""
    sway_mps: keys.Speed = 0.0
    """Speed to starboard over ground [m/s]."""
    yaw_degps: keys.TurnRate = 0.0
    """Rate of turn to starboard [°/s]."""

    def to_velocity_vector(self) -> Vector:
        """Return the velocity over ground [u, v, r] along the ship's axes, in m/s, m/s, rad/s."""
        return np.array([self.surge_mps, self.sway_mps, np.radians(self.yaw_degps)])


class FilterTable(FileModel):
    """Third-order reference filter, at rest at the start of the run."""

    period_s: keys.Positive
    """Natural period of the filter [s]."""
    damping: keys.Positive = 1.0
    """Relative damping of the filter."""


class ReferenceTable(PoseTable):
    """Setpoint of position and heading, with optional filter and preview."""

    filter: FilterTable | None = None
    """Filter of the setpoint; none by default."""
    preview: bool = False
    """Give the controller the reference of the coming samples."""

    def build_reference_filter_if_any(self, scale: Froude) -> ReferenceFilter | None:
        """Return the reference filter in SI units; None where the reference is not filtered."""
        if self.filter is None:
            return None
        # To read a file takes none of the compiled modules.
        from dpbench.mpc.reference import ReferenceFilter

        return ReferenceFilter(
            self.filter.period_s * scale.time_and_speed_factor, self.filter.damping
        )


class ScenarioFile(FileModel):
    """Contents of a scenario file, `problems/scenarios/*.toml`."""

    title: str
    """Short description of the scenario."""
    shows: str
    """Purpose of the scenario."""
    vessel: Annotated[
        str,
        Field(
            json_schema_extra={"allowed": "the name of a vessel or the path of a .toml file"},
        ),
    ]
    """Name of a vessel, or a TOML file, sought first in the folder of this file."""
    sample_s: keys.Seconds
    """Sample time: time between two control updates [s]."""
    duration_s: keys.Seconds
    """Length of the run [s]."""
    controller: ControllerTable
    """Horizons, weights and limits of the controller."""
    environment: EnvironmentTable
    """The weather; an empty table is calm water."""
    start: StartTable = StartTable()
    """Pose and velocity at the first sample; at rest at the origin by default."""
    reference: ReferenceTable = ReferenceTable()
    """Setpoint of the ship over time; the origin by default."""
    estimator: EstimatorTable = EstimatorTable()
    """Estimator between sensors and controller; none by default."""
    plant: PlantTable = PlantTable()
    """Differences of the simulated ship from the model; none by default."""
    faults: list[FaultTable] = []
    """Losses of thrust during the run; none by default."""

    @property
    def steps(self) -> int:
        """Number of samples of the run, from its duration and sample time."""
        return round(self.duration_s / self.sample_s)
