"""What each place of the page is, in a line: its scenario in the scenario's own words, and what of
it was run there."""

from __future__ import annotations

import re

import numpy as np

from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.verdict.run_matrix import Experiment
from dpbench.report.formats import share_text
from dpbench.report.page.facts import Facts
from dpbench.report.page.terms import Word

MOST_PLACES = 60
"""So many places the list of words explains."""


def place_words(facts: Facts) -> dict[int, Word]:
    """The places that enter verdicts, by their number; those without a scenario are left out."""
    first: dict[int, RunRecord] = {}
    for (_, p), run in facts.runs.items():
        if p not in first or not first[p].has_steps:
            first[p] = run
    named = {
        p: _said(facts, facts.experiments[p], first[p])
        for p in facts.judged_experiments[:MOST_PLACES]
    }
    return {
        p: Word(f"place-{p}", facts.experiments[p].label, said) for p, said in named.items() if said
    }


def _said(facts: Facts, place: Experiment, run: RunRecord) -> str:
    scenario = facts.scenario(run) if run.scenario else None
    if scenario is None:
        return ""
    shows = re.split(r"(?<=\.)\s+(?=[A-Z])", scenario.shows.strip())[0]
    parts = [f"{part.strip().rstrip('.')}." for part in (scenario.title, shows) if part.strip()]
    if place.mode == "replay":
        parts.append(_replayed(facts, run))
    if place.units == "si":
        parts.append("Here in N and N·m as they come: an extra that no verdict counts.")
    if place.slowdown > 0:
        parts.append(f"Here on a computer × {place.slowdown:g} slower, whose answers come later.")
    return " ".join(parts).replace("`", "")


def _replayed(facts: Facts, run: RunRecord) -> str:
    """Which steps of the scenario, and how many of them have something to solve."""
    first = run.first_step
    window = f"steps {first} to {first + run.steps_planned} of " if "[" in run.sequence else ""
    kept = facts.kept.get(run.run_id)
    if kept is None:
        return f"Here {window}its exactly solved loop, replayed."
    share = share_text(float(np.mean(kept.steps.n_active > 0)))
    return f"Here {window}its exactly solved loop, replayed: limits are active in {share} of them."
