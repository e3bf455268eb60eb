"""Studies on the page: their points and seas, and the loops that it has room for."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.statistics import none_of
from dpbench.analysis.suites.study import Study
from dpbench.analysis.suites.study_pictures import behind_cm, mean_cm, worst_run

MOST_RUNS = 20_000
"""So many runs of studies stand on the page with their errors; the rest is in the files."""
MOST_LOOPS = 400
"""So many of them with their steps."""


def shown(runs: Iterable[RunRecord]) -> list[RunRecord]:
    """Select the runs of studies for the page, the first sea of every point first."""
    solving = [run for run in runs if not run.is_baseline_law]
    return sorted(solving, key=lambda run: run.replicate)[:MOST_RUNS]


def study_document(
    study: Study, runs: Mapping[str, RunRecord], number_of: Mapping[str, int]
) -> dict[str, Any]:
    """Return the data of a study for the page's script.

    Parameters
    ----------
    runs : those that are shown, by run_id.
    number_of : number on the page of a configuration, by name.
    """
    rows = study.runs[study.runs["run_id"].isin(list(runs))]
    names = [c.name for c in study.configurations if c.name in number_of]
    rows = rows[rows["configuration"].isin(names)]
    place = {name: i for i, name in enumerate(names)}
    return {
        "name": study.name,
        "radius_m": study.radius_m,
        "none_of": none_of(study.realisations),
        "reference": place.get(study.reference, 0),
        "keys": [str(key) for key in study.points],
        "points": [int(point) for point in study.points.index],
        "values": [[_plain(x) for x in study.points[key]] for key in study.points],
        "names": names,
        "c": [number_of[name] for name in names],
        "means": [_mean(study, name) for name in names],
        "runs": {
            "of": [place[name] for name in rows["configuration"]],
            "point": rows["point"].tolist(),
            "sea": rows["replicate"].tolist(),
            "held": [int(held) for held in rows["held"]],
            "tail_m": _short(rows["r_tail_max_m"].where(rows["finished"])),
            "behind_cm": _short(behind_cm(study, rows)),
            "id": rows["run_id"].tolist(),
        },
    }


def opening(study: Study, shown_runs: Sequence[RunRecord]) -> RunRecord | None:
    """Choose the run that a page on a study opens with; None where nothing is shown.

    Of the configuration that holds fewest seas, or else the one farthest from the exact loop; a sea
    that it does not hold, or else the one in which it is farthest off.
    """
    kept = {run.run_id: run for run in shown_runs[:MOST_LOOPS] if run.study == study.name}
    worst = worst_run(study, list(kept))
    return None if worst is None else kept[worst]


def _mean(study: Study, name: str) -> dict[str, Any]:
    """Return the mean over all seas with its interval [cm], and the share that is held."""
    (found,) = (c for c in study.configurations if c.name == name)
    known: dict[str, Any] = {"held": found.held, "pairs": 0}
    if found.error_excess_m is None or found.error_excess_m.pairs == 0:
        return known
    return known | mean_cm(found.error_excess_m)


def _short(values: Iterable[float]) -> list[float | None]:
    """Round to four digits, as the page prints; None for what is missing."""
    return [float(f"{x:.4g}") if math.isfinite(x) else None for x in values]


def _plain(value: Any) -> Any:
    plain = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain
