"""The glossary: at most 130 terms, and a meaning for every value that is printed."""

import re
from collections import Counter
from pathlib import Path
from typing import Any, get_args

import pytest
from markupsafe import escape

from dpbench.analysis.compare.evidence import Verdict as Compared
from dpbench.analysis.verdict.verdict import State as Verdict
from dpbench.bench.plan.suite import FormulationName, RandomTable, RouteName
from dpbench.bench.record import schema
from dpbench.bench.record.cell import OUTCOMES, Units
from dpbench.bench.run.backup import FALLBACKS
from dpbench.cli.ship.check_ship import format_limits_by_axis
from dpbench.qp.random_sequence import FAMILIES
from dpbench.qp.referee.optimum import Kind
from dpbench.qp.solution import Status
from dpbench.report.page.terms import PHRASES, Terms, find_entry
from dpbench.report.report import BESIDE, TERMINAL_NOTES
from dpbench.report.words import format_glossary_as_markdown, term_meanings, topics
from dpbench.scenario.scenario import load_vessel
from dpbench.solvers.contract import POLICIES
from dpbench.solvers.settings import LEVELS
from sitegen import toml_keys

DOCS = Path(__file__).parents[2] / "docs"
GLOSSARY = DOCS / "glossary.md"
PRINTED = {
    "routes": set(get_args(RouteName)),
    "policies": POLICIES,
    "tolerance presets": tuple(LEVELS),
    "formulations": get_args(FormulationName),
    "units": get_args(Units),
    "fallbacks": tuple(FALLBACKS),
    "verdicts": get_args(Verdict),
    "verdicts of comparisons": get_args(Compared),
}
OF_COLUMNS = {
    "outcome": OUTCOMES,
    "status": [status.name.lower() for status in Status],
    "certificate": get_args(Kind),
}


@pytest.mark.parametrize("kind", PRINTED)
def test_every_value_of_an_enumeration_is_explained(kind: str) -> None:
    coded = {value for text in term_meanings().values() for value in re.findall("`(.*?)`", text)}
    assert PRINTED[kind]
    assert not set(PRINTED[kind]) - set(term_meanings()) - coded


@pytest.mark.parametrize("column", OF_COLUMNS)
def test_every_value_of_a_column_is_in_its_meaning(column: str) -> None:
    _, text = {**schema.STEP_COLUMNS, **schema.RUN_COLUMNS}[column]
    assert not set(OF_COLUMNS[column]) - set(re.findall(r"\w+", text))


def test_every_family_of_random_problems_is_described() -> None:
    listed = re.findall(r"(\w+)\s\(", toml_keys.meanings(RandomTable)["families"])
    assert listed == list(FAMILIES)


@pytest.mark.slow
def test_every_line_that_a_run_ends_with_is_in_the_guide(records: Any) -> None:
    records.replay("daqp")
    assert {"answer", "solvers"} <= set(records.ending())
    listed = set(re.findall(r"^\| `([\w ]+)` \|", (DOCS / "guide/report.md").read_text(), re.M))
    assert {*records.ending(), *TERMINAL_NOTES, *BESIDE, "warning", "page"} <= listed


def test_every_row_that_check_prints_of_a_ship_is_in_the_guide() -> None:
    _, *rows, _, _ = format_limits_by_axis(load_vessel("supply_fs99"))
    guide = " ".join((DOCS / "guide/own-ship.md").read_text(encoding="utf-8").split())
    assert [row[:22].strip() for row in rows if row[:22].strip() not in guide] == []


def test_the_glossary_has_at_most_130_terms() -> None:
    assert len(term_meanings()) <= 130


def test_a_term_is_explained_once_and_in_a_sentence() -> None:
    counts = Counter(term for terms in topics().values() for term in terms)
    assert max(counts.values()) == 1
    assert all(text.endswith(".") for text in term_meanings().values())


def test_the_page_of_the_documentation_is_the_glossary() -> None:
    assert GLOSSARY.read_text(encoding="utf-8") == format_glossary_as_markdown()


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
    over = "for results over several realisations, from the realisations"
    assert over in term_meanings()["interval"]


def test_code_in_a_meaning_is_code_in_the_list_and_plain_in_a_link() -> None:
    assert Terms.mark_code("a<b or `x`") == "a&lt;b or <code>x</code>"
    assert '="Interface through which a solver is called: native or qpsolvers."' in Terms.link(
        find_entry("route"), "route"
    )


def test_heads_are_terms_without_their_unit() -> None:
    terms = Terms([])
    assert ">excess error [cm]</a>" in terms.head("excess error [cm]")
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
    plain = {(word, re.sub("</?code>", "", meaning)) for word, meaning in listed}
    assert set(links) <= {(word, meaning.replace('"', "&#34;")) for word, meaning in plain}
    assert len(listed) == len({word for word, _ in listed})
