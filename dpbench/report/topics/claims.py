"""The paper, reproduced: each of its claims, what the rows say, and whether the two agree.

The claims and the words on them stand in `claims.toml`, what decides them in the analysis.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.claims import State, judged
from dpbench.analysis.suites.paper import PAPER, is_of_paper
from dpbench.report.words import filled


@dataclass(frozen=True)
class Claim:
    """A claim of the paper, what was found, and whether it is reproduced."""

    claim: str
    found: str
    state: State


@cache
def _words() -> dict[str, Any]:
    return tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


def claims(records: Records) -> list[Claim]:
    """All claims, in the order of the paper."""
    found = _words()["found"]
    asked = [
        (each["claim"], judged(records, each["scenario"], each["by"]))
        for each in _words()["claims"]
    ]
    return [Claim(text, filled(found[of.by], **of.values), of.state) for text, of in asked]


def choices(records: Records) -> list[tuple[str, str]]:
    """What the paper leaves open and what the scenario `paper` of these rows chose."""
    scenario = records.scenario(PAPER)
    if scenario is None or not is_of_paper(records, PAPER):
        return []
    chosen = {
        "vessel": scenario.vessel,
        "Q": scenario.Q,
        "R": scenario.R,
        "sea": scenario.files["scenario"]["environment"],
        "duration_s": scenario.steps * scenario.sample_s,
    }
    return [(name, filled(words, **chosen)) for name, words in _words()["choices"].items()]
