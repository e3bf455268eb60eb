"""Expansion of the studies of a suite into closed loops, with a check for idle keys."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from dpbench.bench.plan.cells import PlannedCell, plan_run_of_configuration
from dpbench.bench.plan.configurations import BASELINE_LAW, list_configurations
from dpbench.bench.plan.study_points import (
    MOST_CELLS,
    Point,
    StudyPoint,
    StudyTable,
    list_study_points,
)
from dpbench.bench.plan.suite import ClosedLoopTable, SuiteFile
from dpbench.bench.record.cell import StudyRealisation
from dpbench.errors import InputError
from dpbench.scenario.problem_files import ScenarioDocuments
from dpbench.scenario.scenario import Scenario, load_scenario
from dpbench.scenario.variation import (
    SEED,
    behave_differently,
    read_value,
    replace_document_values,
    replace_values,
)


def plan_study_loops(
    suite: SuiteFile, solvers: Sequence[str], beside: Path | None
) -> list[PlannedCell]:
    """Plan the closed loops of a suite's studies; InputError for a parameter without effect."""
    cells: list[PlannedCell] = []
    titles = [table.title for table in suite.study]
    for table in suite.study:
        if titles.count(table.title) > 1:
            allowed = "a name of its own for each study of a suite"
            raise InputError("suite", "study.name", f"two studies called {table.title!r}", allowed)
        cells += _plan_loops_of_study(suite, table, f"suite: study {table.title}", solvers, beside)
        if len(cells) > MOST_CELLS:
            raise InputError("suite", "study", f"{len(cells)} cells", f"at most {MOST_CELLS}")
    return cells


def _plan_loops_of_study(
    suite: SuiteFile,
    table: StudyTable,
    where: str,
    solvers: Sequence[str],
    beside: Path | None,
) -> list[PlannedCell]:
    """Plan the closed loops of one study: each parameter point with each solver configuration."""
    base = load_scenario(table.base, beside=beside)
    keys = [*table.keys, *([table.replicates.key] if table.replicates.count > 1 else [])]
    own = {key: read_value(base, key, where) for key in keys}
    points = list_study_points(table, own)
    scenarios = _ScenarioCache(base, where, beside)
    _refuse_idle_keys(table, points, scenarios)
    blanks = _plan_base_cells(suite, table, base, solvers)
    return [
        _change_cell_to_point(blank, table, point, *documents)
        for point in points
        for documents in (scenarios.documents_and_steps_of_point(point),)
        for blank in blanks
    ]


def _plan_base_cells(
    suite: SuiteFile, table: StudyTable, base: Scenario, solvers: Sequence[str]
) -> list[PlannedCell]:
    """Plan a run for each solver configuration in a study's unchanged base scenario."""
    calls = {name: getattr(table, name) for name in ("solvers", "settings", "routes", "policies")}
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
        return replace_document_values(known.files, point.of_replicate, self._where), known.steps

    def build_scenario(self, values: Point) -> Scenario:
        """Return a study's base scenario with the values of some parameters replaced."""
        if values != self._values:
            self._scenario = replace_values(self._base, values, self._where, beside=self._beside)
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
        found = f"a key that changes nothing in {steps} steps of {self._base.name}"
        if key == SEED and not self._base.environment.is_random:
            found = f"a seed where the weather of {self._base.name} draws nothing at random"
        allowed = "a key that the run depends on; gusts, waves and noise depend on the seed"
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
    return behave_differently(one, other, min(steps or one.steps, one.steps))


def _pick_two_distinct_values(key: str, points: Sequence[StudyPoint]) -> list[object]:
    """Return a parameter's first value in the study points, and the first other one if any."""
    first = points[0].values[key]
    other = next((p.values[key] for p in points if p.values[key] != first), None)
    return [first] if other is None else [first, other]
