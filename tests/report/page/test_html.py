"""The page is one valid file that needs nothing beside it; its script finds what it asks for."""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tracemalloc
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
from markupsafe import escape

from dpbench.bench.record.result_folder import hash_files
from dpbench.embedded.table import EMBEDDED_FILE, write_counted_steps_atomically
from dpbench.report.page.citations import PAPER_CITATION, format_software_citation
from dpbench.report.page.vendored import (
    Vendored,
    compute_sha256_of_script,
    list_vendored_scripts,
    read_script,
)
from dpbench.report.page.write import SCRIPTS, read_page_file
from dpbench.report.write import write_report
from tests.embedded.made_counts import make_counts
from tests.report.conftest import of_seas
from tests.report.page.test_pack import unpacked

CITATION = Path(__file__).parents[3] / "CITATION.cff"
VOID = {"meta", "img", "br", "link", "input", "hr"}
WRITE = """
import sys
from dpbench.report.write import write_report_with_summary
write_report_with_summary(sys.argv[1], figures=("pdf",))
"""
JS = "".join(read_page_file(f"scripts/{name}.js") for name in SCRIPTS)


class Checker(HTMLParser):
    """Collects ids and links, and insists that every tag is closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.sources: list[str] = []
        self.script = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.ids += [found["id"]] if found.get("id") else []
        self.links += [found["href"]] if tag == "a" and found.get("href") else []
        self.sources += [found["src"]] if found.get("src") else []
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        return

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, (tag, self.getpos())


def checked(html: str) -> Checker:
    checker = Checker()
    checker.feed(html)
    checker.close()
    assert checker.open == []
    return checker


def test_every_tag_is_closed_and_every_id_stands_once(written: Any) -> None:
    ids = [name for name in checked(written.html).ids if not re.match(r"(clip|gradient)\d", name)]
    assert len(ids) == len(set(ids)) > 20


def test_nothing_is_loaded_from_elsewhere(written: Any) -> None:
    found = checked(written.html)
    assert all(source.startswith("data:") for source in found.sources)
    for link in found.links:
        if link.startswith("#"):
            assert link[1:] in found.ids, link
        else:
            assert (written.folder / link).is_file(), link
    assert not re.search(r"@import|url\(\s*['\"]?http|<link|<script[^>]*src", written.html)


@pytest.mark.slow
def test_the_script_asks_only_for_what_is_there(written: Any, records: Any, tmp_path: Any) -> None:
    asked = set(re.findall(r'\$\("([\w-]+)"\)', JS))
    assert len(asked) > 20
    folder = of_seas(records).write(tmp_path)
    write_counted_steps_atomically(make_counts("daqp", [1000] * 9), folder / EMBEDDED_FILE)
    studied = write_report(folder).read_text("utf-8")
    assert asked <= {*checked(written.html).ids, *checked(studied).ids}


@pytest.mark.slow
def test_two_processes_write_the_same_bytes(written: Any, tmp_path: Path) -> None:
    """Whatever order Python's sets happen to have in each: page, Markdown and tables."""
    folder = shutil.copytree(written.folder, tmp_path / "standard")
    ours = {path.name: path.read_bytes() for path in (folder / "tables").iterdir()}
    shutil.rmtree(folder / "tables")
    another = "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"
    command = [sys.executable, "-c", WRITE, str(folder)]
    subprocess.run(command, env=os.environ | {"PYTHONHASHSEED": another}, check=True)
    theirs = {path.name: path.read_bytes() for path in (folder / "tables").iterdir()}
    assert len(ours) > 3
    assert [name for name in ours if ours[name] != theirs.get(name)] == []
    assert ours.keys() == theirs.keys()
    assert (folder / "report.html").read_text("utf-8") == written.html
    assert (folder / "report.md").read_text("utf-8") == written.markdown


@pytest.mark.slow
def test_a_loop_alone_has_the_ids_that_scripts_need_at_once(records: Any, tmp_path: Any) -> None:
    records.loop("daqp", steps=20)
    ids = set(checked(write_report(records.write(tmp_path)).read_text("utf-8")).ids)
    bound = set(re.findall(r'\$\("([\w-]+)"\)\.addEventListener', JS))
    assert bound and bound <= ids


