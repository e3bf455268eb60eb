"""The calculator of the page: counted instructions as times on a core."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from dpbench.embedded.table import EMBEDDED_FILE, write_counted_steps_atomically
from dpbench.report.write import write_report
from tests.embedded.made_counts import make_counts
from tests.report.browser.conftest import SIZES, check_accessible, opening, selection

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def counted_page(campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of the campaign with counts of two solvers."""
    folder = shutil.copytree(campaign, tmp_path_factory.mktemp("counted") / "standard")
    frames = [make_counts("daqp", [2_000_000] * 200), make_counts("osqp", [4_500_000] * 200)]
    write_counted_steps_atomically(pd.concat(frames), folder / EMBEDDED_FILE)
    return write_report(folder)


@pytest.fixture
def opened(chromium: Any, counted_page: Path) -> Iterator[Any]:
    with opening(chromium, counted_page) as opener:
        yield opener


def cells(page: Any) -> list[list[str]]:
    """Times and shares of the deadline, a row for each solver."""
    rows = page.locator("#core-times tbody tr").all()
    return [[cell.text_content() for cell in row.locator("td").all()[2:]] for row in rows]


def test_the_inputs_give_times_and_stay_in_the_address(opened: Any) -> None:
    page = opened()
    page.click("#embedded summary")
    assert cells(page) == [["20.0 ms", "20.0 ms", "6.7 %"], ["45.0 ms", "45.0 ms", "15 %"]]
    page.fill("#cpi", "2")
    page.press("#cpi", "Enter")
    page.fill("#mhz", "400")
    page.press("#mhz", "Enter")
    page.wait_for_function("document.querySelector('#core-said').textContent.includes('400 MHz')")
    assert cells(page)[0] == ["10.0 ms", "10.0 ms", "3.3 %"]
    assert (selection(page)["cpi"], selection(page)["mhz"]) == ("2", "400")
    again = opened(page.evaluate("location.hash"))
    assert cells(again)[0] == ["10.0 ms", "10.0 ms", "3.3 %"]


def test_an_impossible_clock_becomes_the_usual_one(opened: Any) -> None:
    page = opened("#mhz=0&cpi=-1")
    assert cells(page)[0] == ["20.0 ms", "20.0 ms", "6.7 %"]
    assert (page.input_value("#cpi"), page.input_value("#mhz")) == ("1", "100")


def test_without_scripts_the_usual_clock_is_shown(opened: Any) -> None:
    page = opened(scripts=False)
    assert cells(page) == [["20.0 ms", "20.0 ms", "6.7 %"], ["45.0 ms", "45.0 ms", "15 %"]]
    assert not page.is_visible("#cpi")
    assert " per instruction at 100 MHz;" in page.text_content("#core-said")


def test_a_counted_solver_has_its_speed_margin(opened: Any) -> None:
    output = opened("#s=daqp&slow=2").inner_text("#slow-kept")
    assert "daqp meets both limits up to a slowdown of ×" in output and ", set by its " in output


@SIZES
def test_it_is_accessible(opened: Any, size: tuple[int, int]) -> None:
    check_accessible(opened(size=size), size[0])
