"""What a person asks of a suite on the command line: other settings, fewer steps, own scenarios."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

from pydantic import BaseModel

from dpbench.bench.judge.rules import supports
from dpbench.bench.plan.cells import PlannedCell
from dpbench.bench.plan.study_points import RunsTable
from dpbench.bench.plan.suite import SuiteFile
from dpbench.errors import InputError


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
    tables: dict[str, list[Any]] = {
        key: list(getattr(suite, key)) for key in SuiteFile.tables_of_cells()
    }
    if not set(asked) <= set(suite.scenario_names):
        tables["closed_loop"] = [
            _changed(t, scenarios=asked, vessels=[], steps=0) for t in suite.closed_loop
        ]
        tables["replay"] = [
            _changed(t, scenario=name, first=0, steps=0) for t in suite.replay for name in asked
        ]
    if settings:
        for key, own in tables.items():
            tables[key] = [_changed(t, settings=list(settings)) for t in own]
    if steps is not None:
        for key in ("closed_loop", "replay", "study"):
            tables[key] = [_changed(t, steps=min(steps, t.steps or steps)) for t in tables[key]]
        tables["replay"] = [_changed(t, hardest=min(steps, t.hardest)) for t in tables["replay"]]
    chosen = scenarios or settings or steps is not None
    return _changed(suite, **{k: _once(own) for k, own in tables.items()}) if chosen else suite


Model = TypeVar("Model", bound=BaseModel)


def _changed(model: Model, **update: object) -> Model:
    return model.model_copy(update=update)


def _once(tables: Sequence[RunsTable]) -> list[RunsTable]:
    """Tables that have become equal, once."""
    kept: list[RunsTable] = []
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
