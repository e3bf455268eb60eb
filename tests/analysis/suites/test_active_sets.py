"""The active sets that QPs visit."""

import numpy as np
import pytest

from dpbench.analysis.suites.active_sets import (
    SavedWork,
    count_saved_work,
    count_visited_sets,
    count_visited_sets_of,
)
from dpbench.cli.main import main
from dpbench.embedded.toolchain import has_extra
from dpbench.errors import InputError
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.referee.optimum import Optimum
from dpbench.report.active_sets_text import make_table_of_saved_work
from dpbench.solvers.open import open_workspace
from dpbench.solvers.own.active_set_memory import ActiveSetMemoryWorkspace


def make_optimum(*multipliers: float, bound: float = 0.0) -> Optimum:
    """An optimum of one variable and one row."""
    box, row = multipliers
    return Optimum(np.zeros(1), np.array([row]), np.array([box]), bound=bound, kind="linear")


def test_good_and_turing_by_hand() -> None:
    """Sets none (3 times), box up (2), box down (1), both (1): F₁ = 2, F₂ = 1 of K = 7.

    The error is √(2 (1 − 2/7) + 2) / 7 = √(24/7) / 7. Laws take 8 k (2 n + k) + 4 k bytes: for two
    sets of one limit 28 each, for one of two 72.
    """
    optima = [make_optimum(0, 0)] * 3 + [make_optimum(1, 0)] * 2
    optima += [make_optimum(-1, 1e-12), make_optimum(2, 1), make_optimum(9, 9, bound=np.inf)]
    visited = count_visited_sets("hand", 1, optima)
    assert (visited.steps, visited.sets, visited.once, visited.twice) == (7, 4, 2, 1)
    assert visited.unseen_mass == pytest.approx(2 / 7)
    assert visited.unseen_error == pytest.approx(np.sqrt(24 / 7) / 7)
    assert visited.most_active == 2
    assert visited.table_bytes == 28 + 28 + 72


def test_a_stored_sequence_is_counted_and_printed(capsys: pytest.CaptureFixture[str]) -> None:
    """Sets, and the share that was not seen, on one line."""
    visited = count_visited_sets_of("paper-30-5")
    assert 1 < visited.sets <= visited.steps == 75
    assert main(["active-sets", "paper-30-5"]) == 0
    assert str(visited.sets) in capsys.readouterr().out


def test_changing_matrices_are_refused() -> None:
    """One law holds for one P."""
    with pytest.raises(InputError, match="constant matrices"):
        count_visited_sets_of("turn-30-5")


def test_multiply_adds_of_laws_by_hand() -> None:
    """n = 2, m = 1, one active limit: 4 for the base, 1·(2 + 1) and 2·1 for the law, 1·2 for A."""
    qp = QuadraticProgram(
        np.eye(2), [-3.0, 0.0], [[1.0, 1.0]], [-9.0], [9.0], [-1.0, -1.0], [1.0, 1.0]
    )
    workspace = open_workspace("active_set_memory", policy="warm")
    assert isinstance(workspace, ActiveSetMemoryWorkspace)
    workspace.setup(qp)
    counted = []
    for _ in range(2):
        workspace.update(QPStep(qp.q, qp.l, qp.u))
        workspace.solve()
        counted.append((workspace.hits, workspace.multiply_adds))
    assert counted == [(0, 4), (1, 4 + 3 + 2 + 2)]


def test_a_step_without_a_law_takes_the_method_too() -> None:
    """The multiply-adds alone remain of the step that a law answers."""
    saved = SavedWork(
        "hand", np.array([True, False]), np.array([900.0, 500.0]), np.array([90.0, 50.0])
    )
    assert saved.least_instructions.tolist() == [90.0, 550.0]
    (row,) = make_table_of_saved_work([saved]).rows
    assert row[:4] == ("hand", "1 of 2", "900 and 900", "90 and 90")


@pytest.mark.slow
@pytest.mark.skipif(not has_extra(), reason="the extra embedded is not installed")
def test_stored_laws_save_nothing_at_the_p99_of_the_paper() -> None:
    """Hard steps have new sets: there the tried laws come on top of the method."""
    saved = count_saved_work("paper-30-5")
    assert saved.answered.sum() > 50 and not saved.answered[0]
    hardest = saved.instructions.argmax()
    assert not saved.answered[hardest]
    assert saved.least_instructions.max() >= saved.instructions.max()
    assert np.median(saved.least_instructions) < np.median(saved.instructions)
