"""The backup steps in where the first solver fails or is late, and never as if it had more time."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dpbench import load_scenario, open_workspace, run_closed_loop
from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.suite import ClosedLoopTable, SuiteFile
from dpbench.bench.record.raw_log import BackupLog, RawLog, make_loop_layout
from dpbench.bench.run.backup import WARM_UP_SOLVES, Backup
from dpbench.bench.run.slow_computer import ComputationalDelay
from dpbench.errors import InputError, UnknownNameError
from dpbench.qp.program import QPStep, QuadraticProgram
from dpbench.qp.solution import Solution, Status
from dpbench.scenario.scenario import Scenario
from dpbench.solvers.contract import Workspace
from tests.bench.run.loops import SAMPLE_NS, Planned, run_loop, surge_steps

FAILED = Status.NUMERICAL_ERROR


class FailingAt(Workspace):
    """The right answers but in the stated steps, where it has none and says so."""

    def __init__(self, steps: set[int], solver: str = "paper_active_set") -> None:
        super().__init__("failing", "native", "fresh")
        self.setup_every_step = True
        self._steps, self._k, self._inner = steps, -1, open_workspace(solver)

    def setup(self, qp: QuadraticProgram) -> None:
        self._k += 1
        self._inner.setup(qp)

    def update(self, step: QPStep) -> None:
        raise AssertionError("set up at every step")

    def solve(self) -> None:
        self._inner.solve()

    def read(self) -> Solution:
        answer = self._inner.read()
        if self._k not in self._steps:
            return answer
        return Solution.without_point(len(answer.z), len(answer.y), FAILED, "forced")


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario("paper").truncate(12)


def of_backup(log: RawLog) -> BackupLog:
    assert log.backup is not None
    return log.backup


def steps_of(log: RawLog) -> tuple[list[int], list[int]]:
    """The steps in which the backup was asked, and those in which its plan was applied."""
    backup = of_backup(log)
    asked = np.flatnonzero(backup.times[0, :, 3] >= 0)
    return asked.tolist(), np.flatnonzero(backup.acted).tolist()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "steps", "backup"), [("paper", 40, "daqp"), ("turn", 60, "paper_active_set")]
)
def test_a_right_backup_makes_failures_harmless(name: str, steps: int, backup: str) -> None:
    scenario = load_scenario(name).truncate(steps)
    failing = {0, 3, 4, *range(20, steps, 2)}
    run = run_closed_loop(scenario, FailingAt(failing), backup=backup)
    undisturbed = run_closed_loop(scenario, open_workspace("paper_active_set"))
    for column in ("n_m", "e_m", "psi_rad"):
        np.testing.assert_allclose(run.steps[column], undisturbed.steps[column], atol=1e-9)
    row = run.summary
    counts = row["backup_asked"], row["backup_acted"], row["fallbacks"], row["failed_steps"]
    assert counts == (len(failing),) * 4
    assert row["backup_failures"] == 0 and row["backup_error_max"] < 1e-9
    assert set(run.steps["k"][run.steps["backup"]]) == failing
    assert (run.steps["backup_ns"].notna() == run.steps["backup"]).all()
    assert run.scenario is not None and row["scenario"] == f"{name} (backup {backup})"


def test_when_both_fail_the_fallback_acts(scenario: Scenario) -> None:
    """Steps 4 to 6 have no answer of either: the force is held, and the failures are counted."""
    first, second = FailingAt({4, 5, 6}), FailingAt({WARM_UP_SOLVES + i for i in range(3)})
    log, complete = run_loop(scenario, first, "hold", backup=second)
    assert complete and steps_of(log) == ([4, 5, 6], [])
    np.testing.assert_array_equal(log.tau[4:7], np.repeat(log.tau[3:4], 3, axis=0))
    assert np.flatnonzero(log.flags[:, 0]).tolist() == [4, 5, 6]


def test_no_backup_by_default(scenario: Scenario, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Backup, "__init__", None)
    run = run_closed_loop(scenario, FailingAt({3}))
    assert not run.steps["backup"].any() and run.summary["backup_asked"] is pd.NA
    assert not any(name.startswith("backup.") for name in make_loop_layout(3, 15, 15, 16))


def slow(
    scenario: Scenario, first_s: float, backup_s: float, budget: float, *, fails: bool = False
) -> tuple[RawLog, list[float]]:
    """Return the log and first forces of a slow computer; latencies and budget in samples.

    The first solver is late, or fails, in every step. It plans +0.5, the backup −0.5 rate-limit
    steps at once.
    """
    status, now_ns = FAILED if fails else Status.SOLVED, [0]
    first = Planned(lambda i: first_s, status, (0.5, 0, 0, 0, 0), now_ns)
    second = Planned(lambda i: backup_s, Status.SOLVED, (-0.5, 0, 0, 0, 0), now_ns)
    delay = ComputationalDelay(1.0, round(budget * SAMPLE_NS), SAMPLE_NS)
    log, complete = run_loop(scenario, first, "hold", clock=first.clock, backup=second, delay=delay)
    assert complete
    return log, surge_steps(log, scenario)[:4]


def test_a_failure_in_time_leaves_the_backup_the_rest_of_the_budget(scenario: Scenario) -> None:
    """0.2 + 0.3 samples are within 0.6: the backup's move is applied in the step itself."""
    log, forces = slow(scenario, 0.2, 0.3, 0.6, fails=True)
    assert forces == [-0.5, -1.0, -1.5, -2.0]
    assert steps_of(log) == ([*range(12)], [*range(12)])
    assert of_backup(log).ready_ns[0] == SAMPLE_NS // 2


