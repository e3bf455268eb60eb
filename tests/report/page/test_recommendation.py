"""The answer in page, Markdown and terminal: its numbers are those of the verdicts."""

import json
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dpbench.analysis.records.records import Records
from dpbench.analysis.times.solver_tables import tabulate_verdicts
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.verdict import (
    choose_solver,
    judge_solvers,
    list_best_verdict_of_each_solver,
)
from dpbench.bench.record.cell import Configuration
from dpbench.errors import InputError
from dpbench.report.documents.markdown import MOST_BYTES, MOST_LISTED, make_report_markdown
from dpbench.report.documents.solver_comparison import compare_solver, format_worst_steps
from dpbench.report.formats import format_error, format_rounded_down, format_time
from dpbench.report.page.data import PageData
from dpbench.report.page.recommendation import (
    Recommendation,
    build_recommendation,
    format_python_call,
    list_speed_margin_sentences,
)
from dpbench.report.page.write import make_page_document
from dpbench.report.report import Report
from dpbench.report.verdict.verdict_text import (
    describe_limiting_time,
    describe_stopped_runs,
    format_p99_interval,
)


def _facts(records: Any) -> PageData:
    view, requirements = records.view(), Requirements()
    return PageData.from_verdicts(view, judge_solvers(view, requirements))


def _answer(records: Any, baseline: str | None = None) -> Recommendation:
    return build_recommendation(_facts(records), {}, baseline)


def _plain(html: str) -> str:
    head = html.split("<script", 1)[0].split("</style>", 1)[1]
    return re.sub(r"<[^>]+>", "", head)


def test_page_markdown_and_terminal_say_the_same(written: Any) -> None:
    """The recommendation, its p99 and its speed margin are the same everywhere."""
    requirements = Requirements.from_suite(written.results.suite)
    verdicts = judge_solvers(Records(written.results), requirements)
    chosen = choose_solver(verdicts).chosen
    assert chosen.configuration.solver == "daqp"
    page, text = _plain(written.html), written.markdown
    terminal = "\n".join(output for _, output in written.lines)
    margin = written.report.data.get_speed_margin(chosen.configuration)
    for output in (one.replace("\xa0", " ") for one in (page, text, terminal)):
        plain = output.replace("`", "")
        assert "Use daqp (qpsolvers fresh, default), the fastest deployable" in plain
        assert "It was accurate on every step of 4 closed loops" in plain
        assert f"limiting p99 is {format_time(chosen.p99_ns)}" in output
        assert format_error(chosen.error_move) in output
        factor = format_rounded_down(margin.allowed_slowness_factor)
        assert f"may be up to {factor} times slower" in output
        assert margin.p99_limit < margin.deadline and "reaches the p99 limit of 3 ms" in output
        deadline = format_rounded_down(margin.deadline)
        assert f"reaches the deadline of 300 ms at a slowdown of × {deadline}." in output
        hardest = margin.hardest
        longest = f"The longest step is step {hardest.k} of {hardest.run.scenario} ("
        assert longest in plain and f"It took {format_time(hardest.time_ns)}" in output
    output = dict(written.lines)
    assert "native warm" not in output["answer"], (
        "a call mode that was replayed alone is not recommended"
    )
    assert output["inconclusive"].startswith(
        "daqp (native warm) is faster on average, but inconclusive: not run"
    )


def test_the_markdown_is_short_and_its_table_that_of_the_verdicts(written: Any) -> None:
    """At most 9 kB; a row a solver with verdict, times, error and failed steps of its verdict."""
    assert len(written.markdown.encode()) <= MOST_BYTES
    rows = [line.strip("| ").split(" | ") for line in written.markdown.splitlines() if "|" in line]
    head, _, *body = rows
    best = list_best_verdict_of_each_solver(written.report.data.verdicts)
    assert len(body) == len(best) == len(written.report.data.verdicts.of)
    for cells, verdict in zip(body, best, strict=True):
        row = dict(zip(head, cells, strict=True))
        assert row["solver"] == verdict.configuration.solver
        assert row["call mode, settings"] == verdict.configuration.call_text
        assert row["verdict"] == verdict.state
        interval = format_p99_interval(verdict.p99_interval)
        assert row["limiting p99"] == format_time(verdict.p99_ns) + interval
        assert row["longest step"] == format_time(verdict.longest_ns)
        assert row["largest error [maximum increments]"] == format_error(verdict.error_move)
        assert row["failed steps"] == str(verdict.failed_steps)


def test_a_wait_for_the_core_is_named_beside_the_limiting_p99(records: Any) -> None:
    """Twelve of 1000 steps took 4 ms in every round, 3 ms of it waiting."""
    records.loop("daqp")
    records.replay("daqp", median_us=20.0, spread=0.0)
    frame = records._steps[-1]
    frame["waited_ns"] = 0
    frame.loc[frame["k"] < 12, ["total_ns", "waited_ns"]] = 4_000_000, 3_000_000
    report = Report.from_results(records.results())
    (verdict,) = report.data.verdicts.all_verdicts
    wait = " (including a wait of 3.00 ms for the core)"
    assert f"{wait}, in the replay of `paper`" in describe_limiting_time(verdict)
    interval = format_p99_interval(verdict.p99_interval)
    assert f"| 4.00 ms{interval}{wait} |" in make_report_markdown(report)


def test_waits_for_the_core_are_named_beside_hardest_step_and_largest_timing(records: Any) -> None:
    """Step 7 took 10 ms in every round, 6 ms of it waiting; in the last 40 ms, 39 of them."""
    records.loop("daqp")
    records.replay("daqp", median_us=20.0, spread=0.0, raw_max_ns=4e7)
    frame = records._steps[-1]
    at_7, last = frame["k"] == 7, frame["repeat"] == frame["repeat"].max()
    frame["waited_ns"] = 0
    frame.loc[at_7, ["total_ns", "waited_ns"]] = 10_000_000, 6_000_000
    frame.loc[at_7 & last, ["total_ns", "waited_ns"]] = 40_000_000, 39_000_000
    report = Report.from_results(records.results())
    waits = (
        " (including a wait of 6.00 ms for the core)",
        " (including a wait of 39.0 ms for the core)",
    )
    slower = dict(report.summary_rows())["margin"]
    assert "The longest step is step 7 of paper (" in slower
    assert (
        f"It took 10.0 ms{waits[0]}, and reaches the deadline of 300 ms at a slowdown of × 30.0."
        in slower
    )
    assert f"The largest single timing is 40.0 ms{waits[1]} in the replay of paper" in slower
    assert f"| 10.0 ms{waits[0]} |" in make_report_markdown(report)
    text, worst = compare_solver(report, "daqp")
    assert f"| 10.0 ms{waits[0]} |" in text.partition("worst by")[2]
    assert f"10.0 ms{waits[0]}, median" in dict(format_worst_steps(worst))["worst time"]
    document = make_page_document(report.data, report.results, report.recommendation, {})
    assert document["configurations"]["max_wait"] == [waits[0]]


