"""Packed arrays, read by a decoder written from their description; thinning of long runs."""

import base64
import json
import math
import struct
import zlib
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, strategies as st

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_steps import MEASURES, RunSteps, find_hardest_steps
from dpbench.analysis.records.thinned_runs import (
    FORCES,
    TRACK,
    ThinnedRun,
    choose_kept_indices_and_hard_flags,
    find_extreme_indices,
    thin_track,
)
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.verdict import judge_solvers
from dpbench.report.page import data as page_data, pack as packing
from dpbench.report.page.data import PageData
from dpbench.report.page.pack import FLAGS, Block, Room, pack_steps

NUMBERS = st.lists(
    st.one_of(
        st.floats(1e-16, 1e300), st.floats(1e-9, 1e9), st.sampled_from([0.0, math.nan, math.inf])
    ),
    min_size=1,
    max_size=60,
)


def unpacked(text: str) -> tuple[dict[str, Any], list[list[float]]]:
    """The document and its arrays, as the head of `pack.py` describes them."""
    raw = zlib.decompress(base64.b64decode(text))
    (length,) = struct.unpack("<I", raw[:4])
    document = json.loads(raw[4 : 4 + length])
    arrays = [_array(raw[4 + length :], *entry[:4]) for entry in document["arrays"]]
    for i, (kind, _, _, _, *places) in enumerate(document["arrays"]):
        for at in places:
            whole = [0.0 if kind == "flag" else math.nan] * document["arrays"][at][3]
            for place, value in zip(arrays[at], arrays[i], strict=True):
                whole[int(place)] = value
            arrays[i] = whole
    return document, arrays


def _array(raw: bytes, kind: str, start: int, count: int, scale: float) -> list[float]:
    if kind == "flag":
        return [float(byte) for byte in raw[start : start + count]]
    low, high = raw[start : start + count], raw[start + count : start + 2 * count]
    codes, before = [], 0
    for a, b in zip(low, high, strict=True):
        code = a + 256 * b
        if kind != "log":
            code = before = (before + code) % (2**32 if kind == "place" else 65536)
        codes.append(code)
    return [float(c) if kind == "place" else _number(kind, c, scale) for c in codes]


def _number(kind: str, code: int, scale: float) -> float:
    if kind == "log":
        special = {0: math.nan, 1: 0.0, 65535: math.inf}
        return special[code] if code in special else 10.0 ** ((code - 2) / 200 - 16)
    if kind == "count":
        return math.nan if code == 65535 else float(code)
    signed = code - 65536 if code >= 32768 else code
    return math.nan if signed == -32768 else signed * scale


def _one(block: Block) -> list[float]:
    _, (array,) = unpacked(block.compress_to_base64({}))
    return array


@given(NUMBERS)
def test_numbers_over_many_decades_are_told_apart_by_a_percent(values: list[float]) -> None:
    """Half a code is 10^(1/400), 0.58 %; missing, zero and infinite are themselves. The largest
    code but one is 10^(65532/200 − 16), beyond every number."""
    block = Block()
    assert block.add_as_uint16_logs([*values, 1e-20, -1.0]) == 0
    *numbers, smallest, negative = _one(block)
    assert smallest == pytest.approx(1e-16) and math.isnan(negative)
    for value, found in zip(values, numbers, strict=True):
        if value == 0.0 or not math.isfinite(value):
            np.testing.assert_equal(found, value)
        else:
            assert found == pytest.approx(value, rel=10 ** (1 / 400) - 1 + 1e-9)


@given(
    st.lists(st.one_of(st.floats(-1e6, 1e6), st.just(math.nan)), min_size=1, max_size=60),
    st.sampled_from([1e-3, 1e-4, 0.5]),
)
def test_multiples_are_within_half_a_unit_or_cut_off(values: list[float], scale: float) -> None:
    """A value within 32767 units is rounded to the nearest; one beyond stands at the end."""
    block = Block()
    block.add_as_int16_multiples(values, scale)
    for value, found in zip(values, _one(block), strict=True):
        if math.isnan(value):
            assert math.isnan(found)
        else:
            held = max(-32767 * scale, min(32767 * scale, value))
            assert abs(found - held) <= 0.5 * scale * (1 + 1e-9)


@given(
    st.lists(
        st.one_of(st.integers(0, 65534), st.sampled_from([math.nan, -1])), min_size=1, max_size=60
    )
)
def test_counts_are_exact(values: list[float]) -> None:
    block = Block()
    block.add_as_uint16_counts([*values, 70_000.0])
    expected = [math.nan if math.isnan(v) or v < 0 else float(v) for v in values]
    np.testing.assert_equal(_one(block), [*expected, 65534.0])


@given(st.sets(st.integers(0, 300_000), min_size=1, max_size=20))
def test_some_elements_of_a_long_array_stand_in_their_places(places: set[int]) -> None:
    block, rising = Block(), sorted(places)
    length = rising[-1] + 3
    if max(np.diff(rising, prepend=0)) > 65535:
        with pytest.raises(ValueError, match="apart"):
            block.add_rising_indices(rising, length)
        return
    at = block.add_rising_indices(rising, length)
    numbers = (
        block.add_as_uint16_counts(range(len(rising)), at),
        block.add_as_flag_bytes([7] * len(rising), at),
    )
    counts, flags = (unpacked(block.compress_to_base64({}))[1][number] for number in numbers)
    assert len(counts) == len(flags) == length
    assert [counts[place] for place in rising] == [float(i) for i in range(len(rising))]
    assert sum(not math.isnan(count) for count in counts) == len(rising)
    assert sum(flags) == 7 * len(rising)


