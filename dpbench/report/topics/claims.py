"""The paper, reproduced: each of its claims, what the rows say, and whether the two agree.

The claims and the words on them stand in `claims.toml`, what decides them in the analysis.
"""

from __future__ import annotations

from dataclasses import dataclass

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.claims import State, judged
from dpbench.analysis.suites.paper import PAPER, is_of_paper
from dpbench.report.words import beside, filled

_WORDS = beside(__file__)


@dataclass(frozen=True)
class Claim:
    """A claim of the paper, what was found, and whether it is reproduced."""

    claim: str
    found: str
    state: State


def claims(records: Records) -> list[Claim]:
    """All claims, in the order of the paper."""
    asked = [(text, judged(records, where, by)) for text, where, by in _WORDS["claims"]]
    said = _WORDS["found"]
    return [Claim(text, filled(said[of.by], **of.values), of.state) for text, of in asked]


def choices(records: Records) -> list[tuple[str, str]]:
    """What the paper leaves open and what the scenario `paper` of these rows chose."""
    scenario = records.scenario(PAPER)
    if scenario is None or not is_of_paper(records, PAPER):
        return []
    chosen = {
        "vessel": scenario.vessel,
        "Q": scenario.problem.Q,
        "R": scenario.problem.R,
        "sea": scenario.files["scenario"]["environment"],
        "duration_s": scenario.steps * scenario.sample_s,
    }
    return [(name, filled(words, **chosen)) for name, words in _WORDS["choices"].items()]
