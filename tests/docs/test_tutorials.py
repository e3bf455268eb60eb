"""Whoever follows a page of the documentation from top to bottom gets what it promises."""

import shlex
from pathlib import Path

import pytest

from dpbench import load_results
from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.suite import load_path_and_suite
from dpbench.solvers import plugins
from tests.docs.markdown_blocks import DOCS, PAGES, README, Block, blocks_of
from tests.docs.page_commands import PageCommands

ROOT = DOCS.parent
FOLLOWED = [page for page in (README, *PAGES) if blocks_of(page)]


def test_the_tutorials_have_something_to_follow() -> None:
    tutorials = {page.stem for page in FOLLOWED if page.parent.name == "tutorials"}
    assert len(tutorials) == 7
    assert all(
        any(block.language == "sh" for block in blocks_of(DOCS / "tutorials" / f"{name}.md"))
        for name in tutorials
    )


def test_a_plant_of_ones_own_takes_one_short_file() -> None:
    blocks = blocks_of(DOCS / "tutorials" / "own-plant.md")
    scripts = [block.body for block in blocks if "LinearMPC.from_continuous" in block.body]
    assert len(scripts) == 2
    for script in scripts:
        assert len(script.splitlines()) < 80
        assert all(call in script for call in ("run_closed_loop", "run_campaign", "add_runs"))


def test_the_tutorial_on_the_paper_counts_the_presets_of_quadprog_as_configurations() -> None:
    """`high` has the options of `default`, and its own rows."""
    cells = [
        planned
        for planned in plan_suite(load_path_and_suite("standard")[1])
        if planned.cell.solver == "quadprog" and planned.cell.scenario_name == "paper"
        if planned.cell.units == "scaled" and not planned.refused
    ]
    configurations = {
        (planned.cell.route, planned.cell.policy, settings)
        for planned in cells
        for settings in (planned.cell.settings, *planned.alias_settings)
    }
    assert {settings for *_, settings in configurations} == {"default", "high"}
    text = (DOCS / "tutorials" / "reproduce-the-paper.md").read_text("utf-8")
    assert f"Only quadprog was run, in {len(configurations)} configurations" in text


@pytest.fixture(scope="module")
def commands(tmp_path_factory: pytest.TempPathFactory) -> PageCommands:
    """All pages have one, so that what several of them run is run once."""
    return PageCommands(tmp_path_factory.mktemp("commands"), FOLLOWED)


@pytest.mark.slow
@pytest.mark.parametrize("page", FOLLOWED, ids=lambda page: str(page.stem))
def test_a_page_runs_from_top_to_bottom(
    page: Path, commands: PageCommands, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    # Another page may have loaded the same name from another file.
    monkeypatch.setattr(plugins, "_LOADED", {})
    for block in blocks_of(page):
        if block.title:
            Path(block.title).parent.mkdir(parents=True, exist_ok=True)
            Path(block.title).write_text(f"{block.body}\n", encoding="utf-8")
        elif block.language == "python":
            exec(compile(block.body, str(page), "exec"), {"__name__": "page"})
        elif block.language == "sh":
            for command in block.tested:
                commands.run(command)
    for table in Path("results").glob("*/runs.parquet"):
        runs = load_results(table.parent).runs
        bad = runs[runs["outcome"].isin(["crashed", "hung", "invalid", "lost"])]
        assert bad.empty, bad[["solver", "outcome_detail"]].to_string()


@pytest.mark.parametrize("page", (README, *PAGES), ids=lambda page: str(page.stem))
def test_what_is_tested_is_what_is_printed(page: Path) -> None:
    for block in blocks_of(page):
        if not block.instead:
            continue
        assert len(block.commands) == len(block.tested), block
        for printed, tested in zip(block.commands, block.tested, strict=True):
            assert _kind(block, printed) == _kind(block, tested)


def _kind(block: Block, command: str) -> list[str]:
    """Program and command; of `run` how it is told what to run."""
    assert block.language == "sh"
    words = shlex.split(command, comments=True)
    return words[:2] + [
        word for word in words if word in ("--sequence", "--solver-module", "--format")
    ]
