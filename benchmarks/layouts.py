"""Random thruster layouts through DP capability, each edge against an independent linear program.

    python benchmarks/layouts.py [--share 0.01] [--first N]

Each of 10 000 seeds draws a hull and 1 to 12 thrusters, degenerate ones included: in line, at one
place, with next to no thrust, narrow sectors and wide ones, azimuths that flush each other, skegs,
a switchboard for all but one. They are read as a vessel file is, and may be refused in one line. Of
one direction and one failure case the largest wind held is found as by `dpbench capability`. At
1e-6 below and above it the least use of thrust is computed once more: a mixed-integer linear
program over the corners of each thruster's forces chooses the pieces, a linear program gives the
use.
"""

import argparse
import math
import os
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import LinearConstraint, linprog, milp

from dpbench.bench.capability.frontier import CapabilityPlot, Case, is_beyond_standard_winds
from dpbench.bench.capability.utilisation import MOST_USE
from dpbench.errors import InputError
from dpbench.scenario.tables.vessel_file import VesselFile
from dpbench.ship.capability.shapes import Piece
from dpbench.ship.thrusters import Thruster

Vector = NDArray[np.float64]
SEEDS = 10_000
TOLERANCE = 1e-6
"""Tolerance of a wind [m/s, relative above 1 m/s] and of a use."""
SIDES = 24
FINE = 4096
"""Sides that stand for a circle: they give away 3e-7 of the thrust."""
PRECISE = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}


def draw_thruster(rng: np.random.Generator, i: int) -> dict[str, Any]:
    """Return one `[[thrusters]]` table; half of them at places that others share."""
    kind = ("azimuth", "tunnel", "main")[rng.integers(3)]
    on_grid = rng.random() < 0.5
    x_m = rng.choice([-36.0, -30.0, 0.0, 30.0]) if on_grid else rng.uniform(-40.0, 40.0)
    y_m = rng.choice([-5.0, 0.0, 5.0]) if on_grid else rng.uniform(-8.0, 8.0)
    table: dict[str, Any] = {"name": f"t{i}", "kind": kind, "x_m": x_m, "y_m": y_m, "rise_s": 8.0}
    if rng.random() < 0.5:
        table |= {"thrust_kN": 10.0 ** rng.uniform(0.5, 3.0)}
    else:
        table |= {"power_kW": 10.0 ** rng.uniform(1.5, 3.7), "diameter_m": rng.uniform(0.5, 4.0)}
        table["propeller"] = "tunnel" if kind == "tunnel" else rng.choice(["open", "nozzle"])
        if rng.random() < 0.5:
            table["height_m"] = rng.uniform(-2.0, 3.0)
    if kind == "azimuth" and rng.random() < 0.3:
        widths = [0.5, rng.uniform(1.0, 179.0), 180.0, rng.uniform(181.0, 359.0)]
        start = rng.uniform(-180.0, 180.0)
        table["sector_deg"] = [start, start + rng.choice(widths)]
    if kind == "main":
        table["astern"] = rng.choice([0.01, 0.5, 1.0])
    if rng.random() < 0.6:
        table["group"] = f"board {rng.integers(1, 4)}"
    return table


def draw_ship(rng: np.random.Generator) -> dict[str, Any]:
    """Return the document of a vessel file."""
    thrusters = [draw_thruster(rng, i) for i in range(rng.integers(1, 13))]
    if rng.random() < 0.1:
        # All in line: no moment without a force across, or no force across at all.
        thrusters = [table | {"kind": "main", "y_m": 0.0} for table in thrusters]
        thrusters = [{k: v for k, v in t.items() if k != "sector_deg"} for t in thrusters]
        thrusters[0] |= {"kind": "tunnel", "astern": 1.0}
        thrusters[-1] |= {"kind": "tunnel", "astern": 1.0, "x_m": thrusters[0]["x_m"] + 1e-3}
    skegs = [[rng.uniform(-40.0, 0.0), 0.0]] if rng.random() < 0.3 else []
    return {
        "title": "random",
        "source": "random",
        "length_m": 80.0,
        "inertia": [[6e6, 0.0, 0.0], [0.0, 9e6, 0.0], [0.0, 0.0, 4e9]],
        "damping": [[5e4, 0.0, 0.0], [0.0, 2.5e5, 0.0], [0.0, 0.0, 4e8]],
        "windage": {"frontal_m2": rng.uniform(50.0, 600.0), "lateral_m2": rng.uniform(200.0, 2e3)},
        "capability": {"breadth_m": 18.0, "draught_m": rng.uniform(3.0, 8.0), "skegs": skegs},
        "thrusters": thrusters,
    }


