"""The page in a browser: its selection, its figures, its files, and nothing else."""

import io
import re
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from dpbench.analysis.times.paired_times import compare_paired_times
from dpbench.analysis.verdict.requirements import LATE
from dpbench.bench.record.cell import Configuration
from dpbench.report.formats import format_rounded_down
from dpbench.report.page.recommendation import format_python_call
from dpbench.report.verdict.verdict_text import describe_lateness
from dpbench.report.write import write_report
from dpbench.scenario.scenario import load_scenario
from tests.conftest import MadeRecords
from tests.report.browser.conftest import (
    DESK,
    SIZES,
    click_middle,
    opening,
    selection,
    wait_until_ready,
)

pytestmark = pytest.mark.slow
DRAWN = ("ladder", "matrix", "accuracy")
CHOSEN = "#s=piqp&w=qpsolvers-fresh&set=default&sc=rough&k=74"


def wait_for_strips(page: Any) -> None:
    """Wait until the strips show the configuration that the address names."""
    page.wait_for_timeout(400)


def rows_in(page: Any, view: str, data: str) -> int:
    """Rows of a data set of a figure."""
    count: int = page.evaluate(f"views.{view}.then((view) => view.data('{data}').length)")
    return count


def test_it_opens_without_error_or_request(opened: Any) -> None:
    page = opened()
    assert [url for url in opened.requests if not url.startswith("data:")] == [opened.file.as_uri()]
    assert page.inner_text("#answer .lead").startswith("Use ")
    assert page.locator("#figure-ladder svg").bounding_box()["y"] < 900
    assert page.locator("#slow").bounding_box()["y"] < 900
    assert page.evaluate("document.querySelectorAll('*').length") <= 3000
    assert page.evaluate("document.documentElement.scrollHeight") <= 9 * 900


def test_it_answers_without_scripts(opened: Any) -> None:
    page = opened(scripts=False)
    assert page.inner_text("#answer .lead").startswith("Use ")
    for name in DRAWN:
        assert page.locator(f"#figure-{name} svg text").count() > 5
    assert page.locator("#data table a").count() >= 3
    assert "tables/runs.csv" in page.inner_text("noscript")
    for control in page.locator("button, select, input").all():
        assert not control.is_visible()


def test_a_row_of_the_ladder_is_chosen_by_a_click(selected: Any) -> None:
    page = selected()
    name = page.locator("#figure-ladder text", has_text="clarabel")
    box, figure = name.bounding_box(), page.locator("#figure-ladder").bounding_box()
    page.mouse.click(figure["x"] + 0.7 * figure["width"], box["y"] + box["height"] / 2)
    page.wait_for_function("location.hash.includes('s=clarabel')")
    wait_for_strips(page)
    assert page.inner_text("#one-title").startswith("clarabel (")
    assert re.match(
        r"clarabel \(.*\), overall verdict (pass|late|fail|inconclusive), p50 .* in .*, "
        r"(limiting p99|longest step) of .* \((limit|deadline) .*\)",
        page.inner_text("#chosen"),
    )
    assert page.input_value("#choose-other") == str(page.evaluate("facts.answer.first"))
    assert rows_in(page, "strips", "steps") >= 100
    marked = page.evaluate("views.ladder.then((view) => view.data('pick_store')[0].values)")
    assert marked == [str(page.evaluate("state.c"))]


def test_a_tile_of_the_matrix_chooses_the_experiment_too(selected: Any) -> None:
    page = selected()
    wanted = page.locator(
        "#figure-matrix path[aria-label*='solver: highs'][aria-label*='scenario or replay: calm']"
    )
    click_middle(page, wanted.first)
    page.wait_for_function("location.hash.includes('s=highs')")
    wait_for_strips(page)
    assert selection(page)["sc"] == "calm"
    assert page.inner_text("#one-said").startswith(("highs passes in calm", "highs fails in calm"))
    below = page.inner_text("#matrix-said")
    assert re.match(r"highs \(.*\) (passes|fails) in calm", below)
    assert "it ran 200 of 200 steps" in page.inner_text("#one-said")
    assert rows_in(page, "strips", "steps") >= 100
    assert rows_in(page, "strips", "forces") >= 100


def test_a_row_of_the_table_is_chosen_by_a_click(opened: Any) -> None:
    page = opened()
    page.select_option("#table-of", "all")
    page.fill("#table-filter", "quadprog")
    row = page.locator("#table-body tr").nth(1)
    row.scroll_into_view_if_needed()
    before = row.bounding_box()
    row.locator("td").nth(3).click()
    page.wait_for_function("location.hash.includes('s=quadprog')")
    wait_for_strips(page)
    assert page.locator("#table-body tr[aria-current]").count() == 1
    assert row.get_attribute("aria-current") == "true"
    assert abs(row.bounding_box()["y"] - before["y"]) < 30
    assert page.inner_text("#chosen").startswith("quadprog (")
    line = page.locator("#chosen").bounding_box()
    assert line["y"] >= 0 and line["x"] + line["width"] <= DESK[0]
    assert page.inner_text("#one-title").startswith("quadprog (")
    row.locator("button").click()
    assert page.evaluate("document.activeElement.id") == "one"


