"""The sections that follow the selection, each registered once in `SECTIONS`."""

from collections.abc import Iterable, Mapping
from math import inf
from typing import Any

import pandas as pd

from dpbench.analysis.records.machine import find_shortest_wait_ns
from dpbench.analysis.suites.study import SMALL_M
from dpbench.analysis.times.solver_tables import (
    compute_ratios_of_pairs,
    tabulate_best_times,
    tabulate_experiment_verdicts,
    tabulate_tolerance_levels,
)
from dpbench.analysis.verdict.verdict import (
    MOST_OWN,
    list_best_verdict_of_each_solver,
    list_best_verdict_of_own_settings,
    list_main_verdicts,
)
from dpbench.bench.record.result_folder import Results
from dpbench.report.charts.embedded import draw_instructions
from dpbench.report.charts.overview import draw_accuracy, draw_deadline_chart, draw_verdict_tiles
from dpbench.report.charts.steps import COLUMNS as STEP_COLUMNS, draw_step_pairs, draw_step_strips
from dpbench.report.charts.study import draw_point_errors, draw_point_seas, draw_study_points
from dpbench.report.embedded_text import make_calculator_rows, name_sequence_and_core
from dpbench.report.formats import (
    describe_range_of_steps,
    explain_range_of_steps,
    join_with_and,
    plural,
)
from dpbench.report.page.data import (
    PageData,
    convert_to_json_number,
    make_table_of_runs,
    select_tiles,
)
from dpbench.report.page.section import Section
from dpbench.report.verdict.findings_text import shorten_findings
from dpbench.report.verdict.verdict_text import MOST_NAMED, describe_which_solvers_pass

Charts = dict[str, Any]
RATIO_RESOLUTION = 4e-4
"""Resolution of packed log ratios: three digits of ratios up to 490 000."""


def _draw_deadline_charts(data: PageData) -> Charts:
    """Return, by name, the chart of solvers' step times and deadline; empty if not timed."""
    timed = tabulate_best_times(data)
    if timed.empty:
        return {}
    return {
        "ladder": draw_deadline_chart(
            timed, data.requirements.deadline_ms, data.requirements.p99_ms
        )
    }


def _explain_step_times(data: PageData) -> str:
    """Return a text on the chart of step times: what its marks are, and the replay of the p50."""
    timed_on = dict.fromkeys(v.timed_on for v in list_main_verdicts(data.verdicts) if v.timed_on)
    replay = " or ".join(describe_range_of_steps(name) for name in timed_on)
    which = " (column `timed_on` of `tables/ladder.csv`)" * (len(timed_on) > 1)
    custom = len(list_best_verdict_of_own_settings(data.verdicts))
    left_out = custom - MOST_OWN
    what = "each solver and of each of its custom settings" if custom else "each solver"
    more = f" {left_out} more custom settings: `tables/verdicts.csv`." * (left_out > 0)
    return (
        f"Step time of {what} in its best configuration (best verdict, then fastest; if all "
        "fail, fewest failed steps, then smallest error). The "
        f"marker shows the p50 in the replay of {replay}{which}. The bar ends at the limiting p99. "
        "The line ends at the longest step, scaled up if the closed loop takes more iterations. "
        "The dashed line ends at the largest single timing. The grey "
        f"bar shows the call overhead.{_name_absent(data)}{more}"
    )


def _name_absent(data: PageData) -> str:
    """Return a sentence on the solvers that have no p50, after a space; "" for none."""
    ran = [v for v in list_main_verdicts(data.verdicts) if v.state != "not run"]
    names = _mark_names(v.configuration.solver for v in ran if not v.timed_on)
    is_are, its = ("is", "its") if len(names) == 1 else ("are", "their")
    return (
        f" {join_with_and(names)} {is_are} absent, because {its} replays (excluding windows) were "
        "not timed completely."
    ) * bool(names)


BARS = (
    "The call overhead is the time of a call from Python that copies its data but solves nothing. "
    "An interface that copies less can have a p50 below this time; its grey bar ends at the p50. "
    "If step times are below 5 µs, their differences may be due to the interfaces, not the "
    "algorithms."
)


