"""Replay: byte-identical QPs through a solver, the only source of timing rankings.

The sequence is replayed round by round in order, as a warm start needs the previous step; round 0
is a shortened warm-up. Two fixed kernels are timed alternately before and after each round: the
reference kernel shows the clock of the core, the load kernel what else runs on the machine.
"""

from collections.abc import Sequence

import numpy as np

from dpbench.arrays import Floats
from dpbench.bench.record.disturbance import read_disturbance_counters
from dpbench.bench.record.energy import find_energy_counters
from dpbench.bench.record.raw_log import RawLog, sum_phases_of_step_ns
from dpbench.bench.run.timed_solver import Clock, RunLimit, TimedSolver, is_usable, record_answer
from dpbench.kernel_cache import njit
from dpbench.qp.program import QPSequence

KERNEL_REPEATS = 12
PREROLL = 3


@njit(cache=True)
def _reference_kernel(v):  # type: ignore[no-untyped-def] # compiled by numba
    """Run the machine-speed test: some 50 µs of multiply-adds, each waiting for the last."""
    s = 0.5
    for _ in range(100):
        for i in range(v.shape[0]):
            s = s * 0.999 + v[i]
    return s


_KERNEL_DATA = np.linspace(0.0, 1.0, 256)
_LOAD_SIZE = 40
_LOAD_MATRIX = np.eye(_LOAD_SIZE) + 0.01
_LOAD_VECTOR = np.linspace(0.0, 1.0, _LOAD_SIZE)
_LOAD_RESULT = np.empty(_LOAD_SIZE)


def _increment(value: int) -> int:
    """Return `value` + 1: a Python call for the machine-load test to time."""
    return value + 1


def _measure_machine_load() -> None:
    """Run the machine-load test: some 60 µs of Python calls, small NumPy calls, a LAPACK inverse.

    Over 40 runs under other load the slowdown that 14 configurations had in common correlated at
    0.98 with that of these parts, at 0.7 with the reference kernel.
    """
    value = 0
    for _ in range(100):
        value = _increment(value)
    for _ in range(10):
        np.dot(_LOAD_MATRIX, _LOAD_VECTOR, out=_LOAD_RESULT)
        np.maximum(_LOAD_RESULT, _LOAD_VECTOR, out=_LOAD_RESULT)
    np.linalg.inv(_LOAD_MATRIX)


