"""A solver that remembers the answers of earlier rounds is told from one that solves.

The clock is simulated (but for one whole campaign): solving takes `WORK_NS`, looking an answer up
`LOOK_UP_NS`, so nothing depends on the machine.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dpbench import load_results, load_scenario, record_sequence
from dpbench.bench.judge.answer_caching import compute_caching_metrics, find_caching_sign
from dpbench.bench.record.raw_log import RawLog, make_replay_layout
from dpbench.bench.run.formulation import formulate_sequence
from dpbench.bench.run.replay import ReplayRun
from dpbench.bench.run.timed_solver import TimedSolver
from dpbench.qp.program import QPSequence, QPStep, QuadraticProgram
from dpbench.qp.solution import Solution
from dpbench.solvers.contract import Workspace
from dpbench.solvers.open import open_workspace
from tests.bench.deterministic import run_suite, suite_toml

WORK_NS, LOOK_UP_NS, SETUP_NS = 2_000_000, 14_000, 50_000_000
STEPS, WARM_UP, ROUNDS = 80, 20, 4


def remembers(row: Mapping[str, Any]) -> bool:
    return find_caching_sign(row["first_visit_ratio"], row["loop_ratio"]) is not None


class Clock:
    """A clock that goes on by a little at each reading, and by what a solver adds."""

    def __init__(self) -> None:
        self.now = 0
        self.speed = 1.0

    def __call__(self) -> int:
        self.now += round(100 * self.speed)
        return self.now

    def work(self, ns: float) -> None:
        self.now += round(ns * self.speed)


class Honest(Workspace):
    """Solves each step with an exact solver; the subclasses know some answers already."""

    def __init__(self, clock: Clock) -> None:
        super().__init__("planted", "native", "reuse")
        self._clock, self._inner = clock, open_workspace("quadprog", route="native", policy="reuse")
        self._key = b""
        self.known: dict[bytes, Solution] = {}
        self.asked: dict[bytes, int] = {}

    def setup(self, qp: QuadraticProgram) -> None:
        self._clock.work(SETUP_NS)
        self._inner.setup(qp)

    def update(self, step: QPStep) -> None:
        self._key = step.q.tobytes() + step.l.tobytes() + step.u.tobytes()
        self._inner.update(step)

    def look_up(self) -> Solution | None:
        return None

    def keep(self, solution: Solution) -> None:
        """Remember an answer."""

    def solve(self) -> None:
        found = self.look_up()
        self._clock.work(WORK_NS if found is None else LOOK_UP_NS)
        if found is None:
            self._inner.solve()
            found = self._inner.read()
            self.keep(found)
        self._solution = found

    def read(self) -> Solution:
        return self._solution


class ByBytes(Honest):
    """A dictionary on the bytes of q, l, u."""

    def look_up(self) -> Solution | None:
        return self.known.get(self._key)

    def keep(self, solution: Solution) -> None:
        self.known[self._key] = solution


class Patient(ByBytes):
    """Looks nothing up before it has been asked the same for the third time."""

    def look_up(self) -> Solution | None:
        self.asked[self._key] = self.asked.get(self._key, 0) + 1
        return super().look_up() if self.asked[self._key] > 2 else None


class AtSetup(Honest):
    """Solves the one problem it is given at set-up, and knows no other."""

    def setup(self, qp: QuadraticProgram) -> None:
        super().setup(qp)
        self._inner.solve()
        self.known[qp.q.tobytes() + qp.l.tobytes() + qp.u.tobytes()] = self._inner.read()

    def look_up(self) -> Solution | None:
        return self.known.get(self._key)


class Warming(Honest):
    """An honest one that is slower by a third the first time it sees a step."""

    def look_up(self) -> Solution | None:
        self.asked[self._key] = self.asked.get(self._key, 0) + 1
        if self.asked[self._key] == 1:
            self._clock.work(WORK_NS / 3)
        return None


@pytest.fixture(scope="module")
def sequence() -> QPSequence:
    return record_sequence(load_scenario("paper").truncate(STEPS))


def replayed(
    make: Callable[[Clock], Workspace],
    sequence: QPSequence,
    *,
    attempts: tuple[int, ...] = (1,) * (ROUNDS + 1),
    warm_up: int = WARM_UP,
    slow_round: int = -1,
) -> RawLog:
    """The log of a replay on a simulated clock, each round tried so often."""
    clock = Clock()
    base, steps = sequence.base, len(sequence)
    log = RawLog.in_memory(make_replay_layout(len(attempts), steps, base.n, base.m))
    made, formulated = formulate_sequence("condensed_box", sequence)
    timed_solver = TimedSolver(make(clock), formulated, clock)
    configuration = ReplayRun(
        made, timed_solver, log, warmup_steps=warm_up, limit_ns=2**62, clock=clock
    )
    for r, times in enumerate(attempts):
        for attempt in range(times):
            clock.speed = 5.0 if r == slow_round and attempt == 0 else 1.0
            assert configuration.run_round(r)
    return log


def ratio(log: RawLog) -> float:
    return compute_caching_metrics(log)["first_visit_ratio"]


def row(first: float = np.nan, loop: float = np.nan) -> dict[str, float]:
    return {"first_visit_ratio": first, "loop_ratio": loop}


@pytest.mark.parametrize("make", [ByBytes, Patient])
@pytest.mark.parametrize("again", [1, 2], ids=["once", "round 1 run again"])
def test_whoever_remembers_is_marked(make: type[Honest], again: int, sequence: QPSequence) -> None:
    """By bytes, at once or from round 2 on."""
    attempts = (1, again, *(1,) * (ROUNDS - 1))
    found = ratio(replayed(make, sequence, attempts=attempts))
    assert found == pytest.approx(WORK_NS / LOOK_UP_NS, rel=0.05)
    assert remembers(row(found))


@pytest.mark.parametrize("make", [Honest, AtSetup, Warming])
def test_whoever_solves_is_not(make: type[Honest], sequence: QPSequence) -> None:
    found = ratio(replayed(make, sequence))
    assert found == pytest.approx(4 / 3 if make is Warming else 1.0, rel=0.01)
    assert not remembers(row(found))


def test_a_machine_that_was_slow_at_first_marks_nobody(sequence: QPSequence) -> None:
    for attempts in ((1,) * 5, (1, 2, 1, 1, 1)):
        log = replayed(Honest, sequence, attempts=attempts, slow_round=1)
        assert log.first_ns[WARM_UP + 5] > 4 * WORK_NS
        assert ratio(log) == pytest.approx(1.0, rel=0.05)
    remembered = replayed(ByBytes, sequence, attempts=(1, 2, 1, 1, 1), slow_round=1)
    assert remembers(row(ratio(remembered)))


def test_the_first_visit_is_kept_when_a_round_is_run_again(sequence: QPSequence) -> None:
    log = replayed(ByBytes, sequence, attempts=(2, 3, 1, 1, 1))
    assert (log.first_ns[:3] == -1).all()
    assert (log.first_ns[3:] >= WORK_NS).all()
    assert (log.times[1, :, 3] < WORK_NS).all(), "the last attempt is all memory"


PLUGIN = """
import time
import numpy as np
import quadprog
from dpbench.qp.solution import Solution, Status
from dpbench.solvers.function import opener
from dpbench.solvers.plugins import solver_record

