"""Hulls from files: the MSS structure against its own entries, a table of coefficients.

`mss/supply_cut.mat` is the supply ship of the MSS toolbox (licence beside it), cut to the fields
that are read and to its three lowest frequencies.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from dpbench.errors import InputError
from dpbench.files import mat, mat_child
from dpbench.scenario import hull_files
from dpbench.scenario.hull_files import Hull, read_hull_from_csv_table, read_hull_from_mss_file
from dpbench.scenario.own_ship import Particulars, estimate_added_mass_by_regression
from dpbench.scenario.scenario import load_vessel

CUT = Path(__file__).parent / "mss" / "supply_cut.mat"


def structure() -> dict[str, Any]:
    """The structure of the cut file, as dictionaries."""
    vessel: dict[str, Any] = scipy.io.loadmat(CUT, simplify_cells=True)["vessel"]
    return vessel


def save(path: Path, vessel: dict[str, Any]) -> Path:
    """A file with such a structure."""
    scipy.io.savemat(path, {"vessel": vessel})
    return path


@pytest.fixture(scope="module")
def hull() -> Hull:
    """The hull of the cut file."""
    return read_hull_from_mss_file(CUT)


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read files that are no danger without a process of their own, which takes its time."""

    def read(path: Path, name: str) -> tuple[list[str], dict[str, Any]]:
        fields = mat_child._flatten_numeric_fields_by_dotted_name(
            scipy.io.loadmat(path, simplify_cells=True)[name]
        )
        return [name], {f"{name}.{key}": np.asarray(value) for key, value in fields.items()}

    monkeypatch.setattr(hull_files, "read_mat_structure_in_child", read)


def test_the_mss_hull_is_made_of_the_files_own_entries(hull: Hull) -> None:
    """Rows 1, 2, 6 of MRB + A and B + Bv at the lowest frequency; main gives the particulars."""
    raw = scipy.io.loadmat(CUT)["vessel"][0, 0]
    for i, row in enumerate((0, 1, 5)):
        for j, column in enumerate((0, 1, 5)):
            assert hull.M[i, j] == raw["MRB"][row, column] + raw["A"][row, column, 0]
            assert hull.D[i, j] == raw["B"][row, column, 0] + raw["Bv"][row, column, 0]
    main = raw["main"][0, 0]
    assert hull.particulars == {
        "length_m": float(main["Lpp"].item()),
        "breadth_m": float(main["B"].item()),
        "draught_m": float(main["T"].item()),
        "displacement_t": float(main["m"].item()) / 1000,
    }
    assert "0.105 rad/s" in hull.method


def test_the_mss_hull_is_the_ship_that_others_published(hull: Hull) -> None:
    """NTNU's course vessel is this ship: its M agrees within 8 %; its surge is Söding's formula."""
    published = load_vessel("supply_tmr")
    np.testing.assert_allclose(np.diag(hull.M), np.diag(published.M), rtol=0.08)
    own = Particulars(82.8, 19.2, 6.0, 6.3622085e6)
    surge = hull.M[0, 0] - own.displacement_kg
    assert estimate_added_mass_by_regression(own)[0] == pytest.approx(surge, rel=2e-3)


def test_what_the_next_frequency_says_is_said(hull: Hull) -> None:
    (remark,) = hull.remarks
    assert "0.209 rad/s" in remark and "1.91, 1.91, 1.89" in remark


@pytest.mark.usefixtures("in_this_process")
def test_order_speeds_and_one_matrix_of_viscous_damping(hull: Hull, tmp_path: Path) -> None:
    vessel = structure()
    other = vessel | {
        "freqs": vessel["freqs"][::-1],
        "Bv": vessel["Bv"][:, :, 0],
        **{
            key: np.stack([vessel[key][:, :, ::-1], np.full((6, 6, 3), 7.0)], axis=3)
            for key in ("A", "B")
        },
    }
    found = read_hull_from_mss_file(save(tmp_path / "other.mat", other))
    np.testing.assert_array_equal(found.M, hull.M)
    np.testing.assert_array_equal(found.D, hull.D)


@pytest.mark.usefixtures("in_this_process")
def test_a_file_of_one_frequency(hull: Hull, tmp_path: Path) -> None:
    vessel = structure()
    alone = vessel | {key: vessel[key][:, :, 0] for key in ("A", "B", "Bv")} | {"freqs": 0.1}
    found = read_hull_from_mss_file(save(tmp_path / "alone.mat", alone))
    np.testing.assert_array_equal(found.M, hull.M)
    assert not found.remarks


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (lambda v: v.pop("Bv"), ["vessel.Bv", "missing", "viscous"]),
        (lambda v: v.pop("MRB"), ["vessel.MRB", "missing"]),
        (lambda v: v.update(A=np.ones((6, 6, 2))), ["vessel.A", "(6, 6, 2)", "(6, 6, 3)"]),
        (lambda v: v.update(MRB=np.eye(3)), ["vessel.MRB", "(3, 3)", "(6, 6)"]),
        (lambda v: v.update(MRB=np.full((6, 6), np.nan)), ["vessel.MRB", "NaN"]),
        (lambda v: v.update(freqs="none"), ["vessel.freqs", "no numbers"]),
    ],
)
def test_a_structure_that_lacks_something_is_refused_in_one_line(
    change: Callable[[dict[str, Any]], object], parts: list[str], tmp_path: Path
) -> None:
    vessel = structure()
    change(vessel)
    path = save(tmp_path / "bad.mat", vessel)
    with pytest.raises(InputError) as caught:
        read_hull_from_mss_file(path)
    assert all(part in str(caught.value) for part in [str(path), *parts]), caught.value


