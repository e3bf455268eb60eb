"""The paper's case in the records: its two control laws side by side."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cache

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.scenario.scenario import Scenario, load_scenario

OF_PAPER = ("paper", "paper_tight")
"""Scenarios that restate the paper's case."""
PROSE = ("title", "shows", "source")
"""Entries of a problem file that nothing is computed from."""


@dataclass(frozen=True)
class Pair:
    """The constrained loop that follows the exact one most closely, and the baseline law.

    whole : steps of the whole scenario; the loops are complete but may have been asked for fewer.
    """

    constrained: RunRecord | None
    clipped: RunRecord | None
    whole: int = 0


def pair_of(view: Records, scenario: str) -> Pair:
    """The two laws of a scenario, each from a complete one of its longest closed loops."""
    loops = [r for r in view.full_loops(scenario) if r.has_steps and r.outcome == "finished"]
    solved = [row for row in loops if not row.is_baseline_law and row.policy == "fresh"]
    best = min(solved, key=_deviation, default=None)
    clipped = next((row for row in loops if row.is_baseline_law), None)
    return Pair(best, clipped, view.whole_steps(scenario))


def paper_pair(view: Records, name: str) -> Pair:
    """The same where the scenario is the paper's own of that name; else nothing."""
    return pair_of(view, name) if is_of_paper(view, name) else Pair(None, None)


def _deviation(row: RunRecord) -> tuple[float, str]:
    value = row.dev_position_max_m
    return (math.inf if math.isnan(value) else value, row.solver)


def is_of_paper(view: Records, name: str) -> bool:
    """Whether a scenario of the rows is the paper's own of that name, and not one named alike."""
    scenario = view.scenario(name) if name in OF_PAPER else None
    return scenario is not None and _content(scenario) == _own_content(name)


@cache
def _own_content(name: str) -> str:
    return _content(load_scenario(name))


def _content(scenario: Scenario) -> str:
    """What a scenario computes with: its documents without the prose, which may be reworded."""
    files = scenario.files
    documents = {
        key: {name: value for name, value in files[key].items() if name not in PROSE}
        for key in ("scenario", "vessel")
    }
    return json.dumps(documents, sort_keys=True)
