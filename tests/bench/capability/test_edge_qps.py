"""The QPs at the edge: certified, of one shape, feasible before it and infeasible beyond."""

import math
from pathlib import Path

import numpy as np
import pytest

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.capability import build_capability_results
from dpbench.bench.campaign import run_campaign
from dpbench.bench.capability import edge_qps
from dpbench.bench.capability.frontier import FROM_DEG, Capability, CapabilityPlot, Case, WindLimit
from dpbench.bench.plan.plan import plan_suite
from dpbench.bench.plan.suite import CapabilityTable, SuiteFile, load_path_and_suite
from dpbench.bench.record.cell import CapabilitySource
from dpbench.bench.record.result_folder import load_results
from dpbench.bench.sequences.capability_boundary import write_capability_suite
from dpbench.bench.sequences.sequence_file import load_recorded
from dpbench.errors import InputError, ResultsError
from dpbench.qp.referee.referee import certify_all_steps
from dpbench.report.write import write_report
from dpbench.scenario.scenario import load_vessel
from dpbench.ship.capability.loads import DP_CONDITIONS
from tests.bench.deterministic import suite_file, suite_toml

SOME = (0.0, 20.0, 100.0, 200.0)


@pytest.fixture(scope="module")
def frontier() -> CapabilityPlot:
    return CapabilityPlot(load_vessel("ratownik"), 24)


@pytest.fixture(scope="module")
def points(frontier: CapabilityPlot) -> list[edge_qps.Point]:
    return [
        point
        for case in frontier.intact_and_failure_cases
        for from_rad in map(math.radians, SOME)
        for point in edge_qps.list_points_at_limit(
            case, from_rad, frontier.find_wind_limit(case, from_rad)
        )
    ]


def test_a_direction_has_four_points_around_its_edge() -> None:
    points = edge_qps.list_points_at_limit(Case("intact", frozenset()), 0.1, WindLimit(15.0, 6))
    winds = [
        DP_CONDITIONS[6][0],
        (1 - edge_qps.EDGE) * 15.0,
        (1 + edge_qps.EDGE) * 15.0,
        DP_CONDITIONS[7][0],
    ]
    assert [point.wind_mps for point in points] == winds
    assert [point.held for point in points] == [True, True, False, False]
    top = edge_qps.list_points_at_limit(Case("intact", frozenset()), 0.1, WindLimit(32.6, 11))
    assert [point.wind_mps for point in top] == [DP_CONDITIONS[row][0] for row in (8, 9, 10, 11)]
    assert all(point.held for point in top)
    nothing = edge_qps.list_points_at_limit(Case("intact", frozenset()), 0.1, WindLimit(1.0, 0))
    assert [point.wind_mps for point in nothing] == [
        0.5,
        1 - edge_qps.EDGE,
        1 + edge_qps.EDGE,
        DP_CONDITIONS[1][0],
    ]


@pytest.mark.slow
def test_the_referee_agrees(frontier: CapabilityPlot, points: list[edge_qps.Point]) -> None:
    sequence = edge_qps.build_allocation_sequence(frontier, points)
    assert len(sequence) == len(points) == 4 * len(SOME) * 4
    for point, optimum in zip(points, certify_all_steps(sequence), strict=True):
        assert (optimum.kind == "infeasible") is not point.held
        assert not point.held or optimum.bound < 1e-10


def made_up(frontier: CapabilityPlot) -> Capability:
    known = {
        case.name: tuple(WindLimit(10.0 + k % 3, 4) for k in range(len(FROM_DEG)))
        for case in frontier.intact_and_failure_cases
    }
    return Capability("ratownik", 24, known, dict.fromkeys(known, ("bow 1",)), ())


