"""Timed calls of a solver: its phases between two clock reads, its failures as data.

A step that hangs is ended after `step_limit_s`: by an option of the library, else by an alarm,
which reaches whatever runs Python. A library that holds the interpreter is killed with its process,
and the run goes on in another one after that step (`ResumedSolver`, `ReplayRun`). Waits of a thread
for its core, by the scheduler of the kernel, count in no limit.
"""

import math
import os
import signal
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import FrameType

import numpy as np

from dpbench.bench.record.raw_log import PHASES, SOLVER_PHASES, AnswerLog
from dpbench.bench.run.formulation import BoxFormulation
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.solution import Solution, Status, copy_checked_answer, is_solution_of_plain_types
from dpbench.solvers.contract import Workspace

_LONGEST = 96
"""Bytes that three numbers of 64 bits take at most, with room to spare."""
UNKNOWN = -1
Clock = Callable[[], int]
STEP_SHARE = 0.25
"""Share of a cell's run time that one step may take."""
MOST_HANGS = 3
"""Hanging steps after which a run ends."""
MOST_FAILURES = 3
"""Different reasons of failures that the outcome of a run names."""
HANG_DETAIL = "did not return and was killed"
INTERRUPT_DETAIL = "interrupted, as it ran beyond the limit"
_OF_WORKSPACE = frozenset({"setup", "update", "solve", "read"})
_OWN = slice(PHASES.index(SOLVER_PHASES[0]), PHASES.index(SOLVER_PHASES[-1]) + 1)


class RunDelay:
    """Meter of how long a thread was ready to run while its core ran something else.

    It is the second number of `schedstat` in proc(5), without sleep and waits for other threads.
    """

    def __init__(self) -> None:
        try:
            self._file = os.open("/proc/thread-self/schedstat", os.O_RDONLY | os.O_CLOEXEC)
        except OSError:
            # A kernel or a container that does not show it.
            self._file = -1
        self._before_ns = self.read_total_ns()

    def read_total_ns(self) -> int:
        """Return how long the thread has waited for its core so far [ns]; `UNKNOWN` if hidden."""
        if self._file < 0:
            return UNKNOWN
        try:
            return int(os.pread(self._file, _LONGEST, 0).split()[1])
        except (OSError, IndexError, ValueError):
            self._file = -1
            return UNKNOWN

    def read_wait_since_last_call_ns(self) -> int:
        """Return how long the thread waited for its core since the last call [ns]; −1: unknown."""
        before_ns, now_ns = self._before_ns, self.read_total_ns()
        self._before_ns = now_ns
        return now_ns - before_ns if now_ns != UNKNOWN else UNKNOWN

    @property
    def pending_ns(self) -> int:
        """Time waited for the core [ns] since the last reading, which stays; 0 if unknown."""
        return max(self.read_total_ns() - self._before_ns, 0)


@cache
def _cache_run_delay_of_thread(thread: int) -> RunDelay:
    """Return the meter of a thread's waits for its core, one object for each thread."""
    return RunDelay()


def get_run_delay() -> RunDelay:
    """Return the meter of the calling thread's waits for its core, shared by its solvers."""
    # The identifier of a forked child is its own, so that it opens a file of its own.
    return _cache_run_delay_of_thread(threading.get_native_id())


def read_process_wait_s(process: int) -> float:
    """Return how long a process's main thread waited for its core so far [s]; 0 if unknown."""
    try:
        text = Path(f"/proc/{process}/schedstat").read_text(encoding="ascii")
        return 1e-9 * int(text.split()[1])
    except (OSError, IndexError, ValueError):
        return 0.0


