"""Late timings beyond what the machine explains, against planted delays."""

from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.analysis.records.run_steps import find_delays, yield_delays_by_run
from dpbench.analysis.verdict.lateness import (
    DOUBTFUL,
    PROVEN,
    LateTimings,
    adjust_p_values,
    estimate_stall_model,
)
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.verdict import judge_solvers

REQUIREMENTS = Requirements()
HONEST = ("quadprog", "piqp", "clarabel", "highs", "ecos")
"""The other solvers of the same rounds."""


def _campaign(records: Any, **delays: dict[tuple[int, int], float]) -> None:
    """Replays of six solvers in five rounds of 1000 steps of 20 µs; `delays` has, by solver, what
    single timings (round, step) take [ms]."""
    for solver in ("daqp", *HONEST):
        records.loop(solver)
        records.replay(solver, rounds=5, median_us=20.0, spread=0.0)
        frame = records._steps[-1]
        late = delays.get(solver, {})
        timings = zip(frame["repeat"], frame["k"], frame["total_ns"], strict=True)
        frame["total_ns"] = [
            round(1e6 * late[r, k]) if (r, k) in late else ns for r, k, ns in timings
        ]


def _verdict(records: Any, solver: str = "daqp") -> Any:
    return judge_solvers(records.view(), REQUIREMENTS).of[solver][0]


def _every(call: int, ms: float, rounds: range = range(1, 6)) -> dict[tuple[int, int], float]:
    """Every so manieth call of the rounds takes so long."""
    calls = [(r, k) for r in rounds for k in range(1000)]
    return {at: ms for i, at in enumerate(calls) if i % call == call - 1}


@pytest.mark.parametrize(
    ("call", "ms", "state", "kind"),
    [
        (3, 10.0, "late", "late timings"),
        (23, 10.0, "late", "late timings"),
        (203, 10.0, "inconclusive", "late at random"),
        (211, 400.0, "late", "past the deadline"),
    ],
)
def test_random_lateness_is_found(
    records: Any, call: int, ms: float, state: str, kind: str
) -> None:
    """The fastest round of every step is 20 µs, so the algorithmic p99 is too.

    One call in 203 is what a p99 allows: it is proven to be no work of the machine, and open.
    """
    _campaign(records, daqp=_every(call, ms))
    verdict = _verdict(records)
    assert verdict.p99_ns < 30e3
    assert verdict.state == state
    assert kind in {finding.kind for finding in (*verdict.causes, *verdict.doubts)}


@pytest.mark.parametrize("call", [23, 203])
def test_the_same_delays_in_all_solvers_are_the_machine(records: Any, call: int) -> None:
    shifted = {
        solver: {(r, (k + 7 * i) % 1000): ms for (r, k), ms in _every(call, 10.0).items()}
        for i, solver in enumerate(("daqp", *HONEST))
    }
    _campaign(records, **shifted)
    found = {
        finding.kind
        for v in judge_solvers(records.view(), REQUIREMENTS).all_verdicts
        for finding in v.doubts
    }
    assert "late at random" not in found


def test_a_second_liar_hides_nobody(records: Any) -> None:
    _campaign(records, daqp=_every(23, 10.0), piqp=_every(23, 10.0))
    assert _verdict(records).state == _verdict(records, "piqp").state == "late"
    assert _verdict(records, "ecos").state == "pass"


def test_delays_of_two_rounds_by_hand() -> None:
    """Steps of 10, 20 and 30 ns; the second round has one at 45 of 20 ns."""
    repeat, k = np.array([1, 1, 1, 2, 2, 2]), np.array([0, 1, 2, 0, 1, 2])
    times = np.array([10.0, 20.0, 30.0, 20.0, 45.0, 31.0])
    delays = find_delays(repeat, k, times, np.full(6, np.nan))
    assert delays.base_ns.tolist() == [60.0, 60.0]
    assert delays.delay_ns.tolist() == [45.0] and delays.own_ns.tolist() == [20.0]
    assert delays.count_late_by_repetition(44.0).tolist() == [0, 1]
    assert delays.count_late_by_repetition(45.0).tolist() == [0, 0]
    assert delays.count_stalls_by_repetition(24.0).tolist() == [0, 1]
    assert delays.count_stalls_by_repetition(25.0).tolist() == [0, 0]


