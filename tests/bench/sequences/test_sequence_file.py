"""Recorded sequences as files: what stands in them, and what is said of a bad one."""

import json
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from dpbench import (
    InputError,
    QPSequence,
    QuadraticProgram,
    load_scenario,
    load_sequence,
    record_sequence,
)
from dpbench.bench.record.npz import write_npz
from dpbench.bench.sequences.export import Format, export_sequence
from dpbench.bench.sequences.sequence_file import load_recorded, save_sequence
from dpbench.bench.sequences.source import _check_step, record_scenario
from dpbench.errors import ShapeError
from dpbench.mpc.condense import UnitSystem
from dpbench.qp.program import Units, convert_sequence_to_units
from dpbench.qp.random_sequence import RandomRecipe, generate_random_sequence
from dpbench.qp.referee.referee import certify, certify_all_steps

Arrays = dict[str, Any]
STEPS = 30


@pytest.fixture(scope="module")
def tight() -> QPSequence:
    return record_sequence(load_scenario("paper_tight").truncate(STEPS))


@pytest.fixture(scope="module")
def file(tight: QPSequence, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("file") / "tight.npz"
    save_sequence(path, tight)
    return path


def arrays_of(path: Path) -> Arrays:
    with np.load(path, allow_pickle=False) as data:
        return {name: data[name] for name in data.files}


def test_the_file_alone_proves_its_optima(file: Path) -> None:
    a = arrays_of(file)
    n = a["P"].shape[0]
    assert a["q"].shape == (STEPS, n) and a["active"].dtype == np.int8
    C = np.vstack((a["A"], np.eye(n)))
    for k in range(STEPS):
        z, y = a["z"][k], np.concatenate((a["y"][k], a["y_box"][k]))
        low, high = np.append(a["l"][k], a["lb"]), np.append(a["u"][k], a["ub"])
        np.testing.assert_allclose(a["P"] @ z + a["q"][k] + C.T @ y, 0.0, atol=1e-9)
        value = C @ z
        assert (value >= low - 1e-9).all() and (value <= high + 1e-9).all()
        upper, lower = a["active"][k] == 1, a["active"][k] == -1
        np.testing.assert_allclose(value[upper], high[upper], atol=1e-9)
        np.testing.assert_allclose(value[lower], low[lower], atol=1e-9)
        assert (y[upper] > 0).all() and (y[lower] < 0).all()
        np.testing.assert_allclose(y[~upper & ~lower], 0.0, atol=1e-8)
    # Both kinds of limit are at work in this run, or the above says nothing of them.
    assert (a["active"][:, n:] != 0).any() and {-1, 0, 1} == set(np.unique(a["active"]).tolist())


def test_a_sequence_has_the_same_bytes(file: Path, tight: QPSequence, tmp_path: Path) -> None:
    save_sequence(tmp_path / "again.npz", tight)
    assert (tmp_path / "again.npz").read_bytes() == file.read_bytes()
    assert [path.name for path in tmp_path.iterdir()] == ["again.npz"]
    with zipfile.ZipFile(file) as archive:
        assert {info.date_time for info in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def same(found: QPSequence, wanted: QPSequence, rtol: float = 0.0) -> None:
    assert (found.name, len(found)) == (wanted.name, len(wanted))
    assert (found.base.block, found.base.moves) == (wanted.base.block, wanted.base.moves)
    for k in range(len(wanted)):
        mine, theirs = vars(found.problem(k)), vars(wanted.problem(k))
        for name in ("P", "q", "A", "l", "u", "lb", "ub"):
            # Relative to the largest entry: small ones are differences of large ones.
            size = np.abs(theirs[name][np.isfinite(theirs[name])]).max(initial=0)
            np.testing.assert_allclose(mine[name], theirs[name], rtol, 1e-2 * rtol * size)


@pytest.mark.parametrize("family", ["infeasible_steps", "infinite_bounds", "no_rows"])
def test_a_random_sequence_survives_its_file(family: str, tmp_path: Path) -> None:
    rows = 0 if family == "no_rows" else 6
    sequence = generate_random_sequence(RandomRecipe(family, 4, rows, 1, steps=6, block=2))
    optima = certify_all_steps(sequence)
    save_sequence(tmp_path / "one.npz", sequence, optima)
    recorded = load_recorded(tmp_path / "one.npz")
    same(recorded.sequence, sequence)
    assert recorded.optima is not None and recorded.sequence.units is None
    for mine, theirs in zip(recorded.optima, optima, strict=True):
        assert (mine.kind, mine.bound) == (theirs.kind, theirs.bound)
        for name in ("z", "y", "y_box"):
            np.testing.assert_array_equal(getattr(mine, name), getattr(theirs, name))


def test_bounds_of_each_step_survive_and_are_certified(tmp_path: Path) -> None:
    """min ½z² − z with bounds that move: the optimum is 1, or the nearest bound to it."""
    lb, ub = np.array([[0.0], [2.0], [-5.0]]), np.array([[3.0], [4.0], [0.5]])
    q, none, no_rows = np.full((3, 1), -1.0), np.zeros(0), np.zeros((3, 0))
    base = QuadraticProgram(np.eye(1), q[0], np.zeros((0, 1)), none, none, lb[0], ub[0])
    sequence = QPSequence("moving", base, q, no_rows, no_rows, lb=lb, ub=ub)
    save_sequence(tmp_path / "one.npz", sequence)
    recorded = load_recorded(tmp_path / "one.npz")
    same(recorded.sequence, sequence)
    assert recorded.optima is not None
    np.testing.assert_allclose([o.z[0] for o in recorded.optima], [1.0, 2.0, 0.5], atol=1e-12)
    active = arrays_of(tmp_path / "one.npz")["active"]
    assert active[:, 0].tolist() == [0, -1, 1]


def test_an_si_sequence_is_written_scaled_with_its_units(tmp_path: Path) -> None:
    scenario = load_scenario("paper").truncate(3)
    si = record_sequence(scenario, units="si")
    save_sequence(tmp_path / "si.npz", si)
    a, largest = arrays_of(tmp_path / "si.npz"), scenario.problem.du_max
    np.testing.assert_allclose(a["unit_z"], np.tile(largest, scenario.problem.N_c), rtol=1e-12)
    P = a["P"] / np.outer(a["unit_z"], a["unit_z"])
    np.testing.assert_allclose(P, si.base.P, rtol=1e-9, atol=0.0)
    np.testing.assert_allclose(a["l"] * a["unit_row"], si.l, rtol=1e-9)
    assert (a["lb"] == -1.0).all()


def without(name: str) -> Callable[[Arrays], Arrays]:
    return lambda a: {key: array for key, array in a.items() if key != name}


def with_nan(name: str) -> Callable[[Arrays], Arrays]:
    def change(a: Arrays) -> Arrays:
        array = a[name].copy()
        array[-1] = np.nan
        return a | {name: array}

    return change


def put(name: str, value: object) -> Callable[[Arrays], Arrays]:
    return lambda a: a | {name: np.asarray(value)}


def renamed(a: Arrays) -> Arrays:
    return a | {"certificate": np.array(["hearsay"] * STEPS)}


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (without("format"), ["format", "missing"]),
        (without("q"), ["q", "missing"]),
        (without("bound"), ["bound", "missing"]),
        (without("certificate"), ["certificate", "missing"]),
        (put("format", "spam"), ["format", "'spam'", "dpbench-sequence"]),
        (put("version", 2), ["version", "2", "newer"]),
        (put("version", "1"), ["version", "allowed: the whole number 1"]),
        (put("meta", "{"), ["meta", "invalid JSON"]),
        (put("meta", '{"every": "two"}'), ["meta.every", "'two'"]),
        (put("documents", "[]"), ["documents", "list"]),
        (put("block", 4), ["block", "divisor"]),
        (put("P", np.eye(3)), ["P", "(3, 3)", "(15, 15)"]),
        (put("P", np.full((15, 15), "x")), ["P", "real numbers"]),
        (put("q", np.zeros((0, 15))), ["q", "(0, 15)"]),
        (put("lb_steps", np.zeros(15)), ["lb_steps", "(15,)", "(30, 15)"]),
        (put("z", np.zeros((STEPS, 14))), ["z", "(30, 14)", "(30, 15)"]),
        (with_nan("P"), ["P[14, 0]", "nan"]),
        (with_nan("q"), ["q[29, 0]", "nan"]),
        (with_nan("u"), ["u[29, 0]", "nan"]),
        (with_nan("z"), ["z, y, y_box[29]", "NaN at a step with a finite error bound"]),
        (put("q", np.full((STEPS, 15), np.inf)), ["q[0, 0]", "inf", "finite"]),
        (renamed, ["certificate[0]", "hearsay", "linear"]),
    ],
)
def test_a_bad_file_is_one_line(
    change: Callable[[Arrays], Arrays], parts: list[str], file: Path, tmp_path: Path
) -> None:
    bad = tmp_path / "bad.npz"
    write_npz(bad, change(arrays_of(file)))
    with pytest.raises(InputError) as caught:
        load_sequence(bad)
    message = str(caught.value)
    assert "\n" not in message
    fault = ["required"] if "missing" in parts else ["found", "allowed"]
    assert all(part in message for part in [str(bad), *fault, *parts]), message


