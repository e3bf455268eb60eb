"""Slowest steps of windows, in the page's list of extreme steps."""

import json
from typing import Any

import pytest

from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.verdict import judge_solvers
from dpbench.report.page.data import PageData, make_table_of_runs


def test_all_long_steps_of_all_windows_are_listed(records: Any) -> None:
    """Not only the longest step and that at the p99: five of two windows, the longest first."""
    for scenario, slow in (
        ("turn", {3: 10.0, 4: 8.0, 9: 6.0}),
        ("rough", {1: 9.0, 2: 7.0, 5: 5.0}),
    ):
        records.loop("daqp", scenario)
        source = {"kind": "hardest", "name": f"{scenario} hardest 30", "of": 450}
        cell = json.dumps({"scenario": records.scenario(scenario).files, "source": source})
        window = {"steps": 30, "first_sample": 210, "scenario": scenario, "cell": cell}
        records.replay("daqp", source["name"], median_us=20.0, spread=0.0, slow=slow, **window)
    view, requirements = records.view(), Requirements()
    data = PageData.from_verdicts(view, judge_solvers(view, requirements))
    (steps,) = data.longest_window_steps.values()
    found = [(data.experiments[p].label, k, time_ns / 1e3) for p, k, time_ns in steps]
    assert found == [
        ("turn", 213, pytest.approx(200.0)),
        ("rough", 211, pytest.approx(180.0)),
        ("turn", 214, pytest.approx(160.0)),
        ("rough", 212, pytest.approx(140.0)),
        ("turn", 219, pytest.approx(120.0)),
    ]


def test_the_table_of_runs_has_windows_with_their_limiting_p99(records: Any) -> None:
    """(1 + 9) / (1 + 4) times 20 µs, in a row of the solver's configuration."""
    records.loop("daqp", "turn", iterations_p99=9.0)
    cell = json.dumps({"source": {"kind": "hardest", "name": "turn hardest 30", "of": 450}})
    window = {"steps": 30, "scenario": "turn", "cell": cell, "iterations_p99": 4.0}
    window["first_sample"] = 210
    records.replay("daqp", "turn hardest 30", spread=0.0, window_p99_ns=20e3, **window)
    view = records.view()
    data = PageData.from_verdicts(view, judge_solvers(view, Requirements()))
    table = make_table_of_runs(data, records.results().runs)
    names = [column["name"] for column in table["columns"]]
    assert table["values"][names.index("scaled_p99_ns")] == [None, 40e3]
    assert table["values"][names.index("where")] == ["turn", "turn, window of steps 210 to 239"]
    assert (table["c"], table["p"]) == ([0, 0], [0, 0])
    assert table["windows"] == [1]