class RunLimit:
    """Limit on the calling thread's run time [ns]: time by a clock without waits for its core.

    Another process on the core thus stops no run. The waits are read only where the clock alone is
    beyond the limit; where the kernel hides them the clock alone counts.
    """

    def __init__(self, start_ns: int, limit_ns: int) -> None:
        self._start_ns, self._limit_ns = start_ns, limit_ns
        self._delay = get_run_delay()
        self._waited_before_ns = self._delay.read_total_ns()
        self._due_ns = start_ns + limit_ns

    def spent_ns(self, now_ns: int) -> int:
        """Return the run time from the start until `now_ns` of the clock, without waits."""
        waited_ns = self._delay.read_total_ns() - self._waited_before_ns
        return now_ns - self._start_ns - max(waited_ns, 0)

    def is_exceeded(self, now_ns: int) -> bool:
        """Return whether the run time until `now_ns` of the clock is beyond the limit."""
        if now_ns <= self._due_ns:
            return False
        left_ns = self._limit_ns - self.spent_ns(now_ns)
        self._due_ns = now_ns + left_ns
        return left_ns < 0


class StepTimeLimitError(TimeoutError):
    """Raised in a solver's call that ran beyond the time limit of a step."""


def is_usable(solution: Solution) -> bool:
    """Return whether a closed loop can apply an answer: by its status, and if z is finite."""
    return solution.status.is_usable and math.isfinite(solution.z.sum())


