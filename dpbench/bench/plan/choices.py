"""What a person asks of a suite on the command line: other settings, fewer steps, own scenarios."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

from pydantic import BaseModel

from dpbench.bench.judge.rules import supports
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.plan.study_points import StudyTable
from dpbench.bench.plan.suite import (
    CapabilityTable,
    ClosedLoopTable,
    RandomTable,
    RecordedTable,
    ReplayTable,
    SuiteFile,
)
from dpbench.errors import InputError

Table = TypeVar(
    "Table",
    ClosedLoopTable,
    ReplayTable,
    RecordedTable,
    RandomTable,
    CapabilityTable,
    StudyTable,
)


def with_choices(
    suite: SuiteFile,
    *,
    scenarios: Sequence[str] | None = None,
    settings: Sequence[str] | None = None,
    steps: int | None = None,
) -> SuiteFile:
    """The suite as it is asked for.

    Parameters
    ----------
    scenarios : where the suite does not name all of them, they take the place of its own, by name
        or TOML file: each closed loop and replay is run with them, from the first step on.
    settings : at these levels and no other.
    steps : at most so many of each loop and replay.

    Raises
    ------
    InputError : for less than one step.
    """
    if steps is not None and steps < 1:
        raise InputError("--steps", "", steps, "a whole number, 1 or more")
    asked = list(scenarios or ())
    foreign = not set(asked) <= set(suite.scenario_names)
    loops, replays, studies = list(suite.closed_loop), list(suite.replay), list(suite.study)
    if foreign:
        loops = _once([_changed(t, scenarios=asked, vessels=[], steps=0) for t in loops])
        replays = _once(
            [_changed(t, scenario=name, first=0, steps=0) for t in replays for name in asked]
        )
    if settings:
        loops = _once([_changed(t, settings=list(settings)) for t in loops])
        studies = _once([_changed(t, settings=list(settings)) for t in studies])
        replays = _once([_changed(t, settings=list(settings)) for t in replays])
        recorded = _once([_changed(t, settings=list(settings)) for t in suite.recorded])
        random = _once([_changed(t, settings=list(settings)) for t in suite.random])
        edges = _once([_changed(t, settings=list(settings)) for t in suite.capability])
        suite = _changed(suite, recorded=recorded, random=random, capability=edges)
    if steps is not None:
        loops = [_changed(t, steps=min(steps, t.steps or steps)) for t in loops]
        replays = [
            _changed(t, steps=min(steps, t.steps or steps), hardest=min(steps, t.hardest))
            for t in replays
        ]
        studies = [_changed(t, steps=min(steps, t.steps or steps)) for t in studies]
    return _changed(suite, closed_loop=loops, replay=replays, study=studies)


Model = TypeVar("Model", bound=BaseModel)


def _changed(model: Model, **update: object) -> Model:
    return model.model_copy(update=update)


def _once(tables: Sequence[Table]) -> list[Table]:
    """Tables that have become equal, once."""
    kept: list[Table] = []
    for table in tables:
        if table not in kept:
            kept.append(table)
    return kept


def remarks_on(planned: Sequence[PlannedCell]) -> list[str]:
    """What the plan cannot answer, said before it runs."""
    cells = [p.cell for p in planned if p.cell.is_timed]
    lengths = [cell.steps for cell in cells]
    if lengths and not supports(max(lengths), 99):
        return [
            f"no replay has steps enough for a p99 (the longest has {max(lengths)}): the largest "
            "step is judged in its place"
        ]
    return []
