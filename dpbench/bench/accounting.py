"""Where the wall time of a campaign went: what of it was inside timed phases or the referee."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from dpbench.bench.judge.closed_loop import Columns
from dpbench.bench.record.raw_log import TIMES
from dpbench.bench.workers.executor import CellJob

_PHASES = len(TIMES) - 1  # all but the overhead


@dataclass(frozen=True)
class _Stage:
    """A part of a campaign: its cells, and how many of them, or assessments, ran at a time."""

    name: str
    wall_s: float
    jobs: Sequence[CellJob]
    slots: int
    judges: int


class Ledger:
    """The stages of one sitting, in order."""

    def __init__(self) -> None:
        self._stages: list[_Stage] = []

    @contextmanager
    def stage(
        self, name: str, jobs: Sequence[CellJob] = (), *, slots: int = 1, judges: int = 1
    ) -> Iterator[None]:
        """Take the wall time of what is done inside; without cells to run it is no stage."""
        began = time.monotonic()
        yield
        if jobs:
            self._stages.append(_Stage(name, time.monotonic() - began, jobs, slots, judges))

    def entries(self, spent: dict[str, tuple[float, float]]) -> list[dict[str, Any]]:
        """What `suite.json` keeps of each stage.

        Parameters
        ----------
        spent : seconds inside timed phases and inside the referee, by run_id (`time_inside`).
        """
        entries = []
        for stage in self._stages:
            if not round(stage.wall_s, 2):
                # All of its cells were lost at once, and nothing was run.
                continue
            both = [spent.get(job.run_id, (0.0, 0.0)) for job in stage.jobs]
            entries.append(
                {
                    "stage": stage.name,
                    "cells": len(stage.jobs),
                    "wall_s": round(stage.wall_s, 2),
                    "timed_s": round(sum(timed for timed, _ in both), 2),
                    "referee_s": round(sum(judged for _, judged in both), 2),
                    "slots": stage.slots,
                    "judges": stage.judges,
                }
            )
        return entries


def time_inside(columns: Columns) -> tuple[float, float]:
    """Seconds inside the timed phases of all recorded steps, and inside the referee.

    A round that was run again counts once, as its first attempt is not kept.
    """
    times = columns["times"][:, :_PHASES]
    timed = float(np.where(times > 0, times, 0).sum()) / 1e9
    return timed, float(columns["referee_ns"].sum()) / 1e9
