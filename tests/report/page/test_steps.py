"""How much of a long run the page keeps, and that what it keeps is right."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.analysis.records.kept_runs import (
    FORCES,
    TRACK,
    KeptRun,
    extremes,
    thinned_indices,
    track_of,
)
from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_steps import MEASURES, RunSteps, hardest
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.verdict import verdicts_of
from dpbench.report.page import data as page_data
from dpbench.report.page import pack as packing
from dpbench.report.page.data import PageData
from dpbench.report.page.pack import FLAGS, Block, Room, pack_steps
from tests.report.page.test_pack import unpacked


def _long(count: int, seed: int = 1) -> RunSteps:
    """A run of `count` steps with a few slow, wrong and hard ones at random."""
    rng = np.random.default_rng(seed)
    flags = dict.fromkeys(("claimed", "true", *FLAGS[2:]), np.ones(count, dtype=bool))
    return RunSteps(
        k=np.arange(count) + 7,
        time_ns=rng.lognormal(9.0, 0.5, count),
        raw_ns=rng.lognormal(10.0, 0.5, count),
        error=rng.lognormal(-20.0, 2.0, count),
        iterations=rng.integers(1, 30, count).astype(float),
        n_active=np.zeros(count),
        **flags,
        status=np.full(count, "SOLVED", dtype=object),
        rounds=1,
    )


def test_what_fits_stays_whole() -> None:
    lengths = [667] * 500
    assert sum(lengths) <= packing.MOST_STEPS and Room.of(lengths).steps >= 667
    chosen, extra = thinned_indices(_long(667), Room.of(lengths).steps)
    assert len(chosen) == 667 and not extra.any()


@pytest.mark.parametrize(
    "lengths", [[100_000] * 10, [1000] * 1000, [500] * 800 + [100_000] * 6, [1] * 3 + [10**6]]
)
def test_a_million_steps_share_the_room(lengths: list[int]) -> None:
    share = Room.of(lengths).steps
    taken = sum(min(length, share) for length in lengths)
    assert packing.MOST_STEPS - len(lengths) <= taken <= packing.MOST_STEPS
    assert Room.of(lengths).points * len(lengths) <= packing.MOST_POINTS


@pytest.mark.parametrize("most", [90, 600, 5000])
def test_a_thinned_run_keeps_its_hardest_and_a_regular_part(most: int) -> None:
    run = _long(20_000)
    chosen, extra = thinned_indices(run, most)
    assert len(chosen) <= most + 1 and np.all(np.diff(chosen) > 0)
    assert len(set(np.diff(chosen[~extra]))) == 1
    for measure in MEASURES:
        assert {hard.at for hard in hardest(run, measure, 5)} <= set(chosen.tolist())


def test_left_out_steps_are_missing_in_the_block() -> None:
    run, whole, thin = _long(20_000), Block(), Block()
    of_whole = pack_steps(whole, KeptRun.of(run, 20_000))
    of_thin = pack_steps(thin, KeptRun.of(run, 600))
    assert of_whole["first"] == of_thin["first"] == 7
    assert len(thin.text({})) < 0.1 * len(whole.text({}))
    all_steps, some = (
        unpacked(block.text({}))[1][entry["t"]]
        for block, entry in ((whole, of_whole), (thin, of_thin))
    )
    kept_ones = ~np.isnan(some)
    assert len(some) == len(all_steps) and 500 < kept_ones.sum() <= 601
    np.testing.assert_array_equal(np.array(some)[kept_ones], np.array(all_steps)[kept_ones])


def test_a_track_has_no_more_points_than_it_may() -> None:
    names = [*TRACK, *FORCES]
    table = pd.DataFrame({name: np.arange(1001.0) for name in names})
    track = track_of(table, np.ones(3), 100)
    assert len(track.position) == 91 and track.every == 11
    np.testing.assert_array_equal(track.position[:, 0], np.arange(1001.0)[::11])


def test_extremes_of_a_line_are_drawn() -> None:
    values = np.sin(np.arange(100_000) / 50.0)
    values[[3, 70_001]] = 5.0, -5.0
    places = extremes(values, 1000)
    assert len(places) <= 1000 and {3, 70_001} <= set(places.tolist())
    assert len(extremes(values[:1000], 1000)) == 1000


def test_the_block_of_many_long_runs_stays_within_its_room(
    records: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The budget at a scale of 1 to 1000: a third of what the same runs take whole."""
    for solver in ("daqp", "osqp", "quadprog", "piqp"):
        records.replay(solver, steps=3000, rounds=1, spread=0.3)
    results = records.results()

    def size() -> int:
        view, requirements = Records(results), Requirements.of(results.suite)
        facts = PageData.of(view, verdicts_of(view, requirements))
        cells = list(facts.cells())
        assert len(cells) == 4
        return len(facts.block.text({}))

    whole = size()
    monkeypatch.setattr(packing, "MOST_STEPS", 400)
    assert size() < whole / 3


def test_of_many_runs_fewer_hard_steps_are_listed(
    records: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    for solver in ("daqp", "osqp", "quadprog"):
        records.replay(solver, steps=30, rounds=1, spread=0.3)

    def listed(most: int) -> set[int]:
        monkeypatch.setattr(page_data, "MOST_HARD", most)
        view, requirements = records.view(), Requirements.of({})
        facts = PageData.of(view, verdicts_of(view, requirements))
        assert all(len(rows) == 5 for run in facts.kept.values() for rows in run.hard.values())
        return {len(rows) for cell in facts.cells() for rows in cell["hard"]}

    assert listed(45) == {5} and listed(20) == {2} and listed(1) == {1}
