"""Sequences for other tools: what MATLAB, a spreadsheet and another solver's reader find there."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat

from dpbench.bench.sequences.export import export_sequence, save_qps
from dpbench.bench.sequences.sequence_file import load_recorded, load_sequence
from dpbench.errors import InputError
from dpbench.scenario.problem_files import resolve_sequence_path
from dpbench.scenario.scenario import load_scenario


@pytest.mark.parametrize("name", ["paper-30-5", "turn-30-5"])
def test_a_matlab_file_has_the_arrays(name: str, tmp_path: Path) -> None:
    export_sequence(name, tmp_path / "a.mat", format="mat", steps=3)
    found, stored = loadmat(tmp_path / "a.mat"), load_recorded(resolve_sequence_path(name))
    for k in range(3):
        problem = stored.sequence.problem(k)
        P = found["P"] if stored.sequence.P is None else found["P"][k]
        np.testing.assert_array_equal(P, problem.P)
        np.testing.assert_array_equal(found["u"][k], problem.u)
    assert found["bound"].shape == (1, 3)


def test_a_matlab_file_has_units_sample_time_scenario_and_version(tmp_path: Path) -> None:
    export_sequence("paper-30-5", tmp_path / "a.mat", format="mat", steps=3)
    found = loadmat(tmp_path / "a.mat", simplify_cells=True)
    # A maximum increment of the paper's ship in surge, sway and yaw [N, N·m].
    assert found["unit_z"].tolist() == [32736.0, 11008.0, 475200.0] * 5
    assert found["unit_row"].shape == (15,)
    meta = found["meta"]
    assert (meta["sample_s"], meta["scenario"], meta["N_p"]) == (0.3, "paper-30-5", 30)
    assert meta["name"].startswith("paper-30-5") and meta["dpbench"]


def test_a_matlab_file_has_the_same_bytes_at_any_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The text before the version, bytes 0 to 115, begins as readers expect and has no time."""
    contents = []
    for now in ("Tue Dec  1 13:06:02 2026", "Wed Dec  2 14:07:03 2026"):
        monkeypatch.setattr("time.asctime", lambda *_, now=now: now)
        export_sequence("paper-30-5", tmp_path / "a.mat", format="mat", steps=3)
        contents.append((tmp_path / "a.mat").read_bytes())
    assert contents[0] == contents[1]
    text = contents[0][:116].decode("ascii")
    assert text.startswith("MATLAB 5.0 MAT-file") and text.isprintable()
    assert contents[0][124:128] == b"\x00\x01IM"


def test_csv_tables_have_the_arrays_to_the_last_digit(tmp_path: Path) -> None:
    export_sequence("turn-30-5", tmp_path / "tables", format="csv", steps=2)
    problem = load_recorded(resolve_sequence_path("turn-30-5")).sequence.problem(1)
    P = np.loadtxt(tmp_path / "tables" / "P.csv", delimiter=",")[1].reshape(problem.P.shape)
    np.testing.assert_array_equal(P, problem.P)
    l = np.loadtxt(tmp_path / "tables" / "l.csv", delimiter=",")[1]  # noqa: E741 - lower row limits, as in l ≤ Az ≤ u
    np.testing.assert_array_equal(l, problem.l)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper-30-5", "thruster_loss_soft-30-5", "thrusters_move-30-5"])
def test_another_solver_reads_a_qps_file_and_finds_the_optimum(name: str, tmp_path: Path) -> None:
    """HiGHS has a reader of its own. Soft limits have slacks without an upper bound."""
    highspy = pytest.importorskip("highspy", reason="highspy is not installed")
    recorded = load_recorded(resolve_sequence_path(name))
    save_qps(tmp_path / "qps", recorded)
    k = len(recorded.sequence) // 2
    highs = highspy.Highs()
    highs.setOptionValue("output_flag", False)
    # HiGHS reads files of this suffix alone.
    file = (tmp_path / "qps" / f"{k:06d}.qps").rename(tmp_path / "qp.mps")
    assert highs.readModel(str(file)) == highspy.HighsStatus.kOk
    highs.run()
    problem, optimum = recorded.sequence.problem(k), (recorded.optima or [])[k]
    expected = problem.objective(optimum.z)
    assert highs.getInfo().objective_function_value == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_the_guide_lists_every_array_with_its_shape(tmp_path: Path) -> None:
    guide = Path(__file__).parents[3] / "docs" / "guide" / "sequences.md"
    rows = [line.split("|")[1:-1] for line in guide.read_text("utf-8").splitlines() if "|" in line]
    listed: list[dict[str, tuple[int, ...] | None]] = [{}, {}, {}]
    sizes = {"n": 9, "m": 21, "K": 3}
    for what, *cells in rows:
        for name in re.findall(r"`(\w+)`", what):
            for shapes, cell in zip(listed, cells, strict=True):
                if cell.strip() != "–":
                    is_shape = cell.strip().startswith("(")
                    shapes[name] = eval(cell, {}, sizes) if is_shape else None
    for path in ("a.npz", "a.mat", "csv"):
        kind: Any = path.removeprefix("a.")
        export_sequence("thrusters_cascade-allocation", tmp_path / path, format=kind, steps=3)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as arrays:
        found = [{name: arrays[name].shape for name in arrays.files}]
    matlab = loadmat(tmp_path / "a.mat")
    found += [{name: array.shape for name, array in matlab.items() if not name.startswith("__")}]
    tables = {path.stem: path for path in (tmp_path / "csv").iterdir()}
    found += [
        {name: np.loadtxt(path, delimiter=",", ndmin=2).shape for name, path in tables.items()}
    ]
    for shapes, own in zip(listed, found, strict=True):
        assert own.keys() == shapes.keys()
        assert {name: shape for name, shape in shapes.items() if shape} == {
            name: shape for name, shape in own.items() if shapes[name]
        }


def test_a_matlab_file_needs_its_suffix(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.mat"):
        export_sequence("paper-30-5", tmp_path / "a.npz", format="mat", steps=3)


def test_a_sequence_in_memory_is_written_in_scaled_units(tmp_path: Path) -> None:
    """One in SI has its units in the file, and the QPs of the stored one."""
    export_sequence(load_sequence("turn-30-5", units="si"), tmp_path / "a.npz", steps=3)
    written, stored = (
        load_recorded(tmp_path / "a.npz"),
        load_recorded(resolve_sequence_path("turn-30-5")),
    )
    units, expected = written.sequence.units, stored.sequence.units
    assert units is not None and expected is not None
    np.testing.assert_array_equal(units.z, expected.z)
    np.testing.assert_array_equal(written.sequence.q, stored.sequence.q[:3])


def test_a_scenario_in_memory_is_recorded(tmp_path: Path) -> None:
    export_sequence(load_scenario("paper").truncate(3), tmp_path / "a.npz")
    assert len(load_recorded(tmp_path / "a.npz").sequence) == 3
    with pytest.raises(TypeError, match="allowed: a Scenario"):
        export_sequence(3, tmp_path / "b.npz")  # type: ignore[arg-type] # the wrong type is the test
