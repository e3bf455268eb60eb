"""Captions of tables in LaTeX: contents, how step times were measured, intervals, empty cells."""

from collections.abc import Iterator, Sequence

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.study import NOTHING, Study, find_studies
from dpbench.bench.record.result_folder import Results
from dpbench.report.formats import plural

_TIME_ENDINGS = ("_us", "_ms", "_ns")
RATIO_NOTE = (
    "Ratio: geometric mean of the step times of the second over those of the first, on the same "
    "steps. Low and high: its 95 % interval, for these measurements only: two runs can differ by "
    "more."
)
NO_RATIO_NOTE = (
    "No ratio: two configurations must be timed on the same QPs. One solver at several horizons "
    "solves different QPs: vary the horizon in a study, whose effects on step times have intervals."
)
P99_INTERVAL_NOTE = (
    "p99 low and high: 95 % interval of the limiting p99; empty for a window and for a p99 that is "
    "scaled up, infinite if too few steps take longer."
)
UNTIMED_NOTE = (
    "An empty cell: the configuration was not run or not timed, or, for a p99, had neither a "
    "replay of at least 1 000 steps nor a window."
)
VERDICT_REPLAYS_NOTE = (
    "`results.verdict()` has the replays of the p50 and the limiting p99 in its columns `timed_on` "
    "and `p99_on`."
)
EXCESS_NOTE = (
    "Excess error: 95 % radial error less that of the reference in the same realisation, mean over "
    "points. Excess cost: 100 times the logarithm of the ratio of closed-loop costs. Low and high: "
    "95 % interval of the mean, for each row alone; empty with too few pairs, or if differences "
    f"of each point are equal to within {100.0 * NOTHING:.4f} cm or %; a mean not above that is 0."
)
EFFECTS_NOTE = (
    "Low and high: 95 % interval of the effect, over realisations (over points if each has one), "
    "for each row alone. No effect: other load can explain that on the step time (disturbed). An "
    "effect without low and high: the same in every realisation, to within "
    f"{100.0 * NOTHING:.4f} of its unit, or of too few pairs. The column `interval` tells them "
    "apart."
)
_TIMES_OF_VERDICT = ("p50_us", "replay_p99_us", "limiting_p99_us", "max_us", "margin")
"""Columns of the verdicts that are empty for a configuration without times."""


def _describe_realisations(study: Study, points: int) -> str:
    """Return a sentence on the number of realisations at so many points of a study."""
    return (
        f"Study `{study.name}`: {plural(points, 'point')}, "
        f"at most {plural(study.seas_per_point, 'realisation')} each."
    )


def _describe_studies(studies: Sequence[Study]) -> list[str]:
    """Return sentences on the points and realisations in each study's means, and on the others."""
    # The report draws, and Altair takes its time.
    from dpbench.report.topics.study import yield_excluded_points_sentences

    compared = [
        _describe_realisations(study, len(study.points) - len(study.points_left_out))
        for study in studies
    ]
    return [*compared, *yield_excluded_points_sentences(studies)]


def describe_table_with_runs(results: Results, name: str, table: pd.DataFrame) -> str:
    """Return the contents of a table of results, and how its step times were measured."""
    # The report draws, and Altair takes its time.
    from dpbench.report.report import describe_table

    caption = describe_table(name, table)
    if name == "study_excess":
        studies = find_studies(Records(results))
        caption = " ".join([caption, EXCESS_NOTE, *_describe_studies(studies)])
    if name in ("study_effects", "study_interactions"):
        counts = (_describe_realisations(s, len(s.points)) for s in find_studies(Records(results)))
        caption = " ".join([caption, EFFECTS_NOTE, *counts])
    is_timed = any(column.endswith(_TIME_ENDINGS) for column in table.columns)
    runs = results.runs[(results.runs["mode"] == "replay") & (results.runs["rounds"] > 0)]
    if not (is_timed and len(runs)):
        return caption
    rounds, steps = (
        " to ".join(dict.fromkeys((str(int(n.min())), str(int(n.max())))))
        for n in (runs["rounds"], runs["steps_done"])
    )
    return f"{caption} Replays: {steps} steps, each step's fastest of {rounds} rounds."


def yield_notes_on_columns(
    frame: pd.DataFrame, columns: Sequence[str], *, are_verdicts: bool
) -> Iterator[str]:
    """Yield sentences on the meaning of columns of a table, and of their empty cells.

    frame : with all columns of the table; columns : those that are printed.
    """
    if {"ratio", "finding"} <= {*frame}:
        yield RATIO_NOTE
        if (frame["finding"] == "one run").any():
            yield "An empty ratio: both names are of one run."
    if {"p99_low_us", "p99_high_us"} & {*columns}:
        yield P99_INTERVAL_NOTE
    if not are_verdicts:
        return
    times = [name for name in columns if name in _TIMES_OF_VERDICT]
    if frame[times].isna().any(axis=None):
        yield UNTIMED_NOTE
    if {"p50_us", "limiting_p99_us"} <= {*columns} and not {"timed_on", "p99_on"} & {*columns}:
        yield VERDICT_REPLAYS_NOTE
