"""Checks of the values of `runs.parquet` that the analysis relies on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pandas as pd

from dpbench.bench.record.cell import FORMULATIONS, OUTCOMES, Units
from dpbench.errors import ResultsError
from dpbench.solvers.contract import Policy, Route

_WORDS = {
    "mode": ("closed_loop", "replay"),
    "route": get_args(Route),
    "policy": get_args(Policy),
    "units": get_args(Units),
    "formulation": FORMULATIONS,
    "outcome": OUTCOMES,
}
"""All words of a column."""
_LEAST = {"steps_planned": 0, "steps_done": 0, "rounds": 0, "N_p": 1, "N_c": 1, "replay_s": 1e-9}
"""The least number of a column, where it is not missing."""


def check_runs(runs: pd.DataFrame, path: Path) -> None:
    """Refuse rows that no campaign writes; ResultsError, naming the column and the row from 0."""
    for column, is_bad, allowed in _rules(runs):
        if is_bad.any():
            row = int(is_bad.to_numpy().argmax())
            value = runs[column].iloc[row]
            found = "nothing" if pd.isna(value) else str(value)[:80]
            raise ResultsError(str(path), f"{column}[{row}]", found, f"{allowed}; run again")


def _rules(runs: pd.DataFrame) -> Iterator[tuple[str, pd.Series[Any], str]]:
    """Yield column, rows that break its rule, and the rule."""
    for column, words in _WORDS.items():
        yield column, ~runs[column].isin(words), " | ".join(words)
    for column, least in _LEAST.items():
        yield column, (runs[column] < least).fillna(False), f"{least:g} or more"
    finished = (runs["mode"] == "replay") & (runs["outcome"] == "finished")
    yield "rounds", finished & (runs["rounds"] == 0).fillna(False), "1 or more, as it finished"
    yield "N_p", runs["N_p"].isna() & runs["N_c"].notna(), "a horizon, as N_c is one"
    of_study = runs["study"] != ""
    for column in ("study_point", "replicate"):
        yield column, of_study & runs[column].isna(), "a number, as the run is of a study"
