"""Rounds that other work on the machine robbed of speed: which, and again within a budget.

A neighbour may slow every step of a round by up to a factor of two, for milliseconds or for
minutes. The counters do not show it: over 14 runs of 14 configurations on a shared machine
the slow-down of a round correlated with the load kernel around it at 0.8, with steal time at 0.2
and with involuntary switches at 0.3. What those two take hits few steps of a round, and the
minimum over the rounds passes over them.

Which round runs again is for the load kernel to say, never for the solver's own times: choosing
rounds by these would make a ratio of two runs smaller than it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from random import Random
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from dpbench.bench.record.cell import Cell
from dpbench.bench.record.raw_log import RawLog

ROBBED_FACTOR = 1.25
"""A round whose load kernel took this much longer than in the quietest round of any
configuration."""


class Served(Protocol):
    """A configuration of a group of replays; `spent_s` is what its rounds took so far."""

    run_id: str
    cell: Cell
    serving: bool
    spent_s: float


Replayed = TypeVar("Replayed", bound=Served)


def load_levels(log: RawLog) -> NDArray[np.float64]:
    """(rounds,) the load kernel around each round [ns]: median of its passes on the quieter side.

    NaN for a round that was not finished, and for the warm-up, which does not count.
    """
    levels: NDArray[np.float64] = np.median(log.load_kernel_ns, axis=2).min(axis=1)
    levels[(levels <= 0.0) | (log.done == 0)] = np.nan
    levels[0] = np.nan
    return levels


def most_robbed(levels: NDArray[np.float64], quietest: float) -> int | None:
    """The round that was robbed most, None where none was."""
    robbed = np.flatnonzero(levels > ROBBED_FACTOR * quietest)
    return int(robbed[np.argmax(levels[robbed])]) if len(robbed) else None


def repeat_robbed(
    configurations: Sequence[Replayed],
    logs: Mapping[str, RawLog],
    serve: Callable[[Replayed, int], None],
    order: Random,
) -> None:
    """Run robbed rounds again, one of each configuration by turns, while its budget lasts.

    The last attempt counts. Configurations take turns because a neighbour stays for longer than a
    round.

    Parameters
    ----------
    logs : the raw log of each configuration; serve : runs a round of a configuration into it.
    order : of the configurations within a turn.
    """
    # Within its own limit too: a repetition must not end a configuration that had done its work.
    end_s = {
        a.run_id: min(a.spent_s + a.cell.repeat_budget_s, a.cell.limit_s) for a in configurations
    }
    while True:
        serving = [configuration for configuration in configurations if configuration.serving]
        levels = {
            configuration.run_id: load_levels(logs[configuration.run_id])
            for configuration in serving
        }
        quietest = np.fmin.reduce(
            [np.fmin.reduce(found) for found in levels.values()], initial=np.nan
        )
        due = []
        for configuration in serving:
            r = most_robbed(levels[configuration.run_id], float(quietest))
            if r is not None:
                took_s = float(np.nan_to_num(logs[configuration.run_id].counters[r, 0]))
                if configuration.spent_s + took_s < end_s[configuration.run_id]:
                    due.append((configuration, r))
        if not due:
            return
        for configuration, r in order.sample(due, len(due)):
            serve(configuration, r)
