"""Every term the tool prints is in the glossary once, and the page of the docs is made of it."""

import re
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import pytest
from markupsafe import escape
from rich.console import Console

from dpbench.analysis.compare.evidence import Verdict as Compared
from dpbench.analysis.compare.pairs import DONE, FigureChange
from dpbench.analysis.statistics import Interval
from dpbench.analysis.suites.capability import BatchAnswers
from dpbench.analysis.suites.study import find_studies
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.verdict import State as Verdict
from dpbench.bench.plan.suite import FormulationName, RouteName
from dpbench.bench.record.cell import OUTCOMES, Cell, Formulation, Units
from dpbench.bench.run.backup import FALLBACKS
from dpbench.cli.check_ship import format_limits_by_axis
from dpbench.cli.doctor import describe_machine_and_clock
from dpbench.cli.listing import list_table
from dpbench.qp.random_sequence import FAMILIES
from dpbench.qp.referee.optimum import Kind
from dpbench.qp.solution import Status
from dpbench.report.compare.comparison import (
    make_changes_table,
    make_solvers_table,
    make_times_table,
)
from dpbench.report.formats import Table
from dpbench.report.page.terms import PHRASES, Terms
from dpbench.report.report import BESIDE, TERMINAL_NOTES
from dpbench.report.topics.capability import make_consequence_row
from dpbench.report.topics.study import build_study_topic
from dpbench.report.topics.thrusters import make_wear_row
from dpbench.report.words import format_glossary_as_markdown, term_meanings, topics
from dpbench.scenario.scenario import load_vessel
from dpbench.solvers.contract import POLICIES
from dpbench.solvers.settings import LEVELS
from tests.report.conftest import of_seas

CHANGED = FigureChange(
    SimpleNamespace(configuration_label="daqp", a=SimpleNamespace(mode="replay", problem="paper")),
    DONE,
    (2.0, 2.0),
    (1.0, 1.0),
    "worse",
)
TIMED = SimpleNamespace(
    timing=SimpleNamespace(
        pair=SimpleNamespace(
            configuration_label="daqp", a=SimpleNamespace(solver="daqp", problem="paper")
        ),
        median_ns=(1e3, 2e3),
        steps=10,
        rounds=2,
    ),
    assessment=SimpleNamespace(
        raw=2.0, machine=1.0, ratio=Interval(2.0, 1.9, 2.1), verdict="slower"
    ),
)
DOCS = Path(__file__).parents[2] / "docs" / "glossary.md"
PRINTED = {
    "outcomes of cells": OUTCOMES,
    "modes": get_args(Cell.__annotations__["mode"]) or ("closed_loop", "replay"),
    "routes": set(get_args(RouteName)),
    "policies": POLICIES,
    "tolerance levels": tuple(LEVELS),
    "formulations": {*get_args(FormulationName), *get_args(Formulation)},
    "units": get_args(Units),
    "fallbacks": tuple(FALLBACKS),
    "certificates": get_args(Kind),
    "statuses": [status.name.lower() for status in Status],
    "verdicts": get_args(Verdict),
    "verdicts of comparisons": get_args(Compared),
    "families of random problems": tuple(FAMILIES),
}


@pytest.mark.parametrize("what", PRINTED)
def test_every_value_of_an_enumeration_is_explained(what: str) -> None:
    assert PRINTED[what]
    assert not set(PRINTED[what]) - set(term_meanings())


def _spoken() -> set[str]:
    """Terms, each alone: those that share an entry are set apart by commas."""
    return {part for term in term_meanings() for part in (term, *term.split(", "))}


@pytest.mark.slow
def test_every_word_that_a_run_ends_with_is_explained(records: Any) -> None:
    records.replay("daqp")
    assert {"answer", "solvers"} <= set(records.ending())
    output = {
        *records.ending(),
        *TERMINAL_NOTES,
        *BESIDE,
        "warning",
        "solver",
        "machine",
        "harness",
        "page",
    }
    assert output <= _spoken()


@pytest.mark.parametrize(
    "table",
    [
        make_solvers_table([TIMED], []),
        make_times_table([TIMED], 0.05, 0.05),
        make_changes_table([CHANGED], 0.05),
    ],
    ids=["solvers", "times", "answers"],
)
def test_every_head_of_a_comparison_is_explained(table: Table) -> None:
    heads = {re.sub(r"^[AB] | \[.*\]$", "", head) for head in table.heads}
    assert len(heads) > 4
    assert heads <= _spoken()


