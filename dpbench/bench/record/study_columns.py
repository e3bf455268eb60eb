"""Columns that say where a run stands in a study: its point, its replicate, the values of keys."""

from __future__ import annotations

import json
from typing import Any

import pandas as pd

PREFIX = "x_"
"""Of the columns that hold the values of a study's keys, before the key's dotted name."""


def study_columns(runs: pd.DataFrame) -> pd.DataFrame:
    """The columns of a study, of runs (N) with a column `cell`; none where no run is of one.

    `study`, `study_point` and `replicate` as in the schema; an `x_<key>` for each key, a number
    where all its values are numbers and text else, missing in runs of other studies.
    """
    cells = runs["cell"].astype(str)
    of_study = cells.str.contains('"study": {', regex=False)
    if not of_study.any():
        return pd.DataFrame(index=runs.index)
    rows = {i: _columns_of(json.loads(cell)["study"]) for i, cell in cells[of_study].items()}
    table = pd.DataFrame.from_dict(rows, orient="index").reindex(runs.index)
    return table.assign(study=table["study"].fillna(""))


def _columns_of(study: dict[str, Any]) -> dict[str, Any]:
    values = {f"{PREFIX}{key}": _plain(value) for key, value in study["x"].items()}
    return {
        "study": study["name"],
        "study_point": study["point"],
        "replicate": study["replicate"],
    } | values


def _plain(value: object) -> object:
    """What a cell of a table can hold: a list as text."""
    return json.dumps(value) if isinstance(value, list) else value
