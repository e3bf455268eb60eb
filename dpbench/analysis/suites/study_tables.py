"""Studies as tables: rows per configuration and point; data of the pictures."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from dpbench.analysis.suites.study import SMALL_M, PairedDifference, StudiedConfiguration, Study
from dpbench.analysis.suites.study_effects import group_keys_that_vary_together

EXCESS_COLUMNS = (
    *("study", "configuration", "reference", "runs", "finished", "stopped", "within_share"),
    *(
        "verified_share",
        "r_95_m",
        "cost_over_exact_percent",
        "excess_error_cm",
        "excess_error_cm_low",
        "excess_error_cm_high",
    ),
    *(
        "excess_cost_percent",
        "excess_cost_percent_low",
        "excess_cost_percent_high",
        "p_differs",
        "realisations_for_1_cm",
    ),
)
POINT_COLUMNS = (
    *("study", "configuration", "point", "runs", "finished", "stopped", "within_share", "r_95_m"),
    "r_max_m",
)
"""Columns of each study; those of its keys follow."""
_ERRORS = ("r_95_m", "r_max_m")


def tabulate_differences_from_reference(studies: Sequence[Study]) -> pd.DataFrame:
    """Return a table of all studies' configurations against their references, with units."""
    rows = [_make_difference_row(study, c) for study in studies for c in study.results_by_cost]
    return pd.DataFrame(rows, columns=list(EXCESS_COLUMNS))


def _make_difference_row(study: Study, configuration: StudiedConfiguration) -> dict[str, object]:
    """Return a table row of a studied configuration's differences from the reference."""
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
        "verified_share": configuration.accurate,
        "r_95_m": configuration.r_95_m,
        "cost_over_exact_percent": 100.0 * configuration.cost,
        **_make_percent_interval_columns("excess_error_cm", behind),
        **_make_percent_interval_columns("excess_cost_percent", dearer),
        "p_differs": np.nan if behind is None else configuration.p_differs,
        "realisations_for_1_cm": np.nan if seas is None else float(seas),
    }


def _make_percent_interval_columns(
    name: str, difference: PairedDifference | None
) -> dict[str, float]:
    """Return 100 times a mean difference and the ends of its interval; NaN for none."""
    ends = (np.nan,) * 3 if difference is None else difference.stated_numbers
    known = [100.0 * value if np.isfinite(value) else np.nan for value in ends]
    return dict(zip((name, f"{name}_low", f"{name}_high"), known, strict=True))


def tabulate_study_points(studies: Sequence[Study]) -> pd.DataFrame:
    """Return a table of all studies' points by configuration: keys (`x_<key>`), runs, means."""
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


MOST_MAPS = 6
"""The reference, and those that hold least, are mapped."""
MOST_POINTS, FIELDS = 300, 14
"""A map of more points shows fields instead, so many along each key."""
MOST_DOTS = 1500
"""Most seas of a figure: of more, some of each configuration at even ranks, with its extremes."""


def has_few_enough_points_for_tiles(study: Study) -> bool:
    """Return whether a study has few enough parameter points to draw each as its own tile."""
    return len(study.points) <= MOST_POINTS


def label_numeric_factors(study: Study) -> dict[str, str]:
    """Return a numeric key of each factor of a study, and the label of an axis with its values."""
    found = {}
    for factor in group_keys_that_vary_together(study.points):
        numeric = [key for key in factor if is_numeric_dtype(study.points[key])]
        for key in numeric[:1]:
            others = [other for other in factor if other != key]
            found[key] = f"{key} (with {', '.join(others)})" if others else key
    return found


