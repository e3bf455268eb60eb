"""Stability of controllers in ships, and the largest sway offset each one recovers from.

A design is the controller of one scenario in one vessel. Without limits its loop is stable where
the roots of paper eq. 35 are inside the unit circle. With limits the ship starts at rest at a sway
offset to each side, steered by the certified optimum of every step; an offset is held when the ship
stays near the reference over the end of a long run.
"""

import hashlib
import json
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from pydantic import ConfigDict

from dpbench.bench.engines.dispatcher import Dispatcher
from dpbench.bench.plan.suite import DesignTable
from dpbench.bench.progress import Progress
from dpbench.bench.record.cell import HARNESS_VERSION, Outcome
from dpbench.bench.record.result_folder import check_document_as_type, read_json, write_json
from dpbench.bench.run.exact_loop import solve_loop_exactly
from dpbench.bench.workers.worker import disable_gc_and_warnings, pin_to_core, write_outcome
from dpbench.errors import CertificateError, InputError, RenamedWarning, ResultsError
from dpbench.scenario.problem_files import ScenarioDocuments, find_problem_path
from dpbench.scenario.scenario import Scenario, build_scenario_from_documents, load_scenario
from dpbench.scenario.stability import compute_loop_eigenvalues
from dpbench.ship.characteristics import has_mirror_symmetry
from dpbench.ship.froude import Froude
from dpbench.ship.layout import AXES, HEADING, NORTH, YAW

DESIGN_FILE = "design.json"
DESIGN_SCHEMA = 2
WEATHER = "calm"
"""The scenario whose weather the ship is held in."""
STILL = "still water"

# All at full size; a model ship is given what Froude's law makes of them.
OFFSETS_M = tuple(0.25 * 2.0**i for i in range(9))
"""Offsets that are tried, 0.25 m to 64 m, up to the first that is not held."""
WIDTH = 0.05
"""Width of the bracket around the largest offset held, relative to its upper end."""
DURATION_S = 600.0
"""Length of a trial [s]. The slowest return seen, from 64 m, takes more than four minutes."""
TAIL_S = 60.0
"""The end of a trial over which the ship has to stay where it belongs."""
TOLERANCE_M = 0.1
"""Largest distance from the setpoint in the tail of a trial [m]: more than five times what the
weather of `calm` moves the ship about."""

LIMIT_S = 600.0
"""Time limit of a design [s]; it takes some six seconds on a machine of today."""
WORK = 20_000
"""A design for the progress bar, in steps: about as long as so many steps of a solver."""


Holds = Callable[[Scenario, float, Sequence[float]], bool]


@dataclass(frozen=True)
class Bracket:
    """Sway offsets [m, full size] between which a controller stops recovering the ship.

    `holds_m` is 0 when the smallest is not held, `fails_m` None when all of them are.
    """

    holds_m: float
    fails_m: float | None


@dataclass(frozen=True)
class DesignRecord:
    """Closed-loop eigenvalues and held sway offsets of one controller in one vessel.

    `eigenvalues` are real and imaginary parts without limits, by falling modulus; `held` has the
    bracket of each weather.
    """

    vessel: str
    controller: str
    tuning: str
    N_p: int
    N_c: int
    eigenvalues: tuple[tuple[float, float], ...]
    held: dict[str, Bracket]

    @property
    def spectral_radius(self) -> float:
        """Largest eigenvalue modulus; below 1 the loop is stable without active limits."""
        return float(np.hypot(*self.eigenvalues[0]))


@dataclass(frozen=True)
class UnanalysedStability:
    """Controller and vessel whose closed-loop stability could not be analysed, and the reason."""

    vessel: str
    controller: str
    reason: str


@dataclass(frozen=True)
class Designs:
    """Content of `design.json`: stability of each controller and vessel, and what is missing."""

    # A key too many or a number that is none is damage.
    __pydantic_config__ = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    records: tuple[DesignRecord, ...]
    missing: tuple[UnanalysedStability, ...] = ()
    schema: int = DESIGN_SCHEMA


@dataclass(frozen=True, eq=False)
class Design:
    """A controller and a vessel to study for stability, as scenario documents in calm weather."""

    controller: str
    files: ScenarioDocuments

    @property
    def vessel(self) -> str:
        """Name of the vessel that the controller is tried on."""
        return str(self.files["vessel_name"])

    @property
    def text(self) -> str:
        """JSON text of controller and vessel, which identifies their stored stability record."""
        return json.dumps(vars(self), sort_keys=True, ensure_ascii=False)


