"""Counts of a suite on embedded cores: planned, stored, not repeated, and refused with a reason."""

import json
from pathlib import Path

import numpy as np
import pytest

from dpbench import run_campaign
from dpbench.bench import embedded_counts
from dpbench.bench.embedded_counts import pair_sequences_with_cores
from dpbench.bench.gather import join_result_folders
from dpbench.bench.plan.suite import EmbeddedTable
from dpbench.embedded import toolchain
from dpbench.embedded.table import EMBEDDED_FILE, load_counted_steps_of_folder
from dpbench.embedded.toolchain import has_extra
from dpbench.errors import InputError, ResultsError

SUITE = """
title = "Counts"
solvers = ["daqp"]
baseline_law = false
[embedded]
sequences = ["paper:3:4", "turn:0:2"]
solvers = ["paper_active_set", "osqp"]
[[closed_loop]]
scenarios = ["paper"]
steps = 3
"""
COUNTED = [("paper_active_set", "paper[3:7]"), ("osqp", "paper[3:7]")]


def table(*sequences: str, **keys: list[str]) -> EmbeddedTable:
    return EmbeddedTable.model_validate({"sequences": list(sequences), **keys})


def test_each_sequence_is_planned_with_each_core_and_solver() -> None:
    planned = pair_sequences_with_cores(
        table("paper:0:5", "rough:2:3", targets=["m7", "a53"], solvers=["daqp", "osqp"])
    )
    assert [(c.sequence, c.target, c.solver) for c in planned[:3]] == [
        ("paper[0:5]", "m7", "daqp"),
        ("paper[0:5]", "m7", "osqp"),
        ("paper[0:5]", "a53", "daqp"),
    ]
    assert len(planned) == 8
    assert planned[-1].sequence == "rough[2:5]"


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("paper", "SCENARIO:FIRST:STEPS"),
        ("paper:0:-1", "SCENARIO:FIRST:STEPS"),
        ("paper:0:0", "STEPS of 1 or more, within steps 0 to 999 of paper"),
        ("paper:990:20", "STEPS of 1 or more, within steps 0 to 999 of paper"),
        ("nowhere:0:1", "nowhere"),
    ],
)
def test_a_bad_sequence_is_refused(text: str, found: str) -> None:
    with pytest.raises(InputError, match=found):
        pair_sequences_with_cores(table(text))


def test_a_solver_without_a_recipe_is_refused() -> None:
    with pytest.raises(InputError, match=r"embedded.solvers: found 'clarabel'; allowed: a solver "):
        pair_sequences_with_cores(table("paper:0:1", solvers=["clarabel"]))


def test_without_the_extra_a_count_ends_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (planned,) = pair_sequences_with_cores(table("paper:0:1", solvers=["daqp"]))
    monkeypatch.setattr(toolchain, "EXTRAS", ("no_such_package",))
    monkeypatch.setattr(embedded_counts, "pin_to_core", lambda _: None)
    monkeypatch.setattr(embedded_counts, "disable_gc_and_warnings", lambda: None)
    embedded_counts.run_count_in_process(planned.text, tmp_path, "one", 0, tmp_path / "one.parquet")
    said = json.loads((tmp_path / "one.json").read_text())
    assert said["outcome"] == "invalid"
    assert "pip install 'dpbench[embedded]'" in said["detail"]
    assert not (tmp_path / "one.parquet").exists()


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of the suite, run once."""
    if not has_extra():
        pytest.skip("the extra `embedded` is not installed")
    folder = tmp_path_factory.mktemp("counts")
    (folder / "suite.toml").write_text(SUITE)
    return run_campaign(folder / "suite.toml", folder / "out")


@pytest.mark.slow
def test_counts_stand_beside_the_other_results(out: Path) -> None:
    steps = load_counted_steps_of_folder(out)
    assert steps is not None
    assert [*steps.groupby(["solver", "sequence"], sort=False).groups] == [
        *COUNTED,
        ("paper_active_set", "turn[0:2]"),
    ]
    assert steps[steps["sequence"] == "paper[3:7]"]["k"].tolist() == [0, 1, 2, 3] * 2
    assert (steps["error_move"] < 1e-2).all()


@pytest.mark.slow
def test_what_cannot_be_counted_is_named_with_the_reason(out: Path) -> None:
    (missing,) = json.loads((out / "suite.json").read_text())["not_counted"]
    assert (missing["solver"], missing["sequence"]) == ("osqp", "turn[0:2]")
    assert "P, which changes in" in missing["reason"]


@pytest.mark.slow
def test_a_finished_count_is_not_repeated(out: Path) -> None:
    stored = {path: path.stat().st_mtime_ns for path in (out / "cells").glob("embedded-*")}
    assert len(stored) == 3
    (out / EMBEDDED_FILE).unlink()
    run_campaign(out.parent / "suite.toml", out)
    assert {path: path.stat().st_mtime_ns for path in (out / "cells").glob("embedded-*")} == stored
    assert load_counted_steps_of_folder(out) is not None


@pytest.mark.slow
def test_shards_are_gathered_with_their_counts_and_reasons(out: Path, tmp_path: Path) -> None:
    suite = out.parent / "suite.toml"
    shards = [run_campaign(suite, tmp_path / f"shard{i}", shard=f"{i}/2") for i in (1, 2)]
    joined = join_result_folders(shards, tmp_path / "joined", suite=suite)
    steps, whole = load_counted_steps_of_folder(joined), load_counted_steps_of_folder(out)
    assert steps is not None and whole is not None
    assert steps.equals(whole)
    assert load_counted_steps_of_folder(shards[1]) is None
    found = [json.loads((folder / "suite.json").read_text()) for folder in (joined, out)]
    assert found[0]["not_counted"] == found[1]["not_counted"]


@pytest.mark.slow
def test_a_part_has_the_qps_of_its_steps(out: Path) -> None:
    steps = load_counted_steps_of_folder(out)
    assert steps is not None
    (part,) = pair_sequences_with_cores(table("paper:3:4", solvers=["paper_active_set"]))
    (longer,) = pair_sequences_with_cores(table("paper:0:7", solvers=["paper_active_set"]))
    counted = part.count_instructions()
    np.testing.assert_allclose(counted.z, longer.count_instructions().z[3:], rtol=0, atol=1e-12)
    own = steps[(steps["solver"] == "paper_active_set") & (steps["sequence"] == "paper[3:7]")]
    assert own["instructions"].tolist() == counted.steps["instructions"].tolist()


@pytest.mark.slow
def test_a_damaged_file_is_refused_by_name(out: Path, tmp_path: Path) -> None:
    whole = (out / EMBEDDED_FILE).read_bytes()
    (tmp_path / EMBEDDED_FILE).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ResultsError, match=r"embedded\.parquet"):
        load_counted_steps_of_folder(tmp_path)
    assert load_counted_steps_of_folder(tmp_path / "nowhere") is None