def test_delays_of_a_loop_are_its_timings_above_the_median() -> None:
    """One round has no fastest time of a step; a step without a computation has none at all."""
    times = np.array([1.0, 2.0, 3.0, 9.0, np.nan])
    delays = find_delays(np.zeros(5, np.int64), np.arange(5), times, np.full(5, np.nan))
    assert (delays.step_ns, delays.samples.tolist()) == (2.5, [4])
    assert delays.delay_ns.tolist() == [3.0, 9.0]


def _waiting(records: Any, solver: str, waited_ns: float, **columns: Any) -> None:
    """A replay with four timings of 10 ms a round, in which it waited for the core for so long.

    They are of other steps in each round, and no other step waited.
    """
    records.replay(solver, rounds=5, median_us=20.0, spread=0.0, **columns)
    frame = records._steps[-1]
    late = (frame["k"] - frame["repeat"]).isin([100, 300, 500, 700])
    frame.loc[late, "total_ns"] = 10_000_000
    frame["waited_ns"] = np.where(late, waited_ns, 0)


@pytest.mark.parametrize(
    ("waited_ns", "state"),
    [(9_650_000, "pass"), (7_000_000, "pass"), (6_999_999, "inconclusive"), (0, "inconclusive")],
)
def test_a_wait_for_the_core_is_the_machine(records: Any, waited_ns: float, state: str) -> None:
    """Others waited as long and as often, so that the gross timings would contradict nobody.

    A solver that took the core for more than the limit of 3 ms was late by itself.
    """
    for solver in ("daqp", *HONEST):
        records.loop(solver)
        _waiting(records, solver, waited_ns if solver == "daqp" else 9_980_000)
    assert _verdict(records).state == state
    assert _verdict(records, "ecos").state == "pass"


@pytest.mark.parametrize(("waited_ns", "state"), [(12_000_000, "inconclusive"), (0, "late")])
def test_two_rounds_on_a_busy_machine(records: Any, waited_ns: float, state: str) -> None:
    """Both timings of 40 steps took 13.9 ms: by waits a quick solver is not late, nor does it pass.

    The limit is 3 ms; a slow solver without waits remains late.
    """
    for solver in ("daqp", *HONEST):
        records.loop(solver)
        records.replay(solver, rounds=2, median_us=20.0, spread=0.0, involuntary_switches=900)
        frame = records._steps[-1]
        if solver == "daqp":
            frame.loc[frame["k"] < 40, "total_ns"] = 13_900_000
        frame["waited_ns"] = np.where(frame["total_ns"] == 13_900_000, waited_ns, 0)
    assert _verdict(records).state == state
    assert _verdict(records, "ecos").state == "pass"


@pytest.mark.parametrize(("switches", "state"), [(2499, "inconclusive"), (2500, "pass")])
def test_waits_of_threads_are_unknown(records: Any, switches: int, state: str) -> None:
    """A solver that waits in half of its 5000 calls waits for threads, whose wait for the core is
    not in its own: its timings are compared as they are."""
    for solver in ("daqp", *HONEST):
        records.loop(solver)
        waited_ns = 0 if solver == "daqp" else 9_980_000
        own = {"voluntary_switches": switches} if solver == "daqp" else {}
        _waiting(records, solver, waited_ns, **own)
    assert _verdict(records).state == state


def test_the_share_of_late_timings_is_without_waits(records: Any) -> None:
    """100 timings of a round of 1000 take 10 ms; 70 of them waited for 9.5 ms, 30 did not wait."""
    for solver in ("daqp", *HONEST):
        records.loop(solver)
        records.replay(solver, rounds=5, median_us=20.0, spread=0.0)
        frame = records._steps[-1]
        place = frame["k"] - 150 * frame["repeat"]
        frame.loc[place.between(0, 99), "total_ns"] = 10_000_000
        idle = place.between(0, 69 if solver == "daqp" else 99)
        frame["waited_ns"] = np.where(idle, 9_500_000, 0)
    verdict = _verdict(records)
    finding = next(one for one in verdict.causes if one.kind == "late timings")
    assert verdict.state == "late" and _verdict(records, "ecos").state == "pass"
    assert finding.value == pytest.approx(0.03)
    assert finding.machine < 0.001