KNOWN = {}


def solve(qp):
    key = qp.q.tobytes() + qp.l.tobytes() + qp.u.tobytes()
    if key not in KNOWN:
        time.sleep(0.002)
        C = np.vstack((np.eye(qp.n), -np.eye(qp.n), qp.A, -qp.A))
        b = np.concatenate((qp.lb, -qp.ub, qp.l, -qp.u))
        z, _, _, _, y, _ = quadprog.solve_qp(qp.P, -qp.q, C.T.copy(), b)
        n, m = qp.n, qp.m
        box, rows = y[n : 2 * n] - y[:n], y[2 * n + m :] - y[2 * n : 2 * n + m]
        KNOWN[key] = Solution(Status.SOLVED, z, rows, box)
    return KNOWN[key]


RECORD = solver_record("table", method="none", module="quadprog", distribution="quadprog")
open = opener("table", solve)
"""
CALLS = {"steps": 60, "routes": ["native"], "policies": ["fresh"]}
SUITE = suite_toml(
    **{"solvers": ["table", "quadprog"], "rounds": 3, "warmup_steps": 10},
    closed_loop=[{"scenarios": ["paper"], **CALLS}],
    replay=[{"scenario": "paper", **CALLS}],
)


@pytest.mark.alone  # Real times are compared.
def test_a_campaign_marks_it(tmp_path: Path) -> None:
    (tmp_path / "table.py").write_text(PLUGIN, encoding="utf-8")
    out = run_suite(tmp_path, SUITE, solver_module=tmp_path / "table.py")
    runs = load_results(out).runs.set_index(["solver", "mode"])
    assert (runs["outcome"] == "finished").all()
    table = runs.loc[("table", "replay")]
    assert table["true_share"] == 1.0 and remembers(table)
    assert table["first_visit_ratio"] > 10.0 and table["loop_ratio"] > 10.0
    assert np.isfinite(runs.loc[("quadprog", "replay"), ["first_visit_ratio", "loop_ratio"]]).all()
    assert not any(remembers(row) for _, row in runs.xs("closed_loop", level="mode").iterrows())
