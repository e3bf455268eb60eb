"""Slowdowns so large that load cannot explain them, and load that explains them."""

from typing import Any

import numpy as np
import pytest

from dpbench.ci.benchmarks import BenchmarkRun
from dpbench.ci.comparison import RunComparison, compare_runs
from tests.ci.test_comparison import QUIET, entry, run_of

NOT_GROSS = "not treated as a gross slowdown (above × 1.5)"
LOUD = QUIET | {"involuntary_switches": 120.0, "processor_s": 0.9}


def compare(*heads: tuple[float, dict[str, Any]], base: Any = LOUD) -> RunComparison:
    """Compare pairs of a base of 1 ms with heads of other times and states of the machine."""
    pairs: list[tuple[BenchmarkRun, BenchmarkRun]] = [
        (run_of(entry(machine=base)), run_of(entry(seconds=1e-3 * ms, machine=machine)))
        for ms, machine in heads
    ]
    return compare_runs(pairs)


def test_a_gross_slowdown_fails_on_a_disturbed_machine() -> None:
    """The verdict has a name of its own, an interval, the complaints and exit code 1."""
    found = compare((2.6, LOUD), (2.7, QUIET))
    (row,) = found.rows
    assert (row.verdict, row.not_judged) == ("slower, on a disturbed machine", "")
    assert found.headline == "slower, on a disturbed machine: 1 benchmark"
    assert row.ratio is not None and row.ratio.low > 1.5
    assert "3 of 4 runs disturbed" in row.remarks[0]
    assert found.exit_code(75) == found.exit_code(0) == 1


@pytest.mark.parametrize(
    ("machine", "condition"),
    [
        ({"processor_s": 0.5}, "× 1.30 ≤ 1.5 after deducting the time in which the head {}"),
        ({"processor_s": 1.9}, "busy threads of the head 1.90 > 1.05"),
        ({"steal_s": 0.014}, "stolen time of the head 1.40 % > 1 %"),
        ({"throttle_events": 1.0}, "processor of the head throttled"),
        ({"kernel_after_ns": 6.2e4}, "reference kernel changed by 55.0 % > 10 %"),
        ({"kernel_before_ns": float("nan")}, "reference kernel not timed"),
    ],
)
@pytest.mark.parametrize(("waits", "lost"), [(0.0, "had no processor"), (99.0, "waited itself")])
def test_load_that_may_explain_a_slowdown_leaves_it_without_verdict(
    machine: dict[str, float], condition: str, waits: float, lost: str
) -> None:
    """One such pair among three is enough, and the output names the condition."""
    doubtful = LOUD | machine | {"voluntary_switches": waits}
    found = compare((2.6, LOUD), (2.6, doubtful), (2.6, LOUD))
    assert (found.verdict, found.worse) == ("disturbed", False)
    line = f"largest ratio not judged: × 2.60 (t); {NOT_GROSS}: {condition.format(lost)}"
    assert found.describe_unjudged(0)[0] == line
    assert compare((2.6, LOUD), (2.6, LOUD), (2.6, LOUD)).worse


def test_a_single_pair_or_one_that_differs_shows_nothing() -> None:
    """Load that hits one run of the head alone is a single pair."""
    found = compare((9.0, LOUD))
    assert not found.worse
    assert found.describe_unjudged(0)[0].endswith(f"; {NOT_GROSS}: 1 pair of runs < 2")
    assert not compare((2.6, LOUD), (1.1, LOUD), (2.6, LOUD)).worse
    # Each pair is beyond 1.5, their interval is not.
    found = compare((1.7, QUIET), (9.0, QUIET | {"steal_s": 0.009}), (1.7, LOUD))
    assert not found.worse
    assert f"{NOT_GROSS}: lower end of the interval " in found.describe_unjudged(0)[0]


@pytest.mark.slow
def test_unchanged_code_is_not_slower_however_little_of_the_processor_the_head_has() -> None:
    """The base alone on the machine, the head with a tenth to all of it, in its shortest pass."""
    rng = np.random.default_rng(3)
    for _ in range(500):
        shares = rng.uniform(0.1, 1.0, rng.integers(2, 6))
        heads = [
            (float(rng.uniform(0.9, 1.15) / share), LOUD | {"processor_s": share})
            for share in shares
        ]
        assert not compare(*heads, base=QUIET).worse
