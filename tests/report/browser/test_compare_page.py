"""The page of a comparison in a browser: its selection, its figures, its table."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from dpbench.bench.record.result_folder import Results, load_results
from dpbench.report.compare.comparison import compare
from dpbench.report.compare.page import write_comparison
from tests.report.browser.conftest import SIZES, Opener, check_accessible, opening, wait_until_ready
from tests.result_folder import StepsInMemory, write_results

SLOWER, FACTOR = "piqp", 1.5


@pytest.fixture(scope="module")
def comparison_file(campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The campaign against itself with one solver slowed."""
    folder = tmp_path_factory.mktemp("compared")
    a = load_results(shutil.copytree(campaign, folder / "a"))
    slow = set(a.runs.loc[a.runs["solver"] == SLOWER, "run_id"])
    steps = a.steps.copy()
    rows = steps["run_id"].isin(slow)
    steps.loc[rows, "total_ns"] = (steps.loc[rows, "total_ns"] * FACTOR).round().astype("Int64")
    write_results(folder / "b", Results(a.runs, StepsInMemory(steps), a.machine, a.suite))
    return write_comparison(folder / "compare.html", compare(folder / "a", folder / "b"))


@pytest.fixture
def compared(chromium: Any, comparison_file: Path) -> Iterator[Opener]:
    """The page of the comparison."""
    with opening(chromium, comparison_file) as opener:
        yield opener


def test_it_opens_with_what_became_slower_most(compared: Opener) -> None:
    page = compared()
    assert [u for u in compared.requests if not u.startswith("data:")] == [compared.file.as_uri()]
    assert SLOWER in page.inner_text("#answer .lead")
    assert page.locator("#figure-ratios svg").bounding_box()["y"] < 900
    assert page.inner_text("#one-title").startswith(SLOWER)
    assert page.evaluate("views.steps.then((view) => view.data('pairs').length)") > 100
    assert page.evaluate("document.querySelectorAll('*').length") <= 3000
    assert compared.file.stat().st_size <= 5_000_000


def test_a_row_and_a_dot_are_chosen_and_kept_in_the_address(compared: Opener) -> None:
    page = compared()
    page.fill("#table-filter", "osqp")
    page.locator("#times-body button").first.click()
    page.wait_for_function("location.hash.includes('s=osqp')")
    assert page.inner_text("#one-title").startswith("osqp")
    page.locator("#furthest button").first.click()
    page.wait_for_function("location.hash.includes('k=')")
    assert "ratio" in page.inner_text("#step-said")
    page.reload()
    wait_until_ready(page)
    assert page.inner_text("#one-title").startswith("osqp")
    assert "ratio" in page.inner_text("#step-said")
    page.go_back()
    page.wait_for_function("!location.hash.includes('k=')")


def test_a_mark_of_the_figure_is_chosen_by_a_click(compared: Opener) -> None:
    page = compared()
    name = page.locator("#figure-ratios text", has_text="osqp").first
    chosen = str(name.text_content()).split(" (")[0]
    box, figure = name.bounding_box(), page.locator("#figure-ratios").bounding_box()
    page.mouse.click(figure["x"] + 0.95 * figure["width"], box["y"] + box["height"] / 2)
    page.wait_for_function(f"location.hash.includes('s={chosen}')")
    assert page.inner_text("#one-title").startswith(chosen)


def test_it_answers_without_scripts(compared: Opener) -> None:
    page = compared(scripts=False)
    assert SLOWER in page.inner_text("#answer .lead")
    for name in ("ratios", "both"):
        assert page.locator(f"#figure-{name} svg text").count() > 5
    assert SLOWER in page.inner_text("#times-body tr:first-child")
    for control in page.locator("button, select, input").all():
        assert not control.is_visible()


@SIZES
def test_axe_has_nothing_to_say(compared: Opener, size: tuple[int, int]) -> None:
    check_accessible(compared(size=size), size[0])