def _draw_verdict_grids(data: PageData) -> Charts:
    """Return the charts of verdicts by name: the grid, wide and for narrow screens."""
    tiles = select_tiles(tabulate_experiment_verdicts(data)).replace(
        inf, "inf"
    )  # JSON has no infinity
    if tiles.empty:
        return {}
    tiles = tiles.assign(detail=tiles["detail"].map(shorten_findings))
    return {
        "matrix": draw_verdict_tiles(tiles),
        "matrix_narrow": draw_verdict_tiles(tiles, stacked=True),
    }


MATRIX = (
    "Each cell shows the verdict on a configuration (solver, call mode, settings) in one scenario "
    "or replay."
)
TIMED_LOOPS = "The verdict on a closed loop also depends on the step times of its window."


def _explain_verdict_grid(data: PageData) -> str:
    """Return a text on the chart of verdicts by scenario, and how many scenarios it leaves out."""
    tiles = tabulate_experiment_verdicts(data)
    tables = tiles, select_tiles(tiles)
    there, drawn = (table["experiment"].nunique() if len(table) else 0 for table in tables)
    wording = [MATRIX]
    if failures := describe_failures_in_si(data):
        wording.append(failures)
    if there != drawn:
        most = (
            f"The figure shows the {drawn} of {there} scenarios and replays with the fewest passes"
        )
        wording.append(f"{most}; `tables/experiments.csv` contains all.")
    return " ".join(wording)


def describe_failures_in_si(data: PageData, *, beyond_verdicts: bool = False) -> str:
    """Return a sentence on solvers that fail in SI units with default settings; "" for none.

    beyond_verdicts : nor if all these solvers have the overall verdict "fail".
    """
    unscaled = _list_unscaled_experiments(data)
    tiles = tabulate_experiment_verdicts(data) if unscaled else pd.DataFrame()
    if tiles.empty:
        return ""
    ran = tiles[tiles["experiment_id"].isin(unscaled) & tiles["verdict"].ne("not run")]
    requested = ran[ran["settings"] == "default"]
    failing = requested.loc[requested["verdict"] == "fail", "solver"].unique().tolist()
    best = list_best_verdict_of_each_solver(data.verdicts)
    known = {verdict.configuration.solver for verdict in best if verdict.state == "fail"}
    if not failing or (beyond_verdicts and known.issuperset(failing)):
        return ""
    count = requested["solver"].nunique()
    verb = "fails" if 1 in (count, len(failing)) else "fail"
    names = [f"`{name}`" for name in failing[:MOST_NAMED]]
    names += [f"{len(failing) - MOST_NAMED} more"] if len(failing) > MOST_NAMED else []
    return (
        f"In SI units (N, N·m), {len(failing)} of {plural(count, 'solver')} {verb}: "
        f"{join_with_and(names)}. Scale the QP, as all other runs do."
    )


def _list_experiments_of_other_modes(tiles: pd.DataFrame) -> list[str]:
    """Return as code the scenarios where a solver is shown in another call mode than elsewhere."""
    if tiles.empty:
        return []
    ran = tiles[tiles["verdict"].ne("not run")]
    usual = ran.groupby(["solver", "settings"])["call_mode"].transform(lambda m: m.mode().iloc[0])
    others = ran.loc[ran["call_mode"] != usual, "experiment"]
    return _mark_names(others)


def _list_unscaled_experiments(data: PageData) -> list[str]:
    """Return the numbers of the judged scenarios and replays in SI units, as in tables of tiles."""
    judged = data.judged_experiment_indices
    return [str(p) for p in judged if data.experiments[p].units == "si"]