def test_a_hard_step_opens(selected: Any) -> None:
    page = selected()
    page.select_option("#choose-experiment", label="paper (replay)")
    wait_for_strips(page)
    page.locator("#hard summary", has_text="of paper (replay)").click()
    button = page.locator("#hard details").last.locator("button").first
    k = re.match(r"step (\d+):", button.inner_text())
    button.click()
    wait_for_strips(page)
    assert selection(page)["k"] == k[1]
    assert f"Step {k[1]}:" in page.inner_text("#step-said")
    assert f"--at {k[1]} --out step-{k[1]}.npz" in page.inner_text("#step-export")
    assert page.evaluate("views.strips.then((view) => view.signal('at'))") == int(k[1])
    assert page.locator("#hard button[aria-pressed=true]").count() >= 1
    run_id = page.evaluate("cell(state.c, state.p).id")
    assert run_id in page.inner_text("#step-query")
    assert "north" not in page.inner_text("#step-said")
    assert not page.locator("#ship").is_visible()
    drawn = page.evaluate("facts.charts[forms.strips].data.map((data) => data.name)")
    assert "steps" in drawn and "forces" not in drawn
    assert rows_in(page, "strips", "steps") >= 100
    wide = page.locator("#figure-strips canvas").bounding_box()["width"]
    page.select_option("#choose-experiment", label="paper")
    wait_for_strips(page)
    assert rows_in(page, "strips", "forces") >= 100
    assert page.locator("#figure-strips canvas").bounding_box()["width"] < wide
    assert page.locator("#figure-strips canvas").count() == 1


def test_a_range_has_the_steps_of_its_scenario_and_a_doubt_its_reason(opened: Any) -> None:
    """`k` of the table of steps starts at the range."""
    page = opened("#s=daqp&w=qpsolvers-fresh&set=default&sc=paper (replay)")
    page.evaluate("""async () => {
      facts.experiments[state.p].first = 900;
      facts.cells.first = facts.cells.first.map((first) => first + 900);
      facts.cells.reason = facts.cells.reason.map(() => "its p99 is unknown");
      select({ k: 907 });
      await draw();
    }""")
    said = page.text_content("#one-said"), page.text_content("#matrix-said")
    assert "Reason for this verdict: its p99 is unknown." in said[0]
    assert ": its p99 is unknown. Show" in said[1]
    assert page.text_content("#step-said").startswith("Step 907:")
    assert "--at 907 --out step-907.npz" in page.text_content("#step-export")
    assert '("k", "==", 7)' in page.text_content("#step-query")
    assert page.evaluate("views.strips.then((view) => view.signal('at'))") == 907


def test_a_click_among_the_strips_opens_the_nearest_step(selected: Any) -> None:
    page = selected("#s=daqp&w=qpsolvers-fresh&set=default&sc=paper")
    canvas = page.locator("#figure-strips canvas")
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    wanted = page.evaluate(
        """(x) => views.strips.then((view) =>
          view.scale("x").invert(x - view.origin()[0] - view.padding().left))""",
        0.6 * box["width"],
    )
    page.mouse.click(box["x"] + 0.6 * box["width"], box["y"] + 100)
    page.wait_for_function("state.k !== null")
    assert abs(int(selection(page)["k"]) - wanted) < 4.0, "a dot there is the step it stands for"


def test_the_hardest_steps_are_those_of_all_experiments_then_of_one(selected: Any) -> None:
    page = selected("#s=daqp&w=qpsolvers-fresh&set=default&sc=paper")
    _, here = page.locator("#hard details").all()
    assert here.locator("summary").inner_text() == "Extreme steps of paper"
    heads = page.locator("#hard span").all_text_contents()
    error = "largest error of the first move [maximum increments]"
    own = [error, "largest single timings, including interruptions by other load"]
    assert heads[0] == "largest step times of replays and windows, each in its fastest round"
    assert heads[-2:] == own
    runs = page.evaluate(
        "facts.experiments.map((_, p) => cell(state.c, p)).filter((run) => run?.hard)"
    )
    experiments = page.evaluate("facts.experiments.map(({ trial, mode }) => ({ trial, mode }))")
    worst = page.evaluate("worstAnywhere(0)")
    assert worst == sorted(worst, key=lambda step: -step["value"])
    wanted = {"trial": False, "mode": "replay"}
    assert page.evaluate("[written(1, 6525), written(2, 6525)]") == ["6\u202f525", "6\u202f530"]
    judged = [run["hard"][0][0][1] for run in runs if experiments[run["p"]] == wanted]
    assert worst[0]["value"] == max(judged)
    page.locator("#hard details button").first.click()
    experiment = page.evaluate(f"facts.experiments[{worst[0]['p']}].label")
    page.wait_for_function(f"state.p === {worst[0]['p']} && state.k === {worst[0]['k']}")
    assert selection(page)["sc"] == experiment


