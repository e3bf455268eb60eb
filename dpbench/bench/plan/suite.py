"""Suites: which cells a campaign runs, and the requirements its report judges them by."""

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated, ClassVar, Literal, get_args

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, WithJsonSchema

from dpbench.bench.plan.study_points import RouteName, RunsTable, StudyTable
from dpbench.bench.record.cell import DEFAULT_FALLBACK, SLOWEST, Units
from dpbench.bench.run.backup import FALLBACKS
from dpbench.embedded.toolchain import TARGETS
from dpbench.errors import InputError, SituationError
from dpbench.qp.random_sequence import RandomRecipe
from dpbench.scenario.problem_files import (
    FileModel,
    find_problem_path,
    read_toml_as_dict,
    validate_settings_as_model,
)
from dpbench.scenario.tables.key_types import (
    Horizons,
    parse_horizons,
    require_distinct_horizon_texts,
)
from dpbench.ship.capability.loads import DYNAMIC_FACTOR
from dpbench.solvers.contract import LEVELS, Options, Policy, Route

Count = Annotated[int, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Size = Annotated[list[Count], Field(min_length=2, max_length=2)]
Option = bool | int | float | str


def _require_table_of_solver(value: object) -> object:
    """Return the options of a solver unchanged; ValueError for an option without its solver."""
    if not isinstance(value, dict):
        raise ValueError("route, policy, or the table of a solver, such as osqp = { rho = 1.6 }")
    return value


OptionsTable = Annotated[
    dict[str, Option | list[Option] | dict[str, Option | list[Option]]],
    Field(min_length=1),
    BeforeValidator(_require_table_of_solver),
]
"""Options of one solver; those of a group in a table of its own."""
FormulationName = Literal["condensed_box", "condensed_stacked", "sparse"]


def _require_slowdown_0_or_from_1(value: float) -> float:
    """Return a computer slowdown unchanged; ValueError outside 0 and 1 to `SLOWEST`."""
    if value != 0.0 and not 1.0 <= value <= SLOWEST:
        raise ValueError(f"0 (off), or 1 to {SLOWEST:g}")
    return value


def _require_name_among(known: Collection[str], name: str) -> str:
    """Return a name unchanged; ValueError, with the known names, for an unknown one."""
    if name not in known:
        raise ValueError(", ".join(map(repr, known)))
    return name


TargetName = Annotated[
    str,
    AfterValidator(partial(_require_name_among, TARGETS)),
    WithJsonSchema({"enum": list(TARGETS)}),
]
Fallback = Annotated[
    str,
    AfterValidator(partial(_require_name_among, FALLBACKS)),
    WithJsonSchema({"enum": list(FALLBACKS)}),
]
Slowdown = Annotated[float, AfterValidator(_require_slowdown_0_or_from_1)]


SHORTEST_S, LONGEST_S = 1e-4, 1e6
"""Samples [s] of a sequence that are taken for its deadline."""
P99_SHARE = 0.01
"""Share of the deadline that the p99 of a step may take, where nothing else is said."""


class RequirementsTable(FileModel):
    """Requirements of a controller on a solver: errors, failed steps, step time, deadline."""

    error_move: Positive = 1e-2
    """Largest error of the first move on any step, in maximum increments."""
    failed_steps: Count = 0
    """Largest number of failed steps of a run."""
    p99_ms: Positive = 3.0
    """Largest p99 of the algorithmic step time [ms]."""
    deadline_ms: NotNegative = 300.0
    """The deadline of a step [ms]; 0: none is known, and no step time is judged."""


class ScenarioRunsTable(RunsTable):
    """Call options of closed loops and replays: solvers, units, form of the QP, time limit."""

    solvers: list[str] = []
    """Solvers of the suite that take part; empty: all."""
    without: list[str] = []
    """Solvers of the suite that do not take part."""
    units: list[Units] = ["scaled"]
    """Units of the QP that a solver gets."""
    formulations: list[FormulationName] = ["condensed_box"]
    """Formulations of the QP that a solver gets."""
    limit_s: Positive | None = None
    """Run time after which a cell of this table stops [s]; by default cell_limit_s."""


class ClosedLoopTable(ScenarioRunsTable):
    """Closed loops of a suite: every solver controls the ship of each scenario by itself."""

    scenarios: list[str]
    """Scenarios by name, scenario@vessel, or TOML files in the suite's folder."""
    vessels: list[str] = []
    """Run every scenario with each of these vessels instead of its own."""
    fallback: Fallback = DEFAULT_FALLBACK
    """Action in a step without a usable solution."""
    backup: str = ""
    """Second solver, called before the fallback if a step has no usable solution in time."""
    slowdowns: Annotated[list[Slowdown], Field(min_length=1)] = [0.0]
    """Slowdown factors of the ship's computer, 1 to 1e9; 0: the ship waits for every solution."""
    deadline_s: NotNegative = 0.0
    """Longest time that a step may take on that computer [s]; 0: the sample time."""
    steps: Count = 0
    """Number of steps from the first on; 0: all."""

    @property
    def scenario_list(self) -> list[str]:
        """Names of the scenarios to run, each with each vessel."""
        if not self.vessels:
            return self.scenarios
        return [f"{scenario}@{vessel}" for scenario in self.scenarios for vessel in self.vessels]


class ReplayTable(ScenarioRunsTable):
    """Replays of a suite: every solver solves the QPs of one reference loop.

    Consequence analysis has a sequence for each failure group of the ship, which tells whether the
    other thrusters could take over at each sample. The hardest step has most active limits and
    changes of them at the optimum.
    """

    scenario: str
    """The scenario whose reference loop is recorded."""
    consequence: bool = False
    """Consequence analysis along the loop, in place of the controller's own QPs."""
    margin: Annotated[float, Field(ge=1, le=10)] = DYNAMIC_FACTOR
    """Dynamic margin of a consequence analysis: the force to hold is multiplied by it."""
    horizons: Annotated[list[str], AfterValidator(require_distinct_horizon_texts)] = []
    """Pairs such as 30/5, instead of the scenario's own."""
    first: Count = 0
    """The first step that is replayed."""
    steps: Count = 0
    """Number of steps that are replayed; 0: all."""
    hardest: Count = 0
    """Number of steps around the hardest one, if only these are replayed; 0: all."""

    @property
    def horizon_pairs(self) -> list[Horizons | None]:
        """Pairs of MPC horizons (N_p, N_c) to replay under; None for the controller's own."""
        return [parse_horizons(text) for text in self.horizons] or [None]


class RandomTable(RunsTable):
    """Random QPs of a suite with known optima, for each family, size and seed.

    A size is [n, m]. Such QPs have no units but their own.
    """

    units: ClassVar[list[Units]] = ["scaled"]
    formulations: ClassVar[list[FormulationName]] = ["condensed_box"]
    families: Annotated[list[str], Field(min_length=1)]
    """Families of random problems: plain (every active limit has a multiplier), degenerate (more
    active limits than variables, duplicate rows), weakly_active (limits active with a zero
    multiplier, or missed by 1.5e-8), equal (some rows with l = u), free (some rows without a limit,
    or with only one), infinite_bounds (half of the bounds infinite, rows with one limit), no_rows
    (bounds alone), semidefinite (P rank deficient, unique optimum), ill_conditioned (condition
    number of P 1e8), infeasible_steps (every third step infeasible)."""
    sizes: Annotated[list[Size], Field(min_length=1)]
    """Pairs of variables and rows."""
    seeds: list[Count] = [1]
    """Seeds; each gives one sequence."""
    steps: Annotated[int, Field(ge=1)] = 24
    """Length of each sequence."""
    block: Count = 0
    """Variables per move by which a warm start is shifted; 0: it is not shifted."""
    cond: NotNegative = 0.0
    """Condition number of P, 1 to 1e8; 0: that of the family."""

    def list_random_recipes(self) -> list[RandomRecipe]:
        """Return family, size and seed of all random sequences of QPs; InputError if impossible."""
        return [
            RandomRecipe(family, n, m, seed, self.steps, self.block, self.cond)
            for family in self.families
            for n, m in self.sizes
            for seed in self.seeds
        ]


class RecordedTable(RunsTable):
    """Recorded QPs of a suite: a stored sequence by name, a file, or a folder.

    A relative path starts at the suite's folder. Such QPs have no units but their own.
    """

    units: ClassVar[list[Units]] = ["scaled"]
    sequence: str
    """A stored sequence by name, or a file or folder of QPs (.npz, .json, .mat)."""
    formulations: list[FormulationName] = ["condensed_box"]
    """Formulations of the QP that a solver gets."""


class CapabilityTable(RunsTable):
    """A DP capability plot (DNV-ST-0111, level 1), and its QPs, solved by every solver.

    It is the largest wind the thrusters hold from 36 directions, intact and after each failure. Its
    QPs have no units but their own, and no deadline: each is solved in one round.
    """

    units: ClassVar[list[Units]] = ["scaled"]
    formulations: ClassVar[list[FormulationName]] = ["condensed_box"]
    vessel: str
    """A vessel with `[[thrusters]]` and `[capability]`, or its TOML file in the suite's folder."""
    sides: Annotated[
        int,
        Field(ge=4, multiple_of=2, json_schema_extra={"allowed": "an even number, 4 or more"}),
    ] = 16
    """Sides of the polygons in place of circles."""


class DesignTable(FileModel):
    """Stability and region of attraction of controllers in vessels, without any solver."""

    controllers: Annotated[list[str], Field(min_length=1)]
    """Scenarios whose controllers are studied."""
    vessels: Annotated[list[str], Field(min_length=1)]
    """Vessels with which they are studied."""


class EmbeddedTable(FileModel):
    """Instruction counts of solvers' C code on emulated cores (extra `embedded`).

    Instructions, memory and error of each step. What cannot be counted is named in the report and
    does not end the run.
    """

    sequences: Annotated[list[str], Field(min_length=1)]
    """Parts of reference loops, SCENARIO:FIRST:STEPS, such as paper:0:200."""
    targets: Annotated[list[TargetName], Field(min_length=1)] = ["m7"]
    """Cores: m7, a53, riscv, x86."""
    solvers: list[str] = []
    """Solvers to count; empty: all with a build recipe."""
    precision: Literal["double", "float"] = "double"
    """Precision of the C code."""


class ReportTable(FileModel):
    """Settings of a suite's report: the solver to compare with, and the step it shows first."""

    baseline: str | None = None
    """The solver to compare the recommendation with; by default a faster one that is not deployable
    or, if there is none, the next fastest deployable one."""
    step: Count | None = None
    """Step that the report shows first."""
    configuration: str | None = None
    """Configuration for which that step was found, as the report names it."""


class SettingsTable(FileModel):
    """Custom settings: each solver's options by its own keys; a list is a grid."""

    later_keys: ClassVar[frozenset[str]] = frozenset({"route", "policy"})
    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, OptionsTable]

    route: Route | None = None
    """Route of these settings; it overrides `routes` of the tables that use them."""
    policy: Policy | None = None
    """Policy of these settings; it overrides `policies` of the tables that use them."""

    @property
    def options_by_solver(self) -> dict[str, Options]:
        """Options of each solver, a list of values for a grid."""
        return dict(self.__pydantic_extra__)