@pytest.mark.parametrize(
    ("of", "time"),
    [
        (450, "limiting p99 is {}, in the window of `paper`"),
        (60, "longest step is {}, over the 60 steps of `paper`"),
    ],
)
def test_a_window_has_the_p99_of_its_stretch_and_no_ratio(records: Any, of: int, time: str) -> None:
    """A stretch of fewer than 100 steps has none beyond its p99, which is then the largest."""
    source = {"kind": "hardest", "name": "paper hardest 15", "of": of}
    cell = json.dumps({"scenario": records.scenario("paper").files, "source": source})
    for solver, median_us in (("daqp", 20.0), ("quadprog", 30.0)):
        records.loop(solver)
        records.replay(
            solver, "paper hardest 15", steps=15, spread=0.0, median_us=median_us, cell=cell
        )
    ending = records.ending()
    assert time.replace("`", "").format("20.0 µs") in ending["answer"]
    following = time.replace("`", "").format("30.0 µs")
    against = "Compared with daqp (qpsolvers fresh): too few common steps for a ratio (15 of 500)."
    assert f"{following}. {against}" in ending["next"]
    estimated = (
        "In paper, only a window of 15 of the 450 steps was replayed, so the p99 is an estimate"
    )
    assert (estimated in ending["margin"]) is (of == 450)


@pytest.mark.slow
def test_a_markdown_of_very_many_solvers_counts_the_rows_that_it_leaves_out(records: Any) -> None:
    for i in range(150):
        records.loop(f"somebody_elses_solver_{i:03d}")
    text = make_report_markdown(Report.from_results(records.results()))
    assert text.count("\n| somebody_elses_solver_") == MOST_LISTED
    more = f"The verdicts on {150 - MOST_LISTED} more configurations are in `tables/verdicts.csv`."
    assert more in text and "\n\nA call mode is a route" in text


