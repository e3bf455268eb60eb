"""The search on functions with a known best point."""

import math
from collections.abc import Sequence

import pytest

from dpbench.solvers.contract import Options
from dpbench.tuning.search import BATCH, OptionRange, Score, SearchSpace, SettingsSearch

SPACE = SearchSpace((OptionRange("a", 1e-3, 1e3), OptionRange("b", 0.0, 1.0)))


def _time(options: Options) -> float:
    """1 at a = 10 and b = 0.7, and more elsewhere."""
    a, b = float(str(options["a"])), float(str(options["b"]))
    return 1.0 + math.log10(a / 10.0) ** 2 + (b - 0.7) ** 2


def _evaluate(settings: Sequence[Options]) -> list[Score]:
    """Inaccurate above a = 100, the more the larger."""
    scores = []
    for options in settings:
        excess = max(0.0, math.log10(float(str(options["a"])) / 100.0))
        scores.append(Score(int(excess > 0.0), excess, _time(options) if not excess else math.nan))
    return scores


def test_the_batches_near_the_best_improve_it() -> None:
    search = SettingsSearch(SPACE, _evaluate, seed=1)
    search.run(8 * BATCH)
    spread = search.trials[: 4 * BATCH]
    assert search.best.score.is_right
    assert search.best not in spread
    assert search.best.score.ratio < 1.02
    assert len({trial.name for trial in search.trials}) == len(search.trials) <= 8 * BATCH


def test_the_same_seed_tries_the_same_settings() -> None:
    """So that a search that was interrupted finds its finished runs again."""
    trials = []
    for seed in (3, 3, 4):
        search = SettingsSearch(SPACE, _evaluate, seed)
        search.run(2 * BATCH)
        trials.append([trial.name for trial in search.trials])
    assert trials[0] == trials[1] != trials[2]


@pytest.mark.parametrize("trials", [1, 2, 3, 8, 11, 20])
def test_as_many_settings_are_tried_as_asked(trials: int) -> None:
    """In batches of at most 8; from two trials on some are near the best."""
    batches: list[int] = []

    def evaluate(settings: Sequence[Options]) -> list[Score]:
        batches.append(len(settings))
        return _evaluate(settings)

    SettingsSearch(SPACE, evaluate, seed=1).run(trials)
    assert sum(batches) == trials and max(batches) <= BATCH
    assert len(batches) >= min(2, trials)


def test_accuracy_comes_before_time() -> None:
    """Inaccurate settings rank by their distance from the requirement; a run without a time comes
    last."""
    first_to_last = [
        Score(0, 0.0, 0.5),
        Score(0, 0.0, 2.0),
        Score(0, 0.0, math.nan),
        Score(1, 0.1, math.nan),
        Score(1, 3.0, math.nan),
        Score(2, 0.1, math.nan),
    ]
    last_to_first = first_to_last[::-1]
    assert sorted(last_to_first, key=lambda score: score.key) == first_to_last


def test_the_search_tries_the_start_first() -> None:
    """As it is given, also between the points of the ranges, and goes on near it."""
    start = {"a": 10.001, "b": 0.7}
    search = SettingsSearch(SPACE, _evaluate, seed=1)
    search.run(2 * BATCH, start)
    assert search.trials[0].options == start
    assert search.best.score.ratio < 1.0001
    near = [trial.point for trial in search.trials[-BATCH:]]
    assert all(abs(point - search.trials[0].point).max() <= 0.25 for point in near)