@pytest.mark.parametrize(("waited_ns", "state"), [(9_980_000, "pass"), (0, "late")])
def test_a_loop_is_late_beyond_its_waits(records: Any, waited_ns: float, state: str) -> None:
    """47 of 450 timings; where waits are known, context switches explain nothing beyond them."""
    records.loop("daqp", steps=450, raw_p50_ns=20e3, involuntary_switches=100)
    frame = records._steps[-1]
    frame.loc[:46, "total_ns"] = 10_000_000
    frame["waited_ns"] = np.where(np.arange(450) < 47, waited_ns, 0)
    records.replay("daqp", median_us=20.0)
    assert _verdict(records).state == state


def test_delays_know_waits_where_all_are_recorded() -> None:
    """Two rounds of two steps of 10 and 20 ns; the timing of 50 ns waited for 35 ns."""
    steps = pd.DataFrame(
        {
            "run_id": ["a"] * 4 + ["b"] * 4,
            "repeat": [1, 1, 2, 2] * 2,
            "k": [0, 1, 0, 1] * 2,
            "counts": True,
            "total_ns": pd.array([10, 20, 10, 50] * 2, dtype="Int64"),
            "waited_ns": pd.array([0, 0, 0, 35, 0, 0, None, 35], dtype="Int64"),
        }
    )
    delays = dict(yield_delays_by_run(steps))
    assert [one.has_waits for one in delays.values()] == [True, False]
    assert [one.delay_ns.tolist() for one in delays.values()] == [[50.0], [50.0]]
    assert [one.net_ns.tolist() for one in delays.values()] == [[15.0], [50.0]]
    assert delays["a"].without_waits.net_ns.tolist() == [50.0]
    assert delays["a"].base_ns.tolist() == [30.0, 30.0]


@pytest.mark.parametrize(
    ("waited_ns", "late", "stalls"),
    [
        (0.0, 1, 1),
        (10.0, 1, 1),  # 111 of 121 ns are left
        (21.0, 0, 1),  # 100 ns, 90 more than usual
        (60.0, 0, 1),
        (61.0, 0, 0),
    ],
)
def test_a_delay_is_late_without_its_wait(waited_ns: float, late: int, stalls: int) -> None:
    """A step of 10 ns that took 121 ns, beyond a limit of 100 ns, and half of it."""
    repeat, k = np.array([1, 2]), np.array([0, 0])
    delays = find_delays(repeat, k, np.array([10.0, 121.0]), np.array([0.0, waited_ns]))
    assert delays.count_late_by_repetition(100.0).tolist() == [0, late]
    assert delays.count_late_by_repetition(121.0).tolist() == [0, 0]
    assert delays.count_stalls_by_repetition(50.0).tolist() == [0, stalls]
    assert delays.without_waits.count_late_by_repetition(100.0).tolist() == [0, 1]


def test_a_hard_step_is_late_by_itself() -> None:
    """In a loop whose median is near the limit, a step little beyond it is late all the same."""
    times = np.array([99.0, 99.0, 99.0, 102.0])
    delays = find_delays(np.zeros(4, np.int64), np.arange(4), times, np.array([0.0, 0, 0, 1.0]))
    assert delays.count_late_by_repetition(100.0).tolist() == [1]
    assert delays.count_late_by_repetition(101.0).tolist() == [0]


def test_uneven_rounds_make_a_small_shape() -> None:
    """Ten rounds of equal exposure: one stall in each, or all ten in one of them."""
    exposed = np.full(10, 1e9)
    even, uneven = np.ones(10), np.array([10.0, *np.zeros(9)])
    machines = estimate_stall_model(even, exposed), estimate_stall_model(uneven, exposed)
    assert machines[0].rate == machines[1].rate == pytest.approx(1.05e-9)
    assert machines[0].shape == 50.0 and machines[1].shape == 0.5


def test_p_values_are_adjusted_together(records: Any) -> None:
    """Holm: the smallest of three is tripled, the next doubled."""
    records.replay("daqp")
    (run,) = records.view().runs
    tests = [LateTimings("late timings", run, 1, 10, 0.0, p) for p in (0.02, 3e-4, 0.9)]
    first, second, _ = adjusted = adjust_p_values(tests)
    assert [test.p for test in adjusted] == pytest.approx([0.04, 9e-4, 0.9])
    assert second.p <= PROVEN < first.p <= DOUBTFUL
    assert second.is_proven_late and not first.is_proven_late
