"""The whole report: complete, self-contained, and whole on partial results."""

import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from markdown_it import MarkdownIt

from dpbench.analysis.demand import Demand
from dpbench.analysis.records import Records
from dpbench.analysis.times.fastest import recommend
from dpbench.analysis.verdict import verdicts_of
from dpbench.bench.record.result_folder import load_results
from dpbench.report.blocks import Tabular
from dpbench.report.formats import rounded_down, time_text
from dpbench.report.render import inline
from dpbench.report.section_verdict import verdict_table
from dpbench.report.write import build_page, verdict_lines, write_report

pytestmark = pytest.mark.slow

VOID = {"meta", "img", "br", "link"}


class _Checker(HTMLParser):
    """Collects ids, links and sources, and insists that every tag is closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.sources: list[str] = []
        self.tables = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.ids += [found["id"]] if found.get("id") else []
        self.links += [found["href"]] if found.get("href") else []
        self.sources += [found["src"]] if found.get("src") else []
        self.tables += tag == "table"
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def _checked(html: Path) -> _Checker:
    checker = _Checker()
    checker.feed(html.read_text(encoding="utf-8"))
    assert checker.open == []
    return checker


def _images(text: str) -> list[str]:
    """The sources of all images of a Markdown text."""
    lines = [token.children or [] for token in MarkdownIt("commonmark").parse(text)]
    return [str(t.attrs["src"]) for line in lines for t in line if t.type == "image"]


@pytest.fixture(scope="module")
def report(campaign: Path) -> Path:
    """The report of a campaign like the standard one."""
    return write_report(campaign)


def test_html_is_well_formed_and_self_contained(report: Path) -> None:
    """Every tag is closed, every id is unique, every link stays inside, nothing is loaded."""
    found = _checked(report)
    assert len(found.ids) == len(set(found.ids))
    assert {link.removeprefix("#") for link in found.links} <= set(found.ids)
    assert found.sources
    assert all(source.startswith("data:image/svg+xml;base64,") for source in found.sources)
    text = report.read_text(encoding="utf-8")
    assert not re.search(r"https?://|<script|@import|url\(", text)


def test_figures_of_the_markdown_exist_and_are_drawings(report: Path) -> None:
    """Every figure that the Markdown names is an SVG file beside it, and no stale one is left."""
    named = _images((report.parent / "report.md").read_text("utf-8"))
    assert len(named) == len(set(named)) >= 10
    for name in named:
        assert ElementTree.parse(report.parent / name).getroot().tag.endswith("svg")
    kept = {f"figures/{path.name}" for path in (report.parent / "figures").iterdir()}
    assert kept == set(named)


def test_markdown_and_html_hold_the_same_tables(report: Path) -> None:
    """Markdown renders to as many tables as the HTML has, each with its note above it."""
    text = (report.parent / "report.md").read_text(encoding="utf-8")
    tokens = MarkdownIt("commonmark").enable("table").parse(text)
    tables = sum(token.type == "table_open" for token in tokens)
    assert tables == _checked(report).tables > 10


def test_sections_come_in_their_order(report: Path) -> None:
    """The verdict comes first and how to read it last."""
    ids = [i for i in _checked(report).ids if i]
    assert ids == [
        "verdict",
        "runs",
        "accuracy",
        "units",
        "timing",
        "ranks",
        "use",
        "figures",
        "control",
        "paper",
        "solvers",
        "reading",
    ]


def test_the_same_records_give_the_same_report(records: Any, tmp_path: Path) -> None:
    """Writing again changes no byte: nothing in it depends on the day or on chance."""
    records.loop("daqp")
    records.replay("daqp", steps=30)
    html = write_report(records.write(tmp_path))
    before = html.read_bytes()
    assert write_report(tmp_path).read_bytes() == before


def test_every_table_states_its_population(campaign: Path) -> None:
    """No table stands without a note that counts something."""
    page = build_page(load_results(campaign))
    notes = [b.table.note for s in page.sections for b in s.blocks if isinstance(b, Tabular)]
    assert len(notes) > 10
    assert [note for note in notes if not note] == []


def test_the_verdict_lines_name_the_fastest(campaign: Path) -> None:
    """The terminal hears what to use, and not of ways that were replayed alone."""
    text = "\n".join(verdict_lines(load_results(campaign)))
    assert "\nUse daqp (route qpsolvers, policy fresh, settings default), the fastest" in text
    assert "native warm" not in text


def test_page_markdown_terminal_and_verdicts_say_the_same(report: Path) -> None:
    """Who is recommended, in which way, at which p99 and slow-downs is one answer everywhere."""
    results = load_results(report.parent)
    view, demand = Records(results), Demand.of(results.suite)
    verdicts = verdicts_of(view, demand)
    chosen = recommend(verdicts).chosen
    assert chosen is not None
    who = chosen.configuration
    told = (
        f"{who.solver} (route {who.route}, policy {who.policy}, settings default)",
        time_text(chosen.p99_ns),
        f"{rounded_down(chosen.slowdown(demand))} times slower",
        f"{rounded_down(chosen.raw_slowdown(demand))} times by its largest sample",
    )
    terminal = "\n".join(verdict_lines(results))
    plain = re.sub(r"[*`]", "", (report.parent / "report.md").read_text(encoding="utf-8"))
    page = re.sub(r"<[^>]+>", "", report.read_text(encoding="utf-8"))
    for words in told:
        assert words in terminal
        assert words in plain
        assert words in page
    rows = {row[0].text: [cell.text for cell in row[1:3]] for row in verdict_table(verdicts).rows}
    for level, column in (("default", 0), ("high", 1)):
        for verdict in verdicts.at(level):
            assert rows[verdict.configuration.solver][column] == verdict.outcome


def _nothing(records: Any) -> None:
    """Leave the records empty."""


def _refused_only(records: Any) -> None:
    records.refused("qpax", "not installed")


def _loop_only(records: Any) -> None:
    records.loop("daqp", "calm")


def _replay_only(records: Any) -> None:
    records.replay("daqp", steps=30)


def _single_step(records: Any) -> None:
    records.loop("daqp", steps=1)
    records.replay("daqp", steps=1, rounds=1)


def _all_crashed(records: Any) -> None:
    for solver in ("daqp", "scs"):
        records.loop(solver, done=0, outcome="crashed", outcome_detail="signal 11")
        records.replay(solver, outcome="crashed", steps_done=0)


def _all_silent(records: Any) -> None:
    records.loop("ecos", error=float("inf"), failed=120)
    records.replay("ecos", error=float("inf"), failed=3000)


def _baseline_law_only(records: Any) -> None:
    records.loop("unconstrained_clipped", formulation="none", error=1.0)


def _si_only(records: Any) -> None:
    records.loop("daqp", units="si", settings="high")


def _odd_names(records: Any) -> None:
    records.loop('a<b>&"c|d', outcome_detail="<script>", outcome="timed_out", done=5)


PARTIAL = [
    (_nothing, "Missing: no solver was run"),
    (_refused_only, "was not run: not installed"),
    (_loop_only, "Missing: no replay left a step"),
    (_replay_only, "Missing: no full-length closed loop"),
    (_single_step, "Missing: no closed loop was run in SI units"),
    (_all_crashed, "its process ended in `paper`: signal 11"),
    (_all_silent, "it leaves steps without an answer"),
    (_baseline_law_only, "Contrast"),
    (_si_only, "Missing: no solver was run in scaled units"),
    (_odd_names, "was stopped at its time limit"),
]


@pytest.mark.parametrize(("fill", "says"), PARTIAL)
def test_partial_results_still_make_a_report(
    records: Any, tmp_path: Path, fill: Callable[[Any], None], says: str
) -> None:
    """Whatever is missing from the results, the report is written and says what is missing."""
    fill(records)
    html = write_report(records.write(tmp_path))
    _checked(html)
    assert says in (tmp_path / "report.md").read_text(encoding="utf-8")


def test_markup_is_escaped() -> None:
    """Words of a library never become tags of the page."""
    assert inline("`a` **b** <i>") == "<code>a</code> <strong>b</strong> &lt;i&gt;"
