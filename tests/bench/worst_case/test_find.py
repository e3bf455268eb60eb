"""The search: what it finds is worse than the scenario itself, and replays to the same figures."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from dpbench import InputError, load_results, load_scenario, load_sequence, open_workspace, replay
from dpbench.bench.judge.evaluation import CERTIFICATES, EVALUATION, EvaluatedCell
from dpbench.bench.plan.suite import build_sequence_suite
from dpbench.bench.run.exact_loop import record_sequence
from dpbench.bench.sequences.sequence_file import load_recorded
from dpbench.bench.workers import child as supervise
from dpbench.bench.worst_case import search as case_search
from dpbench.bench.worst_case.find import find_worst_case
from dpbench.bench.worst_case.search import find_worst_step
from dpbench.bench.worst_case.space import SearchSpace
from dpbench.cli.main import main
from dpbench.qp.program import QPSequence
from dpbench.qp.solution import Status
from dpbench.scenario.scenario import Scenario, build_scenario_from_documents

pytestmark = pytest.mark.slow

FAULTY = Path(__file__).with_name("faulty_searched.py")
BIG = 1e9
"""A claimed error beyond anything a limited plan can have."""


@pytest.mark.parametrize(
    ("solver", "route", "policy", "goal"),
    [("daqp", "native", "warm", "iterations"), ("piqp", "qpsolvers", "fresh", "error")],
)
def test_replay_of_a_case(solver: str, route: Any, policy: Any, goal: Any, tmp_path: Path) -> None:
    path = tmp_path / "found.npz"
    found = find_worst_case(solver, goal=goal, route=route, policy=policy, budget=16, out=path)
    assert found.worst is not None and found.search.evaluations == 16
    assert found.beats_baseline, found.lines
    run = replay(load_sequence(path), open_workspace(solver, route=route, policy=policy), repeats=2)
    meta = load_sequence(path).meta
    counting = run.steps[~run.steps["warmup"]]
    step = counting[counting["k"] == meta["worst_case_step"]]
    assert len(step) == 2
    assert (step["iterations"] == meta["worst_case_iterations"]).all()
    saved = float(meta["worst_case_error_plan"])
    np.testing.assert_allclose(step["error_plan"], saved, rtol=1e-12)
    column = "iterations" if goal == "iterations" else "error_plan"
    assert counting[column].max() == step[column].max()


def test_the_command_replays_what_is_found_in_the_way_it_was_found(tmp_path: Path) -> None:
    """`dpbench run --sequence` shows the searched count, which the default route does not know."""
    found, out = tmp_path / "found.npz", tmp_path / "out"
    find_worst_case("daqp", policy="warm", settings="low", budget=9, steps=12, out=found)
    command = ["run", "--sequence", str(found), "--solver", "daqp", "--out", str(out)]
    assert main(command) == 0
    results, meta = load_results(out), load_sequence(found).meta
    runs = results.runs.set_index(["route", "policy", "settings"])["run_id"]
    assert sorted(runs.index)[0] == ("native", "warm", "low") and len(runs) == 3
    steps = results.steps[
        (results.steps["k"] == meta["worst_case_step"]) & ~results.steps["warmup"]
    ]
    searched = steps[steps["run_id"] == runs["native", "warm", "low"]]
    assert (searched["iterations"] == meta["worst_case_iterations"]).all() and len(searched) > 0
    np.testing.assert_allclose(
        searched["error_plan"], float(meta["worst_case_error_plan"]), rtol=1e-12
    )
    plain = steps[steps["run_id"] == runs["qpsolvers", "fresh", "default"]]
    assert plain["iterations"].isna().all() and len(plain) > 0


def test_a_way_that_cannot_be_is_not_replayed() -> None:
    plain = build_sequence_suite("x.npz")
    assert build_sequence_suite("x.npz", {"worst_case_route": "native"}) == plain
    for key, nonsense in (("route", "sideways"), ("policy", 3), ("settings", ["best"])):
        way = {
            "worst_case_route": "native",
            "worst_case_policy": "warm",
            "worst_case_settings": "low",
        }
        assert len(build_sequence_suite("x.npz", way).recorded) == 2
        assert build_sequence_suite("x.npz", way | {f"worst_case_{key}": nonsense}) == plain


def test_a_case_found_with_options_is_replayed_with_them(tmp_path: Path) -> None:
    """With the options in brackets, as not every solver has them; the report shows its step."""
    path, choice = tmp_path / "found.npz", "osqp[rho=1.6,max_iter=75]"
    found = find_worst_case(choice, budget=1, steps=4, out=path)
    assert found.lines[0].startswith("osqp native fresh max_iter=75,rho=1.6: 75 iterations (max_")
    meta = load_sequence(path).meta
    report = build_sequence_suite(path, meta).report
    assert (report.step, report.configuration) == (
        meta["worst_case_step"],
        "osqp (native fresh, max_iter=75,rho=1.6)",
    )
    out = tmp_path / "out"
    command = ["run", "--sequence", str(path), "--solver", choice, "--route", "native"]
    main([*command, "--out", str(out)])
    steps = load_results(out).steps
    worst = steps[(steps["k"] == meta["worst_case_step"]) & ~steps["warmup"]]
    assert (worst["iterations"] == 75).all() and len(worst) > 0


def test_the_documents_make_the_same_sequence_again(tmp_path: Path) -> None:
    path = tmp_path / "found.npz"
    find_worst_case("daqp", scenario="turn", budget=3, steps=12, out=path)
    saved = load_sequence(path)
    again = record_sequence(build_scenario_from_documents(saved.documents))
    assert again.P is not None, "each step of a turn has a matrix of its own"
    for name in ("q", "l", "u", "P"):
        np.testing.assert_array_equal(getattr(again, name), getattr(saved, name))
    assert again.units is not None and saved.units is not None
    np.testing.assert_array_equal(again.units.z, saved.units.z)


def test_the_seed_decides(tmp_path: Path) -> None:
    files = [tmp_path / f"{i}.npz" for i in range(3)]
    for path, seed in zip(files, (1, 1, 2), strict=True):
        find_worst_case("daqp", route="native", budget=9, steps=8, seed=seed, out=path)
    assert files[0].read_bytes() == files[1].read_bytes()
    assert (load_sequence(files[0]).q != load_sequence(files[2]).q).any()


def backs_off(path: Path) -> bool:
    """True where a certified optimum of a saved case changes the surge force astern at full
    rate."""
    optima = load_recorded(path).optima
    assert optima is not None
    return any(optimum.z[0] < -0.99 for optimum in optima)


@pytest.mark.alone  # What else runs could use up limits of 0.3 s.
@pytest.mark.parametrize(("mode", "outcome"), [("crash", "crashed"), ("hang", "hung")])
def test_a_solver_that_dies_or_hangs_does_not_end_the_search(
    mode: str, outcome: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(case_search, "CASE_LIMIT_S", 0.3)
    monkeypatch.setattr(case_search, "BASELINE_LIMIT_S", 0.3)
    monkeypatch.setattr(supervise, "GRACE_S", 0.3)
    module = tmp_path / "faulty_searched.py"
    module.write_text(FAULTY.read_text(encoding="utf-8").replace('"none"', f'"{mode}"'))
    out = tmp_path / "found.npz"
    found = find_worst_case(
        "searched", goal="error", budget=12, steps=6, out=out, solver_module=module
    )
    count, _ = found.search.failures[outcome]
    assert 0 < count < 12 and found.search.evaluations == 12
    assert backs_off(found.failures[outcome]) and not backs_off(out)
    assert load_sequence(found.failures[outcome]).meta["worst_case_outcome"] == outcome
    assert any(f"in {count} cases" in line for line in found.lines)


class _Interrupts:
    """A person who presses Ctrl-C after so many cases."""

    def __init__(self, after: int) -> None:
        self._left = after

    def start(self, work: int) -> None:
        """Nothing yet."""

    def advance(self, work: int, what: str) -> None:
        self._left -= work
        if self._left == 0:
            raise KeyboardInterrupt


def test_ctrl_c_keeps_the_best_so_far(tmp_path: Path) -> None:
    path = tmp_path / "found.npz"
    found = find_worst_case("daqp", budget=50, steps=8, out=path, progress=_Interrupts(4))
    assert (found.search.evaluations, found.search.stopped) == (4, "interrupted")
    assert len(load_sequence(path)) == 8
    assert "4 cases tried (interrupted)" in found.lines[0]


Row = tuple[Status, float, bool, int, str]


def judged(*rows: Row) -> EvaluatedCell:
    """A replay of a warm-up step, which must not count, and a row per answer."""
    all_rows: list[Row] = [(Status.SOLVED, BIG, False, 10**6, "linear"), *rows]
    status, error, true, iterations, kind = zip(*all_rows, strict=True)
    evaluations = np.zeros((len(all_rows), len(EVALUATION)))
    evaluations[:, EVALUATION.index("error_plan")], evaluations[:, EVALUATION.index("true")] = (
        error,
        true,
    )
    columns = {
        "repeat": np.array([0] + [1] * len(rows)),
        "k": np.array([0, *range(len(rows))]),
        "status": np.array(status),
        "iterations": np.array(iterations),
        "certificate": np.array([CERTIFICATES.index(name) for name in kind]),
        "evaluations": evaluations,
    }
    return EvaluatedCell(columns, {})


ACCURATE: Row = (Status.SOLVED, 1e-9, True, 5, "linear")
POOR: Row = (Status.SOLVED, 5e-3, True, 5, "linear")
NO_ANSWER: Row = (Status.ERROR, np.inf, False, 1, "linear")
DECLINED_BUT_RIGHT: Row = (Status.MAX_ITERATIONS, 1e-12, True, 900, "linear")
WRONG: Row = (Status.SOLVED, 0.05, False, 7, "linear")
FALSE_INFEASIBLE: Row = (Status.PRIMAL_INFEASIBLE, 0.0, False, 3, "linear")
TRUE_INFEASIBLE: Row = (Status.PRIMAL_INFEASIBLE, np.nan, True, 3, "infeasible")
SOLVED_THE_IMPOSSIBLE: Row = (Status.SOLVED, np.nan, False, 3, "infeasible")


def test_a_lie_is_worse_than_a_refusal_and_a_refusal_worse_than_a_poor_answer() -> None:
    order = (TRUE_INFEASIBLE, DECLINED_BUT_RIGHT, ACCURATE, POOR, NO_ANSWER, WRONG)
    for i, better in enumerate(order):
        for worse in order[i + 1 :]:
            found = find_worst_step(judged(better, worse, better), "error")
            assert found is not None and found.step == 1, (better, worse)
    for lie in (FALSE_INFEASIBLE, SOLVED_THE_IMPOSSIBLE):
        found = find_worst_step(judged(WRONG, lie), "error")
        assert found is not None and found.step == 1 and np.isinf(found.objective)
        assert np.isfinite(found.score), "a search can climb it"


def test_an_error_that_is_not_claimed_says_what_it_counts_as() -> None:
    refused = find_worst_step(judged((Status.MAX_ITERATIONS, 75.0, False, 9, "linear")), "error")
    lied = find_worst_step(judged(WRONG), "error")
    assert refused is not None and lied is not None and lied.objective > refused.objective
    assert refused.describe_figure("error").endswith("(max_iterations, which counts as 0.01)")
    assert lied.describe_figure("error") == "error_plan 5.00e-02 (claimed)"


def test_iterations_are_counted_whatever_the_answer() -> None:
    found = find_worst_step(judged(WRONG, DECLINED_BUT_RIGHT, ACCURATE), "iterations")
    assert found is not None and (found.step, found.iterations) == (1, 900)
    busier = find_worst_step(judged(ACCURATE, WRONG, WRONG), "iterations")
    idler = find_worst_step(judged(ACCURATE, ACCURATE, WRONG), "iterations")
    assert busier is not None and idler is not None
    assert busier.objective == idler.objective and busier.score > idler.score
    assert int(busier.score) == int(idler.score) == 7
    assert find_worst_step(judged((Status.SOLVED, 0.0, True, -1, "linear")), "iterations") is None


@given(point=st.lists(st.floats(-1.0, 1.0), min_size=13, max_size=13).map(np.array))
@settings(max_examples=30, deadline=None)
def test_a_case_is_what_its_point_says(point: Any) -> None:
    own = load_scenario("paper")
    scenario = SearchSpace(own, 20, "case").build_variant(point)
    assert (scenario.steps, scenario.problem.N_p, scenario.name) == (20, own.problem.N_p, "case")
    assert (np.abs(scenario.start) <= [20.0, 20.0, np.radians(20.0) + 1e-12]).all()
    np.testing.assert_array_equal(np.sign(scenario.start), np.sign(point[:3] * np.abs(point[:3])))
    assert (np.abs(scenario.velocity) <= [1.0, 1.0, np.radians(1.0) + 1e-12]).all()
    np.testing.assert_array_equal(
        np.sign(scenario.velocity), np.sign(point[3:6] * np.abs(point[3:6]))
    )
    limit = np.array([980e3, 417e3, 18e6])
    sinusoid = own.environment
    begins = 0.5 * (1.0 + point[12]) * 19 * 0.3
    early, late = (
        scenario.environment.compute_slow_forces_and_squalls(t)
        - sinusoid.compute_slow_forces_and_squalls(t)
        for t in (begins, begins + 0.3)
    )
    np.testing.assert_allclose(early, point[6:9] * limit, atol=1e-6)
    np.testing.assert_allclose(late - early, 2.0 * point[9:12] * limit, atol=1e-3)


def test_a_fault_of_the_scenario_happens_within_the_case() -> None:
    space = SearchSpace(load_scenario("thruster_loss"), 20, "case")
    assert space.dimensions == 14
    faults = [
        space.build_variant(np.array([0.0] * 13 + [x])).controller.changes[0][0]
        for x in (-1.0, 0.0, 1.0)
    ]
    assert faults[0] == 0 and faults[1] in (9, 10) and faults[2] == 19


def test_a_model_ship_is_pushed_by_what_it_can_hold() -> None:
    model = load_scenario("calm@cybership2")
    point = np.array([0.0] * 3 + [1.0, 0.0, 0.0] + [1.0] * 3 + [0.0] * 4)
    scenario = SearchSpace(model, 20, "case").build_variant(point)
    np.testing.assert_allclose(scenario.velocity, [70**-0.5, 0.0, 0.0], rtol=1e-12)
    np.testing.assert_allclose(
        scenario.environment.mean, np.minimum(-model.vessel.tau_min, model.vessel.tau_max)
    )


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["nobody"], "nobody"),
        (["daqp", "--goal", "speed"], "--goal"),
        (["daqp", "--budget", "0"], "--budget"),
        (["daqp", "--steps", "0"], "--steps"),
        (["daqp", "--steps", "1000000000"], "--steps"),
        (["daqp", "--seed", "-1"], "--seed"),
        (["daqp", "--route", "sideways"], "route: found 'sideways'"),
        (["daqp", "--policy", "hot"], "policy: found 'hot'"),
        (["quadprog", "--policy", "warm"], "policy: found 'warm'"),
        (["daqp", "--settings", "best"], "'best'"),
        (["osqp[rhoo=1.6]"], "settings of osqp: rhoo: found an unknown option"),
        (["osqp[rho=[1,2]]"], "worst-case: found osqp[rho=[1,2]]; allowed: one value per option"),
        (
            ["osqp[rho=1]", "--settings", "high"],
            "with the options of osqp; allowed: a preset or options, not both",
        ),
        (["daqp", "--out", "found.txt"], "--out"),
        (["daqp", "--scenario", "nowhere"], "nowhere"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 2 and one line that names the mistake, before anything runs."""
    assert main(["worst-case", *arguments]) == 2
    said = capsys.readouterr().err.strip()
    assert named in said and len(said.splitlines()) == 1


