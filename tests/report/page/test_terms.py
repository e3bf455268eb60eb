"""Terms in the texts of a page: linked to the list of words, once a section, with their meaning."""

from __future__ import annotations

import re
from typing import Any

import pytest
from markupsafe import escape

from dpbench.report.glossary import meanings
from dpbench.report.page.terms import PHRASES, Terms


def test_a_term_is_linked_where_a_section_names_it_first() -> None:
    terms = Terms([])
    said = terms("Replays of a<b: the requirements, the replay and requirements.")
    assert said.count("<a ") == 2 and "a&lt;b" in said
    assert said.startswith('<a class="term" href="#word-replay"')
    assert f'title="{escape(meanings()["replay"])}">Replays</a>' in said
    assert "<a " not in terms("The requirements again.")
    terms.section()
    assert "<a " in terms("The requirements in a new section.")
    assert [word.term for word in terms.words] == ["replay", "requirements"]


def test_the_longest_phrase_is_the_term() -> None:
    said = Terms([])("one rate-limit step, paired ratios, unwarm, step-warm")
    assert re.findall(r"#word-([\w-]+)", said) == ["rate-limit-step", "paired-ratio"]


def test_heads_are_terms_without_their_unit() -> None:
    terms = Terms([])
    assert ">behind [cm]</a>" in terms.head("behind [cm]")
    assert terms.head("<b>") == "&lt;b&gt;"


@pytest.mark.parametrize("phrase", PHRASES)
def test_every_phrase_stands_for_a_term_of_the_glossary(phrase: str) -> None:
    terms = Terms([])
    assert f">{phrase}</a>" in terms(f"a {phrase} there")
    assert [word.term for word in terms.words] == [PHRASES[phrase]]
    assert PHRASES[phrase] in meanings()


def test_every_link_of_the_page_leads_to_its_meaning(written: Any) -> None:
    links = re.findall(r'class="term" href="#([\w-]+)" title="([^"]*)"', written.html)
    listed = re.findall(r'<dt id="([\w-]+)">[^<]*</dt><dd>(.*?)</dd>', written.html)
    assert len(links) > 15
    assert set(links) <= {(word, meaning.replace('"', "&#34;")) for word, meaning in listed}
    assert len(listed) == len({word for word, _ in listed})