def test_what_check_says_of_a_ship_is_explained() -> None:
    axes, *rows, sideways = format_limits_by_axis(load_vessel("supply_fs99"))
    names = {row[:22].strip() for row in rows}
    assert len(names) == 5
    assert {*names, *axes.split(), "drift at full"} <= _spoken()
    assert sideways.startswith("1 m/s sideways") and "1 m/s sideways" in term_meanings()


@pytest.mark.slow
def test_what_doctor_says_is_explained() -> None:
    lines = [line for line in describe_machine_and_clock(offline=True) if not line.startswith(" ")]
    names = {re.split(r":| {2,}", line)[0] for text in lines for line in text.splitlines()[:1]}
    assert {"memory", "quiet means", "harness"} <= names
    assert names <= _spoken()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["suites", "sequences"])
def test_every_head_of_a_list_is_explained(kind: str) -> None:
    screen = Console(width=80)
    with screen.capture() as printed:
        screen.print(list_table(kind))
    heads = {head.strip() for head in printed.get().splitlines()[0].split("┃")}
    assert "name" in heads
    assert heads <= _spoken()


@pytest.mark.slow
def test_every_head_of_a_table_of_the_page_is_explained(written: Any) -> None:
    tables = [table for topic in written.report.topics for table in topic.tables]
    heads = {re.sub(r" \[.*\]$", "", head).lower() for table in tables for head in table.heads}
    assert {"claim", "configuration"} & heads
    assert heads <= {term.lower() for term in _spoken()}


def test_every_head_of_a_consequence_analysis_is_explained() -> None:
    answers = BatchAnswers("daqp", "daqp", 1, 1, 0, 1, 0, 0, 0, p99=0.01, largest=0.02)
    heads = set(make_consequence_row(answers, [True]))
    assert len(heads) == 9
    assert heads <= _spoken()


@pytest.mark.slow
def test_every_head_of_a_study_and_of_thrusters_is_explained(records: Any) -> None:
    topic = build_study_topic(find_studies(of_seas(records).view()))
    heads = {re.sub(r" \[.*\]$", "", head) for table in topic.tables for head in table.heads}
    assert len(heads) > 8
    assert {*heads, *make_wear_row("", [], {}, Requirements())} <= _spoken()


def test_a_term_is_explained_once_and_in_a_sentence() -> None:
    counts = Counter(term for terms in topics().values() for term in terms)
    assert max(counts.values()) == 1
    assert all(text.endswith(".") or text.endswith("?") for text in term_meanings().values())


def test_the_page_of_the_documentation_is_the_glossary() -> None:
    assert DOCS.read_text(encoding="utf-8") == format_glossary_as_markdown()


def test_a_term_is_linked_where_a_section_names_it_first() -> None:
    terms = Terms([])
    output = terms("Replays of a<b: the requirements, the replay and requirements.")
    assert output.count("<a ") == 2 and "a&lt;b" in output
    assert output.startswith('<a class="term" href="#word-replay"')
    assert f'title="{escape(term_meanings()["replay"])}">Replays</a>' in output
    assert "<a " not in terms("The requirements again.")
    terms.start_section()
    assert "<a " in terms("The requirements in a new section.")
    assert [word.term for word in terms.words] == ["replay", "requirements"]


def test_the_longest_phrase_is_the_term() -> None:
    output = Terms([])("one maximum increment, paired ratios, unwarm, step-warm")
    assert re.findall(r"#word-([\w-]+)", output) == ["maximum-increment", "paired-ratio"]


def test_an_interval_of_a_study_is_over_realisations() -> None:
    assert "of a study over realisations" in term_meanings()["interval"]


def test_heads_are_terms_without_their_unit() -> None:
    terms = Terms([])
    assert ">behind [cm]</a>" in terms.head("behind [cm]")
    assert terms.head("<b>") == "&lt;b&gt;"


@pytest.mark.parametrize("phrase", PHRASES)
def test_every_phrase_stands_for_a_term_of_the_glossary(phrase: str) -> None:
    terms = Terms([])
    assert f">{phrase}</a>" in terms(f"a {phrase} there")
    assert [word.term for word in terms.words] == [PHRASES[phrase]]
    assert PHRASES[phrase] in term_meanings()


def test_every_link_of_the_page_leads_to_its_meaning(written: Any) -> None:
    links = re.findall(r'class="term" href="#([\w-]+)" title="([^"]*)"', written.html)
    listed = re.findall(r'<dt id="([\w-]+)">[^<]*</dt><dd>(.*?)</dd>', written.html)
    assert len(links) > 15
    assert set(links) <= {(word, meaning.replace('"', "&#34;")) for word, meaning in listed}
    assert len(listed) == len({word for word, _ in listed})