def test_the_call_is_that_of_the_chosen_one(selected: Any) -> None:
    assert not selected().locator("#one-call").is_visible(), "it would stand there twice"
    page = selected("#s=osqp&w=qpsolvers-fresh&set=high&sc=paper")
    first = page.text_content("#paste-1")
    assert page.text_content("#one-call") == format_python_call(
        Configuration("osqp", "qpsolvers", "fresh", "high")
    )
    codegen = "# C code:\n# dpbench codegen SCENARIO --out DIR\n#   --solver osqp"
    assert codegen in page.text_content("#one-call")
    assert "eps_abs=" in page.text_content("#one-call")
    assert page.locator("[data-copy='one-call']").is_visible()
    page.select_option("#choose-solver", "piqp")
    page.wait_for_function("$('one-call').textContent.includes('piqp')")
    assert page.text_content("#paste-1") == first


def test_the_table_has_pages_and_what_has_no_value_stands_last(opened: Any) -> None:
    page = opened()
    page.select_option("#table-of", "all")
    first = page.locator("#table-body tr").all_inner_texts()
    page.click("#table-next")
    second = page.locator("#table-body tr").all_inner_texts()
    assert len(first) == 20 and second and first != second
    assert page.inner_text("#table-said").startswith(f"rows 21 to {20 + len(second)} of ")
    page.click("#table-back")
    assert page.locator("#table-body tr").all_inner_texts() == first
    assert page.is_disabled("#table-back")
    label = page.evaluate(
        """() => facts.table.columns.find((column, j) => column.group === "times"
          && facts.table.values[j].includes(null)).label"""
    )
    for _ in range(2):
        page.get_by_role("button", name=label, exact=True).click()
        values = page.evaluate("state.rows.map((i) => facts.table.values[sorting.column][i])")
        known = [value for value in values if value is not None]
        assert values == known + [None] * (len(values) - len(known)) and len(known) < len(values)
    assert known == sorted(known, reverse=True)


def test_the_flags_of_a_step_are_links_to_their_meaning(selected: Any) -> None:
    page = selected("#s=daqp&w=qpsolvers-fresh&set=default&sc=paper&k=74")
    change = "run => { array(run.f)[74] = 1 + 4 + 32; drawStep(run); }"
    page.evaluate(f"({change})(cell(state.c, state.p))")
    said = "Its solution fails the referee's test of optimality. Flags: failed step, clipped. Ship"
    assert said in page.inner_text("#step-said")
    for term in page.query_selector_all("#step-said a.term"):
        assert page.query_selector(term.get_attribute("href")) and term.get_attribute("title")


def test_a_step_of_a_loop_says_where_the_ship_is(selected: Any, campaign: Path) -> None:
    page = selected("#s=daqp&w=qpsolvers-fresh&set=default&sc=paper&k=74")
    output = page.inner_text("#step-said").replace("−", "-")
    number = r"([\d.e-]+)"
    ship = re.search(
        rf"Ship(?: at step (\d+), the nearest one stored)?: {number} m north, {number} m east, "
        rf"heading {number}°; forces surge {number} %",
        output,
    )
    k = int(ship[1] or 74)
    assert abs(k - 74) < page.evaluate("trackOf(cell(state.c, state.p)).every")
    run_id = page.evaluate("cell(state.c, state.p).id")
    steps = pd.read_parquet(campaign / "steps.parquet", filters=[("run_id", "==", run_id)])
    row = steps[steps["k"] == k].iloc[0]
    limit = load_scenario("paper").vessel.tau_max[0]
    assert float(ship[2]) == pytest.approx(row["n_m"], rel=0.005, abs=2e-3)
    assert float(ship[3]) == pytest.approx(row["e_m"], rel=0.005, abs=2e-3)
    assert float(ship[5]) == pytest.approx(100 * row["tau_x_N"] / limit, rel=0.05, abs=0.2)


def test_the_query_is_that_of_the_selected_run(selected: Any, campaign: Path) -> None:
    """The lines of a replay give the p99 that the page names."""
    page = selected("#s=daqp&w=qpsolvers-fresh&set=default&sc=paper_tight")
    loop_id = page.evaluate("cell(state.c, state.p).id")
    assert loop_id in page.text_content("#data-query")
    page = selected("#s=daqp&w=qpsolvers-fresh&set=default&sc=paper+(replay)")
    output = page.text_content("#data-query")
    run = re.search(r'"run_id", "==", "(\w+)"', output)
    assert run and "(replay)" in output
    steps = pd.read_parquet(campaign / "steps.parquet", filters=[("run_id", "==", run[1])])
    (total,) = (line.partition("= ")[2] for line in output.splitlines() if "total_ns = " in line)
    total_ns = eval(total, {"steps": steps})
    p50_us = total_ns[steps.counts].groupby(steps.k).min().quantile(0.5) / 1e3
    time = page.evaluate(f"time({1e3 * p50_us})").replace(" ", "\xa0")
    assert f"p50 {time}" in page.inner_text("#chosen")


