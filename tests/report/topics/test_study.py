"""The figures of a large study stay small, and say what they leave out."""

import io
import json
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.analysis.suites import study_tables
from dpbench.analysis.suites.study import Study, find_studies
from dpbench.analysis.suites.study_tables import (
    tabulate_differences_from_reference,
    tabulate_study_points,
)
from dpbench.report.charts.render import compile_vega
from dpbench.report.documents.markdown import make_report_markdown
from dpbench.report.report import Report, encode_csv
from dpbench.report.study_effects_table import build_effects_table, tabulate_effects
from dpbench.report.topics import study as topic

WIND, EAST = "environment.wind.speed_mps", "start.east_m"


def _fill(
    records: Any,
    points: int,
    seas: int,
    *,
    lost: tuple[int, int] | None = None,
    outcome: str = "crashed",
) -> Any:
    """Two solvers at points of two keys; one of them is 2 to 4 cm behind, and does not finish the
    run of one point and sea."""
    rng = np.random.default_rng(1)
    for point in range(points):
        x = {WIND: float(rng.uniform(5, 18)), EAST: float(rng.uniform(0, 3))}
        for sea in range(1, seas + 1):
            for solver, behind in (("daqp", 0.0), ("osqp", rng.uniform(0.02, 0.04))):
                study = {"name": "seas", "point": point, "replicate": sea, "x": x}
                records.loop(
                    solver,
                    done=0,
                    steps_done=5,
                    cell=json.dumps({"study": study}),
                    study="seas",
                    study_point=point,
                    replicate=sea,
                    r_95_m=0.5 + behind,
                    exact_cost=100.0 - (solver == "osqp"),
                    outcome=outcome if behind and (point, sea) == lost else "finished",
                )
    return topic.build_study_topic(find_studies(records.view()))


def _drawn(figure: Any, column: str) -> list[float]:
    """The values of a column in the data of a figure."""
    sets = compile_vega(figure.chart)["data"]
    return [row[column] for data in sets for row in data.get("values", []) if column in row]


def compile_rows(figure: Any) -> list[dict[str, Any]]:
    """The rows in the data of a figure that name a configuration."""
    sets = compile_vega(figure.chart)["data"]
    return [row for data in sets for row in data.get("values", []) if "configuration" in row]


def test_the_files_of_a_study_hold_numbers(records: Any) -> None:
    """20 seas of osqp, 2 to 4 cm behind, one of them stopped."""
    _fill(records, points=5, seas=4, lost=(2, 3), outcome="timed_out")
    studies = find_studies(records.view())
    behind, points = (
        pd.read_csv(io.BytesIO(encode_csv(table(studies))))
        for table in (tabulate_differences_from_reference, tabulate_study_points)
    )
    texts = {"study", "configuration", "reference"}
    assert set(behind.select_dtypes(exclude="number")) == texts
    assert set(points.select_dtypes(exclude="number")) == texts - {"reference"}
    osqp = behind.set_index("configuration").loc["osqp"]
    assert (osqp["runs"], osqp["finished"], osqp["stopped"]) == (20, 19, 1)
    assert (
        2.0
        < osqp["excess_error_cm_low"]
        < osqp["excess_error_cm"]
        < osqp["excess_error_cm_high"]
        < 4.0
    )
    assert points["runs"].tolist() == [4] * 10 and points["finished"].sum() == 39
    assert points[f"x_{WIND}"].between(5, 18).all()


def test_stopped_runs_are_counted_and_named(records: Any) -> None:
    found = _fill(records, points=5, seas=4, lost=(2, 3), outcome="timed_out")
    assert found.lines[1] == (
        "`seas`: 1 of 40 runs stopped at the time limit (`cell_limit_s`) and not judged: 1 of "
        "`osqp`. They are in no share of runs within the radius."
    )
    assert "conditional on the realisations" in found.lines[2]
    assert found.tables[0].rows[1][:2] == ("osqp", "19 of 20, 1 stopped")


