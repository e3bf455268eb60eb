"""Statements on machine and harness, on made-up records."""

from typing import Any

import pytest

from dpbench.analysis.records.machine import (
    select_timed_replays,
    sum_disturbances,
)
from dpbench.analysis.verdict.lateness import compute_repetition_spread
from dpbench.report.formats import format_sample_share, join_with_and
from dpbench.report.topics.trust import build_trust_topic
from dpbench.solvers.calibration import CALIBRATION, WAITS_NS

QUIET = {
    "replay_s": 2.0,
    "involuntary_switches": 4,
    "steal_s": 0.0,
    "rerun_rounds": 1,
    "bit_identical_share": 1.0,
    "answer_spread_max": 0.0,
    "peak_rss_bytes": 5e6,
    "os_threads": 1,
    "pool_threads": 1,
    "N_p": 30,
    "N_c": 5,
}


def _with_calibration(records: Any, off_us: float = 0.4, **columns: Any) -> None:
    for name in CALIBRATION:
        median_us = WAITS_NS.get(name, 0) / 1e3 + off_us
        records.replay(
            name, median_us=median_us, route="native", policy="reuse", **(QUIET | columns)
        )


def test_own_configurations_change_nothing_of_the_verdicts(records: Any) -> None:
    for solver, median in (("daqp", 18.0), ("quadprog", 25.0)):
        records.replay(solver, median_us=median, **QUIET)
        records.loop(solver)
    before = records.ending()
    _with_calibration(records)
    after = records.ending()
    assert "busy_wait_20us" in after.pop("timing")
    assert after == before


def test_nothing_but_the_harness_has_no_verdict(records: Any) -> None:
    _with_calibration(records)
    said = records.ending()
    assert list(said) == ["answer", "machine", "timing"]
    assert said["machine"] == "quiet."
    assert said["timing"].startswith("known waits were measured within tolerance (p50: no_op ")


def test_own_configurations_are_seen_in_no_other_part_of_the_view(records: Any) -> None:
    records.replay("daqp", **QUIET)
    _with_calibration(records)
    view = records.view()
    assert [run.solver for run in view.all_runs] == ["daqp"] == view.solvers
    assert [run.solver for run in view.runs] == ["daqp"]
    assert [run.solver for run in view.calibration] == list(CALIBRATION)


@pytest.mark.parametrize(
    ("off_us", "missed"),
    [
        (0.9, []),
        (1.5, ["no_op", *list(WAITS_NS)[:3]]),
        (3.0, ["no_op", *list(WAITS_NS)[:4]]),
        (11.0, ["no_op", *WAITS_NS]),
    ],
)
def test_the_bar_is_1_us_or_a_hundredth(records: Any, off_us: float, missed: list[str]) -> None:
    """5, 20, 50 and 200 µs and nothing at all: within 1, 1, 1, 2 and 1 µs; 1000 µs within 10."""
    _with_calibration(records, off_us)
    verdict, _, figures = records.ending()["timing"].partition(" (")
    assert verdict == (
        f"{join_with_and(missed)} measured outside the tolerance of 1 µs or 1 %; measure again on "
        "a quiet machine"
        if missed
        else "known waits were measured within tolerance"
    )
    assert all(name in figures for name in CALIBRATION)
    topic = build_trust_topic(records.view())
    waits = [us / 1e3 for name, us in WAITS_NS.items() if name in missed]
    measured = [f"{us + off_us:#.4g}".rstrip(".").replace("1011", "1\u202f011") for us in waits]
    pairs = zip(waits, measured, strict=True)
    off = join_with_and([f"{us:g} µs measured as {m} µs" for us, m in pairs])
    assert (off or "to within 1 µs or 1 %, whichever is larger.") in topic.lines[0]
    if waits:
        errors = [f"{format_sample_share(off_us / us)} near {us:g} µs" for us in waits]
        assert f"wrong by {join_with_and(errors)}." in topic.lines[0]


def test_a_quiet_machine_and_a_disturbed_one(records: Any) -> None:
    same = QUIET | {"raw_max_ns": 7e4}
    records.replay("quadprog", **same)
    records.replay("quadprog", **(same | {"settings": "high"}))
    view = records.view()
    found = sum_disturbances(select_timed_replays(view))
    assert (found.rounds, found.seconds, found.involuntary, found.rerun) == (3, 2.0, 4, 1)
    assert records.ending()["machine"] == "quiet."
    records.replay("daqp", **(QUIET | {"involuntary_switches": 96, "steal_s": 0.2}))
    line = records.ending()["machine"]
    assert "25 involuntary context switches per second" in line and "5.0 % of the time" in line


def _switching(records: Any, solver: str, a_second: float, step_s: float, own: float) -> None:
    """Three rounds of 100 steps: switches by the machine, and so many of the configuration's own a
    step."""
    seconds = 300 * step_s
    columns = {"replay_s": seconds, "involuntary_switches": round(a_second * seconds + own * 300)}
    records.replay(solver, steps=100, rounds=3, **(QUIET | columns))