def _explain_further_verdicts(data: PageData) -> str:
    """Return a text on all verdicts, runs in SI units, other call modes and names of replays."""
    wording = [describe_which_solvers_pass(data.verdicts)] if data.verdicts.of else []
    wording.append(TIMED_LOOPS)
    if _list_unscaled_experiments(data):
        wording.append("Runs in SI units (N, N·m) do not count towards the overall verdict.")
    if elsewhere := _list_experiments_of_other_modes(tabulate_experiment_verdicts(data)):
        wording.append(
            f"In {join_with_and(elsewhere)}, some solvers were run in a call mode other "
            "than that of the first figure; the tooltip names it."
        )
    if notation := explain_range_of_steps(run.sequence for run in data.runs.values()):
        wording.append(notation)
    return " ".join(wording)


def _draw_empty_step_charts(data: PageData) -> Charts:
    """Return by name the empty charts of one run's steps, which the page's script fills."""
    if not data.runs:
        return {}
    forces = pd.DataFrame(columns=["k", "force", "share"])
    no_steps = pd.DataFrame(columns=list(STEP_COLUMNS))
    charts = {"strips": draw_step_strips(no_steps, forces, data.requirements.error_move)}
    if any(run.mode == "replay" or run.is_of_own_plant for run in data.runs.values()):
        limit = data.requirements.error_move
        charts["strips_without_forces"] = draw_step_strips(no_steps, None, limit)
    return charts


def _draw_empty_pair_chart(data: PageData) -> Charts:
    """Return by name the empty chart of two solvers' step times, which the page's script fills."""
    has_pair = len({c for c, p in data.runs if data.experiments[p].mode == "replay"}) > 1
    return {"pairs": draw_step_pairs("first", "second")} if has_pair else {}


def _pack_ratios(data: PageData, _: Results) -> dict[str, Any]:
    """Return JSON data: each two configurations' log time ratio and its half-width, packed."""
    pairs = compute_ratios_of_pairs(data)
    ratio = data.block.add_as_int16_multiples(pairs.logs, RATIO_RESOLUTION)
    reach = data.block.add_as_uint16_logs(pairs.widths)
    about: dict[str, Any] = {
        "variables": pairs.sizes,
        "turns": pairs.turns,
        "spreads": pairs.spreads,
        "shortest": convert_to_json_number(find_shortest_wait_ns(data.records.calibration)),
    }
    return {"paired": {"c": pairs.timed, "ratio": ratio, "reach": reach, **about}}


def _draw_accuracy(data: PageData) -> Charts:
    """Return by name the chart of error by tolerance level; empty if only one was run."""
    points = tabulate_tolerance_levels(data)
    return {} if points.empty else {"accuracy": draw_accuracy(points, data.requirements.error_move)}


def _explain_accuracy(data: PageData) -> str:
    """Return a text on the chart of error over time: which replays its errors and times are of."""
    points = tabulate_tolerance_levels(data)
    if points.empty:
        return ""
    usual, *others = points["timed_on"].value_counts().index
    exceptions = [
        f" {_explain_other_replays(points, names, usual)}{_name_timed_replays(names)}."
        for names in others
    ]
    replays = len(data.records.sequences)
    where = f" over {'both' if replays == 2 else f'all {replays}'} replays" if replays > 1 else ""
    return (
        f"Largest error of each solver{where} against its step time, in the call mode of the "
        f"first figure. The step time is {_name_timed_replays(usual)}.{''.join(exceptions)} The "
        "fill shows the overall verdict. The dashed line is the largest error allowed."
        f"{_name_absent(data)}"
    )


def _explain_other_replays(points: pd.DataFrame, names: str, usual: str) -> str:
    """Return up to its verb a sentence on solvers timed on other replays than usual."""
    solvers = join_with_and(_mark_names(points["solver"][points["timed_on"] == names]))
    has_p99 = points["p99_us"].notna()
    if has_p99[points["timed_on"] == names].any() or not has_p99[points["timed_on"] == usual].all():
        return f"For {solvers}, the step time is "
    has = "has" if points["solver"][points["timed_on"] == names].nunique() == 1 else "have"
    return f"Exception: {solvers} {has} too few steps for a p99. It is shown at its p50: "


def _mark_names(names: Iterable[str]) -> list[str]:
    """Return names as code, each once."""
    return [f"`{name}`" for name in dict.fromkeys(names)]