def test_the_slider_moves_the_ladder(selected: Any) -> None:
    page = selected()
    first = page.locator("#figure-ladder .mark-symbol path").first
    before = first.bounding_box()["x"]
    page.focus("#slow")
    for stop in (2, 5, 10):
        page.keyboard.press("ArrowRight")
        assert float(selection(page)["slow"]) == stop
    wait_for_strips(page)
    assert first.bounding_box()["x"] > before + 40
    assert page.input_value("#slow-said") == "10"


def test_replays_alone_are_counted_as_uncontradicted(chromium: Any, tmp_path: Path) -> None:
    """No solver passes by replays alone: the page does not say "0 of the 0"."""
    records = MadeRecords()
    for solver in ("daqp", "osqp"):
        records.replay(solver, steps=200)
    with opening(chromium, write_report(records.write(tmp_path / "replays"))) as opened:
        output = opened("#slow=2").inner_text("#slow-kept").replace("\xa0", " ")
    assert ", both borderline or inconclusive solvers still meet both limits" in output, output


def test_a_bound_is_never_rounded_up(selected: Any) -> None:
    page = selected()
    for value in (245.9, 246.0, 29.96, 1234.9, 1.0049, 0.4567, 99_950.0):
        shown = page.evaluate(f"roundedDown({value})").replace("\u202f", "")
        assert float(shown) == float(format_rounded_down(value).replace("\u202f", ""))


def test_the_speed_margin_decides_on_slower_computers(selected: Any, written: Any) -> None:
    page = selected()
    for slow in (1, 200, 2000, 10_000):
        _check_speed_margins(page, written.report.data, slow)


def test_the_slowdown_names_custom_settings(opened: Any) -> None:
    page = opened()
    page.evaluate("C().settings.fill('mine')")
    page.fill("#slow-said", "50")
    page.press("#slow-said", "Enter")
    wait_for_strips(page)
    kept = page.inner_text("#slow-kept").replace("\xa0", " ")
    assert re.match(r"\w+ with settings mine ", kept) and " with settings mine (up to × " in kept


def _check_speed_margins(page: Any, facts: Any, slow: int) -> None:
    """Enter a slowdown and check which solvers the page names, and marks as late, by it."""
    page.fill("#slow-said", str(slow))
    page.press("#slow-said", "Enter")
    wait_for_strips(page)
    assert slow == 1 or selection(page)["slow"] == str(slow)
    drawn = page.evaluate("rowsDrawn('ladder').values")
    bounds = {}
    for row in drawn:
        margin = facts.get_speed_margin(facts.configurations[int(row["id"])])
        assert margin is not None and margin.allowed_slowness_factor == pytest.approx(row["margin"])
        bounds[int(row["id"])] = margin.allowed_slowness_factor
    right = [row for row in drawn if row["verdict"] == "pass"]
    keep = [row for row in right if bounds[int(row["id"])] >= slow]
    output = page.inner_text("#slow-kept").replace("\xa0", " ")
    meet = f"{'still ' * (slow > 1)}{'meets' if len(keep) == 1 else 'meet'}"
    limits = "both limits (p99 of 3 ms, longest step of 300 ms)"
    count = f"all {len(right)}" if keep == right else f"{len(keep)} of the {len(right)}"
    slowdown = f"{slow:,}".replace(",", "\u202f")
    assert f"At a slowdown of × {slowdown}, {count} passing solvers {meet} {limits}" in output
    assert len(right) < len(drawn)
    named = [f"{r['solver']} (up to × {format_rounded_down(bounds[int(r['id'])])})" for r in keep]
    assert all((name in output) == (slow > 1 or len(keep) <= 4) for name in named)
    labels = page.locator("#figure-ladder .mark-symbol path[aria-label]").evaluate_all(
        "(all) => all.map((one) => one.getAttribute('aria-label'))"
    )
    met = {
        label.split("configuration: ")[1].split(" (")[0]
        for label in labels
        if "verdict at this slowdown: pass" in label
    }
    assert met == {row["solver"] for row in keep}
    measured = r"largest single timing \[ms\]: [\d.e-]+, as measured"
    assert slow == 1 or all(re.search(measured, label) for label in labels)
    verdicts = {verdict.configuration: verdict for verdict in facts.verdicts.all_verdicts}
    for c, bound in bounds.items():
        page.evaluate(f"select({{ c: {c} }})")
        output = page.inner_text("#slow-kept").replace("\xa0", " ")
        verdict = verdicts[facts.configurations[c]]
        share = 100 * slow / bound
        said = re.search(r"this time is at ([^%]+) % of its limit", output)
        assert slow == 1 or said is not None, output
        assert said is None or float(re.sub(r"\s", "", said[1])) == pytest.approx(share, rel=0.06)
        if slow == 1 and c == page.evaluate("facts.answer.first"):
            assert output.startswith("At a slowdown of × 1, "), "its margin is in the summary"
            continue
        if verdict.state == "fail":
            assert " fails, so it has no speed margin. " in output and "up to a" not in output
            continue
        if any(cause.kind in LATE for cause in verdict.causes):
            assert f" is late on this machine ({describe_lateness(verdict)}).".replace("`", "") in (
                output.replace("`", "")
            )
            continue
        assert (" meets both limits up to a slowdown of × " in output) == (bound >= slow)
        late = (
            " is late beyond a slowdown of × "
            if bound >= 1
            else " exceeds a limit on this machine (speed margin × "
        )
        assert (late in output) == (bound < slow)
        other = f" that were run (overall verdict: {verdict.state})"
        assert (other in output) == (bound >= 1 and verdict.state != "pass")
        assert (
            ", set by its limiting p99 of " in output or ", set by its longest step of " in output
        )


