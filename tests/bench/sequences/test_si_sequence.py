"""A sequence file read back in SI: the QPs the builder itself makes in N and N·m."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpbench import InputError, QPSequence, load_scenario, load_sequence, record_sequence
from dpbench.bench.sequences.recording import record
from dpbench.bench.sequences.sequence_file import save_sequence
from dpbench.errors import ShapeError
from dpbench.qp.program import Units, in_own_units
from dpbench.qp.random_recipe import RandomRecipe
from dpbench.qp.random_sequence import random_sequence

ARRAYS = ("P", "q", "A", "l", "u", "lb", "ub")


def saved(scenario: str, path: Path, steps: int = 5) -> Path:
    recorded = record(load_scenario(scenario), steps=steps)
    save_sequence(
        path, recorded.sequence, recorded.optima, units=recorded.units, documents=recorded.documents
    )
    return path


def same(found: QPSequence, wanted: QPSequence) -> None:
    assert len(found) == len(wanted)
    assert (found.base.block, found.base.moves) == (wanted.base.block, wanted.base.moves)
    for k in range(len(wanted)):
        mine, theirs = found.problem(k), wanted.problem(k)
        for name in ARRAYS:
            # Relative to the largest entry: small ones are differences of large ones.
            size = np.abs(theirs.__dict__[name][np.isfinite(theirs.__dict__[name])]).max(initial=0)
            np.testing.assert_allclose(
                getattr(mine, name), getattr(theirs, name), rtol=1e-12, atol=1e-14 * size
            )


@pytest.mark.parametrize("scenario", ["paper", "turn", "thruster_loss_soft", "watch_circle"])
def test_what_is_read_is_what_the_builder_makes_in_si(scenario: str, tmp_path: Path) -> None:
    """Constant matrices, those of each step, slacks, and rows in m and m/s."""
    path = saved(scenario, tmp_path / "one.npz")
    built = record_sequence(load_scenario(scenario).first(5), units="si")
    found = load_sequence(path, units="si")
    same(found, built)
    assert found.scaled is not None and built.scaled is not None
    assert found.units is not None and built.units is not None
    same(found.scaled, built.scaled)
    np.testing.assert_allclose(found.units.z, built.units.z, rtol=1e-15)
    np.testing.assert_allclose(found.units.row, built.units.row, rtol=1e-15)


def test_bounds_in_si_are_the_rate_limits(tmp_path: Path) -> None:
    """Of the vessel: N, N and N·m per sample, for each move."""
    scenario = load_scenario("paper")
    found = load_sequence(saved("paper", tmp_path / "one.npz"), units="si")
    np.testing.assert_allclose(
        found.base.ub, np.tile(scenario.problem.du_max, scenario.problem.N_c), rtol=1e-15
    )


def test_read_in_si_and_written_it_is_the_same_file(tmp_path: Path) -> None:
    """What is written is the scaled form with the units, bit for bit."""
    path = saved("paper", tmp_path / "one.npz")
    again = tmp_path / "two.npz"
    documents = record(load_scenario("paper"), steps=5).documents
    save_sequence(again, load_sequence(path, units="si"), documents=documents)
    assert again.read_bytes() == path.read_bytes()


@given(seed=st.integers(0, 10_000), moves=st.integers(2, 5), rows=st.integers(1, 5))
def test_a_change_of_units_keeps_cost_and_feasibility(seed: int, moves: int, rows: int) -> None:
    """At any point: the same objective, and A z in its own unit."""
    rng = np.random.default_rng(seed)
    scaled = random_sequence(RandomRecipe("plain", moves, rows, seed, steps=2))
    units = Units(10.0 ** rng.uniform(-2, 4, moves), 10.0 ** rng.uniform(-2, 4, rows))
    own = in_own_units(scaled, units)
    for k in range(2):
        z = rng.standard_normal(moves)
        before, after = scaled.problem(k), own.problem(k)
        cost = before.objective(z)
        assert after.objective(units.z * z) == pytest.approx(cost, rel=1e-9, abs=1e-9)
        np.testing.assert_allclose(after.A @ (units.z * z), units.row * (before.A @ z), rtol=1e-9)
        np.testing.assert_allclose(after.u, units.row * before.u)
        np.testing.assert_allclose(after.lb, units.z * before.lb)


def test_a_sequence_without_si_units_is_refused(tmp_path: Path) -> None:
    """A random one has units of its own; units of another size, or of another name, are refused."""
    path = tmp_path / "random.npz"
    sequence = random_sequence(RandomRecipe("plain", 3, 2, 1, steps=2))
    save_sequence(path, sequence)
    with pytest.raises(InputError, match=r"random.npz: unit_z, unit_row"):
        load_sequence(path, units="si")
    with pytest.raises(InputError, match="'imperial'"):
        load_sequence(path, units="imperial")
    with pytest.raises(ShapeError, match="row"):
        in_own_units(sequence, Units(np.ones(3), np.ones(3)))