@pytest.mark.slow
def test_a_plot_of_a_suite_is_a_row_a_qp(frontier: CapabilityPlot, tmp_path: Path) -> None:
    capability = made_up(frontier)
    points = edge_qps.list_points_at_all_limits(frontier, capability)
    assert edge_qps.load_capability_plots(tmp_path) is None
    edge_qps.write_capability_plots(
        tmp_path, [edge_qps.make_capability_columns("some name", capability, points)]
    )
    found = edge_qps.load_capability_plots(tmp_path)
    assert found is not None
    assert list(found) == list(edge_qps.COLUMNS)
    assert found["k"].tolist() == list(range(len(points)))
    assert found["wind_mps"].tolist() == [point.wind_mps for point in points]
    assert found["from_deg"].iloc[:8].tolist() == 4 * [0.0] + 4 * [10.0]
    assert found["edge_mps"].iloc[4] == 11.0
    path = tmp_path / "capability.parquet"
    for column, value in (("case", "bow 1"), ("edge_mps", math.nan)):
        found.assign(**{column: value}).to_parquet(path)
        with pytest.raises(ResultsError, match=column):
            edge_qps.load_capability_plots(tmp_path)
    path.write_bytes(b"nothing")
    with pytest.raises(ResultsError, match=r"capability\.parquet"):
        edge_qps.load_capability_plots(tmp_path)


@pytest.mark.slow
def test_a_batch_runs_as_a_suite(frontier: CapabilityPlot, tmp_path: Path) -> None:
    capability = made_up(frontier)
    path, suite = load_path_and_suite(
        write_capability_suite(frontier, capability, tmp_path / "new")
    )
    assert path.parent == tmp_path / "new"
    assert suite.recorded[0].sequence == "capability.npz"
    recorded = load_recorded(path.parent / "capability.npz")
    assert recorded.optima is not None
    assert len(recorded.optima) == 4 * len(frontier.intact_and_failure_cases) * len(FROM_DEG)
    assert np.isfinite(recorded.sequence.l).all()


SUITE = suite_toml(
    solvers=["all"], capability=[{"vessel": "osv", "sides": 8, "routes": ["default", "native"]}]
)


def suite_of(**keys: object) -> SuiteFile:
    return SuiteFile(title="", capability=[CapabilityTable.model_validate(keys)])


def test_a_solver_has_a_cell_of_four_qps_a_direction_and_case() -> None:
    suite = suite_of(vessel="osv").model_copy(update={"calibration": True})
    (planned,) = plan_suite(suite, solvers=["quadprog"])
    cell = planned.cell
    assert (cell.steps, cell.rounds, cell.scenario) == (4 * 36 * 3, 1, {})
    assert cell.sequence == "osv capability, 16 sides"
    assert isinstance(cell.source, CapabilitySource) and cell.source.vessel_name == "osv"


@pytest.mark.parametrize(
    ("keys", "said"),
    [({"vessel": "supply_mss"}, "thrusters"), ({"vessel": "nowhere"}, "'nowhere'")],
)
def test_a_vessel_that_has_no_plot_is_refused(keys: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        plan_suite(suite_of(**keys), solvers=["quadprog"])


@pytest.mark.slow
def test_a_run_leaves_the_plot_and_answers_that_the_referee_judged(tmp_path: Path) -> None:
    suite, out = suite_file(tmp_path, SUITE), tmp_path / "out"
    run_campaign(suite, out, solvers=["quadprog"])
    table_of_run = edge_qps.load_capability_plots(out)
    assert table_of_run is not None
    (plot,) = build_capability_results(Records(load_results(out)), table_of_run)
    (answers,) = plot.answers
    assert answers.has_only_right_answers
    held = int(table_of_run["held"].sum())
    assert (answers.balanced, answers.refused) == (held, len(table_of_run) - held)
    assert len(plot.edges) == 36 * 3 and not plot.edges["untrue"].any()
    (out / "capability.parquet").unlink()
    run_campaign(suite, out, solvers=["quadprog"])
    assert edge_qps.load_capability_plots(out) is not None
    page = write_report(out).read_text(encoding="utf-8")
    assert 'id="answer"' in page and "1 of 1 solver answers all 432 QPs" in page
    assert (out / "figures" / "capability-osv.svg").is_file()