def _name_timed_replays(names: str) -> str:
    """Return a text on the replays of a step time, the largest of several, as of `timed_on`."""
    replays = [describe_range_of_steps(name) for name in names.split("; ")]
    if len(replays) == 1:
        return f"that in the replay of {replays[0]}"
    largest = "larger" if len(replays) == 2 else "largest"
    return f"the {largest} of the values in the replays of {join_with_and(replays)}"


def _draw_empty_study_charts(data: PageData) -> Charts:
    """Return the charts of a study by name, without data, which the page's script fills in."""
    if not (data.studies and data.runs):
        return {}
    return {
        "design_tiles": draw_study_points(tiles=True),
        "design_points": draw_study_points(tiles=False),
        "behind": draw_point_errors(100 * SMALL_M),
        "seas": draw_point_seas(),
    }


def _draw_counts(data: PageData) -> Charts:
    """Return by name the chart of instructions of each solver's C on embedded cores; or empty."""
    cores = {(sequence.target, sequence.single) for sequence in data.counts.sequences}
    rows, one_core = [], len(cores) == 1
    for sequence in data.counts.sequences:
        group = name_sequence_and_core(sequence)
        for one in sequence.solvers:
            name = f"{one.solver} in {sequence.sequence if one_core else group}"
            row = {"label": name, "group": group, "k": str(one.k)}
            rows.append(row | {"p50": one.p50, "p99": one.p99, "worst": one.worst})
    return {"embedded": draw_instructions(pd.DataFrame(rows))} if rows else {}


def _explain_counts(data: PageData) -> str:
    """Return a text on the chart of instructions: what its marks are."""
    return (
        "Instructions per step of each solver's C code. The marker shows the p50. The bar ends at "
        "the p99 and the line at the maximum. "
        f"{explain_range_of_steps(one.sequence for one in data.counts.sequences)}"
    )


def _pack_counts(data: PageData, _: Results) -> dict[str, Any]:
    """Return JSON data: the instructions of the calculator's rows, packed; empty if not counted."""
    rows = make_calculator_rows(data.counts, data.requirements)
    counts = [{"solver": row.solver, "p99": row.p99, "worst": row.worst} for row in rows]
    return {"counts": counts} if counts else {}


SECTIONS = (
    Section(
        "answer",
        "Summary",
        _draw_deadline_charts,
        ("ladder",),
        text=_explain_step_times,
        folded_text=lambda _: BARS,
        always=True,
    ),
    Section(
        "matrix",
        "Verdicts",
        _draw_verdict_grids,
        ("matrix",),
        text=_explain_verdict_grid,
        folded_text=_explain_further_verdicts,
    ),
    Section("one", "One solver", _draw_empty_step_charts, live=True),
    Section("two", "Two solvers", _draw_empty_pair_chart, data=_pack_ratios, live=True),
    Section("accuracy", "Accuracy", _draw_accuracy, ("accuracy",), text=_explain_accuracy),
    Section(
        "study",
        "Study",
        _draw_empty_study_charts,
        data=lambda data, _: {"studies": data.study_documents},
        live=True,
        in_topic=True,
    ),
    Section(
        "embedded",
        "Embedded cores",
        _draw_counts,
        ("embedded",),
        text=_explain_counts,
        data=_pack_counts,
        in_topic=True,
    ),
    Section(
        "data",
        "Data",
        data=lambda data, all: {"table": make_table_of_runs(data, all.runs)},
        always=True,
    ),
)
"""Sections of the page in its order; topics precede the last one."""


def draw_section_charts(data: PageData) -> dict[str, Charts]:
    """Return the charts that follow the reader's selection, by section of the page and name."""
    return {section.id: section.charts(data) for section in SECTIONS}


def select_static_charts(charts: Mapping[str, Mapping[str, Any]]) -> Charts:
    """Return, by name, the charts that the page shows before any script has run."""
    return {
        name: charts[section.id][name]
        for section in SECTIONS
        for name in section.drawn
        if name in charts.get(section.id, {})
    }