def test_reload_and_back_restore(opened: Any) -> None:
    page = opened(CHOSEN + "&slow=50")
    assert page.input_value("#choose-solver") == "piqp"
    assert page.input_value("#slow-said") == "50"
    output = page.inner_text("#step-said")
    assert output.startswith("Step 74:")
    page.select_option("#choose-solver", "scs")
    page.wait_for_function("location.hash.includes('s=scs')")
    page.reload()
    wait_until_ready(page)
    assert page.input_value("#choose-solver") == "scs"
    page.go_back()
    page.wait_for_function("document.getElementById('choose-solver').value === 'piqp'")
    wait_for_strips(page)
    assert page.inner_text("#step-said") == output
    assert page.input_value("#slow-said") == "50"


def test_every_scenario_is_explained(opened: Any) -> None:
    page = opened()
    title = load_scenario("paper_tight").title
    chip = page.locator(".chips a", has_text="paper_tight").first
    assert str(chip.get_attribute("title")).startswith(title)
    name = page.locator("#figure-matrix text", has_text="paper_tight").first
    name.scroll_into_view_if_needed()
    box = name.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.wait_for_selector("#tip:not([hidden])")
    assert title in page.inner_text("#tip")
    chip.click()
    assert selection(page)["sc"] == "paper_tight"
    assert page.evaluate("document.activeElement.id") == "one"
    experiments = page.evaluate(
        "facts.experiments.filter((experiment) => !experiment.study).map((p) => p.label)"
    )
    assert {*experiments} <= {*page.locator("#words dt").all_text_contents()}


def test_a_term_says_what_it_means(opened: Any) -> None:
    page = opened(CHOSEN)
    before = selection(page)
    term = page.locator("#answer .term").first
    meaning = term.get_attribute("title")
    page.focus("#slow-said")
    for _ in range(60):
        page.keyboard.press("Shift+Tab")
        if page.evaluate("document.activeElement.className") == "term":
            break
    assert page.inner_text("#tip") == page.evaluate("document.activeElement.title")
    page.keyboard.press("Escape")
    assert not page.locator("#tip").is_visible()
    term.click()
    assert page.evaluate("document.activeElement.nextElementSibling.textContent") == meaning
    assert page.locator("#words dd").first.is_visible()
    assert selection(page) == before


def test_the_keys_stay_in_the_table_at_its_end(opened: Any) -> None:
    page = opened()
    page.select_option("#table-of", "all")
    page.focus("#table-next")
    for _ in range(40):
        page.keyboard.press("Enter")
        if page.is_disabled("#table-next"):
            break
    assert page.is_disabled("#table-next")
    assert page.evaluate("document.activeElement.id") == "table-back"
    while page.evaluate("document.activeElement.id") == "table-back":
        page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.id") == "table-next"


def test_sections_and_colours_keep_the_selection(opened: Any) -> None:
    page = opened(CHOSEN + "&slow=50")
    before = selection(page)
    page.click("nav a[href='#data']")
    assert selection(page) == before
    assert page.evaluate("document.activeElement.id") == "data"
    page.emulate_media(color_scheme="dark")
    page.wait_for_timeout(1500)
    assert selection(page) == before
    assert page.evaluate("views.ladder.then((view) => view.signal('slow'))") == pytest.approx(50)
    assert rows_in(page, "strips", "steps") >= 100


