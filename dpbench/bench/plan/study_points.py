"""Points of a study: one scenario under other values of its keys, by the chosen design.

points = product of { the axes of `product`, `zip` as one axis, the draws of `design` as one }
runs   = points × replicates × configurations
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from dpbench.arrays import Matrix
from dpbench.scenario.problem_files import FileModel, KeysError
from dpbench.solvers.contract import Policy

Value = bool | int | float | str | list[float]
"""Value that a key of a scenario, vessel or tuning may be given."""
Values = Annotated[list[Value], Field(min_length=1)]
Range = Annotated[list[float], Field(min_length=2, max_length=2)]
Point = dict[str, Any]
"""Values of keys by their dotted names."""
MOST_CELLS = 1_000_000
"""A plan is kept in memory: a million cells take some gigabytes."""


RouteName = Literal["default", "qpsolvers", "native"]


class RunsTable(FileModel):
    """Call options of a suite table: settings, library interface, what steps hand on."""

    settings: list[str] = ["default"]
    """Names of settings: presets, tolerances such as "1e-4", or entries of [settings]."""
    routes: list[RouteName] = ["default"]
    """Routes to the solver. native: its own interface; qpsolvers: the Python package; default:
    qpsolvers where available, otherwise native."""
    policies: list[Policy] = ["fresh"]
    """Policies: data that a solver keeps between two steps."""
    iteration_limits: list[Annotated[int, Field(ge=1)]] = []
    """Iteration limits: all settings run with each limit, on solvers with such an option."""
    time_limits: list[Annotated[float, Field(gt=0)]] = []
    """Time limits of a solve [s], used in the same way; the solver's own clock applies."""


class ReplicatesTable(FileModel):
    """Repetitions of each study point with other values of one key, by default the seed."""

    key: str = "environment.seed"
    """Dotted name of the key in which replicates differ."""
    count: Annotated[int, Field(ge=1, le=MOST_CELLS)] = 1
    """Number of realisations of each point."""
    first: Annotated[int, Field(ge=0, le=MOST_CELLS)] = 1
    """Value in the first realisation; the others follow by one."""


class DesignOfPointsTable(FileModel):
    """Study points drawn evenly from ranges of parameters, by Sobol or Latin hypercube."""

    kind: Literal["sobol", "latin_hypercube"]
    """sobol: a scrambled Sobol sequence; latin_hypercube: a Latin hypercube sample."""
    points: Annotated[int, Field(ge=1, le=MOST_CELLS)]
    """Number of points; a power of two for sobol."""
    seed: Annotated[int, Field(ge=0)] = 1
    """Seed of the draw: the same seed gives the same points."""
    ranges: Annotated[dict[str, Range], Field(min_length=1)]
    """Smallest and largest value of each key, by its dotted name."""

    @model_validator(mode="after")
    def _refuse_bad_size_or_range(self) -> "DesignOfPointsTable":
        """Raise ValueError for a Sobol size that is no power of two, or a range without growth."""
        if self.kind == "sobol" and self.points & (self.points - 1):
            raise KeysError(
                str(self.points), "a power of two for sobol: 64, 128, 256, ...", "points"
            )
        for key, (least, largest) in self.ranges.items():
            if not least < largest:
                found = f"[{least}, {largest}]"
                allowed = "an increasing range, such as [5.0, 18.0]"
                raise KeysError(found, allowed, "ranges", key)
        return self

    def draw_points(self) -> Matrix:
        """Return drawn parameter values (points, parameters), in the scenario file's units."""
        # A campaign that draws nothing starts half a second sooner, and 40 MB smaller, without.
        from scipy.stats import qmc

        sizes = len(self.ranges)
        sampler = (
            qmc.Sobol(sizes, rng=self.seed)
            if self.kind == "sobol"
            else qmc.LatinHypercube(sizes, rng=self.seed)
        )
        low, high = np.array(list(self.ranges.values())).T
        drawn: Matrix = qmc.scale(sampler.random(self.points), low, high)
        return drawn