def time_speed_and_load_tests(clock: Clock, load_kernel_ns: Floats | None = None) -> int:
    """Return the machine-speed test's shortest time [ns]; write load-test times to an array."""
    best, turn = 2**62, 0 if load_kernel_ns is None else KERNEL_REPEATS // len(load_kernel_ns)
    for i in range(KERNEL_REPEATS):
        started = clock()
        _reference_kernel(_KERNEL_DATA)
        best = min(best, clock() - started)
        if load_kernel_ns is not None and i % turn == 0:
            started = clock()
            _measure_machine_load()
            load_kernel_ns[i // turn] = clock() - started
    return best


class ReplayRun:
    """Replay of one sequence of QPs with one solver, round by round.

    Parameters
    ----------
    warmup_steps : length of round 0; preroll : steps solved before each round without a record.
    lead : QPs just before the first one of the sequence; each round solves them without a record
        in place of the preroll, so that its first step has the warm start that it has in the loop.
    limit_ns : run time of all rounds together, without waits for the core; of a round that is run
        again the last counts.
    hung : (round, step) in which earlier processes of the replay hung, whose log this is; the last
        of
        these rounds goes on where it was, and no such step is tried again.
    """

    def __init__(
        self,
        sequence: QPSequence,
        solver: TimedSolver,
        log: RawLog,
        *,
        warmup_steps: int,
        limit_ns: int,
        clock: Clock,
        preroll: int = PREROLL,
        hung: Sequence[tuple[int, int]] = (),
        lead: QPSequence | None = None,
    ) -> None:
        self.sequence, self._solver, self._log, self._clock = sequence, solver, log, clock
        self._warmup_steps = warmup_steps
        self._limit_ns, self._preroll = limit_ns, preroll
        self._spent_ns = np.zeros(len(log.done), dtype=np.int64)
        self._hung = frozenset(k for _, k in hung)
        # A solver that hung in a step may have hung in one of these, which no record shows.
        self._lead = lead if not hung else None
        self._goes_on = {r: int(log.done[r]) for r, _ in hung[-1:]}
        self._energy = find_energy_counters()
        log.footprint[:] = np.nan
        log.setup_once_ns[0] = solver.prepare()
        log.started[0] = 1

    def run_all_rounds(self) -> None:
        """Replay the warm-up and every round that the log has room for."""
        for r in range(len(self._log.done)):
            self.run_round(r)

    def _prepare_round(self, steps: int) -> None:
        """Solve QPs without recording them: those of the lead, else the first ones to warm caches.

        The solver is reset before the lead, and keeps its data for a warm start after it; else it
        is reset at the end.
        """
        log, solver = self._log, self._solver
        if self._lead is not None:
            # Else the step size that OSQP has adapted in one round would change the next.
            solver.reset()
            for k in range(len(self._lead)):
                step = solver.formulate(self._lead.step(k))
                if not is_usable(solver.answer_without_record(step)):
                    solver.reset()
            return
        for k in range(min(self._preroll, steps)):
            if k in self._hung:
                continue
            solver.answer_without_record(solver.formulate(self.sequence.step(k)))
            # A solver that remembers answers has seen this step now; its time is in no row.
            log.first_ns[k] = log.first_ns[k] or -1
        solver.reset()

    def run_round(self, r: int) -> bool:
        """Solve and record the QPs of replay round r; return False if the time limit stopped it."""
        log, clock, solver, sequence = self._log, self._clock, self._solver, self.sequence
        steps = self._warmup_steps if r == 0 else len(sequence)
        times = log.times[r]
        begin = self._goes_on.pop(r, 0)
        log.done[r] = begin
        log.attempts[r] += begin == 0
        log.counters[r] = log.energy_J[r] = np.nan
        self._spent_ns[r] = 0
        limit_ns = self._limit_ns - int(self._spent_ns.sum())
        before = read_disturbance_counters()
        log.reference_kernel_ns[r, 0] = time_speed_and_load_tests(clock, log.load_kernel_ns[r, 0])
        run_limit = RunLimit(clock(), limit_ns)
        self._prepare_round(steps)
        updates_before, hung = solver.matrix_updates, self._hung
        energy_before_J, begun_ns = self._energy.read_J(), clock()
        for k in range(begin, steps):
            step = solver.formulate(sequence.step(k))
            is_skipped = hung and k in hung
            solution = (
                solver.answer_hung_step(self._limit_ns) if is_skipped else solver.answer(step)
            )
            record_answer(log, r, k, solution, solver.waited_ns)
            if not is_usable(solution):
                solver.reset()
            times[k] = (-1, *solver.phases_ns, -1)
            if log.first_ns[k] == 0:
                log.first_ns[k] = sum_phases_of_step_ns(solver.phases_ns)
            log.matrix_updates[r] = solver.matrix_updates - updates_before
            log.done[r] = k + 1
            if run_limit.is_exceeded(clock()):
                return False
        if begin == 0:
            log.energy_J[r] = self._energy.compute_energy_J(
                energy_before_J, self._energy.read_J(), 1e-9 * (clock() - begun_ns)
            )
        self._spent_ns[r] = run_limit.spent_ns(clock())
        log.reference_kernel_ns[r, 1] = time_speed_and_load_tests(clock, log.load_kernel_ns[r, 1])
        if log.attempts[r] == 1:
            log.first_reference_kernel_ns[r] = log.reference_kernel_ns[r].max()
        np.subtract(read_disturbance_counters(), before, out=log.counters[r])
        return True
