"""A proof of the largest number of iterations of the paper's method."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import linprog

from dpbench.bench.worst_case.iteration_bound import (
    IterationBound,
    IterationCounter,
    prove_iteration_bound,
)
from dpbench.bench.worst_case.method_paths import MethodPaths, ParametricQP, Path
from dpbench.bench.worst_case.parameter_regions import RegionCutter, make_box
from dpbench.cli.main import main
from dpbench.errors import InputError


def follow_all(qp: ParametricQP) -> list[Path]:
    """All paths of the method, followed to their ends."""
    paths = MethodPaths(qp)
    unfinished, done = [paths.start()], []
    while unfinished:
        path = unfinished.pop()
        if path.done:
            done.append(path)
        else:
            unfinished.extend(paths.continue_path(path))
    return done


def test_two_separate_variables_by_hand() -> None:
    """min ½|z|² − 3 tᵀz, |z_i| ≤ 1: nothing beyond its limit in the middle, one variable in each of
    four strips, two in each of four corners, where the more violated one comes first: 8 parts."""
    one = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    q = np.array([[-3.0, 0.0, 0.0], [0.0, -3.0, 0.0]])
    done = follow_all(ParametricQP(np.eye(2), np.eye(2), q, -one, one))
    assert Counter(path.iterations for path in done) == {0: 1, 1: 4, 2: 8}


def make_random_qp(rng: np.random.Generator, n: int, m: int, d: int) -> ParametricQP:
    """A random QP with affine vectors, whose limits leave z = 0."""
    root = rng.standard_normal((n, n))
    C = np.vstack([np.eye(n), rng.standard_normal((m, n))])
    limits = rng.standard_normal((n + m, d + 1))
    limits[:, -1] = np.abs(limits[:, :-1]).sum(axis=1) + rng.uniform(0.05, 1.0, n + m)
    q = 4.0 * rng.standard_normal((n, d + 1))
    return ParametricQP(root @ root.T + 0.1 * np.eye(n), C, q, -limits, limits)


@pytest.mark.slow
@settings(max_examples=12)
@given(st.integers(0, 10**6), st.integers(1, 4), st.integers(0, 3), st.integers(1, 2))
def test_paths_take_as_many_iterations_as_the_library(seed: int, n: int, m: int, d: int) -> None:
    """Every random parameter is in a region, whose path has the iterations of the C library."""
    rng = np.random.default_rng(seed)
    qp = make_random_qp(rng, n, m, d)
    done = follow_all(qp)
    points = rng.uniform(-1.0, 1.0, (40, d))
    library = IterationCounter(qp)
    for t, taken in zip(points, map(library.count, points), strict=True):
        found = {path.iterations for path in done if path.region.contains(t[None])[0]}
        assert taken in found


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(1, 4))
def test_a_cut_is_empty_only_where_no_ball_fits(seed: int, d: int) -> None:
    """Against the largest ball in the halfspaces and the box, by the simplex method."""
    rng = np.random.default_rng(seed)
    cutter, region = RegionCutter(d), make_box(d)
    for _ in range(6):
        function = rng.standard_normal((1, d + 1))
        cut = cutter.cut(region, function)
        length = np.linalg.norm(function[0, :-1])
        G = np.vstack([region.G, function[:, :-1] / length])
        h = np.append(region.h, -function[0, -1] / length)
        rows, limits = np.column_stack([G, np.ones(len(h))]), h
        objective, box = np.append(np.zeros(d), -1.0), [(-1.0, 1.0)] * d + [(None, 10.0)]
        radius = -linprog(objective, rows, limits, bounds=box, method="highs-ds").fun
        assert (cut is not None) == (radius > 1e-9)
        if cut is not None:
            assert (G @ cut.inside <= h).all() and (np.abs(cut.inside) <= 1.0 + 1e-12).all()
            region = cut


@pytest.mark.slow
def test_sway_and_yaw_of_the_paper_near_their_setpoint() -> None:
    """The proof ends, no search finds more, and the C library takes what is proved, everywhere."""
    bound = prove_iteration_bound("sway-yaw", factor=0.004)
    assert bound.is_complete and bound.differing == 0 and bound.compared > 4096
    assert 0 < bound.searched <= bound.bound
    assert "at most" in bound.lines[0] and "no bound" not in bound.lines[0]


@pytest.mark.slow
def test_a_proof_that_was_stopped_is_no_bound() -> None:
    """The part left open is said, and the exit code is that of an unfinished proof."""
    bound = prove_iteration_bound("sway-yaw", factor=0.01, limit_s=0.05)
    assert not bound.is_complete and bound.open_share > 0.0
    assert "no bound" in bound.lines[0] and "is open" in bound.lines[0]
    assert main(["iteration-bound", "sway-yaw", "--limit", "0.01"]) == 1


@pytest.mark.parametrize(
    "arguments",
    [
        {"axes": "heave"},
        {"axes": "surge", "factor": 0.0},
        {"axes": "surge", "limit_s": float("nan")},
        {"axes": "surge", "scenario": "thrusters"},
        {"axes": "surge", "scenario": "thruster_loss_soft"},
    ],
    ids=str,
)
def test_other_problems_are_refused(arguments: dict[str, object]) -> None:
    """Axes, numbers and QPs that the proof does not know end in one line."""
    with pytest.raises(InputError):
        prove_iteration_bound(**arguments)  # type: ignore[arg-type]  # wrong on purpose


def test_open_share_of_a_new_result_is_everything() -> None:
    """A result claims nothing before a path was followed."""
    fresh = IterationBound.__dataclass_fields__["open_share"].default
    assert fresh == 1.0