def test_a_damaged_file_is_one_line(file: Path, tmp_path: Path) -> None:
    whole = file.read_bytes()
    at = whole.index(b"q.npy") + 3000
    flipped = whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :]
    bad = tmp_path / "bad.npz"
    for data in (b"", b"spam", whole[:-40], whole[: len(whole) // 2], flipped):
        bad.write_bytes(data)
        with pytest.raises(InputError, match="damaged"):
            load_sequence(bad)
    with pytest.raises(InputError, match="no such file"):
        load_sequence(tmp_path / "none.npz")


def test_an_unknown_name_is_refused_with_the_one_ending_that_is_read() -> None:
    """`dpbench run --sequence` reads further files, `load_sequence` and `replay` do not."""
    with pytest.raises(InputError, match=r"^sequence name: found 'paperr'; .*; or a \.npz path$"):
        load_sequence("paperr")


def test_python_objects_are_refused(file: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad.npz"
    np.savez(bad, **(arrays_of(file) | {"name": np.array({"a": 1}, dtype=object)}))
    with pytest.raises(InputError, match="Python objects"):
        load_sequence(bad)


def test_a_file_may_call_infeasible_what_is_so_by_rounding_only() -> None:
    one, above = np.ones(1), np.array([1.0 + 2.0**-52])
    base = QuadraticProgram(np.eye(1), np.zeros(1), np.eye(1), above, above + 1.0, 0.0 * one, one)
    sequence = QPSequence("thin", base, base.q[None], base.l[None], base.u[None])
    optimum = certify(base)
    assert optimum.kind == "undecided"
    for kind in ("infeasible", "undecided"):
        _check_step("file", 0, sequence, replace(optimum, kind=kind), optimum)
    with pytest.raises(InputError, match="certificate"):
        _check_step("file", 0, sequence, replace(optimum, kind="linear"), optimum)


def saved(scenario: str, path: Path) -> Path:
    record_scenario(load_scenario(scenario), steps=5).save(path)
    return path


@pytest.mark.parametrize("scenario", ["paper", "turn", "thruster_loss_soft", "watch_circle"])
def test_what_is_read_is_what_the_builder_makes_in_si(scenario: str, tmp_path: Path) -> None:
    path = saved(scenario, tmp_path / "one.npz")
    built = record_sequence(load_scenario(scenario).truncate(5), units="si")
    found = load_sequence(path, units="si")
    same(found, built, 1e-12)
    assert found.scaled is not None and built.scaled is not None
    assert found.units is not None and built.units is not None
    same(found.scaled, built.scaled, 1e-12)
    np.testing.assert_allclose(found.units.z, built.units.z, rtol=1e-15)
    np.testing.assert_allclose(found.units.row, built.units.row, rtol=1e-15)


def test_read_in_si_and_written_it_is_the_same_file(tmp_path: Path) -> None:
    path = saved("paper", tmp_path / "one.npz")
    again = tmp_path / "two.npz"
    save_sequence(again, load_sequence(path, units="si"))
    assert again.read_bytes() == path.read_bytes()


@pytest.mark.parametrize("units", ["scaled", "si"])
def test_a_recorded_sequence_is_written_as_its_scenario_is(
    units: UnitSystem, tmp_path: Path
) -> None:
    """With its units, horizons and documents, whichever way it is written."""
    scenario = load_scenario("paper").truncate(5)
    sequence = record_sequence(scenario, units=units)
    of_scenario, saved, exported = (tmp_path / f"{name}.npz" for name in "abc")
    export_sequence(scenario, of_scenario)
    save_sequence(saved, sequence)
    export_sequence(sequence, exported)
    assert saved.read_bytes() == exported.read_bytes() == of_scenario.read_bytes()
    contents = arrays_of(saved)
    np.testing.assert_allclose(contents["unit_z"][:3], scenario.problem.du_max, rtol=1e-12)
    assert json.loads(str(contents["meta"]))["N_c"] == scenario.problem.N_c
    assert json.loads(str(contents["documents"])) == scenario.files


def test_the_second_qps_of_a_cascade_are_written_with_their_units(tmp_path: Path) -> None:
    """Their variables are thrusts, of other sizes than the controller's moves."""
    scenario = load_scenario("thrusters_cascade").truncate(3)
    save_sequence(tmp_path / "a.npz", record_sequence(scenario, part="allocation"))
    export_sequence(scenario, tmp_path / "b.npz", part="allocation")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert not (arrays_of(tmp_path / "a.npz")["unit_z"] == 1.0).all()


@given(seed=st.integers(0, 10_000), moves=st.integers(2, 5), rows=st.integers(1, 5))
def test_a_change_of_units_keeps_cost_and_feasibility(seed: int, moves: int, rows: int) -> None:
    rng = np.random.default_rng(seed)
    scaled = generate_random_sequence(RandomRecipe("plain", moves, rows, seed, steps=2))
    units = Units(10.0 ** rng.uniform(-2, 4, moves), 10.0 ** rng.uniform(-2, 4, rows))
    own = convert_sequence_to_units(scaled, units)
    for k in range(2):
        z = rng.standard_normal(moves)
        before, after = scaled.problem(k), own.problem(k)
        cost = before.objective(z)
        assert after.objective(units.z * z) == pytest.approx(cost, rel=1e-9, abs=1e-9)
        np.testing.assert_allclose(after.A @ (units.z * z), units.row * (before.A @ z), rtol=1e-9)
        np.testing.assert_allclose(after.u, units.row * before.u)
        np.testing.assert_allclose(after.lb, units.z * before.lb)


def test_a_sequence_without_si_units_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "random.npz"
    sequence = generate_random_sequence(RandomRecipe("plain", 3, 2, 1, steps=2))
    save_sequence(path, sequence)
    with pytest.raises(InputError, match=r"random.npz: unit_z, unit_row"):
        load_sequence(path, units="si")
    with pytest.raises(InputError, match="'imperial'"):
        load_sequence(path, units="imperial")
    with pytest.raises(ShapeError, match="row"):
        convert_sequence_to_units(sequence, Units(np.ones(3), np.ones(3)))


def test_units_that_are_none_are_refused(tight: QPSequence, tmp_path: Path) -> None:
    factors: Any = np.ones(tight.base.n)
    for refuse in (
        lambda: replace(tight, units=factors),
        lambda: save_sequence(tmp_path / "a.npz", tight, units=factors),
    ):
        with pytest.raises(TypeError, match=r"units: found array\(.*allowed: Units\(z=.*, or None"):
            refuse()
    with pytest.raises(ShapeError, match=r"Units: row: found shape \(3,\)"):
        replace(tight, units=Units(factors, np.ones(3)))


def test_no_other_format_is_written_under_a_foreign_suffix(tmp_path: Path) -> None:
    sequence, path = load_sequence("paper-30-5"), tmp_path / "x.mat"
    with pytest.raises(InputError, match=r"path: found 'x\.mat'; allowed: .*export_sequence"):
        save_sequence(path, sequence)
    with pytest.raises(InputError, match=r"ends in \.npz, or `format` mat"):
        export_sequence(sequence, path)
    assert not list(tmp_path.iterdir())
    export_sequence(sequence, path, format="mat", steps=2)
    with pytest.raises(InputError, match=r"found a \.mat file; allowed: .*cannot be read back"):
        load_sequence(path)
    with pytest.raises(InputError, match=r"found a file written by dpbench; allowed: the \.npz"):
        export_sequence(path, tmp_path / "x.npz")
    formats: list[Format] = ["csv", "qps"]
    for format in formats:
        folder = tmp_path / format
        export_sequence(sequence, folder, format=format, steps=2)
        with pytest.raises(InputError, match=r"found a folder; allowed: .*cannot be read back"):
            load_sequence(folder)
        with pytest.raises(InputError, match=r"found no .*cannot be read back: use the \.npz"):
            export_sequence(folder, tmp_path / "x.npz")
