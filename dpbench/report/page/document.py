"""Data of the page's scripts: configurations, experiments, runs, and the first selection."""

from collections.abc import Mapping
from typing import Any

from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.times.solver_tables import make_configuration_columns
from dpbench.analysis.verdict.run_matrix import Experiment
from dpbench.analysis.verdict.verdict import (
    Verdict,
    find_solver_family,
    find_solver_record_or_none,
    list_best_verdict_of_each_solver,
)
from dpbench.bench.record.cell import Configuration
from dpbench.bench.record.result_folder import Results
from dpbench.report.charts import style
from dpbench.report.page.data import PageData, convert_rows_to_columns, convert_to_json_number
from dpbench.report.page.live import SECTIONS
from dpbench.report.page.pack import FLAGS
from dpbench.report.page.recommendation import Recommendation, format_python_call
from dpbench.report.page.terms import GlossaryEntry


def make_page_document(
    data: PageData,
    results: Results,
    recommendation: Recommendation,
    words: Mapping[int, GlossaryEntry],
) -> dict[str, Any]:
    """Return the JSON data of the report page, all but its charts, for its scripts.

    Arrays of numbers go into `data.block`; words : descriptions of experiments, by index.
    """
    cells = list(data.cells())
    verdicts = {v.configuration: v for v in data.verdicts.all_verdicts}
    rows = [
        _describe_configuration(data, recommendation, c, verdicts.get(c))
        for c in data.configurations
    ]
    document: dict[str, Any] = {
        "solvers": {
            name: {"family": find_solver_family(name), "method": known.method if known else ""}
            for name in dict.fromkeys(c.solver for c in data.configurations)
            for known in [find_solver_record_or_none(name)]
        },
        "configurations": convert_rows_to_columns(rows),
        "experiments": [
            _describe_experiment(data, experiment, data.first_run_by_experiment.get(p))
            | ({"shows": words[p].meaning} if p in words else {})
            for p, experiment in enumerate(data.experiments)
        ],
        "cells": convert_rows_to_columns(cells),
        "flags": FLAGS,
        "row_step": style.ROW_STEP,
        "requirements": {
            "error_move": data.requirements.error_move,
            "deadline_ms": data.requirements.deadline_ms,
            "p99_ms": data.requirements.p99_ms,
        },
        "answer": _select_at_opening(data, results, recommendation),
    }
    for section in SECTIONS:
        document |= section.data(data, results)
    return document


def _describe_configuration(
    data: PageData, recommendation: Recommendation, c: Configuration, v: Verdict | None
) -> dict[str, Any]:
    """Return the facts of a configuration that the page's script needs."""
    longest = data.find_longest_timing(c)
    times = {} if v is None else {"p50": v.p50_ns, "p99": v.p99_ns, "max": v.algo_max_ns}
    return {
        **make_configuration_columns(c),
        "verdict": "not judged" if v is None else v.state,
        "why": "" if v is None else recommendation.why(v),
        **{name: convert_to_json_number(times.get(name)) for name in ("p50", "p99", "max")},
        "replay_p99": None if v is None else convert_to_json_number(v.replay_p99_ns),
        "raw_p99": None if v is None else convert_to_json_number(v.raw_p99_ns),
        "p50_in": "" if v is None else v.timed_on,
        "p99_in": "" if v is None else v.sequence_of_largest_p99,
        "error": None if v is None else convert_to_json_number(v.error_move),
        "failed": None if v is None else v.failed_steps,
        "timed_experiment_index": None if v is None else data.find_timed_experiment_index(v),
        "call": format_python_call(c),
        **_describe_margin(data, c),
        "longest": None if longest is None else convert_to_json_number(longest[1].raw_max_ns),
        "longest_at": None if longest is None else data.experiments.index(longest[0]),
    }


def _describe_margin(data: PageData, c: Configuration) -> dict[str, Any]:
    """Return how much slower a computer may be for a configuration, and the limiting steps."""
    margin = data.get_speed_margin(c)
    if margin is None:
        return {"margin": None, "bounds": []}
    loops = {
        experiment.name: p
        for p, experiment in enumerate(data.experiments)
        if (experiment.mode, experiment.units, experiment.study) == ("closed_loop", "scaled", "")
        and not experiment.slowdown
    }
    bounds = [
        [loops[step.run.scenario], step.k, convert_to_json_number(step.time_ns)]
        for step in (margin.hardest, margin.p99)
        if step.run.steps_searched_for_hardest and step.run.scenario in loops
    ]
    return {"margin": convert_to_json_number(margin.allowed_slowness_factor), "bounds": bounds}


def _select_at_opening(
    data: PageData, results: Results, recommendation: Recommendation
) -> dict[str, Any]:
    """Return the configurations and the scenario or replay that the page selects as it opens."""
    report = results.suite.get("report", {})
    named = [i for i, c in enumerate(data.configurations) if c.label == report.get("configuration")]
    first, second = (
        max(0, data.find_index(c)) if c else None
        for c in (recommendation.first, recommendation.second)
    )
    of_study, experiment = data.opening or (None, None)
    return {
        "first": named[0] if named else first or of_study or 0,
        "second": second,
        "best": {
            v.configuration.solver: data.find_index(v.configuration)
            for v in list_best_verdict_of_each_solver(data.verdicts)
            if data.find_index(v.configuration) >= 0
        },
        "experiment": experiment,
        "k": report.get("step"),
    }


def _describe_experiment(
    data: PageData, experiment: Experiment, run: RunRecord | None
) -> dict[str, Any]:
    """Describe a scenario, replay or study run for the page's script: label, mode, reference."""
    wording: dict[str, Any] = {
        "label": experiment.label,
        "mode": experiment.mode,
        "trial": experiment.units == "si",
    }
    if experiment.study:
        wording |= {
            "study": experiment.study,
            "point": experiment.point,
            "sea": experiment.replicate,
        }
    if run is None:
        return wording
    if not experiment.study:
        wording |= {"source": run.export_argument, "first": run.first_step}
    scenario = data.build_scenario_of_run(run) if run.scenario else None
    if scenario is not None:
        wording["reference"] = [float(x) for x in scenario.reference]
        wording["length_m"] = float(scenario.vessel.length_m)
    return wording
