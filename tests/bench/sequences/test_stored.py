"""The sequences that ship: what the manifest states, what the files hold, what is said of a lie."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import quadprog

from dpbench import InputError, load_sequence
from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.suite import RecordedTable, SuiteFile
from dpbench.bench.record.npz import write_npz
from dpbench.bench.sequences.sequence_file import active_set, load_recorded
from dpbench.bench.sequences.shipped import load_rules, record_shipped_sequences
from dpbench.cli.main import main
from dpbench.qp.referee.referee import Referee
from dpbench.scenario.problem_files import (
    find_folder_of_shipped_problems,
    list_shipped_problem_names,
    resolve_sequence_path,
)
from dpbench.scenario.scenario import load_scenario

Arrays = dict[str, Any]
RULES = {rule.name: rule for rule in load_rules()}
NAMES = list_shipped_problem_names("sequences")
SMALL = ("paper-30-5", "wrap-30-5")
CLOSE = 1e-9
"""Largest difference of values between machines."""


def arrays_of(path: Path) -> Arrays:
    with np.load(path, allow_pickle=False) as data:
        return {name: data[name] for name in data.files}


def test_the_files_are_those_of_the_manifest() -> None:
    assert set(NAMES) == set(RULES)
    assert {rule.scenario for rule in RULES.values()} == set(
        list_shipped_problem_names("scenarios")
    )
    horizons = {(rule.N_p, rule.N_c) for rule in RULES.values()}
    assert horizons == {(30, 5), (60, 10), (100, 20), (200, 40)}
    assert sum(resolve_sequence_path(name).stat().st_size for name in NAMES) < 5e6


@pytest.mark.parametrize("name", NAMES)
def test_every_optimum_is_certified_to_1e_9(name: str) -> None:
    a, rule = arrays_of(resolve_sequence_path(name)), RULES[name]
    infeasible = a["certificate"] == "infeasible"
    assert (a["bound"][~infeasible] <= 1e-9).all() and np.isinf(a["bound"][infeasible]).all()
    assert not infeasible.any() or rule.scenario == "thruster_loss_hard"
    assert len(a["q"]) == len(range(0, rule.steps, rule.every))


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_fresh_record_has_the_same_beginning(name: str) -> None:
    """Shapes and active sets the same, values within 1e-9, wherever this runs."""
    rule, stored = RULES[name], arrays_of(resolve_sequence_path(name))
    fresh = rule.record(steps=rule.every + 1)
    sequence, optima = fresh.sequence, fresh.optima or []
    assert len(sequence) == len(optima) == 2
    for k, optimum in enumerate(optima):
        np.testing.assert_array_equal(active_set(optimum), stored["active"][k])
        for key in ("z", "y", "y_box"):
            wanted = stored[key][k]
            np.testing.assert_allclose(getattr(optimum, key), wanted, rtol=CLOSE, atol=CLOSE)
    for key in ("q", "l", "u"):
        found = getattr(sequence, key)
        np.testing.assert_allclose(found, stored[key][:2], rtol=CLOSE, atol=CLOSE)
    for key in ("P", "A", "lb", "ub"):
        found = getattr(sequence.base, key)
        np.testing.assert_allclose(found, stored[key], rtol=CLOSE, atol=CLOSE)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_sampled_optima_are_found_again(name: str) -> None:
    recorded = load_recorded(resolve_sequence_path(name))
    sequence, optima = recorded.sequence, recorded.optima or []
    for k in (0, len(sequence) // 2, len(sequence) - 1):
        qp, stored = sequence.problem(k), optima[k]
        again = Referee(qp.P, qp.A, qp.lb, qp.ub).certify_vectors(qp.q, qp.l, qp.u)
        assert (again.kind == "infeasible") == (stored.kind == "infeasible")
        if stored.kind == "infeasible":
            continue
        np.testing.assert_array_equal(active_set(again), active_set(stored))
        np.testing.assert_allclose(again.z, stored.z, atol=CLOSE)
        C = np.vstack((np.eye(qp.n), qp.A))
        low, high = np.append(qp.lb, qp.l), np.append(qp.ub, qp.u)
        # Equations first, as quadprog wants them: two rows for each may seem inconsistent to it.
        equal = low == high
        C, b = np.vstack((C[equal], C[~equal], -C[~equal])), np.append(low[equal], low[~equal])
        b = np.append(b, -high[~equal])
        finite = np.isfinite(b)
        rows = C[finite].T.copy(), b[finite]
        found = quadprog.solve_qp(qp.P, -qp.q, *rows, meq=int(equal.sum()))[0]
        np.testing.assert_allclose(found, stored.z, atol=1e-7)


@pytest.mark.slow
def test_small_ones_are_regenerated_byte_for_byte(tmp_path: Path) -> None:
    said = record_shipped_sequences(tmp_path / "a", [RULES[name] for name in SMALL])
    assert said.startswith(f"{tmp_path / 'a'}: 2 sequences, ")
    for name in SMALL:
        made, stored = (
            arrays_of(tmp_path / "a" / f"{name}.npz"),
            arrays_of(resolve_sequence_path(name)),
        )
        assert made.keys() == stored.keys()
        np.testing.assert_array_equal(made["active"], stored["active"])
        for key, array in stored.items():
            assert made[key].shape == array.shape
            if array.dtype == np.float64:
                np.testing.assert_allclose(made[key], array, rtol=CLOSE, atol=CLOSE)
    rule, again = RULES[SMALL[0]], tmp_path / "again.npz"
    command = [sys.executable, "-m", "dpbench", "export", rule.scenario, "--out", str(again)]
    command += ["--horizons", f"{rule.N_p}/{rule.N_c}"]
    command += ["--steps", str(rule.steps), "--every", str(rule.every)]
    subprocess.run(command, check=True, capture_output=True)
    assert again.read_bytes() == (tmp_path / "a" / f"{SMALL[0]}.npz").read_bytes()


def test_all_is_said_with_nothing_beside_it(capsys: pytest.CaptureFixture[str]) -> None:
    """--all follows its manifest; without it WHAT and --out are needed: exit 2 in one line."""
    for more in (["paper"], ["--steps", "3"], ["--horizons", "30/5"], ["--every", "2"]):
        assert main(["export", "--all", *more]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    for arguments, message in (
        (["export", "paper"], "export: --out: missing; required: the file or folder to write"),
        (["export", "paperr"], "scenario or sequence name: found 'paperr'; allowed: paper, "),
        (
            ["export", "--out", "x.npz"],
            "export: WHAT: missing; required: the QPs to write, or --all",
        ),
    ):
        assert main(arguments) == 2
        assert message in capsys.readouterr().err


def test_a_manifest_that_leaves_out_what_it_has_not_is_refused(tmp_path: Path) -> None:
    text = (find_folder_of_shipped_problems() / "sequences" / "manifest.toml").read_text(
        encoding="utf-8"
    )
    bad = tmp_path / "manifest.toml"
    bad.write_text(text + '\n[[left_out]]\nsequences = ["papr-30-5"]\nreason = "x"\n', "utf-8")
    with pytest.raises(InputError, match=r"left_out.sequences: found 'papr-30-5'"):
        load_rules(bad)
    bad.write_text(text.replace("title", "titel", 1), "utf-8")
    with pytest.raises(InputError, match="titel"):
        load_rules(bad)


def test_check_certifies_every_step_again(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stored name or a file, infeasible steps among them: one line, wrapped at 80 columns."""
    assert main(["check", "paper-30-5"]) == 0
    line = " ".join(capsys.readouterr().out.split())
    a = arrays_of(resolve_sequence_path("paper-30-5"))
    assert f"{len(a['q'])} QPs, n = 15, m = 15; certificates: " in line
    assert f"largest error bound {a['bound'].max():.1e}" in line
    monkeypatch.chdir(tmp_path)
    Path("mine.npz").write_bytes(resolve_sequence_path("thruster_loss_hard-30-5").read_bytes())
    assert main(["check", "mine.npz"]) == 0
    assert " infeasible" in capsys.readouterr().out


