"""The page of a study in a browser: one selection of configuration, point and sea."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from dpbench.report.write import write_report
from tests.conftest import MadeRecords
from tests.report.browser.conftest import (
    SIZES,
    Opener,
    check_accessible,
    opening,
    selection,
    wait_until_ready,
)
from tests.report.conftest import LOOSE, of_seas

pytestmark = pytest.mark.slow

MIDDLE = """async ([name, wanted]) => {
  // The middle of the first symbol or rectangle whose row has what is wanted, on the screen.
  const view = await views[name], test = new Function("row", `return ${wanted}`), found = [];
  const seek = (mark, x, y) => {
    for (const item of mark.items ?? []) {
      const [left, top] = [x + (item.x ?? 0), y + (item.y ?? 0)];
      if (mark.marktype === "group") for (const inner of item.items) seek(inner, left, top);
      else if (["rect", "symbol"].includes(mark.marktype) && item.datum && test(item.datum))
        found.push([left + (item.width ?? 0) / 2, top + (item.height ?? 0) / 2]);
    }
  };
  const { left, top } = view.padding(), [x, y] = view.origin();
  seek(view.scenegraph().root, x + left, y + top);
  document.getElementById(`figure-${name}`).scrollIntoView({ block: "center" });
  const box = view.container().querySelector("svg, canvas").getBoundingClientRect();
  return [found[0][0] + box.left, found[0][1] + box.top];
}"""


@pytest.fixture(scope="module")
def study_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a study alone."""
    return write_report(of_seas(MadeRecords()).write(tmp_path_factory.mktemp("study") / "seas"))


@pytest.fixture
def study_page(chromium: Any, study_file: Path) -> Iterator[Opener]:
    """Opens it."""
    with opening(chromium, study_file) as opener:
        yield opener


def _rows(page: Any, view: str, data: str) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = page.evaluate(
        f"views.{view}.then((view) => view.data('{data}').map((row) => ({{...row}})))"
    )
    return rows


def _click_on(page: Any, view: str, wanted: str) -> None:
    """Click on the mark of a figure whose row has something."""
    at = page.evaluate(MIDDLE, [view, wanted])
    page.mouse.click(*at)
    page.wait_for_timeout(400)


def test_it_opens_where_a_ship_is_lost(study_page: Opener) -> None:
    page = study_page()
    assert page.inner_text("#one-title").startswith("osqp (")
    assert "beyond the radius, at most 1.5 m off" in page.inner_text("#study-said")
    assert "of 4 realisations, and over all points in 18 of 24" in page.inner_text("#study-said")
    assert page.input_value("#study-sea") == "2"
    assert len(_rows(page, "design", "design")) == 6
    assert page.inner_text("#one-said").startswith(
        f"In seas: point {page.input_value('#study-point')}, realisation 2"
    )
    assert len(_rows(page, "strips", "steps")) == 40
    assert not page.locator("#step-export").is_visible()
    assert not page.locator(".paper img").first.is_visible()


def test_a_point_a_row_and_a_dot_are_chosen(study_page: Opener) -> None:
    page = study_page()
    _click_on(page, "design", "row.point === 0")
    assert selection(page)["sc"] == "seas: point 0, realisation 2"
    assert "in 4 of 4 realisations" in page.inner_text("#study-said")
    assert [row["point"] for row in _rows(page, "design", "design") if row["chosen"]] == [0]
    _click_on(page, "seas", "row.replicate === 4 && row.who === 'chosen'")
    assert selection(page)["sc"] == "seas: point 0, realisation 4"
    assert page.inner_text("#one-said").startswith("In seas: point 0, realisation 4")
    _click_on(page, "behind", "row.name === 'osqp' && row.replicate === 3")
    chosen = selection(page)
    assert (chosen["s"], chosen["set"]) == ("osqp", "default")
    assert chosen["sc"] == "seas: point 0, realisation 3"
    marked = [row for row in _rows(page, "behind", "seas") if row["chosen"]]
    assert [(row["name"], row["replicate"]) for row in marked] == [("osqp", 3)]
    assert marked[0]["error_excess_cm"] == pytest.approx(0.6)
    output = page.inner_text("#study-said")
    page.reload()
    wait_until_ready(page)
    assert page.inner_text("#study-said") == output
    page.go_back()
    page.wait_for_function("document.getElementById('study-sea').value === '4'")
    assert selection(page)["set"] == LOOSE


def test_numbers_choose_as_clicks_do(study_page: Opener) -> None:
    page = study_page()
    for control, value in (("point", "1"), ("sea", "3")):
        page.fill(f"#study-{control}", value)
        page.press(f"#study-{control}", "Enter")
    page.wait_for_function(
        "state.p >= 0 && facts.experiments[state.p].label === 'seas: point 1, realisation 3'"
    )
    page.select_option("#study-who", label="daqp")
    page.wait_for_function("C().solver[state.c] === 'daqp'")
    assert page.inner_text("#study-said").count("daqp") == 1
    page.fill("#study-point", "77")
    page.press("#study-point", "Enter")
    assert page.input_value("#study-point") == "1"


@pytest.mark.parametrize(
    ("keys", "values", "form", "heights"),
    [
        (("a", "twin", "b"), lambda i: (i % 10, 2.0 * (i % 10), i // 10), "design_tiles", {0, 1}),
        (("a", "b"), lambda i: (0.1 * i, 0.3 * (7 * i % 20)), "design_points", None),
        (("a",), lambda i: (0.5 * i,), "design_points", {100, 0}),
    ],
    ids=["zipped", "drawn", "one key"],
)
def test_a_design_is_drawn_over_what_tells_points_apart(
    chromium: Any, tmp_path: Path, keys: Any, values: Any, form: str, heights: Any
) -> None:
    records = MadeRecords()
    for point in range(20):
        x = dict(zip(keys, values(point), strict=True))
        for solver in ("daqp", "osqp"):
            lost = solver == "osqp" and point == 3
            records.sea(solver, point, 1, x, tail_m=2.0 if lost else 0.5, closed_loop_cost=100.0)
    with opening(chromium, write_report(records.write(tmp_path / "drawn"))) as opener:
        page = opener()
        assert page.evaluate("forms.design") == form
        rows = _rows(page, "design", "design")
        assert len(rows) == 20
        found = {row["y"] for row in rows}
        assert found == heights if heights else len(found) > 10
        assert [row["point"] for row in rows if row["state"] == "none within"] == [3]


@SIZES
def test_it_is_seen_and_read(study_page: Opener, size: tuple[int, int]) -> None:
    page = study_page(size=size)
    check_accessible(page, size[0])
    assert page.evaluate("document.querySelectorAll('*').length") <= 3000


def test_without_scripts_maps_effects_and_seas_are_pictures(study_page: Opener) -> None:
    page = study_page(scripts=False)
    assert page.locator(".paper img").count() == 3
    assert page.locator(".paper img").first.is_visible()
    assert not page.locator("#study-live").is_visible()