class SuiteFile(FileModel):
    """Content of a suite, a TOML file of solvers and what they run; 0 steps means all steps.

    A replay gets at least `FEWEST_ROUNDS` rounds, whatever its budget (`interleaved.py`).
    """

    reference: ClassVar[str] = "docs/reference/suite.md"
    old_keys: ClassVar[dict[str, str]] = {"contrast": "baseline_law"}
    refused_keys: ClassVar[dict[str, str]] = {"demand": "requirements"}

    title: str
    """Short description of the suite."""
    duration: str = ""
    """Usual run time in words, such as "two minutes"."""
    solvers: Annotated[list[str], Field(min_length=1)] = ["all"]
    """Solvers that run; all: every installed solver."""
    superseded: bool = True
    """Include solvers that another solver supersedes in `all`."""
    baseline_law: bool = True
    """Closed loops with the clipped unconstrained law as a baseline."""
    calibration: bool = False
    """Also replay calibration configurations, which solve nothing."""
    cell_limit_s: Positive = 5.0
    """Run time, without waits for its core, after which a cell stops [s]."""
    cell_memory_gb: NotNegative = 0.0
    """Memory limit of a cell's process [GB]; 0: 40 % of the memory of the machine."""
    replay_budget_s: NotNegative = 0.0
    """Run time after which a replay gets no further round [s]; 0: no limit."""
    repeat_budget_s: NotNegative = 0.25
    """Run time for repeating rounds of a replay that other load slowed [s]; 0: no repeats."""
    rounds: Annotated[int, Field(ge=1)] = 5
    """Rounds of a replay that count."""
    warmup_steps: Count = 50
    """Steps of the warm-up round, which does not count."""
    requirements: RequirementsTable = RequirementsTable()
    """Requirements on a solver."""
    report: ReportTable = ReportTable()
    """First view of the report."""
    settings: dict[str, SettingsTable] = {}
    """Custom settings by name: options of each solver, and a call mode."""
    design: DesignTable | None = None
    """Stability and region of attraction of the controllers; not studied without this table."""
    embedded: EmbeddedTable | None = None
    """Cost of solvers' C code on embedded cores; not counted without this table."""
    closed_loop: list[ClosedLoopTable] = []
    """Every solver controls a ship of its own."""
    study: list[StudyTable] = []
    """Studies: one scenario at many points of its keys, in many realisations."""
    replay: list[ReplayTable] = []
    """Every solver solves identical QPs; only these times are ranked."""
    recorded: list[RecordedTable] = []
    """Every solver solves recorded QPs."""
    random: list[RandomTable] = []
    """Every solver solves random QPs with a known optimum."""
    capability: list[CapabilityTable] = []
    """Capability plots, and the QPs at their edge, solved by every solver."""

    @classmethod
    def list_names_of_run_tables(cls) -> list[str]:
        """Return the names of the suite's tables that become runs."""
        return [name for name, field in cls.model_fields.items() if field.default == []]

    @property
    def scenario_names(self) -> list[str]:
        """Names of all scenarios in the suite's loops and replays, once each."""
        known = [name for table in self.closed_loop for name in table.scenario_list]
        return list(dict.fromkeys([*known, *(table.scenario for table in self.replay)]))


