"""Notes below a Markdown table of solvers: replays that differ, options of the user's settings."""

from dpbench.analysis.verdict.verdict import Verdict
from dpbench.bench.record.cell import Configuration
from dpbench.report.documents.markdown import describe_table


def _verdict(solver: str, timed_on: str, **given: str) -> Verdict:
    configuration = Configuration(solver, "native", "warm", **given)
    return Verdict(configuration, "pass", timed_on=timed_on)


def test_rows_of_other_replays_and_own_options_are_named() -> None:
    own = _verdict("osqp", "squall", settings="mine", options='{"rho": 1.6}')
    notes = list(describe_table([_verdict("daqp", "move"), own, _verdict("piqp", "move")]))
    assert notes == [
        "p50 and p99 are of the replay of move, but for osqp (native warm, mine) (squall).",
        "Settings of your own: osqp mine: rho=1.6.",
    ]


def test_nothing_is_said_of_one_replay_with_presets() -> None:
    assert list(describe_table([_verdict("daqp", "move"), _verdict("piqp", "")])) == []
    assert list(describe_table([])) == []
