"""Stated times of a solver's step by the size of its QP, for a first forecast of a campaign."""

import math
import tomllib
from functools import cache
from pathlib import Path
from statistics import median
from typing import Any

from dpbench.bench.record.cell import Cell, RandomSource, RecordedSource
from dpbench.bench.sequences.recording import read_sequence
from dpbench.scenario.problem_files import resolve_sequence_path
from dpbench.scenario.scenario import build_scenario_from_documents

SMALL = 30
"""Size of QPs of thrust allocation, of capability plots and of unknown ones."""


def estimate_step_s(solver: str, route: str, size: int) -> float:
    """Return the stated time of a step with all around it [s], by the size of its QP.

    It is a power of the size between two stated ones and beyond the largest. A solver without
    stated times has the median of the others.
    """
    sizes, times = _read_stated_times()
    own = times.get(f"{solver} {route}") or [median(of) for of in zip(*times.values(), strict=True)]
    at = max(size, sizes[0])
    i = next((i for i in range(1, len(sizes)) if at <= sizes[i]), len(sizes) - 1)
    power = math.log(own[i] / own[i - 1]) / math.log(sizes[i] / sizes[i - 1])
    return 1e-6 * own[i - 1] * float((at / sizes[i - 1]) ** power)


def measure_qp_size(cell: Cell) -> int:
    """Return the number of variables and rows of a run's QPs, without soft limits."""
    source = cell.source
    if isinstance(source, RandomSource):
        return source.recipe.n + source.recipe.m
    if isinstance(source, RecordedSource):
        return _measure_recorded_size(source.path)
    if not (cell.scenario and (cell.mode == "closed_loop" or source.is_of_controller)):
        return SMALL
    controller = cell.scenario["scenario"]["controller"]
    names = ("kind", "prediction_horizon", "control_horizon")
    key = (cell.scenario["vessel_name"], *(controller.get(name) for name in names))
    if key not in _SIZES:
        problem = build_scenario_from_documents(cell.scenario).controller.problem
        _SIZES[key] = problem.N_c * (problem.model.n_u + len(problem.G))
    return _SIZES[key]


_SIZES: dict[tuple[Any, ...], int] = {}
"""Sizes by ship, kind of controller and horizons: a study has many scenarios of one size."""


@cache
def _measure_recorded_size(path: str) -> int:
    """Return the number of variables and rows of a recorded sequence, by name or file."""
    base = read_sequence(resolve_sequence_path(path)).sequence.base
    return base.n + base.m


@cache
def _read_stated_times() -> tuple[list[int], dict[str, list[float]]]:
    """Read the sizes, and the times [µs] at these by solver and route."""
    text = Path(__file__).with_name("stated_rates.toml").read_text(encoding="utf-8")
    table = tomllib.loads(text)
    return table["sizes"], table["times"]
