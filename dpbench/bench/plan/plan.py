"""Expansion of a suite and its studies into cells, before anything runs."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from operator import itemgetter
from pathlib import Path

from dpbench.bench.plan.cells import (
    PlannedCell,
    plan_capability_replays,
    plan_random_replays,
    plan_recorded_replays,
    plan_replay_per_configuration,
    plan_run_of_configuration,
)
from dpbench.bench.plan.configurations import (
    BASELINE_LAW,
    choose_solvers,
    find_backup_and_refusal,
    list_configurations,
)
from dpbench.bench.plan.study_points import (
    MOST_CELLS,
    Point,
    StudyPoint,
    StudyTable,
    list_study_points,
)
from dpbench.bench.plan.suite import ClosedLoopTable, ReplayTable, SuiteFile
from dpbench.bench.record.cell import (
    CONTROLLER,
    ConsequenceSource,
    HardestSource,
    QPSource,
    StudyRealisation,
)
from dpbench.bench.sequences.loop_sequences import select_thruster_rows
from dpbench.errors import InputError, SituationError, format_allowed_names
from dpbench.scenario.dotted_keys import copy_documents_with_values, read_value_of_dotted_key
from dpbench.scenario.problem_files import ScenarioDocuments
from dpbench.scenario.scenario import Scenario, load_scenario
from dpbench.scenario.tables.key_types import Horizons
from dpbench.scenario.variation import (
    SEED,
    copy_scenario_with_values,
    differ_in_behaviour_within_steps,
)
from dpbench.solvers.calibration import CALIBRATION
from dpbench.solvers.own_settings import normalise_options


def plan_suite(
    suite: SuiteFile,
    *,
    solvers: Sequence[str] | None = None,
    scenarios: Sequence[str] | None = None,
    beside: Path | None = None,
) -> list[PlannedCell]:
    """Return all planned runs of a suite in the order they run.

    Paths are relative to `beside`, the folder of the suite. A choice of `scenarios` leaves out all
    that have none. InputError for an unknown scenario or solver, or a scenario that the suite has
    not.
    """
    chosen = choose_solvers(suite, solvers)
    known = suite.scenario_names
    for name in scenarios or ():
        if name not in known:
            allowed = "none, as the suite has no scenario"
            if known:
                allowed = f"a scenario of the suite: {format_allowed_names(name, known)}"
            raise InputError("`scenarios`", "", repr(name), allowed)
    loaded = {name: _load_scenario_of_suite(name, beside) for name in known}
    swept = _load_horizon_variants(suite, loaded)
    stems = _list_unique_names([*loaded.values(), *swept.values()])
    wanted = set(scenarios) if scenarios else set(known)
    cells: list[PlannedCell] = []
    for closed in suite.closed_loop:
        for name in closed.scenario_list:
            if name in wanted:
                cells += _plan_closed_loops(suite, closed, loaded[name], chosen)
    if not scenarios:
        cells += plan_study_loops(suite, chosen, beside)
    for replay in suite.replay:
        for pair in replay.horizon_pairs if replay.scenario in wanted else ():
            name = replay.scenario
            scenario = loaded[name] if pair is None else swept[name, pair]
            cells += _plan_scenario_replays(suite, replay, scenario, chosen)
    if not scenarios:
        cells += plan_recorded_replays(suite, chosen, beside, taken=stems)
    for table in suite.random if not scenarios else ():
        cells += plan_random_replays(suite, table, chosen)
    for plot in suite.capability if not scenarios else ():
        cells += plan_capability_replays(suite, plot, chosen, beside)
    if not cells:
        raise SituationError("suite", _explain_empty_plan(suite, chosen))
    return _merge_equal_cells(_unify_own_settings(cells))


def _load_scenario_of_suite(name: str, beside: Path | None) -> Scenario:
    """Return a scenario that a suite names; InputError, at the suite, for a missing file."""
    try:
        return load_scenario(name, beside=beside)
    except InputError as error:
        if (error.where, error.found) != (name, "no such file"):
            raise
        raise InputError("scenario name", repr(name), "no such file", "a scenario file") from None


def _explain_empty_plan(suite: SuiteFile, solvers: Sequence[str]) -> str:
    """Return why a suite, reduced to the requested runs, has no run."""
    if not any(getattr(suite, key) for key in SuiteFile.list_names_of_run_tables()):
        return "nothing to run; required: a table of runs, such as [[closed_loop]] or [[replay]]"
    if set(solvers) == {BASELINE_LAW}:
        where = "closed loops, with the settings default and the policy fresh"
        return f"nothing to run for {BASELINE_LAW}, as it runs only in {where}"
    return f"no run is left; no table includes these solvers: {', '.join(solvers)}"


def _list_unique_names(scenarios: Sequence[Scenario]) -> list[str]:
    """Return the names of scenarios; InputError where two have the same."""
    stems = [scenario.name for scenario in scenarios]
    for stem in stems:
        if stems.count(stem) > 1:
            allowed = "files with different names, as results are kept by name"
            raise InputError("suite", "scenarios", f"two scenarios called {stem!r}", allowed)
    return stems


def _load_horizon_variants(
    suite: SuiteFile, loaded: dict[str, Scenario]
) -> dict[tuple[str, Horizons], Scenario]:
    """Return each replayed scenario with the other MPC horizons that the suite names."""
    asked = {
        (table.scenario, pair) for table in suite.replay for pair in table.horizon_pairs if pair
    }
    return {(name, pair): loaded[name].with_horizons(*pair) for name, pair in sorted(asked)}


def _unify_own_settings(cells: Sequence[PlannedCell]) -> list[PlannedCell]:
    """Return cells in which equal custom options in one call mode have the first of their names.

    The other names are noted at these cells.
    """
    keyed = [
        (p.cell.solver, p.cell.route, p.cell.policy, normalise_options(p.cell.options))
        for p in cells
    ]
    names: dict[tuple[str, ...], dict[str, str]] = {}
    for key, planned in zip(keyed, cells, strict=True):
        if planned.cell.options:
            names.setdefault(key, {}).setdefault(planned.cell.settings, planned.cell.options)
    unified: list[PlannedCell] = []
    for key, planned in zip(keyed, cells, strict=True):
        alike = names.get(key, {})
        if len(alike) < 2:
            unified.append(planned)
            continue
        (first, options), *others = alike.items()
        cell = replace(planned.cell, settings=first, options=options)
        merged = tuple(name for name, _ in others)
        unified.append(replace(planned, cell=cell, merged_settings=merged))
    return unified


def _merge_equal_cells(cells: Sequence[PlannedCell]) -> list[PlannedCell]:
    """Return each planned run once; equal ones are merged with all names of their settings."""
    once: dict[str, PlannedCell] = {}
    for planned in cells:
        key = planned.cell.key
        known = once.setdefault(key, planned)
        if known is not planned:
            names = dict.fromkeys((*known.alias_settings, *planned.alias_settings))
            once[key] = replace(known, alias_settings=tuple(names))
    return list(once.values())


def _plan_closed_loops(
    suite: SuiteFile, table: ClosedLoopTable, scenario: Scenario, solvers: Sequence[str]
) -> list[PlannedCell]:
    """Return planned closed loops of a scenario, one per solver configuration and slowdown."""
    steps = min(table.steps or scenario.steps, scenario.steps)
    if table.deadline_s > scenario.sample_s:
        where, allowed = f"suite: closed loop of {scenario.name}", f"at most {scenario.sample_s:g}"
        raise InputError(where, "deadline_s", table.deadline_s, f"{allowed}, its sample time")
    backup, missing = find_backup_and_refusal(table.backup)
    # The baseline law does not look at units or settings: it runs where the default configurations
    # do.
    plain = ("scaled", "default", "fresh")
    cells = [
        plan_run_of_configuration(
            configuration,
            suite,
            table,
            why_no_sparse_form=scenario.controller.reason_for_no_sparse_form,
            mode="closed_loop",
            scenario=scenario.files,
            steps=steps,
            fallback=table.fallback,
            backup=backup,
            slowdown=slowdown,
            deadline_s=table.deadline_s,
        )
        for slowdown in table.slowdowns
        for configuration in list_configurations(suite, solvers, table)
        if configuration.solver != BASELINE_LAW
        or (configuration.units, configuration.settings, configuration.policy) == plain
    ]
    why = scenario.controller.why_no_delay
    why = why and f"slowdown: not for {why}"
    cells = [replace(planned, refused=planned.refused or missing) for planned in cells]
    return [
        replace(planned, refused=planned.refused or why) if planned.cell.slowdown else planned
        for planned in cells
    ]


def _plan_scenario_replays(
    suite: SuiteFile, table: ReplayTable, scenario: Scenario, solvers: Sequence[str]
) -> list[PlannedCell]:
    """Return planned replays of a scenario's QPs: of the exact loop, hardest steps, or failures."""
    if table.first >= scenario.steps:
        raise InputError(
            f"suite: replay of {scenario.name}", "first", table.first, f"below {scenario.steps}"
        )
    steps = min(table.steps or scenario.steps, scenario.steps - table.first)
    if table.hardest:
        _refuse_impossible_window(table, scenario)
    if "margin" in table.model_fields_set and not table.consequence:
        where = f"suite: replay of {scenario.name}"
        raise InputError(where, "margin", table.margin, "margin only with consequence = true")
    if table.consequence:
        return _plan_consequence_replays(suite, table, scenario, solvers, steps)
    source: QPSource = CONTROLLER
    if table.hardest:
        # A scenario given in place of the suite's own may have fewer steps.
        of, steps = steps, min(table.hardest, steps)
        source = HardestSource(f"{_name_replay(table, scenario, of)} hardest {steps}", of)
        # The machine is measured in the replays that are long enough for it.
        solvers = [name for name in solvers if name not in CALIBRATION]
    return plan_replay_per_configuration(
        suite,
        table,
        solvers,
        steps,
        why_no_sparse_form=scenario.controller.reason_for_no_sparse_form,
        scenario=scenario.files,
        first=table.first,
        source=source,
    )


