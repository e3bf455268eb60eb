"""Training and test have no QP and no loop in common."""

from pathlib import Path

import pytest

from dpbench import load_sequence
from dpbench.bench.sequences.sequence_file import save_sequence
from dpbench.errors import InputError, UnknownNameError
from dpbench.tuning.campaigns import load_tuned_problem, refuse_training_qps_in_test


@pytest.mark.parametrize(
    ("training", "test", "why"),
    [
        ("paper-60-10", "paper-60-10", "QPs of the same closed loop as paper-60-10"),
        ("paper-60-10", "paper-30-5", "QPs of the same closed loop as paper-60-10"),
        ("paper", "paper-30-5", "QPs of the same closed loop as paper in"),
        ("paper", "paper", "QPs of the same closed loop as paper in"),
    ],
)
def test_what_overlaps_is_refused(training: str, test: str, why: str) -> None:
    """Other horizons along one loop are other QPs, but of the same states and references."""
    with pytest.raises(InputError, match=rf"--test: .* has {why}"):
        refuse_training_qps_in_test(
            [load_tuned_problem("calm"), load_tuned_problem(training)], [load_tuned_problem(test)]
        )


def test_sequences_of_other_scenarios_do_not_overlap() -> None:
    refuse_training_qps_in_test(
        [load_tuned_problem("paper-60-10"), load_tuned_problem("rough")],
        [load_tuned_problem("squall-60-10"), load_tuned_problem("move")],
    )


def test_a_file_without_a_scenario_is_compared_by_its_qps(tmp_path: Path) -> None:
    """A shorter file of another name has QPs of the longer one."""
    path = tmp_path / "mine.npz"
    save_sequence(path, load_sequence("calm-30-5"), documents={})
    mine = load_tuned_problem(str(path))
    assert mine.loop == ""
    with pytest.raises(InputError, match="has the same QPs as calm-30-5"):
        refuse_training_qps_in_test([load_tuned_problem("calm-30-5")], [mine])
    refuse_training_qps_in_test([load_tuned_problem("move-30-5")], [mine])


def test_a_problem_is_a_table_of_a_suite(tmp_path: Path) -> None:
    """Files are named by an absolute path, since the suite is written to another folder."""
    assert load_tuned_problem("calm-30-5").table == {"kind": "recorded", "sequence": "calm-30-5"}
    assert load_tuned_problem("paper", steps=7).table == {
        "kind": "replay",
        "scenario": "paper",
        "steps": 7,
    }
    path = tmp_path / "mine.npz"
    save_sequence(path, load_sequence("calm-30-5"))
    assert load_tuned_problem(str(path)).table["sequence"] == str(path.resolve())


def test_an_unknown_name_is_refused() -> None:
    with pytest.raises(
        UnknownNameError, match="scenario or sequence name: found 'papre'; allowed: paper"
    ):
        load_tuned_problem("papre")
