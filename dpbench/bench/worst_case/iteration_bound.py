"""`dpbench iteration-bound`: a proved bound of the iterations of the paper's method.

The QP of one step falls into parts that no entry of P or A couples: surge, and sway with yaw. Over
a box of a part's parameters `method_paths.py` follows every path of the method from a cold start;
the largest number of iterations of any path bounds all of them. The C library solves an inner point
of every region and random parameters of the box, where it must take the iterations of the path.
"""

import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from scipy.optimize import Bounds, differential_evolution

from dpbench.arrays import Matrix, Vector
from dpbench.bench.progress import Progress, Silent
from dpbench.bench.worst_case.method_paths import MethodPaths, ParametricQP
from dpbench.bench.worst_case.parameter_regions import WIDTH
from dpbench.errors import InputError
from dpbench.mpc.condensed_qp import CondensedQP
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.scenario.scenario import Scenario, load_scenario
from dpbench.solvers.open import open_workspace

Axes = Literal["surge", "sway-yaw"]
AXES: dict[Axes, tuple[int, ...]] = dict(zip(get_args(Axes), ((0,), (1, 2)), strict=True))
OFFSETS = np.array([50.0, 50.0, np.deg2rad(30.0)])
"""Half the box, before its factor: offset of n, e [m] and ψ [rad] from the setpoint."""
SPEEDS = np.array([1.0, 1.0, np.deg2rad(1.0)])
"""Rates of change of these offsets, before the factor [m/s, m/s, rad/s]."""
SAMPLE, SEARCHED = 4096, 3000
"""Random parameters that are solved, and those that a search may try."""


@dataclass(frozen=True, eq=False)
class ParameterBox:
    """Half the size of a box of parameters in SI units, for the axes of a part of the QP.

    increments : of the speeds ν a sample; steps : of η a sample; offsets : of η from the setpoint;
    forces : (2, axes) applied in the last sample: the middle of their limits, and half the range.
    """

    axes: Axes
    increments: Vector
    steps: Vector
    offsets: Vector
    forces: Matrix

    @property
    def half(self) -> Vector:
        """Half the box as one vector (4 axes,), in the order of the parameters."""
        return np.concatenate([self.increments, self.steps, self.offsets, self.forces[1]])

    def __str__(self) -> str:
        units = (("m", "N"), ("m", "N"), ("rad", "N·m"))
        words = []
        middle, range_half = self.forces
        low, high = middle - range_half, middle + range_half
        for k, axis in enumerate(AXES[self.axes]):
            unit, force = units[axis]
            words.append(
                f"{('surge', 'sway', 'yaw')[axis]}: offset up to {self.offsets[k]:.3g} {unit}, "
                f"displacement up to {self.steps[k]:.3g} {unit} per sample, speed change up to "
                f"{self.increments[k]:.3g} {unit}/s per sample, "
                f"applied force from {low[k]:.3g} to {high[k]:.3g} {force}"
            )
        return "; ".join(words)


def choose_parameter_box(scenario: Scenario, axes: Axes, factor: float) -> ParameterBox:
    """Return the box of a part's parameters, scaled by a factor; forces never exceed their limits.

    A speed changes in a sample by at most what the largest force gives the ship's mass.
    """
    own, problem = list(AXES[axes]), scenario.controller.problem
    acceleration = problem.u_max / np.diag(scenario.vessel.M)
    return ParameterBox(
        axes,
        factor * (acceleration * scenario.sample_s)[own],
        factor * SPEEDS[own] * scenario.sample_s,
        factor * OFFSETS[own],
        min(factor, 1.0)
        * np.stack([problem.u_max + problem.u_min, problem.u_max - problem.u_min])[:, own]
        / 2.0,
    )