def _refuse_impossible_window(table: ReplayTable, scenario: Scenario) -> None:
    """Raise InputError where a suite table has an impossible window."""
    found, allowed = str(table.hardest), ""
    if table.steps and table.hardest > table.steps:
        allowed = f"at most {table.steps}, the number of steps to choose from"
    elif table.consequence:
        allowed = "0 with consequence = true, as hardness is defined only for the controller's QPs"
    elif table.horizons:
        found = f"{found} with horizons"
        allowed = "0, as each pair of horizons has its own hardest steps"
    if allowed:
        where = f"suite: replay of {scenario.name}"
        raise InputError(where, "hardest", found, allowed)


def _name_replay(table: ReplayTable, scenario: Scenario, steps: int) -> str:
    """Return the name of a replayed part of a scenario, with its steps unless from the start."""
    window = "" if table.first == 0 else f"[{table.first}:{table.first + steps}]"
    return f"{scenario.name}{window}"


def _plan_consequence_replays(
    suite: SuiteFile,
    table: ReplayTable,
    scenario: Scenario,
    solvers: Sequence[str],
    steps: int,
) -> list[PlannedCell]:
    """Return planned consequence-analysis replays of each failure group of a scenario's ship."""
    thrusters, _ = select_thruster_rows(scenario)
    if table.units != ["scaled"]:
        where = f"suite: consequence analysis of {scenario.name}"
        raise InputError(where, "units", ", ".join(table.units), "scaled only")
    own = [name for name in solvers if name not in CALIBRATION]
    sequence = _name_replay(table, scenario, steps)
    return [
        cell
        for group in thrusters.indices_by_failure_group
        for cell in plan_replay_per_configuration(
            suite,
            table,
            own,
            steps,
            scenario=scenario.files,
            first=table.first,
            source=ConsequenceSource(f"{sequence}, {group} lost", group, table.margin),
        )
    ]