def test_the_block_unpacks_to_the_facts(written: Any) -> None:
    (text,) = re.findall(r'<script id="block"[^>]*>(.*?)</script>', written.html, re.S)
    document, arrays = unpacked(text.strip())
    facts = written.report.data
    assert document["configurations"]["solver"] == [c.solver for c in facts.configurations]
    assert [experiment["label"] for experiment in document["experiments"]] == [
        p.label for p in facts.experiments
    ]
    cells = document["cells"]
    assert len(cells["id"]) == len(facts.runs)
    for i in (0, len(cells["id"]) // 2):
        steps = facts.thinned_runs[cells["id"][i]].steps
        assert arrays[cells["t"][i]] == pytest.approx(list(steps.time_ns), rel=0.006)
    verdicts = {v.configuration: v for v in facts.verdicts.all_verdicts}
    for c, p99 in zip(facts.configurations, document["configurations"]["p99"], strict=True):
        verdict = verdicts.get(c)
        if verdict is not None and verdict.p99_ns == verdict.p99_ns:
            assert p99 == verdict.p99_ns


def test_a_file_larger_than_the_memory_has_a_hash(tmp_path: Path) -> None:
    """The steps of a large campaign are a gigabyte: they are read in pieces."""
    with (tmp_path / "steps.parquet").open("wb") as file:
        file.truncate(64_000_000)
    tracemalloc.start()
    try:
        found = hash_files(tmp_path, ["steps.parquet", "absent"])
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert found == {"steps.parquet": hashlib.sha256(bytes(64_000_000)).hexdigest()}
    assert peak < 4_000_000


def test_the_page_is_within_its_budget(written: Any) -> None:
    """At most 5 MB, 3000 elements and 1300 words as it opens, before a script has run."""
    assert len(written.html.encode()) <= 5e6
    body = re.sub(r"<(script|style)\b.*?</\1>", " ", written.html, flags=re.S)
    assert len(re.findall(r"<[a-z]", body)) <= 3000
    prose = re.sub(r"<(svg|details)\b.*?</\1>", " ", body, flags=re.S)
    assert len(re.sub(r"<[^>]+>", " ", prose).split()) <= 1300


@pytest.mark.slow
def test_figures_are_linked_in_each_format_there_is(written: Any, tmp_path: Any) -> None:
    for name in written.report.figures:
        for kind in ("svg", "pdf"):
            assert f'href="figures/{name}.{kind}"' in written.html
    assert "--figures pdf" not in written.html
    plain = write_report(shutil.copytree(written.folder, tmp_path / "plain")).read_text("utf-8")
    assert '.pdf"' not in plain
    assert "dpbench report . --figures pdf" in plain


def test_citations_are_those_of_the_citation_file(written: Any) -> None:
    output = [
        line.strip().removeprefix("- ").split(": ", 1)
        for line in CITATION.read_text(encoding="utf-8").splitlines()
    ]
    of: dict[str, list[str]] = {}
    for name, *values in output:
        of.setdefault(name, []).extend(value.strip('"') for value in values)
    entry = format_software_citation(written.results)
    title, of_the_paper = of["title"]
    assert title in " ".join(entry.replace("{QP}", "QP").split())  # braces keep its capitals
    assert f"{{{of['name'][0]}}}" in entry
    assert f"year = {{{written.results.suite['started_utc'][:4]}}}" in entry
    assert f"version {written.results.suite['harness_version']}" in entry
    assert f"title = {{{of_the_paper}}}" in PAPER_CITATION
    assert len(of["family-names"]) == 4
    for family, given in zip(of["family-names"], of["given-names"], strict=True):
        assert f"{family}, {given}" in PAPER_CITATION
    assert str(escape(f"{entry}\n\n{PAPER_CITATION}")) in written.html


VENDOR = files("dpbench.report.page").joinpath("vendor")


@pytest.mark.parametrize("entry", list_vendored_scripts(), ids=lambda entry: entry.file)
def test_a_script_is_what_the_list_says(entry: Vendored) -> None:
    assert compute_sha256_of_script(entry) == entry.sha256
    assert "Redistribution" in VENDOR.joinpath(entry.licence_file).read_text()
    assert entry.version in read_script(entry)
    assert "</script" not in read_script(entry)


def test_nothing_lies_there_unlisted() -> None:
    listed = {
        name for entry in list_vendored_scripts() for name in (entry.file, entry.licence_file)
    }
    assert {item.name for item in VENDOR.iterdir()} == listed | {"vendored.json"}
