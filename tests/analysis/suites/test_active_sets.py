"""The active sets that QPs visit."""

import numpy as np
import pytest

from dpbench.analysis.suites.active_sets import count_visited_sets, count_visited_sets_of
from dpbench.cli.main import main
from dpbench.errors import InputError
from dpbench.qp.referee.optimum import Optimum


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
