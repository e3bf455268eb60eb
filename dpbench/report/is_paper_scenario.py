"""Tell the paper's own scenarios from others that bear their names, by what they compute with."""

from __future__ import annotations

import json
from functools import cache

from dpbench.analysis.records import Records
from dpbench.scenario.scenario import Scenario, load_scenario

OF_PAPER = ("paper", "paper_tight")
"""Scenarios that restate the paper's case."""
PROSE = ("title", "shows", "source")
"""Entries of a problem file that nothing is computed from."""


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