def test_the_csv_holds_the_numbers_of_the_parquet(opened: Any, campaign: Path) -> None:
    page = opened()
    page.select_option("#table-of", "all")
    runs = pd.read_parquet(campaign / "runs.parquet")
    for group in page.locator("#table-group option").all_inner_texts():
        page.select_option("#table-group", group)
        with page.expect_download() as waiting:
            page.click("#table-csv")
        table = pd.read_csv(io.BytesIO(Path(waiting.value.path()).read_bytes()))
        assert sorted(table["run_id"]) == sorted(runs["run_id"])
        row_of = runs.set_index("run_id").loc[table["run_id"]].reset_index()
        numbers = [
            name
            for name in table.columns
            if name in runs and pd.api.types.is_numeric_dtype(runs[name])
        ]
        for name in numbers:
            pd.testing.assert_series_equal(
                table[name].astype(float), row_of[name].astype(float), rtol=1e-12
            )
        assert numbers or group in ("memory", "deadline")


def test_two_solvers_are_compared(selected: Any) -> None:
    page = selected("#s=piqp&w=qpsolvers-fresh&set=default&sc=paper&b=daqp~qpsolvers-fresh~default")
    assert rows_in(page, "pairs", "pairs") > 100
    output = page.inner_text("#two-said")
    ratio = re.search(r"takes ([\d.]+) times as long", output)
    assert output.startswith("piqp (")
    assert float(ratio[1]) == pytest.approx(90.0 / 18.0, rel=0.1)
    assert re.search(r"over [\d\u202f]+ steps of paper \(replay\)", output)
    rows = "[[1, 2], [3, 4], [6, 5]].map(([a_us, b_us]) => ({ a_us, b_us, variables: 1 }))"
    slower = page.evaluate(f"slowerIn({rows}, 0.9, true)")
    assert slower == "It is slower in 2 of 3 steps, but the interval includes 1. "
    assert page.evaluate(f"slowerIn({rows}, 1.1, true)") == ""
    for name, title in (("first", "piqp ("), ("second", "daqp (")):
        named = page.evaluate(f"views.pairs.then((view) => view.signal('{name}'))")
        assert named.startswith(title) and named.endswith("[µs]")
    markdown = page.text_content("#two-markdown")
    (p50,) = re.findall(
        r"\| p50 \| [\d.]+ µs in the replay of `(\S+)` \| [\d.]+ µs in the replay of `(\S+)` \|",
        markdown,
    )
    assert set(p50) <= {"paper", "rough"}
    assert "| limiting p99 |" in markdown
    assert len(markdown.encode()) < 3000


def test_two_of_separate_commands_have_no_ratio(selected: Any) -> None:
    page = selected("#s=piqp&w=qpsolvers-fresh&set=default&sc=paper&b=daqp~qpsolvers-fresh~default")
    other = """async (number) => {
      for (const own of Object.values(facts.paired.turns)) if (own[state.c]) own[state.c] = number;
      await drawTwo();
    }"""
    before = page.evaluate("Object.values(facts.paired.turns).map((own) => own[state.c])[0]")
    page.evaluate(other, [99, 99])
    output = page.inner_text("#two-said")
    assert re.search(r"takes [\d.]+\sµs per step and daqp .* [\d.]+\sµs, timed in separate", output)
    assert "so there is no ratio" in output and "times as long" not in output
    page.evaluate(other, [99, before[1]])
    assert "not interleaved" in page.inner_text("#two-said")
    page.evaluate(other, before)
    assert "times as long" in page.inner_text("#two-said")
    disturbed = """async (spread) => {
      for (const p in facts.paired.turns) facts.paired.spreads[p] = { [state.c]: spread };
      await drawTwo();
    }"""
    for spread, text in ((1e6, "rounds differ by a factor of"), (None, "there is a single round")):
        page.evaluate(disturbed, spread)
        assert f"No ranking, as the machine was disturbed and {text}" in page.inner_text(
            "#two-said"
        )
    page.evaluate(disturbed, 1.0)
    assert "No ranking" not in page.inner_text("#two-said")


def test_any_two_have_the_interval_of_their_ratio(selected: Any, written: Any) -> None:
    facts = written.report.data
    timed = [v for v in facts.verdicts.all_verdicts if v.timed_on]
    page = selected()
    for first, second in ((timed[0], timed[-1]), (timed[-2], timed[1])):
        (*_, compared) = compare_paired_times(facts.records, first, second)
        ratio = compared.ratio
        a, b = (facts.find_index(v.configuration) for v in (first, second))
        reach = page.evaluate(f"reachOf({a}, {b})")
        assert reach == page.evaluate(f"reachOf({b}, {a})")
        assert reach == pytest.approx((ratio.high / ratio.low) ** 0.5, rel=1e-3)
        of_steps = page.evaluate(f"ratioOf({a}, {b}, comparedSteps({a}, {b}))")
        assert of_steps == pytest.approx(ratio.value, rel=3e-4)