def plan_study_loops(
    suite: SuiteFile, solvers: Sequence[str], beside: Path | None
) -> list[PlannedCell]:
    """Return planned closed loops of a suite's studies; InputError for a parameter of no effect."""
    cells: list[PlannedCell] = []
    titles = [table.title for table in suite.study]
    for table in suite.study:
        if titles.count(table.title) > 1:
            allowed = "a different name for each study"
            raise InputError("suite", "study.name", f"two studies called {table.title!r}", allowed)
        cells += _plan_loops_of_study(suite, table, f"suite: study {table.title}", solvers, beside)
        if len(cells) > MOST_CELLS:
            raise InputError("suite", "study", f"{len(cells)} runs", f"at most {MOST_CELLS}")
    return cells


def _plan_loops_of_study(
    suite: SuiteFile,
    table: StudyTable,
    where: str,
    solvers: Sequence[str],
    beside: Path | None,
) -> list[PlannedCell]:
    """Return planned closed loops of a study: each parameter point with each configuration.

    The first realisation of all points comes first, so that passing load affects all points.
    """
    base = load_scenario(table.base, beside=beside)
    keys = [*table.keys, *([table.replicates.key] if table.replicates.count > 1 else [])]
    own = {key: read_value_of_dotted_key(base.files, key, where) for key in keys}
    points = list_study_points(table, own)
    scenarios = _ScenarioCache(base, where, beside)
    _refuse_idle_keys(table, points, scenarios)
    blanks = _plan_base_cells(suite, table, base, solvers)
    cells = [
        (point.replicate, _change_cell_to_point(blank, table, point, *documents))
        for point in points
        for documents in (scenarios.documents_and_steps_of_point(point),)
        for blank in blanks
    ]
    return [cell for _, cell in sorted(cells, key=itemgetter(0))]