def test_refused_runs_are_counted_and_named(records: Any) -> None:
    """They are in no share within the radius, and have not failed to finish.

    Nothing shows that two settings are the same.
    """
    for sea in (1, 2):
        records.sea("daqp", 0, sea, {EAST: 1.0})
        refused = {"outcome": "refused", "outcome_detail": "no native route."}
        for settings in ("default", "high"):
            records.sea("scs", 0, sea, {EAST: 1.0}, done=0, settings=settings, **refused)
    found = topic.build_study_topic(find_studies(records.view()))
    assert found is not None
    assert found.lines[1:] == (
        "`seas`: 4 of 6 runs refused and not judged: 2 of `scs` (no native route) and 2 of `scs` "
        "(high) (no native route).",
        "In 100 % (at least 0 %) of the runs with `daqp` the ship stays within 1 m in the second "
        "half, as with all other configurations.",
    )
    assert found.tables[0].rows[1][:3] == ("scs", "0 of 2", "–")


@pytest.mark.parametrize("switches", [99, 101])
def test_a_disturbed_machine_is_said_of_a_study(records: Any, switches: int) -> None:
    """Two runs of 10 s each with so many involuntary switches: 10 a second are allowed."""
    for sea in (1, 2):
        columns = {"replay_s": 10.0, "involuntary_switches": switches}
        records.sea("daqp", 0, sea, {EAST: 1.0}, **columns)
    found = topic.build_study_topic(find_studies(records.view()))
    assert found is not None
    said = [line for line in found.lines if "other load disturbed the machine" in line]
    expected = (
        "`seas`: other load disturbed the machine: 10 involuntary context switches per second. "
        "An effect on step times is shown only if its whole interval is above +50 % or below "
        "−33 %: other load may cause a smaller one."
    )
    assert said == ([expected] if switches == 101 else [])
    plain = expected.replace("`", "")
    assert records.ending().get("times") == (plain if switches == 101 else None)
    report = make_report_markdown(Report.from_results(records.results()))
    assert (expected in report) == (switches == 101)


@pytest.mark.parametrize("switches", [99, 101])
def test_a_step_time_of_a_disturbed_machine_has_no_number(records: Any, switches: int) -> None:
    """The error keeps its own: other load changes no answer."""
    for sea in range(1, 7):
        for point, east in enumerate((0.0, 3.0)):
            columns = {"replay_s": 10.0, "involuntary_switches": switches, "r_95_m": 0.5 + east}
            time_ns = (1.0 + 0.2 * point + 0.01 * sea * point) * 1e5
            records.sea("daqp", point, sea, {EAST: east}, raw_p50_ns=time_ns, **columns)
            records._runs[-1]["r_95_m"] += 0.01 * sea * point
    (study,) = find_studies(records.view())
    whole = build_effects_table([study]).set_index("measure")
    ends = whole[["low", "high"]].notna().all(axis=1)
    assert ends["95 % radial error"] and ends["median step time"] == (switches == 99)
    numbers = whole.loc["median step time", ["effect", "median", "same_sign"]]
    if switches == 99:
        assert numbers["effect"] == pytest.approx(23.5, abs=0.1) and numbers["same_sign"] == 6
    else:
        assert numbers.isna().all()
    assert whole.loc["median step time", "interval"] == ("95 %" if switches == 99 else "disturbed")
    table = tabulate_effects(study)
    assert table is not None
    (text,) = (row[3] for row in table.rows)
    assert (text == "disturbed") == (switches == 101)
    (figure,) = topic.draw_effect_figures(study, "seas")
    measures = {row["measure"] for row in compile_rows(figure)}
    assert ("median step time [%]" in measures) == (switches == 99)
    assert ("other load can explain are not drawn" in figure.caption) == (switches == 101)


def test_a_skewed_difference_is_marked(records: Any) -> None:
    """Nine realisations near 1 cm and one of 90 cm; of the other solver, 1 to 10 cm evenly."""
    for sea in range(10):
        for solver, change in (("daqp", 0.9 if sea == 9 else 0.01 + 1e-4 * sea), ("osqp", sea)):
            for point, east in enumerate((0.0, 3.0)):
                more = change if solver == "daqp" else 0.01 * (1 + change)
                records.sea(solver, point, sea, {EAST: east}, r_95_m=0.5 + point * more)
    (study,) = find_studies(records.view())
    table = tabulate_effects(study)
    assert table is not None
    texts = {row[2]: row[table.heads.index("95 % radial error [cm]")] for row in table.rows}
    assert texts["daqp"].endswith(" (skewed, widened)") and "widened" not in texts["osqp"]
    assert "1.5 times as wide as Student's" in table.note
    whole = build_effects_table([study])
    rows = whole[whole["measure"] == "95 % radial error"].set_index("configuration")
    assert rows.loc["daqp", "widening"] >= 1.5 > rows.loc["osqp", "widening"] >= 1.0
    excess = next(iter(topic._make_study_tables(study)))
    assert any("(skewed, widened)" in cell for row in excess.rows for cell in row)