def make_parametric_qp(builder: CondensedQP, box: ParameterBox, scenario: str) -> ParametricQP:
    """Return a part of a controller's QP as a function of its parameters in a box.

    scenario : its name, for errors.

    Raises
    ------
    InputError : where P couples the part with other axes.
    """
    axes = AXES[box.axes]
    own = np.array([3 * i + a for i in range(builder.control.N_c) for a in axes])
    others = np.setdiff1d(np.arange(builder.n), own)
    if np.abs(builder.P[np.ix_(own, others)]).max() > 0.0:
        found = f"{scenario}, whose Hessian P couples {box.axes} with other axes"
        raise InputError("--scenario", "", found, "a scenario without this coupling")
    at, k = builder.control.model.theta, len(axes)
    # [x; y_ref; u_prev; 1] of the parameters: Δν, Δη, and η from a setpoint of 0, then u_prev.
    theta = np.zeros((at.size, 4 * k + 1))
    theta[at.size - 1, -1] = 1.0
    for j, half in enumerate(box.half):
        part, axis = divmod(j, k)
        first = at.u_prev.start if part == 3 else at.x.start + 3 * part
        theta[first + axes[axis], j] = half
    theta[at.u_prev.start + np.array(axes), -1] = box.forces[0]
    Z, n = builder.Z @ theta, builder.n
    one = np.zeros((len(own), 4 * k + 1))
    one[:, -1] = 1.0
    return ParametricQP(
        P=builder.P[np.ix_(own, own)],
        C=np.vstack([np.eye(len(own)), builder.A[np.ix_(own, own)]]),
        q=Z[own],
        low=np.vstack([builder.lb[own, None] * one, Z[n + own]]),
        high=np.vstack([builder.ub[own, None] * one, Z[2 * n + own]]),
    )


class IterationCounter:
    """Iterations that the C library takes for parameters of a QP, from a cold start."""

    def __init__(self, qp: ParametricQP) -> None:
        self._qp, self._n = qp, len(qp.P)
        self._workspace = open_workspace("paper_active_set", route="native", policy="fresh")
        q, low, high = self._vectors(np.zeros(qp.d))
        n = self._n
        bounds = low[:n], high[:n]
        self._workspace.setup(QuadraticProgram(qp.P, q, qp.C[n:], low[n:], high[n:], *bounds))

    def _vectors(self, t: Vector) -> tuple[Vector, Vector, Vector]:
        """Return q, low and high at parameters."""
        one = np.append(t, 1.0)
        return self._qp.q @ one, self._qp.low @ one, self._qp.high @ one

    def count(self, t: Vector) -> int:
        """Return the iterations at parameters t (d,) of the box; −1 without a solution."""
        q, low, high = self._vectors(t)
        n = self._n
        self._workspace.reset()
        self._workspace.update(QPStep(q, low[n:], high[n:], lb=low[:n], ub=high[:n]))
        self._workspace.solve()
        return self._workspace.read().iterations


@dataclass(eq=False)
class IterationBound:
    """Result of a proof over a box: regions by iterations, and what the C library takes there.

    open_share : of random parameters whose path was not followed to its end; 0 in a proof that is
    complete. differing : points where the C library takes another number of iterations.
    """

    box: ParameterBox
    scenario: str
    n: int
    regions: Counter[int] = field(default_factory=Counter)
    tests: int = 0
    differing: int = 0
    compared: int = 0
    open_share: float = 1.0
    searched: int = 0
    duration_s: float = 0.0

    @property
    def bound(self) -> int:
        """The largest number of iterations of a region that was followed to its end."""
        return max(self.regions, default=0)

    @property
    def is_complete(self) -> bool:
        """Return whether every path was followed to its end, so that the bound holds."""
        return self.open_share == 0.0

    @property
    def lines(self) -> list[str]:
        """The result in words: the bound, the box, the comparison and the search."""
        count = f"{sum(self.regions.values())} regions"
        if self.is_complete:
            head = f"at most {self.bound} iterations from a cold start, in all {count} of the box"
        else:
            open_part = f"{100 * self.open_share:.1f} % of the box is open"
            head = f"no bound: at most {self.bound} iterations in {count}; {open_part}"
        spread = ", ".join(f"{k}: {self.regions[k]}" for k in sorted(self.regions))
        return [
            f"paper_active_set, {self.box.axes} of {self.scenario} ({self.n} variables): {head}",
            f"box       {self.box}",
            f"regions   by iterations {spread}",
            f"effort    {self.tests} tests of emptiness, {self.duration_s:.0f} s",
            f"C code    other iteration counts at {self.differing} of {self.compared} points: one "
            f"in each region, and {SAMPLE} random ones",
            f"search    at most {self.searched} iterations at {SEARCHED} points tried by a search",
            f"excluded  parameters within {WIDTH:g} half box widths of the edge of a region",
        ]


