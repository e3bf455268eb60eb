"""Appearance of the page: for a screen reader, on a phone, in the dark, and positions of texts."""

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from dpbench.report.write import write_report
from tests.conftest import MadeRecords
from tests.report.browser.conftest import (
    AXE,
    PHONE,
    SCHEMES,
    SIZES,
    check_accessible,
    click_middle,
    opening,
)

pytestmark = pytest.mark.slow
CHOSEN = "#s=osqp&w=qpsolvers-fresh&set=default&sc=paper&k=74"

TEXTS = """async (names) => {
  // All figures as SVG, those on a canvas too, at the size they have on the page.
  const out = [];
  for (const name of names) {
    const host = document.getElementById(`figure-${name}`);
    if (!host || host.hidden) continue;
    let root = host.querySelector("svg"), aside = null;
    if (!root) {
      aside = document.createElement("div");
      aside.innerHTML = await (await views[name]).toSVG();
      document.body.append(aside);
      root = aside.querySelector("svg");
      root.style.maxWidth = "none";
    }
    const scale = root.getBoundingClientRect().width / root.viewBox.baseVal.width;
    for (const text of root.querySelectorAll("text")) {
      const box = text.getBoundingClientRect(), turn = /rotate\\((-?[\\d.]+)/.exec(
        text.getAttribute("transform") ?? "");
      if (!text.textContent.trim() || !+getComputedStyle(text).opacity || !box.width) continue;
      out.push({ figure: name, text: text.textContent, turn: turn ? Number(turn[1]) : 0,
        size: parseFloat(getComputedStyle(text).fontSize) * scale,
        left: box.left, right: box.right, top: box.top, bottom: box.bottom });
    }
    aside?.remove();
  }
  return out;
}"""
FIGURES = ["ladder", "matrix", "accuracy", "strips", "pairs", "ship"]


def test_axe_is_what_its_list_says() -> None:
    entry = json.loads((AXE / "axe.json").read_text())
    script = (AXE / entry["file"]).read_bytes()
    assert hashlib.sha256(script).hexdigest() == entry["sha256"]
    assert f"axe v{entry['version']}".encode() in script[:40]
    assert "Mozilla Public License" in (AXE / entry["licence_file"]).read_text()
    assert {item.name for item in AXE.iterdir()} == {
        "axe.json",
        entry["file"],
        entry["licence_file"],
    }


@SIZES
def test_axe_has_nothing_to_say(opened: Any, size: tuple[int, int]) -> None:
    check_accessible(opened(CHOSEN, size=size), size[0])


def test_the_axis_of_accuracy_names_the_chosen_percentile(opened: Any) -> None:
    page = opened(CHOSEN)
    for percentile in ("p50", "p99"):
        page.select_option("#percentile", percentile)
        titled = f"{percentile} of the step time [µs], log scale"
        page.locator("#figure-accuracy text").filter(has_text=titled).wait_for()


def test_who_has_no_name_among_the_points_is_named_below_when_chosen(opened: Any) -> None:
    page = opened(CHOSEN, size=PHONE)
    assert "the selected configuration, osqp (" in page.inner_text("#accuracy figcaption")
    points = page.locator("#figure-accuracy .mark-symbol path[aria-label*='solver: quadprog']")
    click_middle(page, points.first)
    page.wait_for_function("location.hash.includes('s=')")
    page.wait_for_timeout(300)
    chosen = page.evaluate("label(state.c)")
    assert f"the selected configuration, {chosen}." in page.inner_text("#accuracy figcaption")
    page.evaluate(
        """() => select({ c: all().find((c) => !rowsDrawn("accuracy").values
          .some((row) => Number(row.id) === c)) })"""
    )
    page.wait_for_timeout(300)
    assert "is not in this figure" in page.inner_text("#accuracy figcaption")


# The narrowest of each layout; the tests with axe look at the width of PHONE and DESK too.
@pytest.mark.parametrize("width", [320, 768, 1024, 1280])
def test_nothing_scrolls_sideways(opened: Any, width: int) -> None:
    page = opened(CHOSEN, size=(width, 844))
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    named = "new Option('a long name '.repeat(20))"
    page.evaluate(f"document.querySelector('#choose-experiment').add({named})")
    assert page.evaluate("document.documentElement.scrollWidth") <= width, "by a name in a menu"
    boxes = page.evaluate(
        """() => [...document.querySelectorAll("body *")].filter((node) => {
          const style = getComputedStyle(node);
          return /auto|scroll/.test(style.overflowX + style.overflowY)
            && !["SELECT", "TEXTAREA"].includes(node.tagName);
        }).map((node) => node.outerHTML.slice(0, 120))"""
    )
    assert boxes == []


def test_sections_and_experiments_stay_on_a_phone(opened: Any) -> None:
    page = opened(CHOSEN, size=PHONE)
    commands = page.locator(".commands button").first.bounding_box()
    assert commands["y"] + commands["height"] < PHONE[1]
    assert page.locator("#slow").bounding_box()["y"] < PHONE[1]
    page.evaluate("scrollTo(0, document.documentElement.scrollHeight)")
    line = page.locator(".top").bounding_box()
    assert line["y"] == 0 and line["height"] < 50, "one line"
    menu = page.locator("#sections")
    box = menu.bounding_box()
    assert box["height"] >= 24, "as high as a finger needs"
    assert box["x"] >= 0 and box["x"] + box["width"] <= PHONE[0]
    names = page.locator("nav a").all_text_contents()
    assert menu.locator("option").all_text_contents() == names
    menu.select_option("data")
    assert page.evaluate("document.activeElement.id") == "data"
    assert page.locator("#data h2").bounding_box()["y"] >= line["y"] + line["height"]
    menu.select_option("answer")
    assert page.evaluate("document.activeElement.id") == "answer"
    levels = page.evaluate("unique(rowsDrawn('matrix').values.map((row) => row.settings)).length")
    heads = page.locator("#figure-matrix text").get_by_text("paper_tight", exact=True)
    assert heads.count() == levels > 1


