"""Expansion of a suite into cells, before anything runs."""

from collections.abc import Sequence
from dataclasses import replace
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
from dpbench.bench.plan.study_cells import plan_study_loops
from dpbench.bench.plan.suite import ClosedLoopTable, ReplayTable, SuiteFile
from dpbench.bench.record.cell import CONTROLLER, ConsequenceSource, HardestSource, QPSource
from dpbench.bench.sequences.loop_sequences import select_thruster_rows
from dpbench.bench.sequences.recording import with_horizons
from dpbench.errors import InputError, format_allowed_names
from dpbench.scenario.scenario import Scenario, load_scenario
from dpbench.scenario.tables.key_types import Horizons
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
            allowed = (
                format_allowed_names(name, known) if known else "none, the suite has no scenario"
            )
            raise InputError("`scenarios`", "", repr(name), f"a scenario of the suite: {allowed}")
    loaded = {name: load_scenario(name, beside=beside) for name in known}
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
        allowed = "[[closed_loop]] or another table of runs, with a solver to run"
        raise InputError("suite", "", "nothing to run", allowed)
    return _merge_equal_cells(_unify_own_settings(cells))


def _list_unique_names(scenarios: Sequence[Scenario]) -> list[str]:
    """Return the names of scenarios; InputError where two have the same."""
    stems = [scenario.name for scenario in scenarios]
    for stem in stems:
        if stems.count(stem) > 1:
            allowed = "files of different names, which tell their results apart"
            raise InputError("suite", "scenarios", f"two scenarios called {stem!r}", allowed)
    return stems


def _load_horizon_variants(
    suite: SuiteFile, loaded: dict[str, Scenario]
) -> dict[tuple[str, Horizons], Scenario]:
    """Return each replayed scenario with the other MPC horizons that the suite names."""
    asked = {
        (table.scenario, pair) for table in suite.replay for pair in table.horizon_pairs if pair
    }
    return {(name, pair): with_horizons(loaded[name], *pair) for name, pair in sorted(asked)}


def _unify_own_settings(cells: Sequence[PlannedCell]) -> list[PlannedCell]:
    """Return cells in which equal options of one's own of a solver have the first of their names.

    The other names are noted at the first of these cells.
    """
    keyed = [(p.cell.solver, normalise_options(p.cell.options)) for p in cells]
    names: dict[tuple[str, str], dict[str, str]] = {}
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
    """Plan the closed loops of a scenario, one per solver configuration and computer slow-down."""
    steps = min(table.steps or scenario.steps, scenario.steps)
    if table.deadline_s > scenario.sample_s:
        where, allowed = f"suite: closed loop of {scenario.name}", f"at most {scenario.sample_s:g}"
        raise InputError(where, "deadline_s", table.deadline_s, f"{allowed}, its sample")
    backup, missing = find_backup_and_refusal(table.backup)
    # The baseline law does not look at units or settings: it runs where the default configurations
    # do.
    plain = ("scaled", "default", "fresh")
    cells = [
        plan_run_of_configuration(
            configuration,
            suite,
            table,
            why_no_sparse_form=scenario.controller.why_no_sparse_form,
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
    cells = [replace(planned, refused=planned.refused or missing) for planned in cells]
    return [
        replace(planned, refused=planned.refused or why) if planned.cell.slowdown else planned
        for planned in cells
    ]


def _plan_scenario_replays(
    suite: SuiteFile, table: ReplayTable, scenario: Scenario, solvers: Sequence[str]
) -> list[PlannedCell]:
    """Plan replays of a scenario's QPs: along the exact loop, its hardest steps, or failures."""
    if table.first >= scenario.steps:
        raise InputError(
            f"suite: replay of {scenario.name}", "first", table.first, f"below {scenario.steps}"
        )
    steps = min(table.steps or scenario.steps, scenario.steps - table.first)
    if table.hardest:
        _refuse_impossible_window(table, scenario)
    if "margin" in table.model_fields_set and not table.consequence:
        where = f"suite: replay of {scenario.name}"
        raise InputError(where, "margin", table.margin, "nothing without consequence = true")
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
        why_no_sparse_form=scenario.controller.why_no_sparse_form,
        scenario=scenario.files,
        first=table.first,
        source=source,
    )


def _refuse_impossible_window(table: ReplayTable, scenario: Scenario) -> None:
    """Raise InputError where a suite table has an impossible window of hardest steps."""
    allowed = ""
    if table.steps and table.hardest > table.steps:
        allowed = f"at most {table.steps}, the steps it is chosen from"
    elif table.consequence:
        allowed = "0 with consequence: hardness is that of the controller's QPs"
    elif table.horizons:
        allowed = "0 with horizons: each pair has other hardest steps, and they are compared"
    if allowed:
        where = f"suite: replay of {scenario.name}"
        raise InputError(where, "hardest", table.hardest, allowed)


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
    """Plan the consequence-analysis replays of each failure group of a scenario's ship."""
    thrusters, _ = select_thruster_rows(scenario)
    if table.units != ["scaled"]:
        where = f"suite: consequence analysis of {scenario.name}"
        raise InputError(where, "units", ", ".join(table.units), "scaled, its only units")
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
