"""Paired ratios to a baseline: exact cases, coverage, and how the baseline is chosen."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dpbench.analysis.demand import Demand
from dpbench.analysis.statistics import pooled_mean
from dpbench.analysis.times.fastest import fastest_on
from dpbench.analysis.times.pooled import CommonSteps, PooledTimes, common_steps
from dpbench.analysis.times.ratios import ratios
from dpbench.bench.plan.configurations import choose_solvers
from dpbench.bench.plan.suite import ReportTable, SuiteFile
from dpbench.bench.record.configuration import Configuration
from dpbench.cli.main import main
from dpbench.errors import InputError
from dpbench.report.tables_ranks import ratio_tables
from dpbench.report.write import write_report

DEMAND = Demand()


def _pool(records: Any) -> CommonSteps:
    found = common_steps(records.view(), DEMAND)
    assert found is not None
    return found


def _configuration(solver: str, times: list[float]) -> PooledTimes:
    time = np.array(times)
    return PooledTimes(
        Configuration(solver, "native", "fresh"), time, np.zeros(len(time)), True, True
    )


def test_sequences_weigh_the_same_in_a_ratio() -> None:
    """Twice as long on 1000 steps and 8 times on 80 is 4 times, exactly and without doubt."""
    base, other = (
        _configuration("base", [3.0] * 1080),
        _configuration("other", [6.0] * 1000 + [24.0] * 80),
    )
    pooled = CommonSteps(("a", "b"), np.repeat([0, 1], [1000, 80]), (base, other), 0)
    (found,) = ratios(pooled, base)
    assert found.per_sequence == pytest.approx((2.0, 8.0))
    interval = (found.mean.value, found.mean.low, found.mean.high)
    assert interval == pytest.approx((4.0, 4.0, 4.0))
    assert not found.turns


def test_a_ratio_that_turns_with_the_sequence_is_marked() -> None:
    """Faster on one sequence and slower on the other."""
    base, other = _configuration("base", [2.0] * 8), _configuration("other", [1.0] * 4 + [8.0] * 4)
    (found,) = ratios(CommonSteps(("a", "b"), np.repeat([0, 1], 4), (base, other), 0), base)
    assert found.turns


def test_only_common_steps_are_compared() -> None:
    """A step that one of the two has not done says nothing about either."""
    base, other = (
        _configuration("base", [1.0, 1.0, np.nan, 1.0]),
        _configuration("other", [2.0, np.nan, 9.0, 2.0]),
    )
    (found,) = ratios(CommonSteps(("a",), np.zeros(4, dtype=int), (base, other), 0), base)
    assert (found.steps, found.mean.value) == (2, pytest.approx(2.0))


@pytest.mark.parametrize(
    ("count", "shown"),
    [(1, []), (3, ["1.00", "2.00", "3.00"]), (6, ["1.00", "6.00"])],
)
def test_many_sequences_are_shown_by_their_extremes(count: int, shown: list[str]) -> None:
    """One sequence needs no column of its own, and six would make the table too wide."""
    base, other = (
        _configuration("base", [1.0] * count),
        _configuration("other", [i + 1.0 for i in range(count)]),
    )
    pooled = CommonSteps(tuple("abcdef"[:count]), np.arange(count), (base, other), 0)
    (table,) = ratio_tables(pooled, base, ratios(pooled, base))
    at = table.heads.index("simultaneous interval") + 1
    assert [cell.text for cell in table.rows[0][at:-1]] == shown


@pytest.mark.slow
def test_intervals_hold_together() -> None:
    """Ten intervals of as many comparisons all cover the truth in about 95 % of 200 draws.

    The standard deviation of that share is 1.5 %; with 25 blocks the standard error is a little
    small, so 88 % is the floor. Without correction they would hold together in 60 %.
    """
    rng = np.random.default_rng(5)
    held = 0
    for _ in range(200):
        logs = 0.3 * rng.standard_normal((10, 500))
        held += all(pooled_mean([log], 10).spans(1.0) for log in logs)
    assert held >= 0.88 * 200


def test_correction_widens_intervals() -> None:
    """By the ratio of the normal quantiles at 0.05/2 and 0.05/200, 3.48 to 1.96."""
    logs = [np.random.default_rng(6).standard_normal(400)]
    one, many = pooled_mean(logs, 1), pooled_mean(logs, 100)
    widths = [np.log(found.high / found.low) for found in (one, many)]
    assert widths[1] / widths[0] == pytest.approx(3.4808 / 1.95996, rel=1e-3)


def test_the_baseline_is_the_fastest_right_configuration(records: Any) -> None:
    """A faster configuration with wrong answers is not what others are measured against."""
    records.replay("wrong", median_us=1.0, error=0.5)
    records.replay("right", median_us=10.0, policy="warm")
    records.replay("right", median_us=20.0)
    pooled = _pool(records)
    chosen = fastest_on(pooled, None)
    assert (chosen.configuration.solver, chosen.configuration.policy) == ("right", "warm")
    assert fastest_on(pooled, "wrong").configuration.solver == "wrong"
    assert fastest_on(pooled, "never heard of") is chosen


def test_settings_without_effect_are_compared_once(records: Any) -> None:
    """One run under two names is one comparison, under its usual name."""
    records.replay("other", median_us=5.0)
    for settings in ("high", "default"):
        records.replay("quadprog", settings=settings, spread=0.0, rounds=1)
    assert [(a.configuration.solver, a.configuration.settings) for a in _pool(records).pooled] == [
        ("other", "default"),
        ("quadprog", "default"),
    ]


def _three(records: Any, tmp_path: Path) -> Path:
    for solver, us in (("daqp", 10.0), ("osqp", 50.0), ("piqp", 30.0)):
        records.replay(solver, median_us=us, steps=60)
    folder: Path = records.write(tmp_path / "out")
    return folder


@pytest.mark.slow
def test_the_command_line_names_the_baseline(
    records: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`--baseline osqp` compares with it; an unknown one is refused in one line with exit 2."""
    out = _three(records, tmp_path)
    assert main(["report", str(out), "--baseline", "osqp"]) == 0
    assert "### Step times against osqp (" in (out / "report.md").read_text("utf-8")
    before = (out / "report.md").read_bytes()
    capsys.readouterr()
    assert main(["report", str(out), "--baseline", "nope"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "dpbench: --baseline: found 'nope'; allowed: a solver that was replayed: " + (
        "daqp, osqp, piqp"
    )
    assert (out / "report.md").read_bytes() == before


@pytest.mark.slow
@pytest.mark.parametrize(
    ("named", "against", "says"),
    [
        (None, "daqp", "the fastest configuration"),
        ("piqp", "piqp", "the fastest way of the solver chosen"),
        ("scs", "daqp", "The suite names scs as baseline, which was not replayed here."),
    ],
)
def test_the_suite_names_the_baseline(
    records: Any, tmp_path: Path, named: str | None, against: str, says: str
) -> None:
    """The baseline of the suite holds unless it was not replayed, which is said."""
    out = _three(records, tmp_path)
    suite = json.loads((out / "suite.json").read_text("utf-8"))
    (out / "suite.json").write_text(json.dumps(suite | {"report": {"baseline": named}}), "utf-8")
    write_report(out)
    text = (out / "report.md").read_text("utf-8")
    assert f"### Step times against {against} (" in text
    assert says in text


def test_a_baseline_that_the_suite_does_not_run_is_refused() -> None:
    """Before anything runs, naming key, found and allowed."""
    suite = SuiteFile(title="t", solvers=["daqp", "osqp"], report=ReportTable(baseline="scs"))
    with pytest.raises(InputError, match=r"report.baseline: found 'scs'; allowed: .*daqp, osqp"):
        choose_solvers(suite, None)
    assert choose_solvers(suite.model_copy(update={"report": ReportTable()}), ["osqp"]) == ["osqp"]