def pair_controllers_with_vessels(table: DesignTable, beside: Path | None = None) -> list[Design]:
    """Return each controller of a suite table with each vessel, as pairs; InputError if bad."""
    controllers = [load_scenario(name, beside=beside) for name in table.controllers]
    vessels = [find_problem_path("vessels", name, beside) for name in table.vessels]
    given = {"controllers": [c.name for c in controllers], "vessels": [v.stem for v in vessels]}
    for key, names in given.items():
        for name in names:
            if names.count(name) > 1:
                allowed = "files of different names, each once"
                raise InputError("suite", f"design.{key}", f"{name!r} twice", allowed)
    return [
        Design(controller.name, _make_trial_documents(controller, vessel))
        for controller in controllers
        for vessel in vessels
    ]


def _make_trial_documents(controller: Scenario, vessel: Path) -> ScenarioDocuments:
    """Return scenario documents with this controller, this vessel and the weather of `calm`."""
    own = controller.files["scenario"]
    files = load_scenario(f"{WEATHER}@{vessel.resolve()}").files
    trial = files["scenario"] | {
        "sample_s": own["sample_s"],
        "duration_s": DURATION_S,
        "controller": own["controller"],
    }
    # Said here, before anything runs: what the two cannot make together.
    design: ScenarioDocuments = {**files, "scenario": trial}
    build_scenario_from_documents(design, where=f"suite: design: {controller.name}")
    return design


SIDES = (1.0, -1.0)


def can_recover_from_offset(
    scenario: Scenario, offset_m: float, sides: Sequence[float] = SIDES
) -> bool:
    """Return whether the ship recovers from a sway offset [m, full size] on every side.

    A step without a certified optimum counts as not held.
    """
    scale = Froude(float(scenario.files["vessel"]["model_scale"]))
    tail = round(TAIL_S * scale.time_and_speed_factor / scenario.sample_s)
    for sign in sides:
        start = np.array([0.0, sign * offset_m * scale.length_factor, 0.0])
        try:
            exact = solve_loop_exactly(replace(scenario, start=start, velocity=np.zeros(AXES)))
            exact.require_certificates(scenario.name)
        except CertificateError:
            return False
        state = exact.state
        away = np.hypot(*(state[-tail - 1 :, NORTH:HEADING] - scenario.reference[:YAW]).T)
        # NaN stays outside.
        if not (away <= TOLERANCE_M * scale.length_factor).all():
            return False
    return True


def find_bracket_of_recovery(holds: Callable[[float], bool]) -> Bracket:
    """Return between which sway offsets recovery stops: double until it fails, then bisect."""
    held = 0.0
    for offset in OFFSETS_M:
        if not holds(offset):
            break
        held = offset
    else:
        return Bracket(held, None)
    fails = offset
    while 0.0 < held < (1.0 - WIDTH) * fails:
        middle = 0.5 * (held + fails)
        if holds(middle):
            held = middle
        else:
            fails = middle
    return Bracket(held, fails)


def study_stability(design: Design) -> DesignRecord:
    """Return a controller's closed-loop eigenvalues and the sway offsets it recovers from."""
    scenario, documents = build_scenario_from_documents(design.files), design.files["scenario"]
    still = build_scenario_from_documents(
        design.files | {"scenario": documents | {"environment": {}}}
    )
    held = {
        STILL: find_bracket_of_recovery(partial(can_recover_from_offset, still)),
        WEATHER: find_bracket_of_recovery(partial(can_recover_from_offset, scenario)),
    }
    return replace(compute_linear_record(scenario), controller=design.controller, held=held)


def compute_linear_record(scenario: Scenario) -> DesignRecord:
    """Return a controller's closed-loop eigenvalues without active limits; simulate nothing."""
    problem = scenario.problem
    return DesignRecord(
        vessel=scenario.vessel.id,
        controller=scenario.name,
        tuning=scenario.controller.tuning,
        N_p=problem.N_p,
        N_c=problem.N_c,
        eigenvalues=tuple(
            (float(root.real), float(root.imag)) for root in compute_loop_eigenvalues(scenario)
        ),
        held={},
    )


