"""Numbers of studies as tables: a row per configuration, and a row per point of each."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from dpbench.analysis.suites.study import SMALL_M, PairedDifference, StudiedConfiguration, Study

BEHIND_COLUMNS = (
    *("study", "configuration", "reference", "runs", "finished", "stopped", "within_share"),
    *("r_95_m", "cost_over_exact_percent", "behind_cm", "behind_cm_low", "behind_cm_high"),
    *("dearer_percent", "dearer_percent_low", "dearer_percent_high", "p_differs", "seas_for_1_cm"),
)
POINT_COLUMNS = (
    *("study", "configuration", "point", "runs", "finished", "stopped", "within_share", "r_95_m"),
    "r_max_m",
)
"""Columns of each study; those of its keys follow."""
_ERRORS = ("r_95_m", "r_max_m")


def tabulate_differences_from_reference(studies: Sequence[Study]) -> pd.DataFrame:
    """Tabulate every configuration of all studies against its reference; units in the heads."""
    rows = [_make_difference_row(study, c) for study in studies for c in study.results_by_cost]
    return pd.DataFrame(rows, columns=list(BEHIND_COLUMNS))


def _make_difference_row(study: Study, configuration: StudiedConfiguration) -> dict[str, object]:
    """Return the numbers of a configuration of a study by column."""
    behind, dearer = configuration.error_excess_m, configuration.log_cost_excess
    seas = None if behind is None else behind.count_seas_needed_for(SMALL_M)
    return {
        "study": study.name,
        "configuration": configuration.name,
        "reference": study.reference_name,
        "runs": configuration.runs,
        "finished": configuration.finished,
        "stopped": configuration.stopped,
        "within_share": configuration.within,
        "r_95_m": configuration.r_95_m,
        "cost_over_exact_percent": 100.0 * configuration.cost,
        **_make_percent_interval_columns("behind_cm", behind),
        **_make_percent_interval_columns("dearer_percent", dearer),
        "p_differs": np.nan if behind is None else configuration.p_differs,
        "seas_for_1_cm": np.nan if seas is None else float(seas),
    }


def _make_percent_interval_columns(
    name: str, difference: PairedDifference | None
) -> dict[str, float]:
    """Return 100 times a mean difference and the ends of its interval; NaN for none."""
    ends = [np.nan] * 3
    if difference is not None:
        mean = difference.mean_interval
        ends = [100.0 * value for value in (mean.value, mean.low, mean.high)]
    known = [value if np.isfinite(value) else np.nan for value in ends]
    return dict(zip((name, f"{name}_low", f"{name}_high"), known, strict=True))


def tabulate_study_points(studies: Sequence[Study]) -> pd.DataFrame:
    """Tabulate each point of all studies by configuration: keys (`x_<key>`), runs, means."""
    if not studies:
        return pd.DataFrame(columns=list(POINT_COLUMNS))
    return pd.concat(map(_tabulate_points_of_study, studies), ignore_index=True)


def _tabulate_points_of_study(study: Study) -> pd.DataFrame:
    """Return a row for each point and configuration of a study; means are over judged runs."""
    judged = {name: study.runs[name].where(study.runs["within"].notna()) for name in _ERRORS}
    runs = study.runs.assign(**judged)
    rows = runs.groupby(["configuration", "point"], sort=False, as_index=False).agg(
        runs=("run_id", "count"),
        finished=("finished", "sum"),
        stopped=("stopped", "sum"),
        within_share=("within", "mean"),
        **{name: (name, "mean") for name in _ERRORS},
    )
    rows.insert(0, "study", study.name)
    keys = study.points.add_prefix("x_")
    return rows.join(keys, on="point")