def _plan_base_cells(
    suite: SuiteFile, table: StudyTable, base: Scenario, solvers: Sequence[str]
) -> list[PlannedCell]:
    """Return a planned run of a study's unchanged scenario for each solver configuration."""
    names = ("solvers", "settings", "routes", "policies", "iteration_limits", "time_limits")
    calls = {name: getattr(table, name) for name in names}
    loops = ClosedLoopTable(scenarios=[table.base], **calls)
    cells = [
        plan_run_of_configuration(
            configuration,
            suite,
            loops,
            mode="closed_loop",
            scenario=base.files,
            steps=1,
        )
        for configuration in list_configurations(suite, solvers, loops)
    ]
    # The baseline law does not look at settings or policies: it runs once, under one name.
    once = ("default", "fresh")
    return [
        replace(blank, alias_settings=()) if blank.cell.solver == BASELINE_LAW else blank
        for blank in cells
        if blank.cell.solver != BASELINE_LAW or (blank.cell.settings, blank.cell.policy) == once
    ]


def _change_cell_to_point(
    blank: PlannedCell, table: StudyTable, point: StudyPoint, files: ScenarioDocuments, steps: int
) -> PlannedCell:
    """Return a planned base run changed to the scenario of one study point."""
    cell = replace(
        blank.cell,
        scenario=files,
        steps=min(table.steps or steps, steps),
        study=StudyRealisation(table.title, point.index, point.replicate, point.values),
    )
    return replace(blank, cell=cell)


class _ScenarioCache:
    """Builder of the scenarios at a study's points, which keeps the latest one."""

    def __init__(self, base: Scenario, where: str, beside: Path | None) -> None:
        self._base, self._where, self._beside = base, where, beside
        self._values: Point = {}
        self._scenario = base
        self._point: tuple[Point, Scenario] | None = None

    def documents_and_steps_of_point(self, point: StudyPoint) -> tuple[ScenarioDocuments, int]:
        """Return the scenario documents of a study point, and the number of steps."""
        same = self._point is not None and self._point[0] == point.values
        if self._point is None or not same or point.of_replicate.keys() - {SEED}:
            self._point = point.values, self.build_scenario(point.values | point.of_replicate)
            return self._point[1].files, self._point[1].steps
        # A scenario in another sea need not be made to know that it can be.
        known = self._point[1]
        return copy_documents_with_values(known.files, point.of_replicate, self._where), known.steps

    def build_scenario(self, values: Point) -> Scenario:
        """Return a study's base scenario with the values of some parameters replaced."""
        if values != self._values:
            self._scenario = copy_scenario_with_values(
                self._base, values, self._where, beside=self._beside
            )
            self._values = values
        return self._scenario

    def build_scenario_or_none(self, values: Point) -> Scenario | None:
        """Return a study's base scenario with some values replaced; None if they are invalid."""
        try:
            return self.build_scenario(values)
        except InputError:
            return None

    def raise_idle_key(self, key: str, steps: int) -> None:
        """Raise InputError, always: a parameter changes nothing in the first `steps` steps."""
        steps = min(steps or self._base.steps, self._base.steps)
        allowed = "a key that the run depends on"
        found = f"a key that changes nothing in {steps} steps of {self._base.name}"
        if key == SEED and not self._base.environment.is_random:
            found = f"a seed, although the weather of {self._base.name} has no random part"
            allowed = (
                "a scenario with [environment.waves] (hs_m, tp_s), with [environment.noise], or "
                "with gusts in [environment.wind]; `dpbench list scenarios` shows the random parts "
                "of each"
            )
        raise InputError(self._where, key, found, allowed)


def _refuse_idle_keys(
    table: StudyTable, points: Sequence[StudyPoint], scenarios: _ScenarioCache
) -> None:
    """Raise InputError for a study parameter whose values make no difference to a run.

    It is tried at the first point and at the last one, as a seed has no effect in a calm sea.
    """
    again = table.replicates
    tried = {key: _pick_two_distinct_values(key, points) for key in table.keys}
    if again.count > 1:
        tried[again.key] = [again.first, again.first + 1]
    ends: list[Mapping[str, object]] = [points[i].values | points[i].of_replicate for i in (0, -1)]
    for key, pair in tried.items():
        if len(pair) < 2:
            continue
        trials = [
            [scenarios.build_scenario_or_none({**end, key: value}) for value in pair]
            for end in ends
        ]
        if not any(_can_scenarios_differ(one, other, table.steps) for one, other in trials):
            scenarios.raise_idle_key(key, table.steps)


def _can_scenarios_differ(one: Scenario | None, other: Scenario | None, steps: int) -> bool:
    """Return whether two scenarios can behave differently; None is an invalid scenario."""
    if one is None or other is None or one.steps != other.steps:
        return True
    return differ_in_behaviour_within_steps(one, other, min(steps or one.steps, one.steps))


def _pick_two_distinct_values(key: str, points: Sequence[StudyPoint]) -> list[object]:
    """Return a parameter's first value in the study points, and the first other one if any."""
    first = points[0].values[key]
    other = next((p.values[key] for p in points if p.values[key] != first), None)
    return [first] if other is None else [first, other]
