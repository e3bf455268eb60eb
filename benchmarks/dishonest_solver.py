"""DAQP under another name, whose times or answers are those of a stated fault.

Name and fault are those of the file: in a copy called `busy-23-10.py` every 23rd call takes 10 ms
longer. `FAULTS` lists them all. A copy called `honest.py` is DAQP.
"""

import os
import random
import tempfile
import threading
import time
import zlib
from pathlib import Path

import numpy as np

from dpbench.qp.solution import Solution
from dpbench.solvers.libraries.daqp import NATIVE, DaqpWorkspace
from dpbench.solvers.plugins import solver_record

FAULTS = (
    *("busy-3-10", "busy-23-10", "busy-200-10", "busy-211-400"),
    *("sleep-3-10", "sleep-23-10", "sleep-200-10", "sleep-211-400"),
    *("chance-3-10", "chance-23-10", "chance-200-10", "chance-211-400"),
    *("remember-all-5", "remember-hard-10", "remember-slow-10"),
    *("index-all-5", "index-hard-10", "disk-all-5", "disk-hard-10"),
    *("thread-2", "thread-0.5"),
    *("first-slow", "first-wrong"),
)
"""busy, sleep: every so manieth call takes so many ms longer, at work or asleep. chance: the same
at random. remember, index, disk: all, hard or slow steps take so many ms unless they are remembered
by their vectors, by the number of the step, or in a file. thread: a thread is busy for so many ms
after each answer. first: the first visit of a step is slow, or wrong."""

NAME = Path(__file__).stem
RECORD = solver_record(NAME, method="active set", policies=("warm",), module="daqp")
WORDS = NAME.split("-")
SHARES = {"all": 1, "hard": 4, "slow": 12}
"""Divisor of the steps that are remembered: one in so many QPs, chosen by its vectors."""


def _busy(ms):
    until = time.perf_counter_ns() + round(1e6 * ms)
    while time.perf_counter_ns() < until:
        pass


def _work(ms):
    """Keep a processor busy without the interpreter's lock."""
    until = time.perf_counter_ns() + round(1e6 * ms)
    matrix = np.ones((120, 120))
    while time.perf_counter_ns() < until:
        matrix @ matrix


class DishonestWorkspace(DaqpWorkspace):
    """DAQP with the fault of `WORDS`."""

    def __init__(self, record, policy, options):
        super().__init__(record, policy, options)
        self._calls, self._index, self._known = 0, -1, {}
        self._random = random.Random(7)
        self._disk = Path(tempfile.gettempdir()) / f"dpbench-dishonest-{os.getuid()}" / NAME

    def update(self, step):
        self._index += 1
        self._key = step.q.tobytes() + step.l.tobytes() + step.u.tobytes()
        super().update(step)

    def reset(self):
        self._index = -1
        super().reset()

    def solve(self):
        self._calls += 1
        super().solve()

    def read(self):
        answer = super().read()
        fault = WORDS[0]
        if fault in ("busy", "sleep", "chance"):
            self._delay(fault, int(WORDS[1]), float(WORDS[2]))
        elif fault in ("remember", "index", "disk"):
            self._remember(fault, WORDS[1], float(WORDS[2]))
        elif fault == "thread":
            threading.Thread(target=_work, args=(float(WORDS[1]),), daemon=True).start()
        elif fault == "first" and self._is_first():
            if WORDS[1] == "slow":
                _busy(10.0)
            else:
                answer = Solution(answer.status, answer.z + 0.5, answer.y, answer.y_box)
        return answer

    def _delay(self, fault, every, ms):
        due = self._random.random() < 1 / every if fault == "chance" else self._calls % every == 0
        if due:
            (time.sleep(1e-3 * ms) if fault == "sleep" else _busy(ms))

    def _is_first(self):
        first = self._key not in self._known
        self._known[self._key] = True
        return first

    def _remember(self, fault, which, ms):
        if zlib.crc32(self._key) % SHARES[which]:
            return
        key = self._index if fault == "index" else zlib.crc32(self._key)
        if fault == "disk":
            self._disk.mkdir(parents=True, exist_ok=True)
            path = self._disk / f"{key:x}"
            if not path.exists():
                _busy(ms)
                path.touch()
        elif key not in self._known:
            _busy(ms)
            self._known[key] = True


def open(policy, options):
    """A workspace of DAQP's own record, whose capabilities are the same."""
    return DishonestWorkspace(NATIVE.record, policy, options)
