"""The edge of what holds, found with scripted verdicts."""

from __future__ import annotations

from collections.abc import Callable

from hypothesis import given
from hypothesis import strategies as st

from dpbench.bench.design.bracket import Bracket, Trial, Verdict, find_edge

GRID = tuple(0.25 * 2.0**i for i in range(9))
WIDTH = 0.05


def edge_of(verdict_of: Callable[[float], Verdict]) -> Bracket:
    """The bracket of a scripted verdict."""
    return find_edge(lambda offset: Trial(offset, verdict_of(offset)), GRID, WIDTH)


def up_to(threshold: float, beyond: Verdict = "fails") -> Callable[[float], Verdict]:
    """What holds up to a threshold."""
    return lambda offset: "holds" if offset <= threshold else beyond


@given(st.floats(min_value=GRID[0], max_value=GRID[-1], exclude_max=True))
def test_the_bracket_holds_the_threshold_and_is_narrow(threshold: float) -> None:
    """Whatever the edge, the bracket encloses it and is at most 5 % of its upper end wide."""
    found = edge_of(up_to(threshold))
    assert found.fails_m is not None
    assert found.holds_m <= threshold < found.fails_m
    assert found.fails_m - found.holds_m <= WIDTH * found.fails_m
    assert found.above_m == ()


def test_a_search_without_a_failure_says_how_far_it_went() -> None:
    """Where everything holds there is no upper end, only the largest offset tried."""
    found = edge_of(up_to(1000.0))
    assert (found.holds_m, found.fails_m, found.largest_m) == (64.0, None, 64.0)
    assert [trial.offset_m for trial in found.tried] == list(GRID)


def test_nothing_is_said_to_hold_below_the_smallest_offset() -> None:
    """Where the smallest offset fails the bracket starts at zero and is not narrowed."""
    found = edge_of(up_to(0.1))
    assert (found.holds_m, found.fails_m) == (0.0, 0.25)
    assert len(found.tried) == len(GRID)


def test_an_offset_that_holds_beyond_one_that_fails_is_reported_and_not_counted() -> None:
    """The edge is the lowest one; what holds above it is named apart."""
    found = edge_of(lambda offset: "holds" if offset in (0.25, 0.5, 8.0, 32.0) else "fails")
    assert found.holds_m == 0.5
    assert found.fails_m is not None
    assert found.fails_m < 0.55
    assert found.above_m == (8.0, 32.0)


def test_an_undecided_offset_does_not_count_as_held() -> None:
    """A trial without a verdict ends what is held, and the edge says that it is undecided."""
    found = edge_of(up_to(3.0, beyond="undecided"))
    assert found.edge is not None
    assert found.edge.verdict == "undecided"
    assert found.holds_m <= 3.0 < found.edge.offset_m
    assert found.above_m == ()


def test_trials_are_kept_in_order_of_the_offset() -> None:
    """All trials come back, each once, rising."""
    offsets = [trial.offset_m for trial in edge_of(up_to(1.7)).tried]
    assert offsets == sorted(set(offsets))
    assert set(GRID) < set(offsets)