def change(key: str, at: tuple[int, ...], by: float) -> Callable[[Arrays], None]:
    def apply(arrays: Arrays) -> None:
        arrays[key][at] += by

    return apply


def grow_multiplier(arrays: Arrays) -> None:
    k, i = np.argwhere(arrays["active"][:, 15:] != 0)[0]
    arrays["y_box"][k, i] *= 1.001


def forget_proof(arrays: Arrays) -> None:
    k = int(np.flatnonzero(arrays["certificate"] == "infeasible")[0])
    arrays["y"][k], arrays["y_box"][k] = 0.0, 0.0


@pytest.mark.parametrize(
    ("name", "lie", "place"),
    [
        ("paper-30-5", change("z", (3, 0), 1e-6), "z[3]"),
        ("paper-30-5", change("q", (5, 2), 1e-3), "z[5]"),
        ("paper-30-5", change("y_box", (2, 4), 1e-3), "y, y_box[2]"),
        ("paper-30-5", change("active", (1, 20), 1), "active[1, 20]"),
        ("paper-30-5", lambda arrays: arrays.pop("active"), "active"),
        ("paper-30-5", grow_multiplier, "found a primal, dual or complementarity residual of "),
        ("thruster_loss_hard-30-5", change("y", (-1, 0), 1e-3), ""),
        ("thruster_loss_hard-30-5", forget_proof, "found no proof"),
    ],
)
def test_a_lie_is_one_line(
    name: str,
    lie: Callable[[Arrays], None],
    place: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A false optimum, data, multiplier, active set or proof: exit 2."""
    arrays = arrays_of(resolve_sequence_path(name))
    lie(arrays)
    write_npz(tmp_path / "false.npz", arrays)
    assert main(["check", str(tmp_path / "false.npz")]) == 2
    said = capsys.readouterr()
    assert said.err.count("\n") == 1 and not said.out
    assert "false.npz" in said.err and place in said.err


def test_a_suite_names_stored_sequences() -> None:
    """`[[recorded]]` with a name; a folder beside the suite that has the name is not meant."""
    tables = [RecordedTable(sequence=name) for name in SMALL]
    cells = plan_suite(SuiteFile(title="x", solvers=["daqp"], recorded=tables))
    assert [vars(planned.cell.source)["path"] for planned in cells] == list(SMALL)
    lengths = [len(arrays_of(resolve_sequence_path(name))["q"]) for name in SMALL]
    assert [planned.cell.steps for planned in cells] == lengths


@pytest.mark.slow
def test_the_list_shows_them(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "sequences"]) == 0
    # At 80 columns a cell may go on in a line without a name.
    lines = [line for line in capsys.readouterr().out.splitlines()[2:] if line[:1].isalpha()]
    rows = {line.split()[0]: line.replace("│", " ").split() for line in lines if "│" in line}
    assert list(rows) == NAMES
    a = arrays_of(resolve_sequence_path("rough-100-20"))
    share = f"{100 * np.count_nonzero(a['active']) / a['active'].size:.1f}"
    assert rows["rough-100-20"][1:5] == ["60", "60", str(len(a["q"])), share]


def test_names_of_sequences_load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("turn-60-10").mkdir()
    sequence = load_sequence("turn-60-10")
    assert sequence.base.n == 30 and sequence.P is not None
    assert sequence.meta["scenario"] == "turn-60-10"
    assert sequence.meta["sample_s"] == load_scenario("turn").sample_s