@pytest.mark.parametrize("place", ["a_folder.npz", "a_file/found.npz"])
def test_where_nothing_can_be_written_nothing_is_searched(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(case_search.Search, "run", None)
    (tmp_path / "a_folder.npz").mkdir()
    (tmp_path / "a_file").write_text("mine", encoding="utf-8")
    before = sorted(tmp_path.rglob("*"))
    assert main(["worst-case", "daqp", "--out", str(tmp_path / place)]) == 2
    said = capsys.readouterr().err.strip()
    assert "--out" in said and place.rpartition("/")[2] in said and len(said.splitlines()) == 1
    assert sorted(tmp_path.rglob("*")) == before


def test_iterations_of_a_solver_that_counts_none_are_refused_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a few steps, without a file or folder, and without naming an option not given."""
    recorded = []

    def record(scenario: Scenario) -> QPSequence:
        recorded.append(scenario.steps)
        return record_sequence(scenario)

    monkeypatch.setattr(case_search, "record_sequence", record)
    out = tmp_path / "deep" / "found.npz"
    with pytest.raises(InputError, match=r"^solver searched: .*--goal error"):
        find_worst_case("searched", budget=2, steps=4, out=out, solver_module=FAULTY)
    assert recorded == [case_search.FIRST_STEPS] and not any(tmp_path.iterdir())


def test_the_command_prints_findings(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "deep" / "found.npz"
    arguments = ["worst-case", "daqp", "--route", "native", "--budget", "8", "--out", str(out)]
    assert main(arguments) == 0
    said = " ".join(capsys.readouterr().out.split())
    meta = load_sequence(out).meta
    assert f"{meta['worst_case_iterations']} iterations" in said and str(out) in said
    assert "1000 steps of the unchanged scenario paper" in said