def clip(corners: Vector, normal: Vector, most: float) -> Vector:
    """Return the corners of a convex polygon's part in which normal·f ≤ most."""
    heights = corners @ normal - most
    kept = []
    for i, (corner, height) in enumerate(zip(corners, heights, strict=True)):
        after, higher = corners[(i + 1) % len(corners)], heights[(i + 1) % len(corners)]
        if height <= 0.0:
            kept.append(corner)
        if height * higher < 0.0:
            kept.append(corner + height / (height - higher) * (after - corner))
    return np.array(kept).reshape(-1, 2)


def piece_corners(thruster: Thruster, piece: Piece, sides: int) -> Vector:
    """Return the corners (c, components) of one piece of a thruster's relative forces."""
    if thruster.kind != "azimuth":
        return np.array([[1.0], [-thruster.astern]])
    angle = 2.0 * np.pi * np.arange(sides) / sides
    corners = np.column_stack((np.cos(angle), np.sin(angle)))
    if piece.sector is not None:
        start, end = piece.sector
        corners = clip(corners, np.array([np.sin(start), -np.cos(start)]), 0.0)
        corners = clip(corners, np.array([-np.sin(end), np.cos(end)]), 0.0)
    for chord in piece.chords:
        corners = clip(corners, chord[:2], chord[2])
    return corners


def independent_use(
    plot: CapabilityPlot, case: Case, from_rad: float, wind_mps: float, pieces: list[list[Piece]]
) -> float:
    """Return the least use of thrust over all choices of pieces, by linear programs over corners.

    The largest multiple s of the load that is balanced gives u = 1/s. It is infinite beyond
    `MOST_USE` for a load of all thrust, as what is left of a thruster is then rounding.
    """
    weather, sides = plot.weather(from_rad, wind_mps), plot.sides or FINE
    if not weather.load.any():
        return 0.0
    forces: list[Vector] = []
    owner: list[int] = []
    for i, (thruster, parts) in enumerate(zip(plot.thrusters.thrusters, pieces, strict=True)):
        for piece in [] if i in case.lost else parts:
            corners = piece_corners(thruster, piece, sides)
            full = weather.shares[i] * thruster.thrust_N
            forces.append(full * corners @ thruster.configuration_columns.T)
            owner.append(i)
    if not forces:
        return math.inf
    units = np.array([1.0, 1.0, plot.thrusters.longest_arm_m])
    columns, load = np.vstack(forces) / units, -weather.load / units
    largest, size = (float(np.abs(part).max()) for part in (columns, load))
    if largest == 0.0:
        return math.inf
    lengths = [len(force) for force in forces]
    use = size / largest * _solve(columns.T / largest, load / size, lengths, owner)
    most = MOST_USE * size / float(plot.thrusters.largest_thrusts_N.sum())
    return use if use <= most else math.inf