def test_behind_the_deadline_its_plan_arrives_at_the_next_sample(scenario: Scenario) -> None:
    """Stopped at 0.6, the first leaves the backup until 0.9: its second force acts from step 1."""
    log, forces = slow(scenario, 2.5, 0.3, 0.6)
    assert forces == [0.0, -0.5, -0.5, -1.0]
    assert steps_of(log) == ([*range(12)], [*range(1, 12)])
    assert of_backup(log).ready_ns[0] == round(0.9 * SAMPLE_NS)
    # No step is busy: the first was stopped, not waited for.
    assert (log.latency_ns == round(2.5 * SAMPLE_NS)).all()
    assert log.flags[:, 0].all()


def test_a_backup_that_would_end_beyond_the_sample_does_not_act(scenario: Scenario) -> None:
    """0.6 + 0.5 samples are more than one: it is stopped, and the force is held."""
    log, forces = slow(scenario, 2.5, 0.5, 0.6)
    assert forces == [0.0] * 4
    assert steps_of(log) == ([*range(12)], [])


def test_a_deadline_of_the_whole_sample_leaves_a_late_backup_no_time(scenario: Scenario) -> None:
    """A late answer arrives as without a backup, at sample 3 with its fourth force."""
    log, forces = slow(scenario, 2.5, 0.1, 1.0)
    assert forces == [0.0, 0.0, 0.0, 0.5]
    assert steps_of(log) == ([], [])
    _, forces = slow(scenario, 0.2, 0.1, 1.0, fails=True)
    assert forces == [-0.5, -1.0, -1.5, -2.0]


def suite(**keys: object) -> SuiteFile:
    table = ClosedLoopTable.model_validate({"scenarios": ["paper"], "steps": 5, **keys})
    return SuiteFile(title="backup", solvers=["quadprog"], closed_loop=[table])


def test_a_suite_names_its_backup() -> None:
    (plain,) = plan_suite(suite(), solvers=["quadprog"])
    (backed,) = plan_suite(suite(backup="daqp", fallback="hold"), solvers=["quadprog"])
    assert backed.cell.backup == "daqp" and "backup" not in plain.cell.to_json()
    assert backed.cell.scenario_name == "paper (backup daqp, hold)"
    assert backed.cell.key != plain.cell.key


def test_an_unknown_backup_is_one_line() -> None:
    with pytest.raises(
        UnknownNameError, match=r"closed_loop.backup: found 'dapq'; allowed: daqp, "
    ):
        plan_suite(suite(backup="dapq"))


def test_an_unknown_backup_of_a_loop_names_its_argument(scenario: Scenario) -> None:
    with pytest.raises(UnknownNameError, match=r"^`backup`: found 'dapq'; allowed: daqp, "):
        run_closed_loop(scenario, "daqp", backup="dapq")


def test_a_backup_from_a_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from dpbench.bench.plan import configurations

    monkeypatch.setattr(
        configurations, "find_plugin_file", lambda solver: str(tmp_path / "mine.py")
    )
    with pytest.raises(InputError, match=r"closed_loop.backup: found 'daqp'"):
        plan_suite(suite(backup="daqp"))