def tabulate_shares_in_position(study: Study) -> pd.DataFrame:
    """Return a table of shares of seas in position over two parameters, reference and worst.

    Columns: configuration, x and y (the first numeric factors), within (a share) and judged runs.
    """
    ordered = sorted(study.results_by_cost[1:], key=lambda c: c.share_within_radius)[
        : MOST_MAPS - 1
    ]
    columns = dict(zip(label_numeric_factors(study), ("x", "y"), strict=False))
    names = list(columns.values())
    tables = []
    for configuration in [study.results_by_cost[0], *ordered]:
        runs = study.runs[study.runs["configuration"] == configuration.name]
        within = runs.groupby("point")["within"].agg(runs="count", within="mean").dropna()
        table = study.points.join(within, how="inner").rename(columns=columns)
        part = table[[*names, "within", "runs"]]
        if not has_few_enough_points_for_tiles(study):
            part = part.assign(**{name: _replace_by_bin_centres(part[name]) for name in names})
        # Points that differ in a third key lie on one another: their seas are counted together.
        seas = part.assign(within=part["within"] * part["runs"])
        summed = seas.groupby(names, as_index=False).sum() if names else seas
        summed["within"] /= summed["runs"]
        tables.append(summed.assign(configuration=configuration.name))
    return pd.concat(tables, ignore_index=True)


def _replace_by_bin_centres(values: "pd.Series[float]") -> "pd.Series[float]":
    """Return for each value the centre of its bin, of equally wide bins over the range."""
    least, most = float(values.min()), float(values.max())
    width = (most - least) / FIELDS or 1.0
    number = ((values - least) / width).astype(int).clip(upper=FIELDS - 1)
    return least + width * (number + 0.5)


def convert_difference_to_cm(difference: PairedDifference) -> dict[str, float | None]:
    """Return a paired difference [m] in [cm] by key: mean, interval ends (or None), pairs."""
    mean = difference.mean_interval
    low, high = (100 * end if np.isfinite(end) else None for end in (mean.low, mean.high))
    return {"mean_cm": 100 * mean.value, "low_cm": low, "high_cm": high, "pairs": difference.pairs}


def tabulate_error_excess_by_sea(study: Study) -> tuple[pd.DataFrame, pd.DataFrame, int]:
    """Return configurations' errors over the reference [cm]: means, values by sea, their count."""
    reference = study.get_compared_series(study.reference_name, "r_95_m")
    most = max(2, MOST_DOTS // max(1, len(study.results_by_cost) - 1))
    rows, seas, count = [], [], 0
    for configuration in study.results_by_cost:
        if configuration.error_excess_m is None or configuration.error_excess_m.pairs == 0:
            continue
        rows.append(
            {"name": configuration.name} | convert_difference_to_cm(configuration.error_excess_m)
        )
        each = 100 * (study.get_compared_series(configuration.name, "r_95_m") - reference).dropna()
        count += len(each)
        ranks = np.unique(np.linspace(0, len(each) - 1, min(most, len(each))).round().astype(int))
        some = each.sort_values().iloc[ranks] if len(each) > most else each
        seas.append(some.rename("error_excess_cm").reset_index().assign(name=configuration.name))
    return pd.DataFrame(rows), pd.concat(seas, ignore_index=True) if seas else pd.DataFrame(), count


def compute_error_excess_cm(study: Study, rows: pd.DataFrame) -> "pd.Series[float]":
    """Return each run's position error less the reference's in the same sea [cm], or NaN."""
    reference = study.get_result_series(study.reference_name, "r_95_m")
    sea = pd.MultiIndex.from_frame(rows[["point", "replicate"]])
    other = pd.Series(reference.reindex(sea).to_numpy(), index=rows.index)
    return (100.0 * (rows["r_95_m"] - other)).where(rows["finished"])


def find_id_of_worst_run(study: Study, among: Sequence[str]) -> str | None:
    """Return the id of the run of largest position error of a study's worst configuration, or None.

    It is of the configuration that holds fewest seas, or else of that farthest from the exactly
    solved loop: in a sea that it does not hold, or else in the one of its largest error.
    """
    rows = study.runs[study.runs["run_id"].isin(among)]
    if rows.empty:
        return None
    known = [c for c in study.results_by_cost if (rows["configuration"] == c.name).any()]
    worst = min(reversed(known), key=lambda c: c.share_within_radius)
    rows = rows[rows["configuration"] == worst.name]
    share = rows.groupby("point")["within"].transform("mean")
    order = rows.assign(share=share).sort_values(
        ["share", "within", "r_tail_max_m"], ascending=[True, True, False], kind="stable"
    )
    return str(order["run_id"].iloc[0])
