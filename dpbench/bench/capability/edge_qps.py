"""The static allocations at the edge of what a ship holds: a sequence of QPs, and their table.

For each case and direction there are four: the two winds of the standard's table around the edge,
and a thousandth of the wind before and beyond it. Below the first row half of the edge is taken,
beyond the last row the last four rows. The choice of azimuth pieces is that of least thrust.
`capability.parquet` of a result folder has a row for each, in the order of the sequence.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from dpbench.bench.capability.frontier import (
    FROM_DEG,
    INTACT,
    Capability,
    CapabilityPlot,
    Case,
    WindLimit,
)
from dpbench.bench.record.recorded_steps import convert_table_errors
from dpbench.errors import ResultsError
from dpbench.files.regular_files import write_file_atomically
from dpbench.files.tables import decode_dictionary_columns_to_text, open_untrusted_parquet_table
from dpbench.mpc.thrusters.allocation_qp import StaticAllocation
from dpbench.qp.program import QPSequence
from dpbench.ship.capability.loads import DP_CONDITIONS

EDGE = 1e-3
"""Share of the wind by which a QP lies before or beyond the edge."""
POINTS = 4
"""QPs of one direction."""
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


@dataclass(frozen=True)
class Point:
    """A capability QP: failure case, weather direction [rad], wind [m/s], whether it is held."""

    case: Case
    from_rad: float
    wind_mps: float
    held: bool


def list_points_at_all_limits(frontier: CapabilityPlot, capability: Capability) -> list[Point]:
    """Return the capability QPs around the wind limit of every failure case and direction."""
    return [
        point
        for case in frontier.intact_and_failure_cases
        for from_deg, edge in zip(FROM_DEG, capability.held[case.name], strict=True)
        for point in list_points_at_limit(case, math.radians(from_deg), edge)
    ]


def list_points_at_limit(case: Case, from_rad: float, edge: WindLimit) -> list[Point]:
    """Return the capability QPs at `POINTS` winds around one direction's and failure's limit."""
    number, wind_mps = edge.number, edge.wind_mps
    if number == max(DP_CONDITIONS):
        rows = range(number + 1 - POINTS, number + 1)
        return [Point(case, from_rad, DP_CONDITIONS[row][0], True) for row in rows]
    # A ship that holds no wind holds that of no row: calm and half of the first one.
    beyond = (1.0 + EDGE) * wind_mps if wind_mps > EDGE else 0.5 * DP_CONDITIONS[1][0]
    winds = [
        (DP_CONDITIONS[number][0] if number else 0.5 * wind_mps, True),
        ((1.0 - EDGE) * wind_mps, True),
        (beyond, False),
        (DP_CONDITIONS[number + 1][0], False),
    ]
    # By rising wind: the edge may lie within a thousandth of a row of the table.
    return [Point(case, from_rad, *wind) for wind in sorted(winds)]


def build_allocation_sequence(frontier: CapabilityPlot, points: Sequence[Point]) -> QPSequence:
    """Return the static allocation QP of each capability point, in their order."""
    assert frontier.sides is not None, "a QP has polygons"
    allocation = _build_static_allocation(
        frontier, {point.case for point in points}, frontier.sides
    )
    problems = []
    for point in points:
        weather = frontier.weather(point.from_rad, point.wind_mps)
        _, chosen = frontier.find_least_use_and_pieces(point.case, point.from_rad, point.wind_mps)
        lost = frontier.find_unusable_thrusters(point.case)
        problems.append(
            allocation.build_qp_for_static_load(weather.load, weather.shares, chosen, lost)
        )
    q, low, high = (np.array([getattr(qp, name) for qp in problems]) for name in ("q", "l", "u"))
    rows = np.array([qp.A for qp in problems])
    changed = None if (rows == rows[0]).all() else rows
    return QPSequence(f"{frontier.vessel.id} capability", problems[0], q, low, high, A=changed)


def _build_static_allocation(
    frontier: CapabilityPlot, cases: set[Case], sides: int
) -> StaticAllocation:
    """Return an allocation QP with rows for the thrusters' convex areas in any failure case."""
    every = [frontier.pieces_of(case) for case in cases]
    count = len(frontier.thrusters.thrusters)
    pieces = [[piece for of_case in every for piece in of_case[i]] for i in range(count)]
    sectors = [any(piece.sector is not None for piece in some) for some in pieces]
    chords = [max((len(piece.chords) for piece in some), default=0) for some in pieces]
    return StaticAllocation(frontier.thrusters, sides, sectors, chords)


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
    with (
        convert_table_errors(path),
        open_untrusted_parquet_table(path, error=ResultsError) as file,
    ):
        table = decode_dictionary_columns_to_text(
            file.read(columns=list(COLUMNS)), path, error=ResultsError
        )
        plots: pd.DataFrame = table.to_pandas(ignore_metadata=True)[list(COLUMNS)]
        plots = plots.astype(COLUMNS)
    _refuse_bad_plots(plots, path)
    return plots


def _refuse_bad_plots(plots: pd.DataFrame, path: Path) -> None:
    """Raise ResultsError for winds that are no numbers, and for a plot without the intact ship."""
    for name in ("from_deg", "wind_mps", "edge_mps"):
        finite = np.isfinite(plots[name].to_numpy())
        if not finite.all():
            found = plots.loc[~finite, name].iloc[0]
            raise ResultsError(str(path), name, found, "a finite number; run the suite again")
    whole = set(plots.loc[plots["case"] == INTACT, "sequence"])
    for sequence in set(plots["sequence"]) - whole:
        found = f"no row {INTACT!r} of {sequence!r}"
        raise ResultsError(
            str(path),
            "case",
            found,
            "a row of the intact ship for each sequence; run the suite again",
        )