def test_the_keyboard_reaches_everything(opened: Any) -> None:
    page = opened(CHOSEN)
    wanted = page.evaluate(
        """() => {
          const all = [...document.querySelectorAll(
            "a[href], button, select, input, summary, [tabindex='0']")];
          const seen = all.filter((node) => node.checkVisibility() && !node.disabled);
          seen.forEach((node, i) => { node.dataset.nth = i; });
          return seen.length;
        }"""
    )
    met = set()
    for _ in range(wanted + 5):
        page.keyboard.press("Tab")
        met.add(page.evaluate("document.activeElement.dataset.nth"))
    assert met >= {str(i) for i in range(wanted)}
    page.focus("#table-body button")
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    page.locator("#hard button").first.focus()
    page.keyboard.press("Enter")
    wait_for_strips(page)
    assert selection(page)["k"] != "74"


def test_arrow_keys_choose_in_the_ladder(selected: Any) -> None:
    page = selected()
    rows = page.evaluate("rowsDrawn('ladder').values.map((row) => Number(row.id))")
    page.focus("#figure-ladder")
    page.keyboard.press("ArrowDown")
    wait_for_strips(page)
    chosen = page.evaluate("state.c")
    assert chosen in rows and rows.index(chosen) > 0
    assert selection(page)["s"] == page.evaluate(f"C().solver[{chosen}]")
    assert page.evaluate("views.ladder.then((view) => view.data('pick_store')[0].values)") == [
        str(chosen)
    ]
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    page.keyboard.press("ArrowUp")
    assert page.evaluate("state.c") == rows[rows.index(chosen) - 1]
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.id") == "one"


@SIZES
def test_arrow_keys_choose_in_the_matrix(opened: Any, size: tuple[int, int]) -> None:
    page = opened("#s=clarabel&w=qpsolvers-fresh&set=default&sc=paper", size=size)
    page.focus("#figure-matrix")
    page.keyboard.press("ArrowRight")
    assert (selection(page)["s"], selection(page)["sc"]) == ("clarabel", "paper_tight")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowDown")
    below = selection(page)
    assert below["sc"] == "paper"
    assert below["s"] == page.evaluate(
        """() => { const own = unique(rowsDrawn("matrix").values.map((row) => row.solver));
          return own[own.indexOf("clarabel") + 1]; }"""
    )
    for _ in range(60):
        page.keyboard.press("ArrowRight" if size == DESK else "ArrowDown")
    last = page.evaluate("rowsDrawn('matrix').values.at(-1)")
    assert selection(page)["set"] == last["settings"]


def test_late_is_not_wrong(selected: Any) -> None:
    """On a slower computer a right solver is late, in another colour, shape and sign than a wrong
    one, which stays wrong; the limit of the p99 is a line of its own beside the deadline."""
    page = selected("#slow=10000")
    labels = page.locator("#figure-ladder .mark-symbol path[aria-label]")
    looks: dict[str, set[tuple[str, str]]] = {}
    for mark in labels.all():
        state = (
            str(mark.get_attribute("aria-label"))
            .split("verdict at this slowdown: ")[1]
            .split(".")[0]
        )
        shape = re.sub(r"[\d.,-]+", "", str(mark.get_attribute("d")))
        looks.setdefault(state, set()).add((str(mark.get_attribute("fill")), shape))
    assert {"late", "fail"} <= set(looks)
    ((late_fill, late_shape),), ((wrong_fill, wrong_shape),) = looks["late"], looks["fail"]
    assert late_fill != wrong_fill and late_shape != wrong_shape
    for text in ("p99 limit 3 ms", "deadline 300 ms"):
        assert page.locator("#figure-ladder text", has_text=text).count() == 1
    signs = page.locator("#figure-matrix .mark-text text").all_text_contents()
    assert "✕" in signs
    assert {"fail", "late"} <= {*page.locator("#words dt").all_text_contents()}


def test_the_matrix_shows_another_way(selected: Any) -> None:
    page = selected()
    modes = page.locator("#matrix-mode option").evaluate_all("(all) => all.map((one) => one.value)")
    before = page.locator("#figure-matrix path[aria-label*='verdict: pass']").count()
    page.select_option("#matrix-mode", modes[-1])
    page.wait_for_timeout(300)
    solvers = page.evaluate(
        f"unique(all().filter((c) => callMode(c) === {modes[-1]!r}).map((c) => C().solver[c]))"
    )
    run = page.locator("#figure-matrix path[aria-label]:not([aria-label*='not run'])")
    shown = {
        label.split("solver: ")[1].split(".")[0]
        for label in run.evaluate_all("(all) => all.map((tile) => tile.getAttribute('aria-label'))")
        if "solver: " in label
    }
    assert shown and shown <= set(solvers)
    page.select_option("#matrix-mode", "")
    page.wait_for_timeout(300)
    assert page.locator("#figure-matrix path[aria-label*='verdict: pass']").count() == before