def test_a_markdown_that_is_too_long_leaves_out_whole_sections(
    records: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last first; never a row of a table, its note or the paragraph on the files."""
    for sea in range(1, 7):
        for east in (0.0, 1.0):
            for solver, more in (("daqp", 0.0), ("osqp", 0.02 + 0.002 * sea)):
                error_m = 0.5 + 0.1 * east * (1 + 0.1 * sea) + more
                records.sea(solver, int(east), sea, {"start.east_m": east}, r_95_m=error_m)
    report = Report.from_results(records.results())
    files = "\n\nAll figures are in `report.html` and all"
    whole, _, made = make_report_markdown(report).partition(files)
    _, *tables = re.split(r"\n\n(?=seas: (?:comparison|effect))", whole)
    counts = set()
    for most in range(len(whole.encode()) + 2000, 2000, -50):
        monkeypatch.setattr("dpbench.report.documents.markdown.MOST_BYTES", most)
        text, found, ending = make_report_markdown(report).partition(files)
        kept = [table for table in tables if table in text]
        assert kept == tables[: len(kept)] and found and ending == made
        assert text.count("\n| ") == sum(table.count("\n| ") for table in kept)
        if len(kept) < len(tables):
            assert text.endswith("Further results are left out here; they are in `report.html`.")
        counts.add(len(kept))
    assert counts == {0, 1, 2}


def test_settings_of_ones_own_have_a_verdict_on_screen_and_in_markdown(records: Any) -> None:
    records.loop("osqp")
    records.replay("osqp")
    for rho, error in ((0.16, 0.55), (1.6, 0.33)):
        options = {"settings": f"rho={rho}", "options": json.dumps({"rho": rho})}
        columns = options | {"route": "native", "policy": "warm"}
        records.loop("osqp", error=error, failed=2, **columns)
        records.replay("osqp", **columns)
    report = Report.from_results(records.results())
    lines = [text for about, text in report.summary_rows() if about == "options"]
    assert lines[0].startswith(
        "osqp[rho=0.16] (native warm): fail, largest error 0.55, 2 failed steps; "
    )
    assert "the error of its first move reaches 0.55 times the maximum increment" in lines[0]
    # With the steps that the percentile is of: other settings may have those of a window.
    assert re.search(
        r"; limiting p99 is [\d.]+ µs \(95 %: .*\), in the replay of paper: the error",
        lines[0],
    )
    adapts = "; rho is only an initial value in osqp, as adaptive_rho is on"
    initial = f"{adapts} (fix it with adaptive_rho=false)."
    assert [line.endswith(initial) for line in lines] == [True, True]
    assert "| osqp | native warm, rho=1.6 | fail |" in make_report_markdown(report)


def test_a_grid_that_fails_everywhere_has_one_line(records: Any) -> None:
    """Its best has the smallest error, at the edge in rho; eps_abs changes nothing there."""
    for rho, error in ((0.16, 0.55), (1.6, 0.33), (16.0, 0.22)):
        for eps in (1e-7, 1e-6, 1e-5):
            worse = 0.01 if eps == 1e-6 else 0.0
            own = {"eps_abs": eps, "rho": rho}
            options = {"settings": f"eps_abs={eps},rho={rho}", "options": json.dumps(own)}
            records.loop("osqp", error=error + worse, **options)
            records.replay("osqp", **options)
    report = Report.from_results(records.results())
    (line,) = (text for about, text in report.summary_rows() if about == "options")
    assert line.startswith(
        "Best of 9 settings of osqp by largest error (0.22): eps_abs=1e-07,rho=16.0, at the edge "
        "of the grid in rho: widen it; all fail; the best: the error of its first move reaches 0.22"
    )
    assert line.endswith(
        "; eps_rel is left at osqp's default 0.001, so a solve can end before it reaches eps_abs."
    )
    assert "; rho is only an initial value in osqp, as adaptive_rho is on (fix it with " in line
    assert "adaptive_rho=false); eps_rel is" in line
    assert line in make_report_markdown(report)


def test_inaccurate_settings_that_are_late_too_name_both_reasons(records: Any) -> None:
    """One late reason stands for all: the p99 comes before the median of the closed loop."""
    options = {"settings": "mine", "options": json.dumps({"rho": 1.6})}
    records.loop("osqp", steps=200, error=0.33, raw_p50_ns=5e6, **options)
    records.replay("osqp", median_us=4000.0, spread=0.0, **options)
    line = records.ending()["options"]
    late = "; its p99 is 4.00 ms in the replay of paper, above the limit of 3.00 ms;"
    assert "the error of its first move reaches 0.33 times" in line and late in line
    assert "median timing" not in line


LEFT = "; `eps_rel` is left at osqp's default 0.001, so a solve can end before it reaches `eps_abs`"


@pytest.mark.parametrize(
    ("own", "error", "left"),
    [
        ({"rho": 1.6, "eps_abs": 1e-5}, 0.33, LEFT),
        ({"rho": 1.6, "eps_abs": 1e-2}, 0.33, "; `eps_rel` is left at osqp's default 0.001"),
        ({"eps_abs": 1e-5, "eps_rel": 1e-5}, 0.33, ""),
        ({"rho": 1.6}, 0.33, ""),
        ({"eps_abs": 1e-5}, 1e-9, LEFT),
        ({"eps_abs": 1e-2}, 1e-9, ""),
    ],
)
def test_a_tolerance_that_settings_leave_is_named(
    own: dict[str, float], error: float, left: str, records: Any
) -> None:
    """Accurate settings have it on their line alone, and only if its default is looser."""
    options = {"settings": "mine", "options": json.dumps(own)}
    records.loop("osqp", error=error, **options)
    records.replay("osqp", error=error, **options)
    report = Report.from_results(records.results())
    line = dict(report.summary_rows())["options"]
    assert ("is left at" in line) is bool(left) and left.replace("`", "") in line
    assert ("so a solve can end" in line) is ("so a solve can end" in left)
    left *= error > 1e-2
    assert left.replace("`", "") in report.tables["verdicts"]["why"].iloc[0]
    assert ("is left at osqp's default" in make_report_markdown(report)) is bool(left)


def test_a_grid_that_is_best_at_zero_cannot_be_widened(records: Any) -> None:
    for eps, error in ((0.0, 0.22), (1e-3, 0.33), (1e-2, 0.55)):
        options = {"settings": f"eps_rel={eps}", "options": json.dumps({"eps_rel": eps})}
        records.loop("osqp", error=error, failed=2, **options)
        records.replay("osqp", **options)
    rows = Report.from_results(records.results()).summary_rows()
    best = "Best of 3 settings of osqp by largest error (0.22): eps_rel=0.0; all fail; "
    assert any(about == "options" and text.startswith(best) for about, text in rows)


def test_crashed_and_stopped_settings_are_not_the_best_of_a_grid(records: Any) -> None:
    """The finished settings with an error of 0.33 come before them; without it none is named."""
    ends = {"none": "crashed", "one": "timed_out", "two": "crashed"}
    for mode, outcome in ends.items():
        options = {"settings": f"kind={mode}", "options": json.dumps({"kind": mode})}
        records.loop("osqp", error=1e-14, outcome=outcome, steps=50, **options)
        records.replay("osqp", **options)
    rows = Report.from_results(records.results()).summary_rows()
    assert any(text.startswith("None of 3 settings of osqp finished its runs") for _, text in rows)
    options = {"settings": "kind=right", "options": json.dumps({"kind": "right"})}
    records.loop("osqp", error=0.33, **options)
    records.replay("osqp", **options)
    report = Report.from_results(records.results())
    best = "Best of 4 settings of osqp by largest error (0.33): kind=right"
    assert any(text.startswith(best) for _, text in report.summary_rows())


def test_own_settings_are_judged_by_the_call_modes_that_ran_most(records: Any) -> None:
    """A call mode without a closed loop hides none that fails; each one that fails has a reason."""
    own = {"settings": "mine", "options": '{"rho": 1.6}', "route": "native"}
    records.loop("osqp")
    records.replay("osqp")
    for policy, error, us in (("fresh", 0.22, 10.0), ("reuse", 0.33, 90.0)):
        records.loop("osqp", policy=policy, error=error, **own)
        records.replay("osqp", policy=policy, error=error, median_us=us, **own)
    records.replay("osqp", policy="warm", **own)
    report = Report.from_results(records.results())
    (line,) = [text for about, text in report.summary_rows() if about == "options"]
    assert " (native fresh, best of 3 call modes): fail, largest error 0.22, " in line
    assert "inconclusive" not in line
    assert " native reuse fails: the error of its first move reaches 0.33 times the maximum" in line


@pytest.mark.slow
@pytest.mark.parametrize("solvers", [1, 12])
def test_a_few_configurations_are_all_listed(records: Any, solvers: int) -> None:
    """The best of each solver where there are more than 24, and the count of the others."""
    names = ["daqp", *(f"solver_{i:02d}" for i in range(solvers))]
    for solver in names:
        for policy, us in (("fresh", 30.0), ("warm", 20.0)):
            records.loop(solver, policy=policy)
            records.replay(solver, policy=policy, median_us=us)
    text = make_report_markdown(Report.from_results(records.results()))
    rows = [line for line in text.splitlines() if line.startswith(("| daqp", "| solver_"))]
    modes = [row.split(" | ")[1] for row in rows]
    if solvers == 1:
        assert modes == ["qpsolvers warm", "qpsolvers fresh"] * 2
        assert "more configuration" not in text
    else:
        assert modes == ["qpsolvers warm"] * 13
        assert "\nThe verdicts on 13 more configurations are in `tables/verdicts.csv`.\n" in text


def test_a_grid_whose_best_is_inside_needs_no_wider_one(records: Any) -> None:
    """Two settings are no grid."""
    for rho, us in ((0.1, 60.0), (1.0, 20.0)):
        options = {"settings": f"rho={rho}", "options": json.dumps({"rho": rho})}
        records.loop("osqp", **options)
        records.replay("osqp", median_us=us, **options)
    assert "Best of" not in make_report_markdown(Report.from_results(records.results()))
    options = {"settings": "rho=10.0", "options": json.dumps({"rho": 10.0})}
    records.loop("osqp", **options)
    records.replay("osqp", median_us=90.0, **options)
    text = make_report_markdown(Report.from_results(records.results()))
    assert re.search(
        r"Best of 3 settings of osqp by limiting p99 \([\d.]+ µs\): rho=1.0; the runner", text
    )
    ratio = r"-up, osqp\[rho=0.1\], takes [23][.]\d+ times as long as the best over .* \(95 % "
    assert re.search(ratio, text.replace("\\", ""))
    assert "\nrho is only an initial value in osqp, as " in text
    options = {"settings": "rho=2.0", "options": json.dumps({"rho": 2.0})}
    records.loop("osqp", **options)
    records.replay("osqp", median_us=20.2, **options)
    text = make_report_markdown(Report.from_results(records.results()))
    (best,) = re.findall(r"Best of 4 settings .*", text)
    assert best.endswith("rho=1.0; equally fast within the noise: osqp[rho=2.0].")
    records.loop("osqp", policy="warm", **options)
    records.replay("osqp", policy="warm", median_us=90.0, **options)
    text = make_report_markdown(Report.from_results(records.results()))
    assert re.search(r"Best of 4 settings .*: rho=1\.0 \(qpsolvers fresh\); equally fast ", text)


def test_the_best_of_a_flat_grid_is_the_recommended_one(records: Any) -> None:
    """The fastest by chance is neither named nor at an edge to be widened."""
    for rho, us in ((0.1, 20.1), (0.4, 20.0), (1.6, 20.2), (6.4, 19.9), (12.8, 20.1)):
        options = {"settings": f"rho={rho}", "options": json.dumps({"rho": rho})}
        records.loop("osqp", **options)
        records.replay("osqp", median_us=us, **options)
    rows = Report.from_results(records.results()).summary_rows()
    assert "Use osqp (qpsolvers fresh, rho=0.1)." in dict(rows)["answer"]
    (best,) = (text for about, text in rows if text.startswith("Best of 5"))
    assert re.search(r"\): rho=0\.1; equally fast within the noise: ", best)
    assert best.endswith("osqp[rho=0.4], osqp[rho=1.6] and 2 more.")


EDGE = ", at the edge of the grid in rho: widen it"
EQUAL = "; with the same p50: osqp[rho=6.4]"
FEWEST = "by iterations (p50 25 in the replay of paper)"
NOT_RANKED = "times are not ranked, as the machine was disturbed."


@pytest.mark.parametrize(
    ("fastest_us", "iterations", "best"),
    [
        # The other times are within 1.155 times 18 µs, the spread of the rounds; not of 15 µs.
        (18.0, (75, 25, 50, 50), f"{FEWEST}: rho=0.4; {NOT_RANKED}"),
        (18.0, (75, 75, 50, 25), f"{FEWEST}: rho=6.4{EDGE}; {NOT_RANKED}"),
        (
            18.0,
            (75, 50, 25, 25),
            f"{FEWEST}: rho=1.6{EQUAL}; {NOT_RANKED}",
        ),
        (18.0, (np.nan,) * 4, f"4 of 4 settings of osqp are accurate; {NOT_RANKED}"),
        (15.0, (75, 25, 50, 50), f"by limiting p99 (15.0 µs): rho=0.1{EDGE}; the runner-up, "),
    ],
)
def test_times_of_a_disturbed_machine_name_no_best_settings(
    fastest_us: float, iterations: tuple[float, ...], best: str, records: Any
) -> None:
    times_us = (fastest_us, 20.0, 20.0, 20.0)
    # Settings of equal p50 differ in their maximum, which is not shown.
    values = zip((0.1, 0.4, 1.6, 6.4), times_us, iterations, strict=True)
    for i, (rho, us, p50) in enumerate(values):
        own = {"settings": f"rho={rho}", "options": json.dumps({"rho": rho})}
        records.loop("osqp", **own)
        stolen = {"replay_s": 1.0, "steal_s": 0.1, "iterations_p50": p50}
        stolen["iterations_max"] = 100.0 + i
        records.replay("osqp", median_us=us, spread=0.0, **stolen, **own)
    rows = Report.from_results(records.results()).summary_rows()
    lines = [text.removeprefix("Best of 4 settings of osqp ") for about, text in rows]
    (line,) = (line for line in lines if line.startswith(best))
    assert "disturbed" in line


def test_a_grid_that_fails_everywhere_alike_is_not_to_be_widened(records: Any) -> None:
    """The edge is named all the same, on the page too; the ratio to `default` is first."""
    for solver, us in (("daqp", 20.0), ("osqp", 40.0)):
        records.loop(solver)
        records.replay(solver, median_us=us)
    for rho, error in ((0.1, 0.059), (0.4, 0.045), (1.6, 0.043), (6.4, 0.040)):
        options = {"settings": f"rho={rho}", "options": json.dumps({"rho": rho})}
        records.loop("osqp", error=error, **options)
        records.replay("osqp", error=error, median_us=80.0, **options)
    report = Report.from_results(records.results())
    best = (
        "Best of 4 settings of osqp by largest error (0.040): rho=6.4, at the edge of the grid in "
    )
    best += "rho; all fail, with similar errors (0.040 to 0.059); the best: "
    rows = report.summary_rows()
    (line,) = (text for about, text in rows if text.startswith(best))
    (topic,) = (topic for topic in report.topics if topic.id == "settings")
    assert line in topic.lines and any("rho is only an initial" in text for text in topic.lines)
    settings = dict(rows)["settings"]
    own = "osqp (qpsolvers fresh, rho=6.4) against"
    assert settings.startswith(f"{own} osqp (qpsolvers fresh): ")
    assert f". {own} daqp (qpsolvers fresh): " in settings
    assert settings.endswith(" 5 more pairs: tables/paired_ratios.csv.")
    ratios = report.tables["paired_ratios"]
    pairs = list(zip(ratios["first"], ratios["second"], strict=True))
    assert ("daqp (qpsolvers fresh)", "osqp (qpsolvers fresh, rho=6.4)") in pairs
    assert len(pairs) == len(set(pairs)) == 9
    assert "\n\nVerdicts on `daqp` (qpsolvers fresh): pass in `paper`" in make_report_markdown(
        report
    )


def test_an_equal_point_that_differs_in_both_options_hides_no_edge(records: Any) -> None:
    """The time falls with rho at either tolerance, but for one point on the diagonal."""
    times = {1e-4: (60.0, 40.0, 20.0), 1e-3: (50.0, 20.2, 30.0), 1e-2: (90.0, 90.0, 90.0)}
    for eps, by_rho in times.items():
        for rho, us in zip((0.1, 1.0, 10.0), by_rho, strict=True):
            own = {"eps_abs": eps, "rho": rho}
            options = {"settings": f"eps_abs={eps},rho={rho}", "options": json.dumps(own)}
            records.loop("osqp", **options)
            records.replay("osqp", median_us=us, spread=0.0, **options)
    rows = Report.from_results(records.results()).summary_rows()
    (best,) = (text for about, text in rows if text.startswith("Best of 9"))
    assert ": eps_abs=0.0001,rho=10.0, at the edge of the grid in eps_abs and rho: widen it" in best


def test_an_option_that_changes_nothing_is_not_to_be_widened(records: Any) -> None:
    """Another option of the grid does."""
    for rho, error in ((0.1, 0.2), (1.0, 0.5), (10.0, 0.9)):
        for eps in (1e-9, 1e-8, 1e-7):
            own = {"eps_abs": eps, "rho": rho}
            options = {"settings": f"eps_abs={eps},rho={rho}", "options": json.dumps(own)}
            records.loop("osqp", error=error, **options)
            records.replay("osqp", error=error, spread=0.0, **options)
    (line,) = (
        text
        for about, text in Report.from_results(records.results()).summary_rows()
        if about == "options" and text.startswith("Best of 9")
    )
    assert ", at the edge of the grid in rho: widen it; all fail; " in line


def test_a_fixed_rho_is_no_initial_value(records: Any) -> None:
    for rho in (0.1, 1.0):
        own = {"adaptive_rho": 0, "rho": rho}
        options = {"settings": f"rho={rho}", "options": json.dumps(own)}
        records.loop("osqp", **options)
        records.replay("osqp", **options)
    rows = Report.from_results(records.results()).summary_rows()
    assert not any("initial value" in text for _, text in rows)


def test_own_settings_that_fail_in_si_units_are_counted(records: Any) -> None:
    """They have no part in the verdicts."""
    for rho, error in ((0.1, 1e-9), (1.0, 0.5)):
        options = {"settings": f"rho={rho}", "options": json.dumps({"rho": rho})}
        records.loop("osqp", **options)
        records.replay("osqp", **options)
        records.loop("osqp", units="si", error=error, **options)
    rows = Report.from_results(records.results()).summary_rows()
    line = "In SI units (N, N·m), 1 of 2 custom settings fails: scale the QP. These runs do not"
    assert any(about == "options" and text.startswith(line) for about, text in rows)


def test_steps_above_the_limit_are_counted(records: Any) -> None:
    """Those of the worst run, among all its steps."""
    records.loop("osqp")
    records.replay("osqp", steps=450)
    errors = np.full(450, 1e-9)
    errors[7:61] = 0.3
    steps = records._steps[-1]
    steps["error_move"] = errors[steps["k"].to_numpy(dtype=int)]
    records._runs[-1]["error_move_max"] = 0.3
    counted = ", above the limit in 54 of 450 steps, first at step 7"
    assert f"in the replay of paper{counted}." in records.ending()["solvers"]


def test_windows_of_one_scenario_are_named_once(records: Any) -> None:
    own = {"settings": "mine", "options": '{"rho": 1.6}'}
    records.loop("osqp", error=0.3, **own)
    for n in (15, 30):
        source = {"kind": "hardest", "name": f"paper hardest {n}", "of": 450}
        cell = json.dumps({"source": source})
        records.replay("osqp", f"paper hardest {n}", steps=n, error=0.2, cell=cell, **own)
    assert " (also in the window of paper);" in records.ending()["options"]


def test_the_settings_of_a_solver_with_several_are_named(records: Any) -> None:
    own = {"settings": "mine", "options": '{"rho": 1.6}'}
    records.loop("osqp", error=0.3)
    records.replay("osqp", error=0.3)
    assert " osqp fails: " in records.ending()["solvers"]
    records.loop("osqp", error=0.4, **own)
    records.replay("osqp", error=0.4, **own)
    assert " osqp with default settings fails: " in records.ending()["solvers"]


def test_chips_say_of_each_experiment_what_the_first_did_there(records: Any) -> None:
    records.loop("daqp", "paper")
    records.replay("daqp", "paper")
    records.loop("osqp", "rough")
    answer = _answer(records)
    assert answer.first is not None and answer.first.solver == "daqp"
    assert {(chip.text, chip.mark) for chip in answer.chips} == {
        ("paper: pass", "pass"),
        ("rough: not run", "none"),
        ("paper (replay): pass", "pass"),
    }


def test_a_chip_says_how_other_ways_did_where_the_first_was_not_run(records: Any) -> None:
    for way in ({"route": "native", "policy": "warm", "median_us": 5.0}, {}):
        records.loop("daqp", "paper", **{k: v for k, v in way.items() if k != "median_us"})
        records.replay("daqp", "paper", **way)
    records.loop("daqp", "paper", units="si")
    records.loop("daqp", "paper", units="si", policy="reuse", route="native", error=0.4)
    records.loop("osqp", "paper", units="si")
    answer = _answer(records)
    assert answer.first is not None and answer.first.policy == "warm"
    output = next(chip for chip in answer.chips if "SI" in chip.text)
    assert output.text == (
        "paper (in SI units): not run in this call mode (qpsolvers fresh: pass; native reuse: fail)"
    )
    assert output.mark == "none"


def test_a_choice_with_solutions_that_are_not_verified_says_so(records: Any) -> None:
    records.loop("osqp", error=5e-3)
    records.replay("osqp", error=5e-3, claimed_not_true=3 * 49)
    sentence = "In 49 of 1\u202f000 steps of the replay of `paper` the solution is not verified."
    assert _answer(records).accuracy.endswith(sentence)
    records.replay("daqp", median_us=5.0)
    records.loop("daqp")
    assert "not verified" not in _answer(records).accuracy


def test_open_is_not_recommended(records: Any) -> None:
    records.replay("daqp")
    sentence = _answer(records).sentence
    assert "`daqp` (qpsolvers fresh, default) is inconclusive: no closed loop" in sentence
    assert "was accurate on every step of 1 replay. Its limiting p99 is " in sentence
    records.replay("daqp", policy="reuse", route="native", median_us=5.0)
    assert "inconclusive" not in dict(_answer(records).notes), "the sentence says so"


def test_the_next_solver_passes_only_if_it_does(records: Any) -> None:
    """Without closed loops, both are inconclusive."""
    for loops in (False, True):
        for solver, median_us in (("daqp", 20.0), ("quadprog", 40.0)):
            records.replay(solver, median_us=median_us)
            if loops:
                records.loop(solver)
        note = dict(_answer(records).notes)["next"]
        is_or = "that passes is" if loops else "solver, which is inconclusive, is"
        assert f"{is_or} `quadprog` (qpsolvers fresh). Its limiting p99" in note


NOBODY = [
    ({"error": 0.4}, "Nothing is recommended: no solver passes in any configuration"),
    ({"outcome": "timed_out", "done": 9}, "Nothing is recommended while the verdict on a solver"),
]


def test_a_margin_by_the_iterations_of_the_closed_loop_names_the_longer_time(records: Any) -> None:
    """Half of the iterations are timed: (1 + 9) / (1 + 4) times 20 µs."""
    records.loop("daqp", "turn", iterations_p99=9.0, iterations_max=14.0)
    cell = json.dumps({"source": {"kind": "hardest", "name": "turn hardest 30", "of": 450}})
    window = {"sequence": "turn hardest 30", "scenario": "turn", "cell": cell}
    records.replay("daqp", steps=30, spread=0.0, iterations_p99=4.0, iterations_max=4.0, **window)
    data = Report.from_results(records.results()).data
    (verdict,) = data.verdicts.all_verdicts
    text = " ".join(list_speed_margin_sentences(data, verdict))
    assert "may be up to 75.0 times slower than this machine; the limiting p99 then" in text
    assert (
        "In `turn`, only a window of 30 of the 450 steps was replayed, so the p99 is an estimate "
        "without a confidence interval. The longest step, scaled up to the iterations of the "
        "closed loop, reaches the deadline of 300 ms at a slowdown of × 5\u202f000."
    ) in text
    assert (verdict.p99_ns, verdict.longest_ns) == pytest.approx((40e3, 60e3), rel=1e-3)


@pytest.mark.parametrize(("of_loop", "p99_ns"), [(9.0, 30e3), (4.0, 20e3)])
def test_an_estimated_p99_is_at_most_the_longest_step(
    records: Any, of_loop: float, p99_ns: float
) -> None:
    """The window has a step of 30 µs with all iterations of the loop, five of at least 20 µs."""
    records.loop("daqp", "turn", iterations_p99=of_loop, iterations_max=14.0)
    cell = json.dumps({"source": {"kind": "hardest", "name": "turn hardest 30", "of": 450}})
    window = {"sequence": "turn hardest 30", "scenario": "turn", "cell": cell}
    window |= {"algo_max_ns": 30e3, "window_p99_ns": 20e3}
    counts = {"iterations_p99": 4.0, "iterations_max": 14.0}
    slow = {0: 1.5, 1: 1.4, 2: 1.3, 3: 1.2}
    records.replay("daqp", steps=30, spread=0.0, slow=slow, **counts, **window)
    (verdict,) = Report.from_results(records.results()).data.verdicts.all_verdicts
    assert verdict.p99_ns == pytest.approx(p99_ns, rel=1e-3)


def test_the_table_has_the_times_that_give_each_speed_margin(records: Any) -> None:
    """A window of 20 µs counts as 40 µs by its iterations; `osqp` has one step of 60 ms."""
    records.loop("daqp", "turn", iterations_p99=9.0, iterations_max=14.0)
    cell = json.dumps({"source": {"kind": "hardest", "name": "turn hardest 30", "of": 450}})
    window = {"sequence": "turn hardest 30", "scenario": "turn", "cell": cell}
    records.replay("daqp", steps=30, spread=0.0, iterations_p99=4.0, iterations_max=4.0, **window)
    records.loop("osqp", "paper")
    records.replay("osqp", spread=0.0, slow={500: 3000.0})
    report = Report.from_results(records.results())
    text = make_report_markdown(report)
    table = [line for line in text.splitlines() if line.startswith("| ")]
    head, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in table)
    found = {row[0]: dict(zip(head, row, strict=True)) for row in rows}
    columns = ("limiting p99", "longest step", "speed margin")
    assert [found["daqp"][name] for name in columns] == ["40.0 µs", "60.0 µs", "× 75.0"]
    assert [found["osqp"][name] for name in columns] == [
        "20.0 µs (95 %: 20.0 µs to 20.0 µs)",
        *("60.0 ms", "× 5.00"),
    ]
    assert "the smaller of two ratios: 3 ms / limiting p99 and 300 ms / " in text
    facts = make_page_document(report.data, report.results, report.recommendation, {})
    limits = dict(zip(*(facts["configurations"][n] for n in ("solver", "limited_by")), strict=True))
    assert limits == {
        "daqp": "limiting p99 of 40.0 µs (limit 3 ms)",
        "osqp": "longest step of 60.0 ms (deadline 300 ms)",
    }
    verdicts = tabulate_verdicts(report.data).set_index("solver")
    assert verdicts["limiting_p99_us"].round(3).to_dict() == {"daqp": 40.0, "osqp": 20.0}


def test_a_replay_of_the_same_horizons_by_another_name_times_the_loop(records: Any) -> None:
    """`horizons = ["30/5"]` of `paper` names it `paper-30-5`."""
    for scenario in ("paper", "calm"):
        records.loop("osqp", scenario)
    files = records.scenario("paper").files
    same = json.dumps({"scenario": {**files, "name": "paper-30-5"}})
    records.replay("osqp", scenario="paper-30-5", cell=same)
    slower = dict(_answer(records).notes)["margin"]
    assert slower.endswith("Not timed, as no replay has their QPs: `calm`.")


def test_loops_without_times_and_stopped_runs_are_named(records: Any) -> None:
    for scenario in ("paper", "calm", "rough"):
        records.loop("osqp", scenario)
    records.replay("osqp", stopped=True)
    notes = dict(_answer(records).notes)
    assert notes["margin"].endswith("Not timed, as no replay has their QPs: `calm` and `rough`.")
    assert " times slower than this machine for the replayed QPs; " in notes["margin"]
    assert notes["stopped"] == (
        "The time limit of a run (`cell_limit_s`) stopped 1 of 4 started runs: 1 of "
        "`osqp` (qpsolvers fresh). A configuration with a stopped closed loop cannot pass; one "
        "with a stopped replay can pass only if each step was timed in at least one round. "
        "`tables/runs.csv` lists these runs with the outcome `timed_out`."
    )


def test_runs_stopped_of_several_solvers_are_counted_by_solver(records: Any) -> None:
    for solver, count in {"osqp": 1, "qtqp": 2, "scs": 1, "proxqp": 1, "ecos": 1}.items():
        for settings in ("default", "high")[:count]:
            records.replay(solver, settings=settings, stopped=True)
    assert (
        "stopped 6 of 6 started runs: 2 of `qtqp`, 1 of `osqp`, 1 of `scs` and 2 of other solvers."
    ) in dict(_answer(records).notes)["stopped"]
    run = records.view().all_runs[0]
    assert " stopped 1 of 1 started run: " in describe_stopped_runs(
        [run, replace(run, settings="")]
    )


@pytest.mark.parametrize(("loop", "says"), NOBODY)
def test_nothing_qualifies_is_said_with_why(records: Any, loop: dict[str, Any], says: str) -> None:
    records.loop("osqp", **loop)
    records.replay("osqp")
    answer = _answer(records)
    assert says in answer.sentence
    time = r"on `osqp` \(qpsolvers fresh\): \w+\. Its limiting p99 is .*; the p99 limit is 3 ms\.$"
    assert re.search(time, answer.sentence)
    assert answer.snippets == () and not {*dict(answer.notes)} - {"stopped"}


@pytest.mark.parametrize(("error", "is_named"), [(5e-3, True), (5e-7, False)])
def test_the_next_fastest_has_its_error_where_it_is_far_larger(
    records: Any, error: float, is_named: bool
) -> None:
    for solver, median_us, off in (("daqp", 9.0, 1e-14), ("osqp", 90.0, error)):
        records.loop(solver, error=off)
        records.replay(solver, median_us=median_us, error=off)
    text = dict(_answer(records).notes)["next"]
    assert ("5.0e-03 times the maximum increment, against 1.0e-14" in text) is is_named


def test_what_is_faster_is_named_with_why_it_is_not_the_answer(records: Any) -> None:
    solvers = {"qtqp": ("qpsolvers", 3.0), "daqp": ("qpsolvers", 9.0), "scs": ("qpsolvers", 90.0)}
    for solver, (route, median_us) in solvers.items():
        records.loop(solver, route=route)
        records.replay(solver, route=route, median_us=median_us)
    answer = _answer(records)
    assert (answer.first.solver, answer.second.solver) == ("daqp", "qtqp")
    notes = dict(answer.notes)
    assert "is not recommended: written in Python" in notes["faster"]
    order = "scs (qpsolvers fresh). Its limiting p99 "
    assert (
        notes["next"].replace("`", "").startswith(f"The next fastest solver that passes is {order}")
    )
    assert records.ending()["next"].startswith(order)
    assert notes["deployment"] == (
        "Licence: MIT. Language: C, without external libraries. Embeddable C code: yes (the "
        "solver writes its workspace as C code)."
    )


@pytest.mark.parametrize(
    ("median_us", "says"),
    [
        (8.9, "Several settings of this solver pass and are equally fast within the noise"),
        (12.0, ", the fastest deployable configuration that passes"),
    ],
)
def test_defaults_are_not_called_faster_than_settings_of_ones_own(
    records: Any, median_us: float, says: str
) -> None:
    """The default is the answer where the times do not separate it from a faster one."""
    own = {"settings": "mine", "options": '{"primal_tol": 1e-7}', "route": "native"}
    records.loop("daqp", route="native")
    records.replay("daqp", route="native", median_us=9.0)
    records.loop("daqp", **own)
    records.replay("daqp", median_us=median_us, **own)
    answer = records.ending()["answer"]
    assert "Use daqp (native fresh, default)" in answer
    assert says in answer


def test_the_p99_of_a_replay_has_its_interval(records: Any) -> None:
    """The interval is that of order statistics of the replay's step times; it holds the p99."""
    for solver, median_us in (("daqp", 20.0), ("scs", 90.0)):
        records.loop(solver)
        records.replay(solver, steps=2000, median_us=median_us)
    view = records.view()
    (verdict,) = judge_solvers(view, Requirements()).of["daqp"]
    ordered = np.sort(view.get_step_times(verdict.p99_run).algo_ns)
    low, high = verdict.p99_interval.low, verdict.p99_interval.high
    assert {low, high} < {*ordered} and low < verdict.p99_ns < high
    bounds = f"{format_time(low)} to {format_time(high)}"
    interval = f"limiting p99 is {format_time(verdict.p99_ns)} (95 %: {bounds})"
    answer = _answer(records)
    assert interval in answer.sentence and " (95 %: " in dict(answer.notes)["next"]
    row = tabulate_verdicts(_facts(records)).iloc[0]
    assert (row["p99_low_us"], row["p99_high_us"]) == (low / 1e3, high / 1e3)


def test_of_a_single_configuration_it_is_said_first_that_nothing_was_compared(
    records: Any,
) -> None:
    """In the answer of terminal, page and Markdown; no longer with a second one."""
    first = "Nothing was compared, as only `daqp` (qpsolvers fresh) was run. Use `daqp`"
    records.loop("daqp")
    records.replay("daqp")
    assert records.ending()["answer"].startswith(first.replace("`", ""))
    assert first in make_report_markdown(Report.from_results(records.results()))
    records.loop("daqp", settings="high")
    alone = "Only `daqp` was run, in 2 configurations: no other solver is compared. Use `daqp`"
    assert _answer(records).sentence.startswith(alone)


def test_code_in_python_alone_is_no_recommendation(records: Any) -> None:
    records.loop("qtqp")
    records.replay("qtqp")
    answer = _answer(records)
    assert (
        "No solver that can be deployed passes. `qtqp` (qpsolvers fresh) passes but "
        in answer.sentence
    )
    assert answer.notes == ()


def test_what_is_faster_and_open_is_named(records: Any) -> None:
    for solver, route in (("daqp", "native"), ("qtqp", "qpsolvers"), ("osqp", "native")):
        fast = {"qtqp": 3.0, "daqp": 9.0}.get(solver, 50.0)
        records.loop(solver, route=route, policy="warm")
        records.replay(solver, route=route, policy="warm", median_us=fast)
        records.replay(solver, route=route, policy="reuse", median_us=fast / 2)
    records.loop("hildreth", route="native", error=0.4)
    records.replay("hildreth", route="native", error=0.4, median_us=4.0)
    for settings, median_us, error in (("high", 4.0, 1e-9), ("mid", 5.0, 1e-9), ("low", 2.0, 0.4)):
        way = {"route": "native", "policy": "reuse", "settings": settings}
        records.replay("hildreth", median_us=median_us, error=error, **way)
    notes = [text for word, text in _answer(records).notes if word == "inconclusive"]
    assert notes == [
        "`hildreth` (native reuse, high) is faster on average, but inconclusive: not run in closed "
        "loop.",
        "`daqp` (native reuse) is faster on average, but inconclusive: not run in closed loop.",
    ]


def test_steps_without_a_solution_are_said(records: Any) -> None:
    records.loop("daqp")
    records.loop("daqp", "thruster_loss_hard", infeasible_steps=3, fallbacks=3)
    steps = records._steps[-1]
    steps.loc[steps["k"].between(7, 9), "certificate"] = "infeasible"
    records.loop("daqp", "thruster_loss_hard", infeasible_steps=40, units="si")
    records.replay("daqp")
    output = (
        "maximum increment. 3 steps of `thruster_loss_hard` (7, 8 and 9) have no feasible "
        "solution, which the solver reported correctly; the fallback `shifted_plan` acted."
    )
    assert output in _answer(records).accuracy
    records.replay("daqp", "thruster_loss_hard", infeasible_steps=6, rounds=3, true_share=0.99)
    assert (
        " 5 steps of `thruster_loss_hard` have no feasible solution; the fallback "
        in _answer(records).accuracy
    )
    records.loop("osqp")
    facts = _facts(records)
    assert facts.list_runs_with_infeasible_steps(facts.configurations[-1]) == []


def test_without_a_feasible_step_nothing_is_recommended(records: Any) -> None:
    never = {"error": np.nan, "infeasible_steps": 3000}
    records.replay("daqp", true_share=0.0, **never)
    records.replay("quadprog", true_share=1.0, **never)
    found = _answer(records)
    assert found.first is not None and not found.snippets
    assert found.sentence == (
        "Nothing is recommended, because no step has a feasible point. Solvers that reported this "
        "correctly on every step of all their runs: `quadprog`."
    )
    for verdict in judge_solvers(records.view(), Requirements()).all_verdicts:
        assert verdict.state == "inconclusive"
        assert "no step of the replay of `paper` has a feasible" in Recommendation.why(verdict)
    records.loop("quadprog")
    assert "Use `quadprog`" in _answer(records).sentence


@pytest.mark.parametrize(("shortest_us", "output"), [(20, True), (5, False), (None, False)])
def test_a_p50_below_checked_waits_is_said(
    records: Any, shortest_us: int | None, output: bool
) -> None:
    records.loop("daqp")
    records.replay("daqp", median_us=9.0)
    for wait_us in (shortest_us, 1000) if shortest_us else ():
        name = f"busy_wait_{wait_us}us"
        records.replay(name, median_us=wait_us + 0.2, route="native", policy="reuse")
    note = dict(_answer(records).notes).get("checked", "")
    assert ("is below 20 µs, the shortest time for which" in note) == output == bool(note)


def test_compared_times_below_checked_waits_are_named(records: Any) -> None:
    for solver, median_us in (("daqp", 9.0), ("quadprog", 12.0)):
        records.loop(solver)
        records.replay(solver, median_us=median_us, spread=0.0)
    records.replay("busy_wait_20us", median_us=20.2, route="native", policy="reuse")
    notes = [about for about, _ in _answer(records).notes]
    assert notes.index("checked") == notes.index("next") + 1
    assert dict(_answer(records).notes)["checked"] == (
        "The p50 values of `daqp` (qpsolvers fresh) and `quadprog` (qpsolvers fresh) in the replay "
        "of `paper`, 9.00 µs and 12.0 µs, are below 20 µs, the shortest time for which the timing "
        "was checked. "
        "Differences between such times may be due to the bindings, not the methods."
    )


def test_a_time_above_checked_waits_is_not_put_down_to_bindings(records: Any) -> None:
    for solver, median_us in (("daqp", 9.0), ("quadprog", 400.0)):
        records.loop(solver)
        records.replay(solver, median_us=median_us, spread=0.0)
    records.replay("busy_wait_20us", median_us=20.2, route="native", policy="reuse")
    note = dict(_answer(records).notes)["checked"]
    assert "9.00 µs, is below 20 µs" in note and "bindings" not in note


def test_a_snippet_opens_what_it_recommends(records: Any) -> None:
    records.loop("daqp", route="native", policy="warm")
    records.replay("daqp", route="native", policy="warm")
    names: dict[str, Any] = {}
    exec(compile(dict(_answer(records).snippets)["Python"], "snippet", "exec"), names)
    assert names["solver"] is not None


@pytest.mark.parametrize(
    ("solver", "settings", "text"),
    [
        ("daqp", "default", "DAQPSettings settings;\ndaqp_default_settings(&settings);"),
        (
            "osqp",
            "default_polished",
            "OSQPSettings settings;\nosqp_set_default_settings(&settings);\n"
            "settings.adaptive_rho = 1;\nsettings.adaptive_rho_interval = 50;\n"
            "settings.polishing = 1;",
        ),
        ("quadprog", "default", None),
    ],
)
def test_a_snippet_in_c_has_numbers(
    records: Any, solver: str, settings: str, text: str | None
) -> None:
    for settings_run in dict.fromkeys(("default", settings)):
        error = 0.4 if settings_run != settings else 1e-9
        records.loop(solver, settings=settings_run, error=error)
        records.replay(solver, settings=settings_run, error=error)
    assert dict(_answer(records).snippets).get("C") == text


@pytest.mark.parametrize(
    ("solver", "settings", "options", "named"),
    [
        ("osqp", "rho=1.6", '{"rho": 1.6}', "'osqp[rho=1.6]'"),
        ("osqp", "mine", '{"rho": 1.6}', "'osqp[rho=1.6]'"),
        ("osqp", "high", "", "osqp --settings high"),
        ("osqp", "rho=1.6", '{"rho": 1.6, "adaptive_rho": false}', ""),
        ("paper_active_set", "default", "", "paper_active_set"),
    ],
)
def test_a_snippet_generates_c_code_with_the_same_settings(
    solver: str, settings: str, options: str, named: str
) -> None:
    """A comment shows where the C code cannot adapt what the measured settings adapt."""
    call = format_python_call(
        Configuration(solver, "native", "warm", settings, options=options)
    ).splitlines()
    named = named or "'osqp[adaptive_rho=false,rho=1.6]'"
    assert f"#   --solver {named}" in call
    note = "# C code has a constant rho, as with adaptive_rho = false."
    assert (note in call) == (solver == "osqp" and "adaptive_rho" not in options)


@pytest.mark.parametrize("policy", ["fresh", "reuse", "warm"])
def test_the_c_snippet_and_the_note_on_c_code_are_of_the_call_mode(
    records: Any, policy: str
) -> None:
    records.loop("osqp", route="native", policy=policy)
    records.replay("osqp", route="native", policy=policy)
    snippets = dict(_answer(records).snippets)
    is_warm = policy == "warm"
    assert f"settings.warm_starting = {int(is_warm)};" in snippets["C"]
    assert ("/* Each step: osqp_warm_start with the previous solution" in snippets["C"]) == is_warm
    note = "# It starts warm: judge it with --route native --policy warm."
    assert (note in snippets["Python"]) == (not is_warm)


def test_why_is_the_verdicts_cause(records: Any) -> None:
    records.loop("osqp", error=0.4)
    records.replay("daqp")
    records.refused("qpax", "not installed")
    why = {
        v.configuration.solver: Recommendation.why(v) for v in _facts(records).verdicts.all_verdicts
    }
    assert why["osqp"].startswith(
        "the error of its first move reaches 0.40 times the maximum increment in"
    )
    assert why["daqp"] == "no closed loop was run"
    assert why["qpax"] == "not installed"


def test_the_baseline_is_beside_the_answer(records: Any) -> None:
    for solver, us in (("daqp", 10.0), ("osqp", 50.0), ("piqp", 30.0)):
        records.replay(solver, median_us=us, steps=60)
    assert [c and c.solver for c in (_answer(records).first, _answer(records).second)] == [
        "daqp",
        "piqp",
    ]
    second = _answer(records, "osqp").second
    assert second is not None and second.solver == "osqp"
    with pytest.raises(InputError, match=r"`baseline`: found 'nope'; allowed: .* daqp, osqp, piqp"):
        _answer(records, "nope")


@pytest.mark.parametrize(("named", "second"), [("piqp", "piqp"), ("scs", "osqp"), (None, "osqp")])
@pytest.mark.slow
def test_the_suite_names_the_baseline(records: Any, named: str | None, second: str) -> None:
    for solver, us in (("daqp", 10.0), ("osqp", 20.0), ("piqp", 30.0)):
        records.replay(solver, median_us=us, steps=60)
    records.suite["report"] = {"baseline": named}
    found = Report.from_results(records.results()).recommendation.second
    assert found is not None and found.solver == second


def test_the_code_to_paste_has_settings_of_ones_own(records: Any) -> None:
    """In Python as a mapping, in C as assignments with what dpbench always sets."""
    options = '{"eps_abs": 1e-05, "polishing": true}'
    for settings, own, error in (("default", "", 0.4), ("mine", options, 1e-9)):
        records.loop("osqp", settings=settings, options=own, error=error)
        records.replay("osqp", settings=settings, options=own, error=error)
    snippets = dict(_answer(records).snippets)
    assert "settings={'eps_abs': 1e-05, 'polishing': True}," in snippets["Python"]
    assert "adaptive_rho_interval=50, eps_abs=1e-05, polishing=True" in snippets["Python"]
    assert "settings.polishing = 1;" in snippets["C"]
    assert "settings.adaptive_rho_interval = 50;" in snippets["C"]


@pytest.mark.parametrize(
    ("steps", "named"), [(300, "longest step (20.0 µs on this machine)"), (1000, "limiting p99")]
)
def test_a_margin_of_too_few_steps_names_no_p99(records: Any, steps: int, named: str) -> None:
    """A p99 takes 1000 steps."""
    records.loop("daqp")
    records.replay("daqp", steps=steps, spread=0.0)
    data = Report.from_results(records.results()).data
    (verdict,) = data.verdicts.all_verdicts
    margin = " ".join(list_speed_margin_sentences(data, verdict))
    assert f"up to 150 times slower than this machine; the {named} then reaches " in margin
    assert ("The limiting p99 is that of the replay of `paper`." in margin) is (steps == 1000)
