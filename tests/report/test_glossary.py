"""Every term the tool prints is in the glossary once, and the page of the docs is made of it."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import get_args

import pytest

from dpbench.analysis.compare.evidence import Verdict as Compared
from dpbench.analysis.verdict import Outcome as Verdict
from dpbench.bench.plan.suite import FormulationName, RouteName
from dpbench.bench.record.cell import OUTCOMES, Cell, Fallback, Formulation, Units
from dpbench.qp.random.recipe import FAMILIES
from dpbench.qp.referee.joint import Kind
from dpbench.qp.solution import Status
from dpbench.report.glossary import as_markdown, meanings, topics
from dpbench.solvers.record import POLICIES
from dpbench.solvers.settings import LEVELS

DOCS = Path(__file__).parents[2] / "docs" / "glossary.md"
PRINTED = {
    "outcomes of cells": OUTCOMES,
    "modes": get_args(Cell.__annotations__["mode"]) or ("closed_loop", "replay"),
    "routes": set(get_args(RouteName)),
    "policies": POLICIES,
    "tolerance levels": tuple(LEVELS),
    "formulations": {*get_args(FormulationName), *get_args(Formulation)},
    "units": get_args(Units),
    "fallbacks": get_args(Fallback),
    "certificates": get_args(Kind),
    "statuses": [status.name.lower() for status in Status],
    "verdicts": get_args(Verdict),
    "verdicts of comparisons": get_args(Compared),
    "families of random problems": tuple(FAMILIES),
}


@pytest.mark.parametrize("what", PRINTED)
def test_every_value_of_an_enumeration_is_explained(what: str) -> None:
    """Whatever stands in a column of words."""
    assert PRINTED[what]
    assert not set(PRINTED[what]) - set(meanings())


def test_a_term_is_explained_once_and_in_a_sentence() -> None:
    """No term in two topics; every meaning ends as a sentence does."""
    counts = Counter(term for terms in topics().values() for term in terms)
    assert max(counts.values()) == 1
    assert all(text.endswith(".") or text.endswith("?") for text in meanings().values())


def test_the_page_of_the_documentation_is_the_glossary() -> None:
    """`python -m dpbench.report.glossary > docs/glossary.md` renews it."""
    assert DOCS.read_text(encoding="utf-8") == as_markdown()