def _overlapping(texts: list[dict[str, Any]]) -> list[tuple[str, str, str]]:
    """Pairs of texts of a figure that lie on each other."""
    overlapping = []
    for i, a in enumerate(texts):
        for b in texts[i + 1 :]:
            if a["figure"] != b["figure"]:
                continue
            if a["turn"] % 90 or b["turn"] % 90:
                # Neighbours of equal slant: the distance across the direction of writing.
                if a["turn"] == b["turn"] and abs(a["left"] - b["left"]) * 0.64 < 11:
                    overlapping.append((a["figure"], a["text"], b["text"]))
                continue
            wide = min(a["right"], b["right"]) - max(a["left"], b["left"])
            high = min(a["bottom"], b["bottom"]) - max(a["top"], b["top"])
            # The box of a text has its line's height, more than its letters.
            if wide > 1.0 and high > 4.0:
                overlapping.append((a["figure"], a["text"], b["text"]))
    return overlapping


@SIZES
def test_no_two_texts_of_a_figure_overlap(opened: Any, size: tuple[int, int]) -> None:
    page = opened(CHOSEN, size=size)
    texts = page.evaluate(TEXTS, FIGURES)
    assert {text["figure"] for text in texts} >= {"ladder", "matrix", "accuracy", "strips", "pairs"}
    assert _overlapping(texts) == []
    assert size != PHONE or [text for text in texts if text["size"] < 11.5] == [], "12 pixels"


def test_many_experiments_and_levels_stand_below_each_other(chromium: Any, tmp_path: Path) -> None:
    """The cells of all levels of a few solvers are too many for a row: no two names overlap, and
    the arrow keys go as the eye does."""
    records = MadeRecords()
    experiments = [f"paper_of_some_length_{i}" for i in range(20)]
    for name in experiments:
        records._scenarios[name] = records.scenario("paper")
        for level in ("default", "low", "mid", "high"):
            records.loop("daqp", name, steps=10, settings=level)
            records.loop("osqp", name, steps=10, settings=level)
    with opening(chromium, write_report(records.write(tmp_path / "many"))) as opened:
        page = opened()
        assert _overlapping(page.evaluate(TEXTS, ["matrix"])) == []
        page.focus("#figure-matrix")
        chosen = page.evaluate("[C().solver[state.c], facts.experiments[state.p].label]")
        page.keyboard.press("ArrowDown")
        below = page.evaluate("[C().solver[state.c], facts.experiments[state.p].label]")
        assert (
            below[0] == chosen[0]
            and experiments.index(below[1]) == experiments.index(chosen[1]) + 1
        )


def test_bars_have_the_width_of_a_phone(opened: Any) -> None:
    page = opened(CHOSEN + "&slow=10", size=PHONE)
    width = page.evaluate("views.ladder.then((view) => view.width())")
    assert width > 300
    names = page.locator("#figure-ladder .role-axis-label text")
    rows = page.evaluate("rowsDrawn('ladder').values.map((row) => row.label)")
    boxes = {
        one.text_content(): one.bounding_box() for one in names.all() if one.text_content() in rows
    }
    assert list(boxes) == rows
    marks = page.locator("#figure-ladder .mark-symbol.role-mark path[aria-label]").evaluate_all(
        """(all) => all.map((one) => [one.getAttribute("aria-label"), one.getBoundingClientRect()])
          .map(([label, box]) => [label, (box.top + box.bottom) / 2])"""
    )
    for label, middle in marks:
        (name,) = [row for row in rows if f"configuration: {row}. " in label]
        box = boxes[name]
        assert box["y"] < middle and middle - (box["y"] + box["height"]) < 8


def test_a_point_that_is_open_is_not_filled_like_one_that_meets(selected: Any) -> None:
    page = selected()
    dots = page.locator(
        "#figure-accuracy .mark-symbol path[aria-label*='verdict: '][fill-opacity]"
    ).all()
    opacity: dict[str, set[str]] = {}
    for dot in dots:
        state = str(dot.get_attribute("aria-label")).split("verdict: ")[1].split(".")[0]
        opacity.setdefault(state, set()).add(str(dot.get_attribute("fill-opacity")))
    assert opacity["pass"] == {"0.95"} and opacity["fail"] == {"0"}
    assert opacity["inconclusive"] == {"0.3"}
    legend = page.locator("#figure-accuracy .role-legend-label").all_text_contents()
    assert {"pass", "borderline", "inconclusive", "late or fail"} <= {*legend}


@SCHEMES
def test_signs_of_the_tiles_can_be_read(opened: Any, scheme: str) -> None:
    """Contrast of each sign to its tile, and of a figure's letters to the page: 4.5 to 1."""
    page = opened(scheme=scheme)
    style = page.evaluate(
        """() => Object.fromEntries(["good", "bad", "warn", "late", "none", "ink", "soft", "paper",
          "good-fill", "bad-fill", "warn-fill", "late-fill", "none-fill"].map((name) => [name,
            getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim()]))"""
    )

    def luminance(colour: str) -> float:
        parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    def contrast(a: str, b: str) -> float:
        low, high = sorted((luminance(style[a]), luminance(style[b])))
        return (high + 0.05) / (low + 0.05)

    for state in ("good", "bad", "warn", "late", "none"):
        assert contrast(state, f"{state}-fill") >= 4.5
        assert contrast(state, "paper") >= 4.5
    assert min(contrast("ink", "paper"), contrast("soft", "paper")) >= 4.5