def find_bracket_in_still_water(
    scenario: Scenario, holds: Holds = can_recover_from_offset
) -> Bracket:
    """Return the offsets up to which a controller recovers in still water, by trials of `holds`."""
    own = scenario.files["scenario"]
    kept = ("title", "shows", "vessel", "sample_s", "controller")
    trial = {key: own[key] for key in kept} | {"duration_s": DURATION_S, "environment": {}}
    # The lag of thrusters is theirs in still water too; an FMU has a weather of its own.
    trial["plant"] = {key: value for key, value in own["plant"].items() if key != "fmu"}
    still = build_scenario_from_documents(scenario.files | {"scenario": trial})
    # In still water port mirrors starboard, where ship and model do.
    mirrored = has_mirror_symmetry(still.vessel) and still.controller.psi0_rad == 0.0
    sides = SIDES[:1] if mirrored else SIDES
    return find_bracket_of_recovery(lambda offset_m: holds(still, offset_m, sides))


def run_stability_study_in_process(
    text: str, folder: Path, name: str, core: int, path: Path
) -> None:
    """Study a controller's stability as a process's main function; write the record to `path`."""
    pin_to_core(core)
    disable_gc_and_warnings()
    write_json(path, asdict(Designs((study_stability(Design(**json.loads(text))),))))
    write_outcome(folder / f"{name}.json", Outcome("finished", ""))


class DesignStudy:
    """Stability studies of a suite's controllers and vessels; records are stored in `cells`.

    `lost` has the cause of each design that an accident of the benchmark cost.
    """

    def __init__(
        self, designs: Sequence[Design], cells: Path, machine_id: str, *, fresh: bool = False
    ) -> None:
        made_by = [OFFSETS_M, WIDTH, DURATION_S, TAIL_S, TOLERANCE_M]
        made_by += [HARNESS_VERSION, DESIGN_SCHEMA, machine_id]
        self._designs: dict[Path, Design] = {}
        for design in designs:
            key = hashlib.sha256((design.text + json.dumps(made_by)).encode()).hexdigest()[:16]
            self._designs[cells / f"design-{key}.json"] = design
        self._reasons: dict[Path, str] = {}
        self.lost: list[str] = []
        self._pending = [
            path for path in self._designs if fresh or _read_stored_record(path) is None
        ]

    def __len__(self) -> int:
        return len(self._designs)

    @property
    def work(self) -> int:
        """Remaining work of stability studies, in equivalent solver steps, for the progress bar."""
        return WORK * len(self._pending)

    def run(self, dispatcher: Dispatcher, progress: Progress) -> None:
        """Make and store missing records of controllers' stability, each in a process."""
        for path in self._pending:
            # One that is looked into again must not leave its old record behind if it fails.
            path.unlink(missing_ok=True)
        texts = {path: self._designs[path].text for path in self._pending}
        for path, outcome in dispatcher.yield_made_files(
            run_stability_study_in_process, texts, limit_s=LIMIT_S
        ):
            design, self._reasons[path] = self._designs[path], outcome.detail
            if outcome.outcome == "lost":
                self.lost.append(outcome.detail)
            progress.advance(WORK, f"design {design.controller} {design.vessel}")

    def write(self, out: Path) -> None:
        """Write all stability records to `design.json` in a result folder; remove it if none."""
        if not self._designs:
            (out / DESIGN_FILE).unlink(missing_ok=True)
            return
        records = {path: _read_stored_record(path) for path in self._designs}
        gone = "its record is gone"
        missing = [
            UnanalysedStability(design.vessel, design.controller, self._reasons.get(path, gone))
            for path, design in self._designs.items()
            if records[path] is None
        ]
        finished = tuple(record for record in records.values() if record is not None)
        write_json(out / DESIGN_FILE, asdict(Designs(finished, tuple(missing))))


def _read_stored_record(path: Path) -> DesignRecord | None:
    """Return a controller's stored stability record; None where it is missing or damaged."""
    try:
        (record,) = _read_stability_file(path).records
    except (ResultsError, ValueError):
        return None
    return record


def load_stability_records(folder: Path) -> Designs | None:
    """Return the stability records in `design.json`; None without it; ResultsError if damaged."""
    path = folder / DESIGN_FILE
    if not path.exists():
        return None
    schema = read_json(path).get("schema")
    if schema == DESIGN_SCHEMA - 1:
        older = f"{path}: designs of schema {schema} are not shown; run the suite again"
        warnings.warn(older, RenamedWarning, stacklevel=2)
        return None
    return _read_stability_file(path)


def _read_stability_file(path: Path) -> Designs:
    """Return the stability records in a JSON file; ResultsError if damaged or of another schema."""
    document = read_json(path)
    if document.get("schema") != DESIGN_SCHEMA:
        schema = f"schema {document.get('schema')}"
        raise ResultsError(
            str(path), "schema", schema, f"schema {DESIGN_SCHEMA}; run the suite again"
        )
    return check_document_as_type(document, Designs, path)
