"""Replay: byte-identical QPs through a solver, the only source of timing rankings.

The whole sequence is replayed round by round in order, because a warm start lives on the previous
step; round 0 is a shortened warm-up. A fixed reference kernel is timed before and after each
round, so that a round in which the machine was slow is seen.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from dpbench.bench.disturbance import counters
from dpbench.bench.port import Clock, SolverPort, record_answer
from dpbench.bench.rawlog import RawLog
from dpbench.qp.program import QPSequence

PROBE_REPEATS = 20
PREROLL = 3


@njit(cache=True)
def _reference_kernel(v):  # type: ignore[no-untyped-def] # compiled by numba
    """A dependent chain of multiply-adds, some 50 µs long: no cache misses, no branches."""
    s = 0.5
    for _ in range(100):
        for i in range(v.shape[0]):
            s = s * 0.999 + v[i]
    return s


_PROBE_DATA = np.linspace(0.0, 1.0, 256)


def probe_ns(clock: Clock) -> int:
    """The smallest of a few timings of the reference kernel [ns]."""
    best = 2**62
    for _ in range(PROBE_REPEATS):
        started = clock()
        _reference_kernel(_PROBE_DATA)
        best = min(best, clock() - started)
    return best


class ReplayArm:
    """One solver replaying one sequence.

    Parameters
    ----------
    sequence : the QPs; port : the solver; log : where each round goes.
    warmup_steps : length of round 0; preroll : steps solved before each round without a record.
    limit_ns : own run time of all rounds together after which the arm stops; of a round that is run
        again because the machine was slow, the last attempt counts.
    """

    def __init__(
        self,
        sequence: QPSequence,
        port: SolverPort,
        log: RawLog,
        *,
        warmup_steps: int,
        limit_ns: int,
        clock: Clock,
        preroll: int = PREROLL,
    ) -> None:
        self.sequence, self._port, self._log, self._clock = sequence, port, log, clock
        self._warmup_steps = warmup_steps
        self._limit_ns, self._preroll = limit_ns, preroll
        self._spent_ns = np.zeros(len(log.done), dtype=np.int64)
        log.footprint[:] = np.nan
        log.setup_once_ns[0] = port.prepare()
        log.started[0] = 1

    def round(self, r: int) -> bool:
        """Replay round r into its rows; False when the time limit stopped it.

        The first `preroll` steps are solved without a record beforehand: the worker slept on its
        pipe until now, and cold caches are no property of step 0.
        """
        log, clock, port, sequence = self._log, self._clock, self._port, self.sequence
        steps = self._warmup_steps if r == 0 else len(sequence)
        times = log.times[r]
        log.done[r] = 0
        log.attempts[r] += 1
        log.counters[r] = np.nan
        self._spent_ns[r] = 0
        limit_ns = self._limit_ns - int(self._spent_ns.sum())
        before = counters()
        log.probe_ns[r, 0] = probe_ns(clock)
        began = clock()
        for k in range(min(self._preroll, steps)):
            port.answer(port.formulate(sequence.step(k)))
            # Whoever remembers answers has seen this step now, and its time is in no row.
            log.first_ns[k] = log.first_ns[k] or -1
        port.reset()
        updates_before = port.matrix_updates
        for k in range(steps):
            step = port.formulate(sequence.step(k))
            solution = port.answer(step)
            record_answer(log, r, k, solution)
            if not solution.status.usable:
                port.reset()
            times[k] = (-1, *port.phases_ns, -1)
            if log.first_ns[k] == 0:
                log.first_ns[k] = sum(ns for ns in port.phases_ns if ns > 0)
            log.matrix_updates[r] = port.matrix_updates - updates_before
            log.done[r] = k + 1
            if clock() - began > limit_ns:
                return False
        self._spent_ns[r] = clock() - began
        log.probe_ns[r, 1] = probe_ns(clock)
        if log.attempts[r] == 1:
            log.first_probe_ns[r] = log.probe_ns[r].max()
        np.subtract(counters(), before, out=log.counters[r])
        return True
