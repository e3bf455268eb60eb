"""Length of the run of a slow configuration: rounds within a budget, limits, known waits."""

from collections.abc import Iterator

import pytest

from dpbench import load_scenario, record_sequence
from dpbench.bench.record.raw_log import RawLog, make_replay_layout
from dpbench.bench.record.result_folder import Results, load_results
from dpbench.bench.run.formulation import formulate_sequence
from dpbench.bench.run.replay import ReplayRun
from dpbench.bench.run.timed_solver import RunDelay, TimedSolver
from dpbench.bench.workers.interleaved import FEWEST_ROUNDS
from dpbench.solvers.calibration import NO_OP, open_calibration_solver
from tests.bench.deterministic import run_suite, suite_toml

# A budget of 0.04 s, in which a machine to itself does few rounds.
pytestmark = pytest.mark.alone

STEPS, ROUNDS = 20, 6
SUITE = suite_toml(
    **{"solvers": ["daqp", "busy_wait_1000us", "busy_wait_20us"], "cell_limit_s": 5.0},
    # Less than two rounds of a wait of 1 ms.
    **{"rounds": ROUNDS, "warmup_steps": 2, "replay_budget_s": 0.04},
    closed_loop=[{"scenarios": ["paper"], "steps": 10}],
    replay=[{"scenario": "paper", "steps": STEPS}],
)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    return load_results(run_suite(tmp_path_factory.mktemp("budgets"), SUITE))


def test_a_slow_configuration_has_fewer_rounds_and_is_finished(results: Results) -> None:
    runs = results.runs.set_index("solver")
    slow = runs.loc["busy_wait_1000us"]
    steps = results.steps[results.steps["run_id"] == slow["run_id"]]
    assert slow["outcome"] == "finished"
    # More than the fewest only to make up for rounds that the machine disturbed.
    seen, disturbed = steps["repeat"].max(), slow["disturbed_rounds"] + slow["rerun_rounds"]
    assert FEWEST_ROUNDS <= seen <= FEWEST_ROUNDS + disturbed
    assert (steps.groupby("repeat").size()[1:] == STEPS).all()


def test_both_kernels_are_timed_around_every_round() -> None:
    sequence = record_sequence(load_scenario("paper").truncate(3))
    now = iter(range(10**9))
    log = RawLog.in_memory(make_replay_layout(3, 3, sequence.base.n, sequence.base.m))
    made, formulated = formulate_sequence("condensed_box", sequence)
    timed_solver = TimedSolver(open_calibration_solver(NO_OP), formulated, lambda: next(now))
    configuration = ReplayRun(
        made, timed_solver, log, warmup_steps=1, limit_ns=10**9, clock=lambda: next(now), preroll=0
    )
    assert configuration.run_round(1)
    assert (log.reference_kernel_ns[1] == 1).all() and (log.load_kernel_ns[1] == 1).all()
    assert not log.reference_kernel_ns[2].any() and not log.load_kernel_ns[2].any()


def test_a_round_that_is_run_again_costs_a_configuration_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Its clock is none of this machine's.
    monkeypatch.setattr(RunDelay, "read_total_ns", lambda self: 0)
    sequence = record_sequence(load_scenario("paper").truncate(3))
    ticks = iter(range(0, 10**9, 1000))

    def clock() -> int:
        return next(ticks)

    def configuration_of(limit_ns: int) -> Iterator[bool]:
        log = RawLog.in_memory(make_replay_layout(3, 3, sequence.base.n, sequence.base.m))
        made, formulated = formulate_sequence("condensed_box", sequence)
        timed_solver = TimedSolver(open_calibration_solver(NO_OP), formulated, clock)
        configuration = ReplayRun(
            made, timed_solver, log, warmup_steps=1, limit_ns=limit_ns, clock=clock, preroll=0
        )
        return (configuration.run_round(r) for r in (1, 1, 1, 2))

    began = next(ticks)
    assert list(configuration_of(10**9)) == [True] * 4
    per_round = (next(ticks) - began) // 4
    # Room for two rounds and a half, each a quarter of what the four took with their kernel_ns.
    assert list(configuration_of(round(2.5 * per_round))) == [True] * 4
    assert not all(configuration_of(per_round // 20))