def _solve(balance: Vector, load: Vector, lengths: list[int], owner: list[int]) -> float:
    """Return 1/s for the largest s with balance μ = s load, μ ≥ 0, Σμ ≤ 1, one piece a thruster."""
    n, m = balance.shape[1], len(lengths)
    piece_of = np.repeat(np.arange(m), lengths)
    equal = np.column_stack((balance, np.zeros((3, m)), -load))
    sums = np.zeros((m, n + m + 1))
    sums[piece_of, np.arange(n)] = 1.0
    sums[np.arange(m), n + np.arange(m)] = -1.0
    one = np.zeros((max(owner) + 1, n + m + 1))
    one[owner, n + np.arange(m)] = 1.0
    cost = -np.eye(n + m + 1)[-1]
    upper = np.r_[np.full(n, np.inf), np.ones(m), np.inf]
    chosen = np.ones(m)
    if len(set(owner)) < m:
        found = milp(
            cost,
            integrality=np.r_[np.zeros(n), np.ones(m), 0],
            bounds=(np.zeros(n + m + 1), upper),
            constraints=[
                LinearConstraint(equal, 0.0, 0.0),
                LinearConstraint(np.vstack((sums, one)), -np.inf, np.r_[np.zeros(m), one.any(1)]),
            ],
            options={"mip_rel_gap": 0.0},
        )
        assert found.x is not None, found.message
        chosen = np.round(found.x[n : n + m])
    few = np.r_[chosen[piece_of] > 0.0, np.zeros(m, dtype=bool), True]
    answer = linprog(
        cost[few],
        A_ub=sums[:, few],
        b_ub=chosen,
        A_eq=equal[:, few],
        b_eq=np.zeros(3),
        bounds=np.column_stack((np.zeros(few.sum()), upper[few])),
        options=PRECISE,
    )
    assert answer.x is not None, answer.message
    return 1.0 / answer.x[-1] if answer.x[-1] > 0.0 else math.inf


def examine_layout(seed: int) -> tuple[int, str]:
    """Return a seed and what became of its layout: an edge, refused, or what is wrong."""
    try:
        return seed, _compare_edge(seed)
    except Exception as error:  # reported as a wrong layout; the others go on
        return seed, f"WRONG: {type(error).__name__}: {error}"


def _compare_edge(seed: int) -> str:
    """Return whether the edge of a drawn layout is that of linear programs, in words."""
    rng = np.random.default_rng(seed)
    try:
        vessel = VesselFile.model_validate(draw_ship(rng)).build_vessel("random", "random.toml")
    except InputError as error:
        assert len(str(error).splitlines()) == 1
        return "refused"
    plot = CapabilityPlot(vessel, None if seed % 5 == 0 else SIDES)
    case = plot.intact_and_failure_cases[rng.integers(len(plot.intact_and_failure_cases))]
    from_rad = math.radians(rng.choice([0.0, 90.0, 180.0, rng.uniform(0.0, 360.0)]))
    edge = plot.find_wind_limit(case, from_rad)
    off = TOLERANCE * max(1.0, edge.wind_mps)
    below, above = max(edge.wind_mps - off, 0.0), edge.wind_mps + off
    uses = [
        independent_use(plot, case, from_rad, w, _pieces(plot, case, from_rad, w))
        for w in (below, above)
    ]
    if uses[0] > 1.0 + TOLERANCE:
        return f"WRONG: {edge.wind_mps:.9g} m/s of {case.name} needs {uses[0]:.9g}"
    if uses[1] < 1.0 - TOLERANCE and not is_beyond_standard_winds(edge):
        return f"WRONG: beyond {edge.wind_mps:.9g} m/s of {case.name} needs {uses[1]:.9g}"
    return "beyond the standard" if is_beyond_standard_winds(edge) else "an edge"


def _pieces(
    plot: CapabilityPlot, case: Case, from_rad: float, wind_mps: float
) -> list[list[Piece]]:
    """Return all pieces of each thruster; of circles, which have many corners, the best ones."""
    every = plot.pieces_of(case)
    if plot.sides is not None:
        return every
    best = plot.find_least_use_and_pieces(case, from_rad, wind_mps)[1]
    return [[piece] if some else [] for piece, some in zip(best, every, strict=True)]


def main() -> int:
    """Examine layouts side by side; print the counts and each edge that is off."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--share", type=float, default=1.0, help="of the 10 000 layouts (1)")
    parser.add_argument("--first", type=int, default=0, help="seed of the first layout (0)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes (all)")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + round(SEEDS * arguments.share))
    counts: Counter[str] = Counter()
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for seed, outcome in pool.map(examine_layout, seeds, chunksize=10):
            counts[outcome.split(":")[0]] += 1
            if outcome.startswith("WRONG"):
                print(f"seed {seed}: {outcome}", flush=True)
    print(f"{len(seeds)} layouts: " + ", ".join(f"{n} {what}" for what, n in counts.items()))
    return 1 if counts["WRONG"] else 0


if __name__ == "__main__":
    sys.exit(main())