@given(st.lists(NUMBERS, min_size=1, max_size=5), st.lists(st.integers(0, 255), max_size=20))
def test_arrays_of_a_block_stay_apart(arrays: list[list[float]], flags: list[int]) -> None:
    block = Block()
    numbers = [
        block.add_as_flag_bytes(flags),
        *(block.add_as_uint16_logs(array) for array in arrays),
        block.add_as_uint16_counts([3, 1]),
    ]
    document, found = unpacked(block.compress_to_base64({"output": "µs ≥ 1"}))
    assert numbers == list(range(len(arrays) + 2))
    assert document["output"] == "µs ≥ 1"
    assert found[0] == [float(flag) for flag in flags]
    assert [len(array) for array in found[1:-1]] == [len(array) for array in arrays]
    assert found[-1] == [3.0, 1.0]


def test_a_document_with_a_number_that_json_has_not_is_refused() -> None:
    with pytest.raises(ValueError, match="JSON"):
        Block().compress_to_base64({"x": math.nan})


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
        violation=np.zeros(count),
        n_active=np.zeros(count),
        **flags,
        status=np.full(count, "SOLVED", dtype=object),
        rounds=1,
    )


@pytest.mark.parametrize(
    "lengths", [[100_000] * 10, [1000] * 1000, [500] * 800 + [100_000] * 6, [1] * 3 + [10**6]]
)
def test_a_million_steps_share_the_room(lengths: list[int]) -> None:
    share = Room.from_run_lengths(lengths).steps
    taken = sum(min(length, share) for length in lengths)
    assert packing.MOST_STEPS - len(lengths) <= taken <= packing.MOST_STEPS
    assert Room.from_run_lengths(lengths).points * len(lengths) <= packing.MOST_POINTS


@pytest.mark.parametrize("most", [90, 600, 5000])
def test_a_thinned_run_keeps_its_hardest_and_a_regular_part(most: int) -> None:
    run = _long(20_000)
    failed = [1234, 9877]
    run.claimed[failed] = False
    chosen, extra = choose_kept_indices_and_hard_flags(run, most)
    assert len(chosen) <= most + 1 and np.all(np.diff(chosen) > 0)
    assert len(set(np.diff(chosen[~extra]))) == 1
    for measure in MEASURES:
        assert {*find_hardest_steps(run, measure, 5).tolist()} <= set(chosen.tolist())
    assert {*failed} <= set(chosen.tolist())


def test_left_out_steps_are_missing_in_the_block() -> None:
    run, whole, thin = _long(20_000), Block(), Block()
    of_whole = pack_steps(whole, ThinnedRun.from_run(run, 20_000))
    of_thin = pack_steps(thin, ThinnedRun.from_run(run, 600))
    assert of_whole["first"] == of_thin["first"] == 7
    assert len(thin.compress_to_base64({})) < 0.1 * len(whole.compress_to_base64({}))
    all_steps, some = (
        unpacked(block.compress_to_base64({}))[1][entry["t"]]
        for block, entry in ((whole, of_whole), (thin, of_thin))
    )
    kept_ones = ~np.isnan(some)
    assert len(some) == len(all_steps) and 500 < kept_ones.sum() <= 601
    np.testing.assert_array_equal(np.array(some)[kept_ones], np.array(all_steps)[kept_ones])


def test_a_track_has_no_more_points_than_it_may() -> None:
    names = [*TRACK, *FORCES]
    table = pd.DataFrame({name: np.arange(1001.0) for name in names})
    track = thin_track(table, np.ones(3), 100)
    assert len(track.position) == 91 and track.every == 11
    np.testing.assert_array_equal(track.position[:, 0], np.arange(1001.0)[::11])


def test_extremes_of_a_line_are_drawn() -> None:
    values = np.sin(np.arange(100_000) / 50.0)
    values[[3, 70_001]] = 5.0, -5.0
    places = find_extreme_indices(values, 1000)
    assert len(places) <= 1000 and {3, 70_001} <= set(places.tolist())
    assert len(find_extreme_indices(values[:1000], 1000)) == 1000


def test_the_block_of_many_long_runs_stays_within_its_room(records: Any, monkeypatch: Any) -> None:
    """The budget at a scale of 1 to 1000: a third of what the same runs take whole."""
    for solver in ("daqp", "osqp", "quadprog", "piqp"):
        records.replay(solver, steps=3000, rounds=1, spread=0.3)
    results = records.results()

    def size() -> int:
        view, requirements = Records(results), Requirements.from_suite(results.suite)
        facts = PageData.from_verdicts(view, judge_solvers(view, requirements))
        cells = list(facts.cells())
        assert len(cells) == 4
        return len(facts.block.compress_to_base64({}))

    whole = size()
    monkeypatch.setattr(packing, "MOST_STEPS", 400)
    assert size() < whole / 3


def test_of_many_runs_fewer_hard_steps_are_listed(records: Any, monkeypatch: Any) -> None:
    for solver in ("daqp", "osqp", "quadprog"):
        records.replay(solver, steps=30, rounds=1, spread=0.3)

    def listed(most: int) -> set[int]:
        monkeypatch.setattr(page_data, "MOST_HARD", most)
        view, requirements = records.view(), Requirements.from_suite({})
        facts = PageData.from_verdicts(view, judge_solvers(view, requirements))
        assert all(
            len(rows) == 5 for run in facts.thinned_runs.values() for rows in run.hard.values()
        )
        return {len(rows) for cell in facts.cells() for rows in cell["hard"]}

    assert listed(45) == {5} and listed(20) == {2} and listed(1) == {1}