def test_it_copies(opened: Any) -> None:
    page = opened(CHOSEN)
    for name in ("step-export", "step-query", "data-query"):
        assert page.locator(f"[data-copy={name}]").is_visible()
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    buttons = [one for one in page.locator("[data-copy]").all() if one.is_visible()]
    assert len(buttons) >= 3
    for button in buttons:
        button.click()
        text = page.text_content(f"#{button.get_attribute('data-copy')}")
        page.wait_for_function(
            "(text) => navigator.clipboard.readText().then((got) => got === text)", arg=text
        )
        assert button.inner_text() == "Copied"
    page.wait_for_function("!document.body.innerText.includes('Copied')")
    page.evaluate("() => { navigator.clipboard.writeText = () => Promise.reject(Error()); }")
    page.click("[data-copy='paste-1']")
    page.wait_for_function("getSelection().toString().includes('open_workspace')")


def test_print_has_the_answer_and_what_is_chosen(opened: Any) -> None:
    page = opened(CHOSEN, scheme="dark")
    sheets = re.findall(rb"/Type\s*/Page\b", page.pdf(format="A4"))
    assert 1 <= len(sheets) <= 12
    page.emulate_media(media="print")
    page.set_viewport_size({"width": 710, "height": 1039})  # A4 less its margins, at 96 dpi
    page.wait_for_timeout(800)
    assert page.locator("#matrix").bounding_box()["height"] > 200
    assert page.evaluate("document.querySelector('#matrix').getBoundingClientRect().bottom") < 1039
    assert page.evaluate("getComputedStyle($('one')).breakBefore") == "page"
    seen = page.inner_text("main")
    assert "Click" not in seen and "arrow keys" not in seen
    assert not page.locator("#data > h2").is_visible()
    assert not page.locator("#figure-pairs").is_visible()
    parts = ("#one-said", "#hard", "#step-said", "#figure-strips canvas", "#figure-ship svg")
    for part in (*parts, "#two-said"):
        assert page.locator(part).first.is_visible(), part
    assert page.evaluate("document.documentElement.scrollWidth") <= 710
    controls = [one for one in page.locator("select, input, button").all() if one.is_visible()]
    output = [one.inner_text() for one in controls]
    assert [text for text in output if not re.search(r"\bstep \d+: ", text)] == [], "steps alone"
    ink = page.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--ink')")
    assert ink.strip() == "#1d2733"


def test_the_largest_sample_stays_where_it_was_measured(selected: Any) -> None:
    whiskers = "#figure-ladder path[stroke-dasharray], #figure-ladder line[stroke-dasharray]"
    page = selected()
    before = page.locator(whiskers).count()
    assert before > 3
    output = page.locator("#figure-ladder text", has_text="as measured")
    assert output.count() == 0, "nothing is scaled there"
    caption = page.locator("#answer figcaption").inner_text()
    assert "dashed line ends at the largest single timing" in caption
    page = selected("#slow=10000")
    assert page.locator(whiskers).count() < before
    assert page.locator("#figure-ladder text", has_text="timings on this machine").count() == 1


def test_settings_of_ones_own_are_offered_with_their_options(chromium: Any, tmp_path: Path) -> None:
    """A name that is the options themselves is not repeated."""
    records = MadeRecords()
    own = '{"rho": 2, "eps_abs": 1e-05}'
    for settings, options in (("default", ""), ("mine", own), ("rho=2", '{"rho": 2}')):
        records.loop("osqp", settings=settings, options=options)
        records.replay("osqp", settings=settings, options=options, steps=200)
    with opening(chromium, write_report(records.write(tmp_path / "own"))) as opened:
        page = opened("#s=osqp&set=mine")
        offered = page.locator("#choose-settings option").all_inner_texts()
        assert offered == ["default", "mine (eps_abs=1e-5,rho=2)", "rho=2"]
        assert "settings={'rho': 2, 'eps_abs': 1e-05}," in page.text_content("#one-call")
        page.select_option("#choose-settings", "rho=2")
        page.wait_for_function("$('one-call').textContent.includes(\"{'rho': 2},\")")
        assert selection(page)["set"] == "rho=2"


def test_the_page_opens_with_at_most_1300_words(opened: Any) -> None:
    """Words as a reader sees them: tokens with a letter, without figures and closed lists."""
    page = opened()
    page.reload()
    wait_until_ready(page)
    lists = page.locator("#hard details").evaluate_all("lists => lists.map((list) => list.open)")
    assert lists == [True, False], "the steps of all scenarios are open, those of one are folded"
    page.evaluate("document.querySelectorAll('svg, option:not(:checked)').forEach(e => e.remove())")
    words = [word for word in page.inner_text("body").split() if any(map(str.isalpha, word))]
    assert 300 < len(words) <= 1300
