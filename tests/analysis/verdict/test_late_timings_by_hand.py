"""P-values of late timings worked by hand: stalls of the machine, loops, replays, the deadline."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench.analysis.verdict.lateness import (
    LateTimings,
    StallModel,
    Uncertainty,
    choose_runs_that_show_stalls,
    estimate_stall_model,
    find_late_timings,
)
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.time_findings import convert_late_timings_to_findings
from dpbench.solvers.calibration import COPY_ONLY

REQUIREMENTS = Requirements(p99_ms=3.0, deadline_ms=300.0)
UNCERTAINTY = Uncertainty({}, {}, {}, 2.0)
"""A loop is late from 6 ms on."""
BASE_NS = 20_000


def _found(records: Any) -> dict[str, list[LateTimings]]:
    """The late timings by solver."""
    view = records.view()
    by_run = find_late_timings(view, REQUIREMENTS, UNCERTAINTY)
    solvers = {run.run_id: run.solver for run in view.runs}
    return {solvers[run_id]: found for run_id, found in by_run.items()}


def _loop(records: Any, steps: int, slow_ns: dict[int, float], **columns: Any) -> None:
    """A loop of 20 µs a step but for some slow ones."""
    records.loop("daqp", steps=steps, **columns)
    times = np.full(steps, BASE_NS)
    for k, ns in slow_ns.items():
        times[k] = ns
    records._steps[-1]["total_ns"] = times


def _replay(
    records: Any, solver: str, late: dict[int, int], ns: int = 10_000_000, rounds: int = 4
) -> None:
    """A replay of 1000 steps of 20 µs in four rounds, with so many late timings in some rounds.

    A round has a base time of 20 ms, all four have 80 ms.
    """
    native = {"route": "native", "policy": "reuse"} if solver == COPY_ONLY else {}
    records.replay(solver, rounds=rounds, median_us=BASE_NS / 1e3, spread=0.0, **native)
    frame = records._steps[-1]
    for r, count in late.items():
        frame.loc[(frame["repeat"] == r) & (frame["k"] < count), "total_ns"] = ns


@pytest.mark.parametrize(
    ("count", "allowed", "below"),
    [
        (-1, 0, 0.0),
        (0, 0, 0.0),
        (1, 0, 0.25),
        (2, 0, 0.5),
        (3, 0, 0.6875),
        (0, 2, 0.0),
        (1, 1, 0.25 * 0.99),
        (1, 2, 0.25 * 0.9801),
        (2, 2, 0.25 * (0.9801 + 0.9801 + 0.0198)),
        (3, 2, 0.1875 * 0.9801 + 0.25 * (0.9801 + 0.0198 + 0.9801 + 0.0198 + 0.0001)),
    ],
)
def test_the_tail_of_the_stalls(count: int, allowed: int, below: float) -> None:
    """A mean of 2 and a shape of 2 give 1/4, 1/4, 3/16 for 0, 1 and 2 stalls.

    The allowed timings are late with 1 %: of two, 0, 1 and 2 with 0.9801, 0.0198 and 0.0001.
    """
    machine = StallModel(rate=1e-3, shape=2.0)
    assert machine.compute_tail_probability(count, 2000.0, allowed) == pytest.approx(
        1.0 - below, rel=1e-9
    )


def test_a_machine_of_two_rounds() -> None:
    """Nine stalls in 4 ns and none in 2 ns: the rate is 9.5 / 6, the means are 19/3 and 19/6.

    The moments give (361/9 + 361/36) / (64/9 - 9 + 361/36) = 1805/293.
    """
    machine = estimate_stall_model(np.array([9.0, 0.0]), np.array([4.0, 2.0]))
    assert machine.rate == pytest.approx(19 / 12)
    assert machine.shape == pytest.approx(1805 / 293)


def test_a_machine_more_even_than_chance() -> None:
    """One stall in two equal rounds has a rate of 0.75 and moments of -15/16 + 9/16 < 0."""
    machine = estimate_stall_model(np.array([1.0, 0.0]), np.array([1.0, 1.0]))
    assert (machine.rate, machine.shape) == (0.75, 50.0)


class _Stalls:
    """Delays with these stalls in each round."""

    def __init__(self, *counts: int) -> None:
        self.counts = np.array(counts)

    def count_stalls_by_repetition(self, longer_than_ns: float) -> Any:
        """Return the counts; the limit is half that of the p99."""
        assert longer_than_ns == 1.5e6
        return self.counts


@pytest.mark.parametrize(
    ("solvers", "expected"),
    [("", ""), ("a", "aa"), ("ab", "b"), ("abc", "b"), ("abcd", "bd"), ("abcde", "bd")],
)
def test_the_half_of_the_solvers_with_fewer_stalls_is_trusted(solvers: str, expected: str) -> None:
    """The stalls of a solver are those of all its replays and rounds: 6, 1, 4, 3 and 9."""
    stalls: Any = {
        "a1": _Stalls(2, 3),
        "a2": _Stalls(1, 0),
        "b1": _Stalls(0, 1),
        "c1": _Stalls(2, 2),
        "d1": _Stalls(1, 2),
        "e1": _Stalls(9, 0),
    }
    replays: list[Any] = [
        SimpleNamespace(run_id=name, solver=name[0]) for name in stalls if name[0] in solvers
    ]
    assert (
        "".join(
            run.solver for run in choose_runs_that_show_stalls(replays, [], stalls, REQUIREMENTS)
        )
        == expected
    )
    arm: Any = SimpleNamespace(run_id="arm", solver="arm")
    assert choose_runs_that_show_stalls(replays, [arm], stalls, REQUIREMENTS) == [arm]


def test_a_loop_against_one_late_timing_in_a_hundred(records: Any) -> None:
    """Three of 14 late timings are explained: at least 11 of 450 have a share of 0.6 %."""
    slow = dict.fromkeys(range(14), 6_000_001.0) | {100 + k: 6_000_000.0 for k in range(30)}
    _loop(records, 450, slow, involuntary_switches=3)
    (found,) = _found(records)["daqp"]
    fewer = sum(math.comb(450, n) * 0.01**n * 0.99 ** (450 - n) for n in range(11))
    assert (found.kind, found.late, found.samples) == ("late timings", 14, 450)
    assert found.machine == 3 / 450 and found.late_share == 14 / 450
    assert found.p == pytest.approx(1.0 - fewer, rel=1e-6)
    assert not found.is_proven_late


def test_switches_outside_of_the_timed_calls_explain_nothing(records: Any) -> None:
    """Timed calls are 9 ms of 0.36 s, a share of 1/40: of 50 switches at most 4/40 hit them.

    Five with three standard deviations are 5 + 3·sqrt(5) = 11.7, so that 12 of 23 are explained.
    """
    slow = dict.fromkeys(range(23), 7e6)
    _loop(records, 450, slow, involuntary_switches=50, replay_s=0.36)
    (found,) = _found(records)["daqp"]
    fewer = sum(math.comb(450, n) * 0.01**n * 0.99 ** (450 - n) for n in range(11))
    assert found.machine == 12 / 450
    assert found.p == pytest.approx(1.0 - fewer, rel=1e-6)


@pytest.mark.parametrize(
    ("switches", "replay_s", "proven"),
    [(50, 0.36, False), (51, 5.0, False), (50, 5.0, True), (4, 0.36, True)],
)
def test_a_disturbed_loop_proves_nothing(
    records: Any, switches: int, replay_s: float, proven: bool
) -> None:
    """139 switches a second of another program; not ten a second, nor four of 450 timings."""
    slow = dict.fromkeys(range(200), 7e6)
    _loop(records, 450, slow, involuntary_switches=switches, replay_s=replay_s)
    (found,) = _found(records)["daqp"]
    assert found.p < 0.001 and found.is_proven_late == proven
    (finding,) = convert_late_timings_to_findings([found.run], {found.run.run_id: [found]})
    assert finding.kind == ("late timings" if proven else "late when disturbed")


@pytest.mark.parametrize(("iterations", "proven"), [(3100, True), (2900, False)])
def test_iterations_prove_a_disturbed_loop_late(
    records: Any, iterations: int, proven: bool
) -> None:
    """At 2 µs each, as 20 µs for one and nine, 3100 iterations take 6.2 ms, above the 6 ms."""
    slow = dict.fromkeys(range(200), 7e6)
    _loop(records, 450, slow, involuntary_switches=50, replay_s=0.36)
    frame = records._steps[-1]
    frame["iterations"] = np.where(frame["total_ns"] > BASE_NS, iterations, 9)
    (found,) = _found(records)["daqp"]
    assert found.is_proven_late == proven


@pytest.mark.parametrize(("switches", "p"), [(0, 1.0 - 0.99**3), (1, None), (2, None)])
def test_a_single_late_timing_of_a_short_loop(records: Any, switches: int, p: float | None) -> None:
    _loop(records, 3, {1: 7e6}, involuntary_switches=switches)
    found = [late.p for late in _found(records).get("daqp", [])]
    assert found == ([] if p is None else [pytest.approx(p)])


@pytest.mark.parametrize(("middle_ns", "count"), [(6_000_000.0, 1), (6_000_001.0, 0)])
def test_a_loop_late_in_the_median_is_untested(records: Any, middle_ns: float, count: int) -> None:
    """225 of 451 timings are late; beyond the limit the median is a cause of its own."""
    slow = dict.fromkeys(range(225), 7e6) | {225: middle_ns}
    _loop(records, 451, slow, involuntary_switches=0)
    assert len(_found(records).get("daqp", [])) == count


@pytest.mark.parametrize(("late", "doubtful"), [(40, True), (4, False)])
def test_hidden_switches_doubt_more_than_a_p99_allows(
    records: Any, late: int, doubtful: bool
) -> None:
    """Without a count of context switches the p-value is at the limit of a doubt; 4 are allowed."""
    _loop(records, 450, dict.fromkeys(range(late), 7e6))
    found = _found(records).get("daqp", [])
    assert [(one.p, math.isnan(one.machine)) for one in found] == [(0.05, True)] * doubtful


def test_runs_that_are_not_tested(records: Any) -> None:
    slow = dict.fromkeys(range(40), 7e6)
    for columns in ({"units": "si"}, {"slowdown": 0.5}, {"formulation": "none"}):
        _loop(records, 450, slow, involuntary_switches=0, **columns)
    assert _found(records) == {}
    _loop(records, 450, slow, involuntary_switches=0, slowdown=0.0)
    assert list(_found(records)) == ["daqp"]


def test_a_replay_of_one_round_is_tested_like_a_loop(records: Any) -> None:
    """40 of 1000 timings exceed 6 ms, where ten are allowed."""
    records.replay("daqp", rounds=1, median_us=20.0, spread=0.0, involuntary_switches=0)
    frame = records._steps[-1]
    frame.loc[frame["counts"] & (frame["k"] < 40), "total_ns"] = 6_000_001
    (found,) = _found(records)["daqp"]
    assert (found.kind, found.late, found.samples, found.machine) == ("late timings", 40, 1000, 0)
    assert found.is_proven_late


@pytest.mark.parametrize(
    ("late", "found"),
    [
        ({2: 11, 3: 11, 4: 11}, True),
        ({3: 11, 4: 11}, False),
        ({2: 10, 3: 11, 4: 11}, False),
        ({2: 11, 3: 1000, 4: 1000}, True),
    ],
)
def test_a_replay_alone_is_doubtful(records: Any, late: dict[int, int], found: bool) -> None:
    """The second smallest count of four rounds decides; ten of 1000 are allowed."""
    _replay(records, "daqp", late)
    tests = _found(records).get("daqp", [])
    assert [test.kind for test in tests] == ["late at random", "late timings"] * found
    assert all((test.p, test.late) == (0.05, sum(late.values())) for test in tests)
    assert all(test.samples == 4000 and math.isnan(test.machine) for test in tests)


@pytest.mark.parametrize(
    ("rounds", "late", "found"),
    [(3, 1, False), (3, 2, True), (5, 2, False), (5, 3, True), (6, 3, False), (6, 4, True)],
)
def test_the_middle_is_the_lower_median(records: Any, rounds: int, late: int, found: bool) -> None:
    """The second smallest count of three rounds decides, the third of five and six."""
    _replay(records, "daqp", {rounds - i: 11 for i in range(late)}, rounds=rounds)
    assert bool(_found(records)) is found


def test_a_replay_beside_a_solver_without_stalls(records: Any) -> None:
    """Half a stall in its last three rounds is a mean of 1/6 with a shape of 1.

    Two stalls in a round then have a share of (1/7)^2, in three of four rounds 4 q^3 (1 - q) + q^4.
    The better of two multiples of the limit doubles it (Bonferroni).
    """
    _replay(records, "daqp", {2: 2, 3: 2, 4: 2})
    _replay(records, "piqp", {})
    (found,) = _found(records)["daqp"]
    q = 1 / 49
    assert (found.kind, found.late, found.samples) == ("late at random", 6, 4000)
    assert found.p == pytest.approx(2 * (4 * q**3 * (1 - q) + q**4), rel=1e-9)
    assert found.machine == pytest.approx(0.5 / 3000)
    assert found.is_proven_late


def test_a_replay_of_two_rounds_beside_one_of_a_test_solver(records: Any) -> None:
    """Half a stall in the only round of 20 ms is a mean of 1/2 with a shape of 1.

    Three stalls in a round then have a share of (1/3)^3, in both rounds its square.
    """
    _replay(records, "daqp", {}, rounds=2)
    frame = records._steps[-1]
    late = (frame["k"] // 3).eq(frame["repeat"])
    frame["total_ns"] = np.where(late, 10_000_000, BASE_NS)
    _replay(records, COPY_ONLY, {}, rounds=1)
    (found,) = _found(records)["daqp"]
    assert (found.kind, found.late, found.samples) == ("late at random", 6, 2000)
    assert found.p == pytest.approx(2 / 27**2, rel=1e-9)
    assert found.machine == pytest.approx(1 / 2000)


@pytest.mark.parametrize("is_loop", [True, False])
def test_a_run_without_a_single_timing_is_not_tested(records: Any, is_loop: bool) -> None:
    """A result folder of others may hold one; the late loop beside it is found all the same."""
    _loop(records, 1000, dict.fromkeys(range(100), 7e6))
    records.loop("piqp", steps=1000) if is_loop else _replay(records, "piqp", {}, rounds=1)
    records._steps[-1]["total_ns"] = pd.array([None] * len(records._steps[-1]), dtype="Int64")
    assert list(_found(records)) == ["daqp"]


def test_who_remembers_answers_hides_nobody(records: Any) -> None:
    """A solver that is slow at the first visit of 900 steps shows nothing of the machine."""
    _replay(records, "daqp", {2: 2, 3: 2, 4: 2})
    _replay(records, "piqp", {1: 900})
    (found,) = _found(records)["daqp"]
    # Half a stall in about as much time; 900.5 would be 225 of 1000.
    assert found.machine == pytest.approx(0.5 / 3000, rel=0.1)
    assert found.is_proven_late


@pytest.mark.parametrize(("long_ns", "found"), [(9_000_000, False), (9_000_001, True)])
def test_long_delays_among_many_short_stalls(records: Any, long_ns: int, found: bool) -> None:
    """Four delays beyond 9 ms in most rounds are found, where as many short ones are not."""
    _replay(records, "daqp", dict.fromkeys((2, 3, 4), 4), long_ns)
    _replay(records, "piqp", dict.fromkeys((2, 3, 4), 4), 4_000_000)
    assert bool(_found(records)) is found


@pytest.mark.parametrize(("excess_ns", "stalls"), [(1_500_000, 0), (1_500_001, 1)])
def test_stalls_are_longer_than_half_the_limit(records: Any, excess_ns: int, stalls: int) -> None:
    """The machine leads to expect half a stall more than the other solver had, for three rounds."""
    _replay(records, "daqp", {2: 3, 3: 3, 4: 3})
    _replay(records, "piqp", {3: 1}, BASE_NS + excess_ns)
    (found,) = _found(records)["daqp"]
    assert found.machine == pytest.approx((stalls + 0.5) / 3000)


def test_a_replay_with_more_late_timings_than_a_p99_allows(records: Any) -> None:
    """Thirty late timings in a round of 1000 are proven late of either kind."""
    _replay(records, "daqp", {2: 30, 3: 30, 4: 30})
    _replay(records, "piqp", {})
    found = _found(records)["daqp"]
    assert [(late.kind, late.is_proven_late) for late in found] == [
        ("late at random", True),
        ("late timings", True),
    ]
    assert found[1].machine == pytest.approx(0.5 / 3000)


@pytest.mark.parametrize(
    ("other", "excess_ns", "stalls", "tests"),
    [("piqp", 150_000_000, 0, 2), (COPY_ONLY, 150_000_000, 0, 1), (COPY_ONLY, 150_000_001, 1, 1)],
)
def test_timings_past_the_deadline_against_the_stalls_of_others(
    records: Any, other: str, excess_ns: int, stalls: int, tests: int
) -> None:
    """Stalls longer than half the deadline in 80 ms of the other give the rate of a shape of 1/2.

    With m the mean in the 9 ms of the loop and s = 1 / (1 + 2 m), no stall has a probability of
    s^(1/2), one of half of (1 - s) s^(1/2). A tested replay doubles the p-value (Holm).
    """
    _loop(records, 450, {7: 3e8 + 1, 8: 4e8, 9: 3e8}, involuntary_switches=3)
    _replay(records, other, {3: 1}, BASE_NS + excess_ns)
    mean = (stalls + 0.5) / 80e6 * 9e6
    s = 1.0 / (1.0 + 2.0 * mean)
    expected = tests * (1.0 - math.sqrt(s) - 0.5 * (1.0 - s) * math.sqrt(s))
    (found,) = _found(records)["daqp"]
    assert (found.kind, found.late, found.samples) == ("past the deadline", 2, 450)
    assert found.p == pytest.approx(expected, rel=1e-6)
    assert found.machine == pytest.approx(mean / 450)


def test_a_timing_past_the_deadline_without_others_is_a_doubt(records: Any) -> None:
    _loop(records, 450, {7: 4e8}, involuntary_switches=3)
    _replay(records, "daqp", {})
    (found,) = _found(records)["daqp"]
    assert (found.kind, found.late, found.p) == ("past the deadline", 1, 0.05)
    assert math.isnan(found.machine)
