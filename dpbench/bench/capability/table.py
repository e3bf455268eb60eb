"""The capability plots of a suite as the table `capability.parquet` of its result folder.

A row is a QP at the edge, in the order of the sequence that solvers replay.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from dpbench.bench.capability.batch import Point
from dpbench.bench.capability.frontier import FROM_DEG, INTACT, Capability
from dpbench.errors import ResultsError
from dpbench.files.tables import decode_dictionary_columns_to_text, open_untrusted_parquet_table
from dpbench.files.writing import write_file_atomically

CAPABILITY_FILE = "capability.parquet"
COLUMNS = {
    "sequence": "str",
    "k": "int64",
    "vessel": "str",
    "sides": "int64",
    "case": "str",
    "lost": "str",
    "from_deg": "float64",
    "wind_mps": "float64",
    "held": "bool",
    "edge_mps": "float64",
    "number": "int64",
}
"""Sequence and step in it; ship, and sides of its polygons; failure, and thrusters lost with it;
direction of the weather; wind of the QP and whether it is held; largest wind held, and number.
"""


def make_capability_columns(
    sequence: str, capability: Capability, points: Sequence[Point]
) -> dict[str, list[Any]]:
    """Return one capability plot and its QPs as columns of `capability.parquet`, by name."""
    direction = {round(from_deg, 6): k for k, from_deg in enumerate(FROM_DEG)}
    rows = []
    for k, point in enumerate(points):
        case, from_deg = point.case.name, round(math.degrees(point.from_rad), 6)
        edge = capability.held[case][direction[from_deg]]
        about = (sequence, k, capability.vessel, capability.sides, case)
        lost = ", ".join(capability.lost[case])
        rows.append(
            (*about, lost, from_deg, point.wind_mps, point.held, edge.wind_mps, edge.number)
        )
    return {
        name: list(column) for name, column in zip(COLUMNS, zip(*rows, strict=True), strict=True)
    }


def write_capability_plots(out: Path, tables: Sequence[dict[str, list[Any]]]) -> None:
    """Write capability plots to `capability.parquet` in a result folder."""
    frame = pd.concat([pd.DataFrame(table) for table in tables], ignore_index=True)
    with write_file_atomically(out / CAPABILITY_FILE) as part:
        frame.astype(COLUMNS).to_parquet(part, index=False, compression="zstd")


def load_capability_plots(folder: Path) -> pd.DataFrame | None:
    """Return `capability.parquet` of a result folder, None without one; ResultsError if damaged."""
    path = folder / CAPABILITY_FILE
    if not path.exists():
        return None
    try:
        with open_untrusted_parquet_table(path, error=ResultsError) as file:
            table = decode_dictionary_columns_to_text(
                file.read(columns=list(COLUMNS)), path, error=ResultsError
            )
        plots: pd.DataFrame = table.to_pandas(ignore_metadata=True)[list(COLUMNS)]
        plots = plots.astype(COLUMNS)
    except ResultsError:
        raise
    except (OSError, ValueError, TypeError, KeyError, pa.ArrowException) as error:
        found = f"a damaged file ({str(error)[:80]})"
        raise ResultsError(str(path), "", found, "a parquet table; run again") from error
    _refuse_bad_plots(plots, path)
    return plots


def _refuse_bad_plots(plots: pd.DataFrame, path: Path) -> None:
    """Raise ResultsError for winds that are no numbers, and for a plot without the intact ship."""
    for name in ("from_deg", "wind_mps", "edge_mps"):
        finite = np.isfinite(plots[name].to_numpy())
        if not finite.all():
            found = plots.loc[~finite, name].iloc[0]
            raise ResultsError(str(path), name, found, "a finite number; run again")
    whole = set(plots.loc[plots["case"] == INTACT, "sequence"])
    for sequence in set(plots["sequence"]) - whole:
        found = f"no row {INTACT!r} of {sequence!r}"
        raise ResultsError(str(path), "case", found, "some of the intact ship; run again")