class TimedSolver:
    """Timer of one solver's set-up, update, solve and read; its failures become answers.

    After `answer`, `phases_ns` holds set-up, update, solve and read of that step, −1 for none;
    `waited_ns` is the part of them in which the machine ran something else, −1 if unknown.
    """

    def __init__(self, workspace: Workspace, formulated: BoxFormulation, clock: Clock) -> None:
        self._workspace, self._formulated, self._clock = workspace, formulated, clock
        # Nothing the solver gets is what it is judged against, nor what a later step is made of.
        self._whole, self._given = formulated.base, formulated.base.copy()
        # An emitted step in the formulation the solver gets; part of emitting it.
        self.formulate = formulated.step
        # n and m of the QP in that formulation.
        self.size = formulated.base.n, formulated.base.m
        self.phases_ns = (-1, -1, -1, -1)
        self.waited_ns, self._run_delay = 0, get_run_delay()
        self.details: dict[str, int] = {}
        # Set by the alarm, whatever became of what it raised.
        self.interrupted = ""
        # Whether the last answer is the recorded one of an earlier process.
        self.repeated = False

    @property
    def pending_wait_ns(self) -> int:
        """Time waited for the core since the step began [ns]; 0 if unknown."""
        return self._run_delay.pending_ns

    @property
    def matrix_updates(self) -> int:
        """Number of updates so far in which the solver took new QP matrices."""
        return self._workspace.matrix_updates

    def prepare(self) -> int:
        """Set up the solver before the first step; return the time [ns], −1 if each step does."""
        if self._workspace.setup_every_step:
            return -1
        started = self._clock()
        self._workspace.setup(self._given)
        return self._clock() - started

    def warm_up(self, times: int) -> None:
        """Solve the set-up QP some times without recording it, then reset the solver."""
        base = self._formulated.base
        for _ in range(times):
            self.answer(QPStep(base.q, base.l, base.u).copy())
        self.reset()
        self.details.clear()

    def answer_without_record(self, step: QPStep) -> Solution:
        """Solve one step's QP as `answer`, but count no failure: no row of the run has it."""
        counted = self.details.copy()
        answer = self.answer(step)
        self.details.clear()
        self.details.update(counted)
        return answer

    def answer(self, step: QPStep) -> Solution:
        """Solve one step's QP, timed, and return the answer to its condensed form.

        No failure of a solver is raised, except MemoryError; a malformed answer has the status
        ERROR.
        """
        workspace, clock, formulated = self._workspace, self._clock, self._formulated
        t1 = t2 = t3 = t0 = -1
        setup_every_step, (n, m) = workspace.setup_every_step, self.size
        qp = self._restore_overwritten_problem().at(step) if setup_every_step else self._given
        # Waits before the step end here, so that none is booked on it.
        self._run_delay.read_wait_since_last_call_ns()
        try:
            t0 = clock()
            if setup_every_step:
                workspace.setup(qp)
            else:
                workspace.update(step)
            t1 = clock()
            workspace.solve()
            t2 = clock()
            solution = workspace.read()
            t3 = clock()
            # Looking at a plain answer is no work of the solver's; what any other does is.
            if not is_solution_of_plain_types(solution, n, m):
                solution = copy_checked_answer(solution, n, m)
                t3 = clock()
        except MemoryError:
            # It is at its limit, where the harness would find no memory either.
            raise
        # An adapter that raises is a failed solve of that solver, which is data of the run.
        except Exception as error:
            now = clock()
            t1, t2, t3 = (now if t < 0 else t for t in (t1, t2, t3))
            detail = f"{type(error).__name__}: {error}"
            solution = Solution.without_point(n, m, Status.ERROR, detail)
        self.waited_ns = min(self._run_delay.read_wait_since_last_call_ns(), t3 - t0)
        prepared = t1 - t0
        handed_over = (prepared, -1) if setup_every_step else (-1, prepared)
        self.phases_ns = (*handed_over, t2 - t1, t3 - t2)
        if self.interrupted:
            solution = Solution.without_point(n, m, Status.TIME_LIMIT, self.interrupted)
        if solution.detail:
            self._count_status_detail(solution.detail)
        return formulated.solution(solution)

    def _restore_overwritten_problem(self) -> QuadraticProgram:
        """Return the solver's copy of the QP, with what the solver overwrote restored."""
        if self._formulated.base is not self._whole:
            self._whole = self._formulated.base
            self._given = self._whole.copy()
        whole, given = self._whole, self._given
        np.copyto(given.P, whole.P)
        np.copyto(given.A, whole.A)
        np.copyto(given.lb, whole.lb)
        np.copyto(given.ub, whole.ub)
        return given

    def reset(self) -> None:
        """Make the solver forget an unusable answer, such as a bad warm start.

        After an interrupt, which may have left anything, it is set up anew.
        """
        if self.interrupted:
            self.interrupted = ""
            self.set_up_again()
            return
        try:
            self._workspace.reset()
        except Exception as error:
            self._count_status_detail(f"reset: {type(error).__name__}: {error}")

    def set_up_again(self) -> None:
        """Set the solver up from nothing, with the current QP matrices."""
        if self._workspace.setup_every_step:
            return
        try:
            self._workspace.setup(self._restore_overwritten_problem())
        except Exception as error:
            self._count_status_detail(f"setup: {type(error).__name__}: {error}")

    def _count_status_detail(self, detail: str) -> None:
        """Count one more solver answer with this detail of its status."""
        self.details[detail] = self.details.get(detail, 0) + 1

    def answer_hung_step(self, limit_ns: int) -> Solution:
        """Return the missing answer to a step in which an earlier process hung and was killed."""
        self.phases_ns, self.waited_ns = (-1, 0, limit_ns, 0), 0
        n, m = self.size
        answer = Solution.without_point(n, m, Status.TIME_LIMIT, HANG_DETAIL)
        self._count_status_detail(HANG_DETAIL)
        return self._formulated.solution(answer)


def list_failure_descriptions(counts: Mapping[str, int]) -> list[str]:
    """Return lines on a solver's failures in the library's words, the most frequent first."""
    named = Counter(counts).most_common(MOST_FAILURES)
    others = sum(counts.values()) - sum(count for _, count in named)
    words = [f"{count} × {text}" for text, count in named]
    return [*words, f"{others} × other words"] if others else words


