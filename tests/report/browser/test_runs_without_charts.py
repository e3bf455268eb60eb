"""Runs without a chart of their own: windows and call modes that are refused."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from dpbench.report.write import write_report
from tests.report.browser.conftest import opening


@pytest.fixture
def select(records: Any, chromium: Any, tmp_path: Path) -> Iterator[Callable[[str], Any]]:
    """The page of one solver with a closed loop, a window of it, and a refused call mode."""
    records.loop("daqp", "paper")
    records.loop("daqp", "turn", steps=240)
    cell = json.dumps({"source": {"kind": "hardest", "name": "turn hardest 30", "of": 450}})
    window = {"steps": 30, "first_sample": 210, "scenario": "turn", "cell": cell}
    records.replay("daqp", "turn hardest 30", spread=0.0, slow={3: 10.0}, **window)
    records.refused("daqp", "it keeps no start", mode="replay", route="native", policy="warm")
    with opening(chromium, write_report(records.write(tmp_path / "windows"))) as opener:
        yield opener.select


def test_a_refused_call_mode_is_not_run(select: Callable[[str], Any]) -> None:
    page = select("#s=daqp&w=native-warm&set=default&sc=paper%20(replay)")
    text = page.inner_text("#one-said")
    wanted = (
        "daqp was not run in paper (replay), as it does not support this call mode "
        "(it keeps no start)."
    )
    assert text.startswith(wanted)
    assert not any(word in text for word in ("null", "inconclusive", "verdict", "largest error"))


def test_the_query_is_of_the_limiting_p99_at_opening(select: Callable[[str], Any]) -> None:
    page = select("")
    assert page.evaluate("facts.experiments[state.p].label") == "paper"
    assert "turn, window of steps 210 to 239" in page.text_content("#data-query")
    page.locator("#table-body tr", has_text="paper").nth(0).locator("button").click()
    page.wait_for_function("location.hash.includes('sc=paper')")
    assert "in paper\n" in f"{page.text_content('#data-query')}\n"


def test_replays_alone_open_with_the_replay_of_the_first_line(
    records: Any, chromium: Any, tmp_path: Path
) -> None:
    records.replay("daqp", "paper")
    records.replay("daqp", "rough", median_us=90.0)
    with opening(chromium, write_report(records.write(tmp_path / "replays"))) as opener:
        page = opener.select("")
        assert "in rough" in page.inner_text("#chosen")
        shown = page.evaluate(
            "document.querySelector('#choose-experiment').selectedOptions[0].text"
        )
        assert shown.startswith("rough")


def test_a_window_in_the_table_shows_its_closed_loop(select: Callable[[str], Any]) -> None:
    page = select("#s=daqp&w=qpsolvers-fresh&set=default&sc=paper")
    row = page.locator("#table-body tr", has_text="turn, window of steps 210 to 239")
    row.locator("button").click()
    page.wait_for_function("state.window !== null")
    assert page.input_value("#choose-experiment") == page.evaluate(
        "String(facts.experiments.findIndex(({ label }) => label === 'turn'))"
    )
    assert page.inner_text("#one-said").startswith("A window has no chart of its own")
    assert row.get_attribute("aria-current") == "true"
    assert page.locator("#table-body tr[aria-current]").count() == 1
    query = page.text_content("#data-query")
    run_id = page.evaluate("valueOf('run_id', state.window)")
    assert run_id in query and "turn, window of steps 210 to 239" in query
    page.locator("#table-body tr", has_text="turn").nth(0).locator("button").click()
    page.wait_for_function("state.window === null")
    assert "A window" not in page.inner_text("#one-said")


def test_a_step_of_a_window_has_both_times(select: Callable[[str], Any]) -> None:
    page = select("#s=daqp&w=qpsolvers-fresh&set=default&sc=turn")
    page.locator("#hard details button", has_text="turn, step 213: 200 µs").first.click()
    page.wait_for_function("state.k === 213")
    text = page.inner_text("#step-said")
    assert " in the closed loop shown (200 µs in its window, fastest round), " in text
