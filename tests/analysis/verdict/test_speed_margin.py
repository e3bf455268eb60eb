"""Speed margin of a solver, from steps that are timed several times."""

import json
import math
from typing import Any

import pytest

from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.time_findings import (
    SpeedMargin,
    compute_speed_margins,
    find_largest_stall_ns,
)
from dpbench.analysis.verdict.verdict import judge_solvers
from dpbench.solvers.calibration import COPY_ONLY

REQUIREMENTS = Requirements()


def _margin(records: Any) -> SpeedMargin:
    (margin,) = compute_speed_margins(records.view(), REQUIREMENTS).values()
    return margin


def _window(records: Any, of: int, slow: dict[int, float], **columns: Any) -> None:
    """A window of 30 steps of 20 µs from sample 210 of `turn` on, some of them slower."""
    cell = {
        "scenario": records.scenario("turn").files,
        "source": {"kind": "hardest", "name": "turn hardest 30", "of": of},
    }
    records.replay(
        "daqp",
        "turn hardest 30",
        steps=30,
        median_us=20.0,
        spread=0.0,
        slow=slow,
        cell=json.dumps(cell),
        first_sample=210,
        **columns,
    )


def test_the_margin_is_that_of_the_hardest_step_and_of_the_p99(records: Any) -> None:
    """Steps of 20 µs with one of 60 µs: 300 ms / 60 µs, and 3 ms / 20 µs, which is less."""
    records.replay("daqp", median_us=20.0, spread=0.0, slow={500: 3.0})
    margin = _margin(records)
    assert margin.deadline == pytest.approx(5000.0, rel=1e-4)
    assert margin.p99_limit == pytest.approx(150.0, rel=1e-4)
    assert margin.allowed_slowness_factor == margin.p99_limit
    assert (margin.hardest.k, margin.hardest.run.scenario) == (500, "paper")
    assert margin.hardest.iterations == 5 + 500 % 4


def test_a_stall_changes_no_margin(records: Any) -> None:
    """One timing of 9 ms in one round: the step is timed in the others."""
    records.replay("daqp", median_us=20.0, spread=0.0)
    quiet = _margin(records)
    frame = records._steps[-1]
    frame.loc[(frame["repeat"] == 2) & (frame["k"] == 7), "total_ns"] = 9_000_000
    assert _margin(records).allowed_slowness_factor == quiet.allowed_slowness_factor


def test_without_a_p99_the_hardest_step_has_to_keep_its_limit(records: Any) -> None:
    """No step of 300 is known to be allowed beyond the limit: 3 ms / 60 µs."""
    records.replay("daqp", steps=300, median_us=20.0, spread=0.0, slow={50: 3.0})
    assert _margin(records).p99_limit == pytest.approx(50.0, rel=1e-4)


def test_a_window_has_the_p99_of_its_stretch(records: Any) -> None:
    """Four steps of 450 may be slower: of 200, 160, 120, 80 and 60 µs it is the fifth."""
    records.replay("daqp", median_us=20.0, spread=0.0)
    _window(records, 450, {3: 10.0, 4: 8.0, 10: 6.0, 11: 4.0, 12: 3.0})
    margin = _margin(records)
    assert margin.hardest.time_ns == pytest.approx(200e3, rel=1e-4)
    assert margin.hardest.k == 213
    assert margin.p99.time_ns == pytest.approx(60e3, rel=1e-4)
    assert (margin.p99.k, margin.p99.run.scenario) == (222, "turn")


@pytest.mark.parametrize(("late", "state"), [(4, "pass"), (5, "late")])
def test_late_steps_of_a_window_beyond_a_hundredth_of_its_stretch(
    records: Any, late: int, state: str
) -> None:
    """Four steps of 450 may take 10 ms, five may not, whatever the others take."""
    records.loop("daqp", "turn")
    records.replay("daqp", median_us=20.0, spread=0.0)
    _window(records, 450, dict.fromkeys(range(late), 500.0))
    (verdict,) = judge_solvers(records.view(), REQUIREMENTS).verdicts_on_references
    assert verdict.state == state
    assert (verdict.replays, verdict.windows) == (1, 1)


def test_the_largest_stall_is_that_of_a_calibration_run(records: Any) -> None:
    """A timing of 5 ms where the fastest round took 20 µs; a solver's own is none of them."""
    assert math.isnan(find_largest_stall_ns(records.view()))
    records.replay(COPY_ONLY, median_us=20.0, spread=0.0, route="native", policy="reuse")
    assert math.isnan(find_largest_stall_ns(records.view())), "no delay"
    frame = records._steps[-1]
    frame.loc[(frame["repeat"] == 2) & (frame["k"] == 7), "total_ns"] = 5_000_000
    records.replay("daqp", median_us=20.0, spread=0.0)
    assert find_largest_stall_ns(records.view()) == pytest.approx(4.98e6, rel=1e-4)


def test_a_short_replay_bounds_the_deadline_alone(records: Any) -> None:
    """300 steps of 60 µs support no p99: that of 1000 steps of 20 µs holds."""
    records.replay("daqp", median_us=20.0, spread=0.0)
    records.replay("daqp", "calm", steps=300, median_us=60.0, spread=0.0)
    margin = _margin(records)
    assert (margin.hardest.run.sequence, margin.p99.run.sequence) == ("calm", "paper")
    assert margin.deadline == pytest.approx(5000.0, rel=1e-4)
    assert margin.p99_limit == pytest.approx(150.0, rel=1e-4)


def test_the_largest_p99_of_two_replays(records: Any) -> None:
    """The p99 is that of the slower replay, the hardest step that of the other."""
    records.replay("daqp", median_us=20.0, spread=0.0, slow={700: 9.0})
    records.replay("daqp", "calm", median_us=40.0, spread=0.0)
    margin = _margin(records)
    assert (margin.hardest.run.sequence, margin.hardest.k) == ("paper", 700)
    assert margin.p99.run.sequence == "calm"
    assert margin.p99_limit == pytest.approx(75.0, rel=1e-4)


def test_only_scaled_replays_with_steps_have_a_margin(records: Any) -> None:
    records.loop("scs")
    records.replay("scs", done=0)
    records.replay("scs", units="si")
    records.replay("daqp", median_us=20.0, spread=0.0)
    records.replay("daqp", median_us=30.0, spread=0.0, settings="high")
    margins = compute_speed_margins(records.view(), REQUIREMENTS)
    limits = {(c.solver, c.settings): round(margin.p99_limit) for c, margin in margins.items()}
    assert limits == {("daqp", "default"): 150, ("daqp", "high"): 100}