def record_answer(log: AnswerLog, r: int, k: int, solution: Solution, waited_ns: int) -> None:
    """Record an answer, and its wait for the core [ns], as round r, step k of a run."""
    log.waited_ns[r, k] = waited_ns
    log.status[r, k] = solution.status
    log.iterations[r, k] = solution.iterations
    log.reported_ns[r, k] = solution.reported_ns
    log.z[r, k] = solution.z
    log.y[r, k] = solution.y
    log.y_box[r, k] = solution.y_box


class ResumedSolver(TimedSolver):
    """A timed solver that repeats recorded `answers` up to step `at`, in which its process hung.

    The loop around it is deterministic, so the ship comes to the very state that it had. `skips` is
    whether this solver hung there, for `limit_ns`, and has no answer to it.
    """

    def __init__(
        self,
        workspace: Workspace,
        formulated: BoxFormulation,
        clock: Clock,
        *,
        answers: AnswerLog,
        at: int,
        skips: bool,
        limit_ns: int,
    ) -> None:
        super().__init__(workspace, formulated, clock)
        self._answers, self._at, self._skips, self._limit_ns = answers, at, skips, limit_ns
        self._k, self._updates = -1, int(answers.matrix_updates[0])

    @property
    def matrix_updates(self) -> int:
        """Number of updates with new QP matrices, in the earlier process and in this one."""
        return self._updates + super().matrix_updates

    def answer(self, step: QPStep) -> Solution:
        """Return the recorded answer up to the step that hung, the solver's own after it."""
        k, answers = self._find_next_step_index(), self._answers
        self.repeated = k < self._at or (k == self._at and self._skips)
        if k == self._at:
            self.set_up_again()
            if self._skips:
                return self.answer_hung_step(self._limit_ns)
        if k >= self._at:
            return super().answer(step)
        setup, update, solve, read = answers.times[0, k, _OWN].tolist()
        self.phases_ns = setup, update, solve, read
        self.waited_ns = int(answers.waited_ns[0, k])
        return Solution(
            Status(int(answers.status[0, k])),
            answers.z[0, k].copy(),
            answers.y[0, k].copy(),
            answers.y_box[0, k].copy(),
            int(answers.iterations[0, k]),
            int(answers.reported_ns[0, k]),
        )

    def _find_next_step_index(self) -> int:
        """Return the index of the step to answer, beyond those a slow computer skipped."""
        self._k += 1
        while self._k < self._at and (self._answers.times[0, self._k, _OWN] < 0).all():
            self._k += 1
        return self._k

    def warm_up(self, times: int) -> None:
        """Solve the set-up QP some times with the solver, not from the record, then reset it."""
        at, self._at = self._at, -1
        super().warm_up(times)
        self._at, self._k = at, -1

    def reset(self) -> None:
        """Reset the solver where the last answer was its own, not a recorded one."""
        if self._k > self._at or (self._k == self._at and not self._skips):
            super().reset()


@contextmanager
def raise_at_step_limit(limit_s: float, clock: Clock) -> Iterator[None]:
    """Raise `StepTimeLimitError` in any solver call in the block that takes over `limit_s` [s].

    It reaches what runs Python. No alarm goes off in a run that ends before; a step that began
    since the last alarm goes on.
    """
    limit_ns = round(limit_s * 1e9)

    def alarm(number: int, frame: FrameType | None) -> None:
        called = None
        while frame is not None and frame.f_code is not TimedSolver.answer.__code__:
            called, frame = frame, frame.f_back
        # Only within a call of the workspace `answer` takes what is raised for its failure.
        if frame is None or called is None or called.f_code.co_name not in _OF_WORKSPACE:
            return
        solver = frame.f_locals["self"]
        if clock() - frame.f_locals["t0"] - solver.pending_wait_ns >= limit_ns:
            words = f"{INTERRUPT_DETAIL} of {limit_s:g} s of a step"
            solver.interrupted = words
            raise StepTimeLimitError(words)

    before = signal.signal(signal.SIGALRM, alarm)
    signal.setitimer(signal.ITIMER_REAL, limit_s, limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
