"""The step that a search found: what it does to the solver it was found for, and to the others."""

from __future__ import annotations

import numpy as np

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.records.run_steps import RunSteps
from dpbench.bench.judge.rules import median
from dpbench.report.formats import MISSING, count_text, error_text, time_text
from dpbench.report.page.section import Topic
from dpbench.report.table import Table
from dpbench.report.verdict_text import answer_text


def worst_case_topic(records: Records) -> Topic | None:
    """Return the topic on the step that a search found; None where the suite names none."""
    asked = records.suite.get("report", {})
    k = asked.get("step")
    if k is None:
        return None
    runs = {run.run_id: run for run in records.runs}
    steps = records.run_steps(records.runs)
    row_of = {run_id: _row(runs[run_id], of_run, k) for run_id, of_run, _ in steps}
    rows = [row for run_id in runs if (row := row_of.get(run_id)) is not None]
    if not rows:
        return None
    searched = str(asked.get("configuration") or "")
    rows.sort(key=lambda row: (row[0] != searched, row[0]))
    lead = [_said(row, k) for row in rows[:1]]
    head = ("configuration", "time", "its median", "iterations", "its median", "error", "answer")
    return Topic(
        "worst-case",
        "The step that was searched for",
        (*lead, "The same step of the other configurations stands below."),
        (),
        (Table(head, tuple(rows), f"step {k}"),),
    )


def _row(run: RunRecord, steps: RunSteps, k: int) -> tuple[str, ...] | None:
    """Return the cells of one configuration at the step; None where it did not get there."""
    at = np.flatnonzero(steps.k == k)
    if not len(at):
        return None
    i = int(at[0])
    return (
        run.configuration.label,
        time_text(steps.time_ns[i]),
        time_text(float(np.median(steps.time_ns))),
        count_text(steps.iterations[i]),
        count_text(median(steps.iterations)),
        error_text(float(steps.error[i])),
        answer_text(steps, i),
    )


def _said(row: tuple[str, ...], k: int) -> str:
    name, took, median, iterations, usual, error, answer = row
    counted = "" if iterations == MISSING else f", {iterations} iterations (median {usual})"
    return (
        f"At step {k} {name} takes {took} (median {median}){counted}; error of the first move "
        f"{error}, {answer}."
    )
