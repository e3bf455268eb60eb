"""Planned cells, and those of QPs without a controller: recorded, random, of a capability."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dpbench.bench.capability.edge_qps import POINTS
from dpbench.bench.capability.frontier import DIRECTIONS, CapabilityPlot
from dpbench.bench.plan.configurations import (
    BASELINE_LAW,
    Table,
    find_plugin_file,
    find_reason_to_refuse,
    list_configurations,
)
from dpbench.bench.plan.suite import (
    CapabilityTable,
    RandomTable,
    RecordedTable,
    ReplayTable,
    ScenarioRunsTable,
    SuiteFile,
)
from dpbench.bench.record.cell import (
    CONTROLLER,
    CapabilitySource,
    Cell,
    Configuration,
    QPSource,
    RandomSource,
    RecordedSource,
)
from dpbench.bench.sequences.source import hash_sequence_files, read_sequence
from dpbench.errors import InputError
from dpbench.qp.random_sequence import FAMILIES
from dpbench.qp.referee.kkt import is_proven_positive_definite
from dpbench.scenario.dotted_keys import read_validated_vessel_documents
from dpbench.scenario.problem_files import is_shipped_sequence_name, resolve_sequence_path
from dpbench.scenario.scenario import build_vessel_from_documents
from dpbench.solvers.calibration import CALIBRATION, WAITS_NS
from dpbench.solvers.table import find_solver_record

SEMIDEFINITE_REFUSAL = "P is only semidefinite, and the solver needs P > 0"
WINDOW_WARMUP_STEPS = 5
"""Warm-up steps of a window of the hardest steps: its configuration mostly has replayed another
sequence."""
NO_MODEL = "the sparse formulation needs a model with states, which these QPs do not have"


@dataclass(frozen=True)
class PlannedCell:
    """A planned run of one solver on one problem, or the reason why it is refused.

    `alias_settings` are further names of the same settings, shown as rows of their own;
    `merged_settings` are further names of the same custom options, which get no row.
    """

    cell: Cell
    refused: str = ""
    alias_settings: tuple[str, ...] = ()
    merged_settings: tuple[str, ...] = ()


def plan_run_of_configuration(
    configuration: Configuration,
    suite: SuiteFile,
    table: Table,
    *,
    why_no_sparse_form: str = NO_MODEL,
    **fields: Any,
) -> PlannedCell:
    """Return the planned run of one solver configuration of a suite table, refused or not.

    `why_no_sparse_form` is empty where the QPs have one; `fields` are those of the cell's mode.
    """
    baseline_law = configuration.solver == BASELINE_LAW
    own_limit_s = table.limit_s if isinstance(table, ScenarioRunsTable) else None
    cell = Cell(
        solver=configuration.solver,
        route=configuration.route,
        policy=configuration.policy,
        settings=configuration.settings,
        options=configuration.options,
        formulation="none" if baseline_law else configuration.formulation,
        units=configuration.units,
        limit_s=(own_limit_s or suite.cell_limit_s)
        + _compute_dummy_wait_s(configuration, **fields),
        solver_module=find_plugin_file(configuration.solver),
        memory_gb=suite.cell_memory_gb,
        **fields,
    )
    planned = PlannedCell(cell, find_reason_to_refuse(configuration), configuration.alias)
    if cell.formulation != "sparse":
        return planned
    # States cost nothing along most of their directions, so P is only semidefinite.
    return _mark_refused_if_semidefinite(
        replace(planned, refused=planned.refused or why_no_sparse_form)
    )


def plan_replay_per_configuration(
    suite: SuiteFile,
    table: ReplayTable | RecordedTable | RandomTable | CapabilityTable,
    solvers: Sequence[str],
    steps: int,
    *,
    source: QPSource = CONTROLLER,
    why_no_sparse_form: str = NO_MODEL,
    **fields: Any,
) -> list[PlannedCell]:
    """Return planned replays of `steps` QPs, one for each solver configuration of a suite table.

    Untimed ones, random or of a capability, have no budget. A window of the hardest steps has its
    share of the budgets of its stretch, and a short warm-up.
    """
    share = steps / source.count_stretch_steps(steps)
    if not isinstance(table, RandomTable | CapabilityTable):
        fields |= {
            "budget_s": share * suite.replay_budget_s,
            "repeat_budget_s": share * suite.repeat_budget_s,
        }
    most = suite.warmup_steps if share == 1.0 else min(suite.warmup_steps, WINDOW_WARMUP_STEPS)
    return [
        plan_run_of_configuration(
            configuration,
            suite,
            table,
            why_no_sparse_form=why_no_sparse_form,
            mode="replay",
            source=source,
            steps=steps,
            rounds=suite.rounds,
            warmup_steps=min(most, steps),
            **fields,
        )
        for configuration in list_configurations(suite, solvers, table)
        if configuration.solver != BASELINE_LAW
    ]


def _compute_dummy_wait_s(
    configuration: Configuration, steps: int, rounds: int = 0, **_: Any
) -> float:
    """Return how long a dummy solver of known duration waits on purpose [s]; 0 for real ones."""
    return 2e-9 * WAITS_NS.get(configuration.solver, 0) * steps * (rounds + 1)


def plan_recorded_replays(
    suite: SuiteFile, solvers: Sequence[str], beside: Path | None, taken: Sequence[str]
) -> list[PlannedCell]:
    """Return planned replays of all recorded sequences that a suite in folder `beside` names.

    InputError for a file that is no sequence, or a name that is there twice or `taken`.
    """
    cells: list[PlannedCell] = []
    digests: dict[str, str] = {}
    for table in suite.recorded:
        path = resolve_sequence_path(table.sequence, beside)
        # Another installation has a stored sequence in another folder.
        origin = table.sequence if is_shipped_sequence_name(table.sequence) else str(path)
        sha256, sequence = hash_sequence_files(path), read_sequence(path).sequence
        known = digests.setdefault(sequence.name, sha256)
        if known != sha256 or sequence.name in taken:
            allowed = "different names for all sequences and scenarios, as results are kept by name"
            raise InputError(str(path), "name", f"{sequence.name!r} twice", allowed)
        source = RecordedSource(sequence.name, origin, sha256)
        planned = plan_replay_per_configuration(
            suite, table, solvers, len(sequence), scenario={}, source=source
        )
        matrices = [sequence.base.P] if sequence.P is None else list(sequence.P)
        strict = all(is_proven_positive_definite(P) for P in matrices)
        cells += planned if strict else map(_mark_refused_if_semidefinite, planned)
    return cells


def plan_capability_replays(
    suite: SuiteFile, table: CapabilityTable, solvers: Sequence[str], beside: Path | None
) -> list[PlannedCell]:
    """Return planned runs of a capability plot's QPs; InputError without thrusters or hull."""
    files = read_validated_vessel_documents(table.vessel, beside=beside)
    cases = CapabilityPlot(
        build_vessel_from_documents(files, table.vessel), table.sides
    ).intact_and_failure_cases
    own = [name for name in solvers if name not in CALIBRATION]
    name = f"{files['vessel_name']} capability, {table.sides} sides"
    source = CapabilitySource(name, table.sides, **files)
    steps = POINTS * DIRECTIONS * len(cases)
    cells = plan_replay_per_configuration(suite, table, own, steps, scenario={}, source=source)
    # What a solver claims of a QP does not change from round to round.
    return [replace(planned, cell=replace(planned.cell, rounds=1)) for planned in cells]


def _mark_refused_if_semidefinite(planned: PlannedCell) -> PlannedCell:
    """Return a planned run, marked as refused if its solver needs P > 0 in the QP's cost."""
    needs = find_solver_record(planned.cell.solver).needs_strict_convexity
    return replace(planned, refused=planned.refused or SEMIDEFINITE_REFUSAL) if needs else planned


def plan_random_replays(
    suite: SuiteFile, table: RandomTable, solvers: Sequence[str]
) -> list[PlannedCell]:
    """Return the planned runs that solve the random QPs of a suite table."""
    # What depends on the configuration alone is found out once: a table may make thousands of
    # cells.
    blanks = plan_replay_per_configuration(suite, table, solvers, table.steps, scenario={})
    cells: list[PlannedCell] = []
    for recipe in table.list_random_recipes():
        source = RandomSource(name=recipe.sequence_name, recipe=recipe)
        planned = [replace(blank, cell=replace(blank.cell, source=source)) for blank in blanks]
        semidefinite = FAMILIES[recipe.family].semidefinite
        cells += map(_mark_refused_if_semidefinite, planned) if semidefinite else planned
    return cells