def test_settings_without_an_effect_have_one_row(records: Any) -> None:
    """A run under a second name has the same times; one of other settings has not."""
    for sea in (1, 2):
        for settings, raw_max_ns in (("default", 1e5), ("high", 1e5), ("low", 2e5)):
            columns = {"settings": settings, "raw_max_ns": raw_max_ns + sea}
            records.sea("osqp", 0, sea, {EAST: 1.0}, **columns)
    found = topic.build_study_topic(find_studies(records.view()))
    assert found is not None and found.lines[0].startswith("`seas`: 4 runs at 1 point")
    assert {row[0] for row in found.tables[0].rows} == {"osqp", "osqp (low)"}
    assert found.tables[0].note.endswith(
        "Settings without an effect share a row: osqp (high) with osqp."
    )


@pytest.mark.slow
def test_a_small_study_is_drawn_whole(records: Any) -> None:
    found = _fill(records, points=5, seas=4)
    within, behind = found.figures
    assert len(_drawn(within, "within")) == 2 * 5 and "at each point" in within.caption
    assert len(_drawn(behind, "error_excess_cm")) == 20 and "by rank" not in behind.caption


@pytest.mark.slow
def test_of_a_large_study_some_seas_are_drawn(records: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(study_tables, "MOST_DOTS", 9)
    monkeypatch.setattr(study_tables, "MOST_POINTS", 20)
    monkeypatch.setattr(study_tables, "FIELDS", 3)
    found = _fill(records, points=60, seas=2)
    within, _, behind = found.figures
    assert (
        "in 3 × 3 fields" in within.caption
        and "(9 of 120, evenly spaced by rank)" in behind.caption
    )
    assert len(_drawn(within, "within")) <= 2 * 9 and sum(_drawn(within, "runs")) == 2 * 120
    dots = _drawn(behind, "error_excess_cm")
    assert len(dots) == 9 and min(dots) < 2.1 and max(dots) > 3.9


def test_a_share_of_all_or_none_has_a_bound(records: Any) -> None:
    """All of 12 realisations are within: at least 1 - 3/12 of all are, as sure as any interval."""
    found = _fill(records, points=5, seas=12)
    assert found.lines[1].startswith("In 100 % (at least 75 %) of the runs with ")
    assert {row[2] for row in found.tables[0].rows} == {"100 % (at least 75 %)"}


@pytest.mark.parametrize(("seas", "most"), [(8, 38), (9, 34), (10, 30)])
def test_a_bound_is_rounded_to_the_safe_side(records: Any, seas: int, most: int) -> None:
    """3/8 is 37.5 %, 3/9 a third, 3/10 exactly 30 %."""
    for sea in range(seas):
        records.sea("daqp", 0, sea, {EAST: 1.0})
    (study,) = find_studies(records.view())
    assert study.bound_of_none_percent == most


def test_the_loosest_tolerance_states_its_accuracy(records: Any) -> None:
    """10 of 40 steps are accurate in each of 6 runs, and 28 of the others count as solved."""
    for sea in range(6):
        shared = {"r_95_m": 0.5, "closed_loop_cost": 100.0, "exact_cost": 100.0}
        records.sea("daqp", 0, sea, {EAST: 1.0}, **shared)
        accuracy = {"true_share": 0.25, "claimed_not_true": 28, "error_move_max": 0.0275}
        records.sea("osqp", 0, sea, {EAST: 1.0}, settings="1e-2", **shared, **accuracy)
    found = topic.build_study_topic(find_studies(records.view()))
    assert found is not None and found.lines[-1] == (
        "`seas`: The loosest tolerance (`default` is not compared) with an excess error "
        "significantly below 1 cm and an excess cost significantly below 1 %: `osqp` (1e-2) with "
        "25.0 % of the steps verified. `osqp` (1e-2) does not pass the requirements: the error of "
        "the first move is up to 0.028 (limit 0.01) and 168 of 240 steps were reported as solved "
        "but not verified."
    )
    text = make_report_markdown(Report.from_results(records.results()))
    assert found.lines[-1] in text.splitlines()
    heads, (_, osqp) = found.tables[0].heads, found.tables[0].rows
    assert osqp[heads.index("verified steps")] == "25.0 %"


def test_keys_are_in_the_order_of_the_suite(records: Any) -> None:
    """A run's description sorts its keys; one that the suite does not have comes last."""
    x = {"a": 1.0, "controller.control_horizon": 5, "controller.prediction_horizon": 30, EAST: 1.0}
    records.sea("daqp", 0, 1, x)
    changed = {"controller.prediction_horizon": [30], "controller.control_horizon": [5]}
    records.suite["study"][0] |= {"zip": changed, "product": {EAST: [1.0]}}
    (study,) = find_studies(records.view())
    assert [*study.points] == [EAST, *changed, "a"]


def test_what_was_lost_is_a_condition(records: Any) -> None:
    found = _fill(records, points=2, seas=6, lost=(1, 3))
    assert "1 of 24 runs did not finish" in found.lines[1] and "conditional" in found.lines[1]
    assert "conditional on the realisations" in found.tables[0].note
    assert [row[1] for row in found.tables[0].rows] == ["12 of 12", "11 of 12"]


def test_failed_steps_of_runs_are_said(records: Any) -> None:
    """Two runs of three have failed steps: 3 of 40, and 4 of 20 in one that ended early."""
    records.sea("daqp", 0, 1, {EAST: 1.0})
    records.sea("osqp", 0, 1, {EAST: 1.0}, failed=3)
    records.sea("osqp", 0, 2, {EAST: 1.0}, failed=4, done=20)
    found = topic.build_study_topic(find_studies(records.view()))
    assert found is not None and found.lines[1] == (
        "`seas`: steps failed in 2 of 3 runs, most of them with `osqp` at point 0, realisation 2: "
        "4 of 20 steps. In these steps the fallback or an unconverged iterate acted on the ship."
    )


@pytest.mark.slow
def test_a_mean_without_an_interval_has_no_ends(records: Any) -> None:
    found = _fill(records, points=1, seas=2)
    assert _drawn(found.figures[-1], "low_cm") in ([], [None])
    assert "(no interval)" in found.tables[0].rows[1][5]


def test_a_cost_below_the_exact_loops_is_explained_where_it_is_shown(records: Any) -> None:
    """By the note of its table, and by none where every cost is above."""
    for cost in (101.0, 98.0):
        for sea in range(6):
            columns = {"closed_loop_cost": cost, "exact_cost": 100.0, "r_95_m": 0.5}
            records.sea("daqp", 0, sea + 1, {EAST: 0.0}, settings=f"{cost:g}", **columns)
        report = Report.from_results(records.results())
        (found,) = (part for part in report.topics if part.id == "study")
        assert (topic.CHEAPER_THAN_EXACT in found.tables[0].note) is (cost < 100.0)


@pytest.mark.slow
def test_each_factor_has_a_slope_in_table_figure_and_file(records: Any) -> None:
    """The 20 points are drawn from ranges; the error of one solver is the same at all of them."""
    found = _fill(records, points=20, seas=6)
    table, figure = found.tables[2], found.figures[1]
    rows = {(row[0], row[2]): row for row in table.rows}
    assert set(rows) == {(key, solver) for key in (WIND, EAST) for solver in ("daqp", "osqp")}
    assert rows[WIND, "daqp"][4] == "0 in every realisation"
    assert rows[WIND, "osqp"][1].endswith(", slope") and "[" in rows[WIND, "osqp"][4]
    assert {row["configuration"] for row in compile_rows(figure)} == {"daqp", "osqp"}
    whole = build_effects_table(find_studies(records.view()))
    assert len(whole) == 2 * 2 * 5
    varies = whole["measure"].eq("median step time")
    varies |= whole["configuration"].eq("osqp") & whole["measure"].eq("95 % radial error")
    assert (whole["low"] < whole["high"]).tolist() == varies.tolist()
    constant = whole["interval"] == "in every realisation"
    assert constant.tolist() == (~varies).tolist() and whole["low"].isna().equals(constant)
    assert whole[constant]["effect"].eq(0.0).all()
    assert set(whole["measure"]) >= {"median step time", "95 % radial error"}


@pytest.mark.slow
def test_one_sea_that_carries_a_mean_is_visible(records: Any) -> None:
    """From 0 to 3 m the error falls by 1 cm in five seas of daqp and grows by 65 cm in the sixth.

    Mean (65 - 5) / 6 = 10 cm, median -1 cm. That of piqp grows by 1 to 6 cm; that of osqp is equal.
    """
    changes = {
        "daqp": [-0.01] * 5 + [0.65],
        "piqp": [0.01, 0.02, 0.03, 0.04, 0.05, 0.06],
        "osqp": [0.0] * 6,
    }
    for solver, seas in changes.items():
        for sea, change in enumerate(seas):
            for point, east in enumerate((0.0, 3.0)):
                study = {"point": point, "replicate": sea, "x": {EAST: east}}
                records.loop(
                    solver,
                    done=0,
                    cell=json.dumps({"study": {"name": "seas", **study}}),
                    study="seas",
                    study_point=point,
                    replicate=sea,
                    r_95_m=0.5 + 0.1 * sea + point * change,
                )
    (study,) = find_studies(records.view())
    whole = build_effects_table([study])
    rows = whole[whole["measure"] == "95 % radial error"].set_index("configuration")
    assert rows[["from", "to"]].to_numpy().tolist() == [[0.0, 3.0]] * 3
    assert (rows["realisations"] == 6).all() and (rows["pairs"] == 6).all()
    cells = rows[["effect", "median", "same_sign"]]
    assert cells.loc["daqp"].tolist() == pytest.approx([10.0, -1.0, 5.0])
    assert cells.loc["piqp"].tolist() == pytest.approx([3.5, 3.5, 6.0])
    assert cells.loc["osqp"].tolist() == pytest.approx([0.0, 0.0, 6.0])
    assert rows["interval"].to_dict() == {
        "daqp": "95 %",
        "piqp": "95 %",
        "osqp": "in every realisation",
    }
    table = tabulate_effects(study)
    assert table is not None
    assert "for each cell alone and not for all at once" in table.note
    texts = {row[2]: row[4] for row in table.rows}
    assert texts["piqp"].endswith("] in 6 of 6 realisations")
    assert texts["daqp"].endswith("]") and texts["osqp"] == "0 in every realisation"


@pytest.mark.slow
@pytest.mark.parametrize("levels", [3, 7])
def test_the_markdown_has_what_is_behind_and_the_first_effects(records: Any, levels: int) -> None:
    """Two configurations with an effect of each level after the first; osqp is 2 to 3 cm behind.

    Its six seas have a standard error of 0.153 cm, times 2.57 of Student's t.
    """
    for east in range(levels):
        for sea in range(6):
            for solver, more in (("daqp", 0.0), ("osqp", 0.02 + 0.002 * sea)):
                error_m = 0.5 + 0.1 * east * (1 + 0.1 * sea) + more
                records.sea(solver, east, sea + 1, {EAST: float(east)}, r_95_m=error_m)
    text = make_report_markdown(Report.from_results(records.results()))
    behind, effects = text.split("seas: comparison with daqp in the same realisation:")[1].split(
        "seas: effect of each factor:"
    )
    assert f"| osqp | {6 * levels} of {6 * levels} |" in behind
    assert "| 2.5 [2.1, 2.9] |" in behind and "not for all at once" in behind
    rows = [line for line in effects.splitlines() if line.startswith(f"| {EAST} |")]
    assert len(rows) == min(8, 2 * (levels - 1))
    assert ("\n4 more rows: `tables/study_*.csv`.\n" in effects) is (levels == 7)
    assert "seas: points" not in text


@pytest.mark.slow
def test_points_left_out_are_named(records: Any) -> None:
    """The exact loop leaves its station at point 0 of two, in one sea."""
    for point in (0, 1):
        for sea in (1, 2):
            for solver in ("daqp", "osqp"):
                left = {"exact_left_s": 9.0} if (point, sea) == (0, 2) else {}
                records.sea(solver, point, sea, {EAST: float(point)}, **left)
    studies = find_studies(records.view())
    assert (tabulate_study_points(studies)["r_max_m"] == 1.77).all()
    built = topic.build_study_topic(studies)
    assert built is not None and built.lines[1] == (
        "`seas`: 1 point excluded from every difference to `daqp`, as the reference loop leaves "
        "its station there: 0."
    )
    assert records.ending()["points"] == built.lines[1].replace("`", "")
    assert built.lines[1] in make_report_markdown(Report.from_results(records.results()))
    alone = [run for run in records.view().study if run.solver == "daqp"]
    assert not list(topic.yield_excluded_points_sentences([Study("seas", alone, 1.0)]))


def test_of_one_configuration_the_answer_is_what_it_does(records: Any) -> None:
    """There is nothing to be behind of, and no other to stay within the radius as well."""
    for point, hs in enumerate((1.0, 2.0)):
        for replicate in (1, 2):
            records.sea("daqp", point, replicate, {"waves.hs_m": hs}, tail_m=0.1 if hs < 2 else 2.0)
    found = topic.build_study_topic(find_studies(records.view()))
    assert found is not None
    assert found.lines == (
        "`seas`: 4 runs at 2 points in 2 realisations; in 50 % of the runs with `daqp` the ship "
        "stays within 1 m in the second half.",
    )


def test_keys_that_change_together_are_one_axis(records: Any) -> None:
    """A map over both would be a diagonal; the label names the key that goes with the other."""
    points = [(1.0, 6.0, 0.0), (1.0, 6.0, 3.0), (2.0, 7.5, 0.0), (2.0, 7.5, 3.0)]
    for point, values in enumerate(points):
        x = dict(zip(("waves.hs_m", "waves.tp_s", "start.east_m"), values, strict=True))
        for replicate in (1, 2):
            records.sea("daqp", point, replicate, x, tail_m=0.1)
    (study,) = find_studies(records.view())
    assert study_tables.label_numeric_factors(study) == {
        "waves.hs_m": "waves.hs_m (with waves.tp_s)",
        "start.east_m": "start.east_m",
    }
    assert len(study_tables.tabulate_shares_in_position(study)) == 4


def test_a_solver_that_ran_alone_is_compared_with_none(records: Any) -> None:
    """The baseline law solves no QP, so it is no solver."""
    for sea in range(1, 5):
        records.sea("daqp", 0, sea, {"waves.hs_m": 2.0})
        records.sea("unconstrained_clipped", 0, sea, {"waves.hs_m": 2.0}, formulation="none")
    found = topic.build_study_topic(find_studies(records.view()))
    assert found is not None
    first, *_ = found.lines
    assert first == (
        "`seas`: 8 runs at 1 point in 4 realisations; only `daqp` was run, so no other solver is "
        "compared."
    )


def test_page_and_table_agree_on_a_difference_within_rounding(records: Any) -> None:
    """At most 1e-7 m of error in each of six realisations; the cost differs by 1 to 6 %."""
    for sea in range(1, 7):
        for solver, more in (("daqp", 0.0), ("piqp", 1e-8 * sea)):
            cost = 100.0 + 1e6 * 100.0 * more
            records.sea(solver, 0, sea, {EAST: 1.0}, r_95_m=0.5 + more, closed_loop_cost=cost)
    (study,) = studies = find_studies(records.view())
    row = tabulate_differences_from_reference(studies).set_index("configuration").loc["piqp"]
    assert row["excess_error_cm"] == 0.0
    assert row[["excess_error_cm_low", "excess_error_cm_high"]].isna().all()
    assert row["excess_cost_percent_low"] < row["excess_cost_percent_high"]
    found = topic.build_study_topic([study])
    assert found is not None
    cells = dict(zip(found.tables[0].heads, found.tables[0].rows[1], strict=True))
    assert cells["excess error [cm]"] == "0 in every realisation"
    assert "equal to within 0.0001 cm or %; a mean not above that is 0." in found.tables[0].note