@contextmanager
def name_file_in_errors(
    path: Path, *, chosen: bool = False, scenarios: Collection[str] | None = None
) -> Iterator[None]:
    """Replace "the suite" by its path in input errors raised within the block.

    Settings that were `chosen` by an argument, and its `scenarios`, are not the file's.
    """
    places = {
        "suite": str(path),
        "scenario name": f"{path}: scenario name",
        "settings": "`settings`" if chosen else f"{path}: settings",
    }
    try:
        yield
    except InputError as error:
        place, colon, key = error.where.partition(":")
        if place not in places:
            raise
        given = {repr(name) for name in scenarios or ()}
        if place == "scenario name" and given & {str(error.found), error.key}:
            raise type(error)("`scenarios`", error.key, error.found, error.allowed) from None
        where = f"{places[place]}{colon}{key}"
        if isinstance(error, SituationError):
            raise type(error)(where, str(error.found)) from None
        raise type(error)(where, error.key, error.found, error.allowed) from None


_OTHER_FILES = {
    "limits": "vessel",
    "thrusters": "vessel",
    "environment": "scenario",
    "controller": "scenario",
}
"""Tables that a suite does not have, with the file that does."""


def load_path_and_suite(name_or_path: str | Path) -> tuple[Path, SuiteFile]:
    """Return path and content of a suite, by name or TOML path; InputError if it is bad."""
    path = find_problem_path("suites", name_or_path)
    document = read_toml_as_dict(path)
    kind = next((kind for key, kind in _OTHER_FILES.items() if key in document), None)
    if kind is not None:
        name = "FILE" if kind == "scenario" else "SCENARIO@FILE"
        remedy = f'for this {kind}, use `run_campaign(SUITE, scenarios=["{name}"])`'
        raise SituationError(str(path), f"found a {kind}; required: a suite; {remedy}")
    return path, validate_settings_as_model(document, SuiteFile, str(path))