class StudyTable(RunsTable):
    """A study of a suite: closed loops of one scenario with many parameter values and realisations.

    A key is named with dots: environment.wind.speed_mps, start.east_m, vessel (a ship by name),
    vessel.length_m. Solvers, routes, policies and settings are as in a closed loop.
    """

    base: str
    """The scenario by name, scenario@vessel, or a TOML file in the suite's folder."""
    name: str = ""
    """Name of the study, one word; by default that of its scenario."""
    radius_m: Annotated[float, Field(gt=0)] = 1.0
    """Limit of the radial error in the second half of a run [m]."""
    solvers: list[str] = []
    """Solvers of the suite that take part; empty: all."""
    steps: Annotated[int, Field(ge=0)] = 0
    """Number of steps from the first on; 0: all."""
    product: dict[str, Values] = {}
    """Every value of each key with every value of the others."""
    zip: dict[str, Values] = {}
    """Keys that change together: their first values, then their second ones, and so on."""
    design: DesignOfPointsTable | None = None
    """Points drawn from ranges."""
    replicates: ReplicatesTable = ReplicatesTable()
    """Realisations of the same points; one each by default."""

    @model_validator(mode="after")
    def _refuse_repeated_or_unequal_keys(self) -> "StudyTable":
        """Raise ValueError for parameters that appear twice, or paired lists of unequal length."""
        lengths = {len(values) for values in self.zip.values()}
        if len(lengths) > 1:
            found = f"lists of {' and '.join(map(str, sorted(lengths)))} values"
            raise KeysError(found, "the same number of values for each key", "zip")
        keys = self.keys
        twice = [key for key in keys if keys.count(key) > 1]
        if twice:
            raise ValueError(f"each key once; {twice[0]!r} is given twice")
        if self.replicates.count > 1 and self.replicates.key in keys:
            raise ValueError(f"{self.replicates.key!r} in replicates or among the points, not both")
        return self

    @property
    def title(self) -> str:
        """Name of the study, or of its scenario where it has none."""
        return self.name or self.base

    @property
    def keys(self) -> list[str]:
        """Dotted names of all scenario parameters that a study varies."""
        drawn = [] if self.design is None else list(self.design.ranges)
        return [*self.product, *self.zip, *drawn]


@dataclass(frozen=True)
class StudyPoint:
    """One parameter point and repetition of a study, which every solver configuration runs once.

    `values` are those of its keys, `of_replicate` that of the key that tells replicates apart.
    """

    index: int
    replicate: int
    values: Point
    of_replicate: Point


def list_study_points(table: StudyTable, own: Mapping[str, object]) -> list[StudyPoint]:
    """Return all parameter points of a study, each with all its repetitions.

    Draws are rounded where the base scenario's `own` value of the key is a whole number.
    """
    axes: list[list[Point]] = [[{key: v} for v in values] for key, values in table.product.items()]
    if table.zip:
        together = zip(*table.zip.values(), strict=True)
        axes.append([dict(zip(table.zip, values, strict=True)) for values in together])
    if table.design is not None:
        names = list(table.design.ranges)
        rows: Sequence[Sequence[float]] = table.design.draw_points().tolist()
        axes.append([_round_whole_numbers(dict(zip(names, row, strict=True)), own) for row in rows])
    merged: list[Point] = [
        {key: value for part in parts for key, value in part.items()} for parts in product(*axes)
    ]
    again = table.replicates
    seeds = [{again.key: again.first + r} for r in range(again.count)] if again.count > 1 else [{}]
    return [
        StudyPoint(index, r + 1, values, seed)
        for index, values in enumerate(merged)
        for r, seed in enumerate(seeds)
    ]


def _round_whole_numbers(drawn: Point, own: Mapping[str, object]) -> Point:
    """Return drawn parameter values, rounded where the scenario's own is a whole number."""
    whole = {key for key in drawn if isinstance(own.get(key), int)}
    return {key: round(value) if key in whole else value for key, value in drawn.items()}