def prove_iteration_bound(
    axes: Axes,
    *,
    scenario: str | Path = "paper",
    factor: float = 1.0,
    limit_s: float = 600.0,
    progress: Progress | None = None,
) -> IterationBound:
    """Follow all paths of the paper's method over a box of parameters; return the bound they prove.

    Parameters
    ----------
    axes : "surge" (4 parameters) or "sway-yaw" (8).
    factor : of the box, see `choose_parameter_box`.
    limit_s : time after which the proof stops; the result says how much of the box is open.

    Raises
    ------
    InputError : for other axes, a factor or limit not above 0, or a QP that is not the paper's.
    """
    if axes not in AXES:
        raise InputError("iteration-bound", "AXES", repr(axes), " or ".join(AXES))
    for name, value in {"--box": factor, "--limit": limit_s}.items():
        if not 0.0 < value < np.inf:
            raise InputError(name, "", value, "a number above 0")
    loaded = load_scenario(scenario)
    builder = loaded.controller.make_condensed_qp_builder()
    if not builder.control.model.n_u == builder.block == 3 or builder.m != builder.n:
        allowed = (
            "a scenario with the same kind of QP as scenario paper: three forces with limits per "
            "axis, without soft limits or output bounds"
        )
        raise InputError("--scenario", "", loaded.name, allowed)
    box = choose_parameter_box(loaded, axes, factor)
    qp = make_parametric_qp(builder, box, loaded.name)
    result = IterationBound(box, loaded.name, len(qp.P))
    _follow_paths(MethodPaths(qp), IterationCounter(qp), result, limit_s, progress or Silent())
    return result


def _follow_paths(
    paths: MethodPaths,
    library: IterationCounter,
    result: IterationBound,
    limit_s: float,
    progress: Progress,
) -> None:
    """Follow paths depth first until none is left or the time is up; fill in the result."""
    started_s = time.monotonic()
    sample = np.random.default_rng(1).uniform(-1.0, 1.0, (SAMPLE, paths.qp.d))
    taken = np.array([library.count(t) for t in sample])
    is_open = np.ones(SAMPLE, dtype=bool)
    progress.start(SAMPLE)
    unfinished = [paths.start()]
    while unfinished and time.monotonic() - started_s < limit_s:
        path = unfinished.pop()
        if not path.done:
            unfinished.extend(paths.continue_path(path))
            continue
        result.regions[path.iterations] += 1
        inside = path.region.contains(sample) & is_open
        is_open &= ~inside
        result.differing += int((taken[inside] != path.iterations).sum())
        result.compared += int(inside.sum())
        if not path.region.is_thin:
            result.differing += library.count(path.region.inside) != path.iterations
            result.compared += 1
        progress.advance(int(inside.sum()), f"{sum(result.regions.values())} regions")
    result.tests = paths.cutter.tests
    result.open_share = (
        float(is_open.mean()) if not unfinished else max(float(is_open.mean()), 1e-9)
    )
    result.duration_s = time.monotonic() - started_s
    result.searched = max(_search_most_iterations(library, paths.qp.d), int(taken.max()))


def _search_most_iterations(library: IterationCounter, d: int) -> int:
    """Return the most iterations that differential evolution finds in the box."""

    def rate(t: Vector) -> float:
        return -float(library.count(t))

    found = differential_evolution(
        rate,
        Bounds(-np.ones(d), np.ones(d)),
        maxiter=max(SEARCHED // (15 * d) - 1, 1),
        polish=False,
        seed=1,
        tol=0.0,
    )
    return round(-found.fun)