_MODE_VALUES: dict[str, Collection[str]] = {
    "route": get_args(RouteName),
    "policy": get_args(Policy),
    "settings": LEVELS,
}
_TABLE_KEY = {"route": "routes", "policy": "policies", "settings": "settings"}


def build_sequence_suite(path: str | Path, meta: Mapping[str, object] | None = None) -> SuiteFile:
    """Build a suite that replays one sequence of QPs through every solver.

    A found worst case, as in `meta` of the sequence, is also replayed in the mode of its solver:
    another route or policy has other iterations, or none. The deadline is the sample in `meta`;
    without one no step time is judged.
    """
    calls: list[dict[str, list[str]]] = [{"settings": ["default", "high"]}]
    meta = meta or {}
    worst_case = {key: meta.get(f"worst_case_{key}") for key in _MODE_VALUES}
    # A file may say anything, and not every solver has the settings one of them has.
    if all(
        name in known
        for name, known in zip(worst_case.values(), _MODE_VALUES.values(), strict=True)
    ):
        calls.append({_TABLE_KEY[key]: [str(name)] for key, name in worst_case.items()})
    tables = [RecordedTable.model_validate({"sequence": str(path)} | call) for call in calls]
    title = f"Recorded sequence {Path(path).name}"
    return SuiteFile(
        title=title,
        baseline_law=False,
        recorded=tables,
        requirements=_make_requirements_of_sample(meta.get("sample_s")),
        report=_make_report_table_of_worst_step(meta),
    )


def _make_requirements_of_sample(sample_s: object) -> RequirementsTable:
    """Return the requirements of QPs that follow each other by a sample [s], if it is known."""
    if not isinstance(sample_s, float) or not SHORTEST_S <= sample_s <= LONGEST_S:
        return RequirementsTable(deadline_ms=0.0)
    deadline_ms = 1e3 * sample_s
    return RequirementsTable(deadline_ms=deadline_ms, p99_ms=P99_SHARE * deadline_ms)


def _make_report_table_of_worst_step(meta: Mapping[str, object]) -> ReportTable:
    """Return report settings that show the worst-case step noted in a sequence of QPs, if any."""
    step, solver = meta.get("worst_case_step"), meta.get("worst_case_solver")
    if not isinstance(step, int) or step < 0 or not isinstance(solver, str):
        return ReportTable()
    call = [str(meta.get(f"worst_case_{key}")) for key in _MODE_VALUES]
    settings = "" if call[2] == "default" else f", {call[2]}"
    return ReportTable(step=step, configuration=f"{solver} ({call[0]} {call[1]}{settings})")
