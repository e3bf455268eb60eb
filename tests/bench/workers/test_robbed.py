"""Rounds that a neighbour robbed: which they are, and how they run again within a budget."""

import random
from dataclasses import dataclass

import numpy as np
import pytest

from dpbench.bench.record.cell import Cell
from dpbench.bench.record.raw_log import LOAD_PASSES, RawLog, make_replay_layout
from dpbench.bench.workers.interleaved import (
    ROBBED_FACTOR,
    find_most_loaded_round,
    measure_load,
    rerun_loaded_rounds,
)

ROUNDS = 4
QUIET_NS, BUSY_NS = 60_000.0, 100_000.0
ROUND_S = 0.1


@dataclass
class Replayed:
    """A configuration whose rounds take `ROUND_S`."""

    run_id: str
    cell: Cell
    serving: bool = True
    spent_s: float = 0.0


def configuration(name: str, budget_s: float) -> Replayed:
    return Replayed(
        name, Cell("replay", {}, name, "native", "fresh", "default", 2, repeat_budget_s=budget_s)
    )


def recorded(*busy: int) -> RawLog:
    """A log of finished rounds, in those of `busy` the load kernel is slow."""
    log = RawLog.in_memory(make_replay_layout(ROUNDS + 1, 2, 1, 1))
    log.done[:] = 2
    log.load_kernel_ns[:] = QUIET_NS
    log.load_kernel_ns[list(busy)] = BUSY_NS
    log.counters[:, 0] = ROUND_S
    return log


def served(
    configurations: list[Replayed], logs: dict[str, RawLog], level_ns: float
) -> list[tuple[str, int]]:
    """Return the rounds that `rerun_loaded_rounds` serves again, where the load kernel takes
    `level_ns`."""
    again = []

    def serve(one: Replayed, r: int) -> None:
        again.append((one.run_id, r))
        one.spent_s += ROUND_S
        logs[one.run_id].load_kernel_ns[r] = level_ns

    rerun_loaded_rounds(configurations, logs, serve, random.Random(0))
    return again


def test_robbed_rounds_run_again_until_they_are_quiet() -> None:
    configurations = [configuration("a", 10.0), configuration("b", 10.0)]
    logs = {"a": recorded(0, 1, 3), "b": recorded()}
    assert sorted(served(configurations, logs, QUIET_NS)) == [("a", 1), ("a", 3)]


def test_on_a_quiet_machine_nothing_runs_again() -> None:
    logs = {"a": recorded()}
    logs["a"].load_kernel_ns[2] = ROBBED_FACTOR * QUIET_NS
    assert served([configuration("a", 10.0)], logs, QUIET_NS) == []


@pytest.mark.parametrize(("budget_s", "times"), [(0.0, 0), (0.25, 2), (0.45, 4)])
def test_the_budget_ends_it_where_the_machine_stays_busy(budget_s: float, times: int) -> None:
    configurations = [configuration("a", budget_s), configuration("b", budget_s)]
    logs = {"a": recorded(1, 2), "b": recorded(1)}
    again = served(configurations, logs, BUSY_NS)
    assert [name for name, _ in again].count("a") == times
    assert [name for name, _ in again].count("b") == times


def test_a_busy_run_of_one_configuration_is_told_by_the_others() -> None:
    configurations = [configuration("a", 10.0), configuration("b", 10.0)]
    logs = {"a": recorded(1, 2, 3, 4), "b": recorded()}
    assert sorted(served(configurations, logs, QUIET_NS)) == [
        ("a", r) for r in range(1, ROUNDS + 1)
    ]


def test_a_configuration_that_stopped_is_left_alone() -> None:
    dying = configuration("a", 10.0)
    logs = {"a": recorded(1, 2)}
    again = []

    def serve(one: Replayed, r: int) -> None:
        again.append(r)
        one.serving = False

    rerun_loaded_rounds(
        [dying, configuration("b", 10.0)], logs | {"b": recorded()}, serve, random.Random(0)
    )
    assert len(again) == 1


def test_step_times_choose_no_round() -> None:
    slow = recorded()
    slow.times[2] = 10 * QUIET_NS
    assert served([configuration("a", 10.0)], {"a": slow}, QUIET_NS) == []


def test_the_level_of_a_round_is_that_of_its_quieter_side() -> None:
    log = recorded()
    log.load_kernel_ns[1, 0] = BUSY_NS
    log.load_kernel_ns[2, :, 0] = 100 * BUSY_NS
    log.done[3] = 0
    found = measure_load(log)
    assert LOAD_PASSES >= 3
    assert found[1] == found[2] == QUIET_NS
    assert np.isnan(found[[0, 3]]).all()
    assert find_most_loaded_round(found, QUIET_NS) is None