def test_switches_a_configuration_makes_itself_are_not_the_machines(records: Any) -> None:
    """A thread in each solve puts a configuration off its core every step."""
    for solver, step_s in (("daqp", 1e-3), ("osqp", 5e-3), ("qtqp", 2e-2)):
        _switching(records, solver, 2.0, step_s, 0.0)
    _switching(records, "threads", 2.0, 2e-3, 1.0)
    view = records.view()
    assert records.ending()["machine"] == "quiet."
    topic = build_trust_topic(view)
    said = dict(topic.tables[0].rows)
    assert said["context switches caused by the solver itself"] == (
        "threads (qpsolvers fresh): 1.0 per step"
    )


def test_a_busy_machine_hits_every_configuration_and_is_told(records: Any) -> None:
    """At 100 switches a second a step of 20 ms has two, and they are still the machine's."""
    for solver, step_s in (("daqp", 1e-3), ("osqp", 5e-3), ("qtqp", 2e-2)):
        _switching(records, solver, 100.0, step_s, 0.0)
    line = records.ending()["machine"]
    assert "100 involuntary context switches per second" in line


def test_disturbed_rounds_are_part_of_all_rounds(records: Any) -> None:
    records.replay("daqp", **(QUIET | {"disturbed_rounds": 1}))
    assert "1 of 4 rounds disturbed" in records.ending()["machine"]
    records._runs[-1] |= {"disturbed_rounds": 3, "counting_disturbed": 3}
    assert "3 of 3 rounds disturbed" in records.ending()["machine"]
    topic = build_trust_topic(records.view())
    assert topic is not None and "3 of 3 rounds disturbed" in topic.lines[1]
    rounds = dict(topic.tables[0].rows)["disturbed rounds"]
    assert rounds == "3 of 3; 1 repeated"


def test_records_without_counters_say_nothing(records: Any) -> None:
    records.loop("daqp")
    assert build_trust_topic(records.view()) is None
    assert "machine" not in records.ending()


@pytest.mark.parametrize(
    ("configurations", "switches", "said"),
    [
        (
            4,
            4,
            "most 2.00 for half of the configurations, and of at most 2.00 for 95 % of them. Runs",
        ),
        (3, 4, "differ from day to day, because only 3 configurations had two rounds."),
        (4, 900, "how much times differ from day to day, because the machine was disturbed."),
        (
            1,
            900,
            "because the machine was disturbed and only 1 configuration had two rounds.",
        ),
    ],
)
def test_how_far_rounds_lie_apart_is_said_of_a_quiet_run_alone(
    records: Any, configurations: int, switches: int, said: str
) -> None:
    """Each configuration's slowest round takes twice its fastest; no bound holds for other runs."""
    for solver in ("daqp", "osqp", "piqp", "quadprog")[:configurations]:
        columns = QUIET | {"involuntary_switches": switches}
        records.replay(solver, spread=0.0, median_us=10.0, rounds=3, **columns)
        steps = records._steps[-1]
        for repeat, total_ns in zip((1, 2, 3), (10_000, 15_000, 20_000), strict=True):
            steps.loc[steps["repeat"] == repeat, "total_ns"] = total_ns
    assert compute_repetition_spread(records.view()) == (2.0, 2.0, configurations)
    topic = build_trust_topic(records.view())
    assert topic is not None and said in topic.tables[0].note
    assert ("at most 2.00 for half" in topic.tables[0].note) == (configurations == switches == 4)


def test_one_disturbed_command_among_quiet_ones_is_not_called_quiet(records: Any) -> None:
    """Together, 4 disturbed rounds of 104 would be within the limit of 5 %."""
    times = [f"2026-11-28T{hour}:00:00.000+00:00" for hour in ("08", "09")]
    records.replay("daqp", rounds=100, steps=9, campaign_utc=times[0], **QUIET)
    records.replay(
        "piqp", rounds=4, steps=9, campaign_utc=times[1], **QUIET | {"disturbed_rounds": 4}
    )
    topic = build_trust_topic(records.view())
    assert topic is not None
    (load,) = (line for line in topic.lines if "4 of 8 rounds disturbed" in line)
    assert load.startswith("Other load disturbed the machine: ")
    assert "quiet (command of 2026-11-28 08:00:00 UTC)" in load


def test_a_replay_that_is_worse_than_the_limits_alone_is_counted(records: Any) -> None:
    """One disturbed round is few among 30, but half of the 2 rounds of one replay."""
    for solver in ("daqp", "osqp", "piqp"):
        records.replay(solver, rounds=10, steps=9, **QUIET)
    records.replay("quadprog", rounds=1, steps=9, **QUIET | {"disturbed_rounds": 1})
    topic = build_trust_topic(records.view())
    assert topic is not None
    (load,) = (
        line for line in topic.lines if line.startswith("Over all replays, the machine was quiet: ")
    )
    assert (
        "Over all replays, the machine was quiet: 4 of 32 rounds were repeated because "
        "other load disturbed them, and 1 " in load
    )
    assert load.endswith("remained disturbed (3.1 %, limit 5 %).")
    assert "Taken one by one, 1 of 4 replays " in topic.tables[0].note
    assert (
        "exceeded a limit for a quiet machine (5 % disturbed rounds). For times from these, "
        in topic.tables[0].note
    )