@pytest.mark.slow
def test_files_that_are_no_such_structure_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.mat").write_text("nonsense " * 40, encoding="utf-8")
    scipy.io.savemat(tmp_path / "ship.mat", {"ship": 1.0})
    for name, part in (("none", "no such file"), ("text", "save -v7"), ("ship", "found ship")):
        with pytest.raises(InputError, match=part) as caught:
            read_hull_from_mss_file(tmp_path / f"{name}.mat")
        assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_a_file_that_kills_scipy_is_one_line(tmp_path: Path) -> None:
    path = save(tmp_path / "ship.mat", {"MRB": np.eye(6), "main": {"Lpp": 82.8}, "name": "x"})
    whole = path.read_bytes()
    for at in (260, 668):
        path.write_bytes(whole[:at] + b"\x10" + whole[at + 1 :])
        with pytest.raises(
            InputError, match=r"ship\.mat: found .*; allowed: a \.mat file"
        ) as caught:
            read_hull_from_mss_file(path)
        assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_a_reader_that_is_killed_or_does_not_end_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = save(tmp_path / "ship.mat", structure())
    child = tmp_path / "mat_child.py"
    monkeypatch.setattr(mat, "__file__", str(tmp_path / "mat.py"))
    child.write_text("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "utf-8")
    with pytest.raises(InputError, match=r"a file that crashes SciPy \(SIGSEGV\)"):
        read_hull_from_mss_file(path)
    child.write_text("import time; time.sleep(60)", "utf-8")
    monkeypatch.setattr(mat, "WAIT_S", 0.2)
    with pytest.raises(InputError, match=r"does not read within 0\.2 s"):
        read_hull_from_mss_file(path)


@pytest.mark.parametrize("name", ["supply_fs99", "supply_mss", "osv"])
def test_a_table_gives_back_what_was_written_into_it(name: str, tmp_path: Path) -> None:
    ship = load_vessel(name)
    entries = {(0, 0): "11", (1, 1): "22", (2, 2): "66", (1, 2): "26", (2, 1): "62"}
    rows = [f"M{key},{float(ship.M[ij])!r}" for ij, key in entries.items() if key != "62"]
    rows += [f"D{key},{float(ship.D[ij])!r},a remark" for ij, key in entries.items()]
    path = tmp_path / "ship.csv"
    head = ["# a comment", "coefficient,value,remark", "length_m,80"]
    path.write_text("\n".join([*head, *reversed(rows)]), encoding="utf-8")
    hull = read_hull_from_csv_table(path)
    np.testing.assert_allclose(hull.M, ship.M, rtol=1e-15)
    np.testing.assert_allclose(hull.D, ship.D, rtol=1e-15)
    assert hull.particulars == {"length_m": 80.0}


GOOD = "coefficient,value\nM11,7e6\nM22,8e6\nM66,4e9\nD11,2e5\nD22,8e5\nD66,3e8\n"


def test_couplings_may_be_left_out(tmp_path: Path) -> None:
    """They are zero then, and D62 is D26."""
    path = tmp_path / "ship.csv"
    path.write_text(GOOD, encoding="utf-8")
    np.testing.assert_array_equal(read_hull_from_csv_table(path).M, np.diag([7e6, 8e6, 4e9]))
    path.write_text(GOOD + "D26,-3e6\n", encoding="utf-8")
    D = read_hull_from_csv_table(path).D
    assert D[1, 2] == D[2, 1] == -3e6


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["first row", "an empty file", "coefficient,value"]),
        ("name;value\n", ["first row", "name;value"]),
        (GOOD.replace("M22,8e6\n", ""), ["M22", "missing"]),
        (GOOD + "M12,3\n", ["M12", "an unknown coefficient", "M11"]),
        (GOOD + "D66,3e8\n", ["D66", "a second row"]),
        (GOOD.replace("8e6", "-8e6"), ["M22", "'-8e6'", "above zero"]),
        (GOOD.replace("8e6", "eight"), ["M22", "'eight'"]),
        (GOOD + "M26\n", ["M26", "''", "a number"]),
    ],
)
def test_a_bad_table_is_refused_in_one_line(text: str, parts: list[str], tmp_path: Path) -> None:
    path = tmp_path / "ship.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_hull_from_csv_table(path)
    assert all(part in str(caught.value) for part in [str(path), *parts]), caught.value
