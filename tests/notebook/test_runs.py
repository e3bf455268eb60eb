"""A run in this process: its length, its text, and the figures of the page."""

import inspect
import io
import json
import math
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dpbench import (
    InputError,
    QPSequence,
    QPStep,
    QuadraticProgram,
    Run,
    Solution,
    Status,
    UnknownNameError,
    certify,
    condense,
    load_scenario,
    load_sequence,
    open_workspace,
    opener,
    record_sequence,
    replay,
    run_campaign,
    run_closed_loop,
    save_sequence,
)
from dpbench.bench.record.cell import FORMULATIONS
from dpbench.bench.run.backup import FALLBACKS

STEPS = 12
WAITS = "in 25.0 % of the timed span the solver waited for the processor core, which other programs"


@pytest.fixture(scope="module")
def loop() -> Run:
    return run_closed_loop(
        load_scenario("paper"), open_workspace("daqp", route="native"), steps=STEPS
    )


@pytest.fixture(scope="module")
def clipped() -> Run:
    law = open_workspace("unconstrained_clipped")
    return run_closed_loop(load_scenario("paper"), law, formulation="none", steps=STEPS)


@pytest.fixture(scope="module")
def replayed() -> Run:
    sequence = record_sequence(load_scenario("paper").truncate(STEPS))
    return replay(sequence, open_workspace("daqp", route="native"), repeats=3, warmup_steps=2)


class _Cells(HTMLParser):
    """The cells of plain tables; any tag that a notebook would run or load is kept, too."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.cells: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        assert not attrs

    def handle_data(self, data: str) -> None:
        self.cells.append(data)


def test_a_run_ends_after_the_steps_asked_for(loop: Run) -> None:
    longer = run_closed_loop(
        load_scenario("paper"), open_workspace("daqp", route="native"), steps=2 * STEPS
    )
    assert len(loop.steps) == STEPS == loop.summary["steps_planned"]
    assert len(longer.steps) == 2 * STEPS
    np.testing.assert_array_equal(loop.steps["e_m"], longer.steps["e_m"][:STEPS])
    with pytest.raises(InputError, match="steps"):
        run_closed_loop(load_scenario("paper"), open_workspace("daqp"), steps=0)


def test_the_help_of_a_closed_loop_lists_every_argument_and_choice() -> None:
    text = str(inspect.getdoc(run_closed_loop)).split("Raises")[0]
    assert {*inspect.signature(run_closed_loop).parameters} <= {*re.findall(r"(\w+) :", text)}
    assert all(f'"{choice}"' in text for choice in (*FORMULATIONS, *FALLBACKS, "scaled", "si"))


def test_names_are_taken_where_objects_are(loop: Run, replayed: Run) -> None:
    """The same steps; anything else is a TypeError that states what is allowed."""
    by_name = run_closed_loop("paper", "daqp", steps=STEPS)
    np.testing.assert_allclose(by_name.steps["e_m"], loop.steps["e_m"], rtol=1e-12)
    assert condense("paper").n == 15
    assert len(replay("paper-30-5", "daqp", repeats=1, warmup_steps=0).steps) == 75
    with pytest.raises(TypeError, match="allowed: a Scenario, a name or a TOML file"):
        run_closed_loop(3, "daqp")  # type: ignore[arg-type] # the mistake that is tested
    with pytest.raises(TypeError, match="allowed: a Workspace of open_workspace, or the name"):
        run_closed_loop("paper", None)  # type: ignore[arg-type] # the mistake that is tested
    with pytest.raises(TypeError, match=r"allowed: a QPSequence, a name or a \.npz file"):
        replay(None, "daqp")  # type: ignore[arg-type] # the mistake that is tested
    with pytest.raises(TypeError, match=r"repeats: found 2\.5; allowed: a whole number, 1 or more"):
        replay("paper-30-5", "daqp", repeats=2.5)  # type: ignore[arg-type] # what is tested
    with pytest.raises(TypeError, match="steps: found '9'; allowed: a whole number, 1 or more"):
        run_closed_loop("paper", "daqp", steps="9")  # type: ignore[arg-type] # what is tested
    words = r"suite: found <Scenario .*: a name or a TOML file; for a scenario, its name or file in"
    with pytest.raises(TypeError, match=rf"{words} `scenarios=\[\.\.\.\]`$"):
        run_campaign(load_scenario("paper"))
    with pytest.raises(TypeError, match=r"sequence: found 3; allowed: a name or a \.npz file or"):
        run_campaign(sequence=3)
    with pytest.raises(TypeError, match=r"scenarios: found <Scenario .*: a name or a file in the"):
        run_campaign("smoke", scenarios=[load_scenario("paper")])
    with pytest.raises(TypeError, match=r"solvers: found <.*: a name in the list; .*`solver_modul"):
        run_campaign("smoke", solvers=[opener("mine", lambda qp: qp)])
    with pytest.raises(TypeError, match=r"routes: found 3; allowed: a name in the list$"):
        run_campaign("smoke", routes=[3])
    with pytest.raises(TypeError, match=r"scenario: found \{\}; allowed: a name or a TOML file"):
        load_scenario({})
    with pytest.raises(TypeError, match=r"^scenario: found \{'name': .{,200}…; allowed: a name"):
        load_scenario(load_scenario("paper").files)  # type: ignore[arg-type] # what is tested
    with pytest.raises(TypeError, match=r"^scenario: found \{'name': .{,200}…; allowed: a Scen"):
        run_closed_loop(load_scenario("paper").files, "daqp")  # type: ignore[arg-type] # the same
    with pytest.raises(TypeError, match="sequence: found 3; allowed: a name or"):
        load_sequence(3)
    with pytest.raises(TypeError, match="solver: found 3; allowed: the name of a solver"):
        open_workspace(3)  # type: ignore[arg-type] # the mistake that is tested


@pytest.mark.parametrize(
    ("function", "policy", "options", "words"),
    [
        (
            len,
            "banana",
            {},
            "policy: found 'banana'; allowed: 'fresh', as the solver is a function",
        ),
        (len, "warm", {}, "policy: found 'warm'; allowed: 'fresh', as the solver is a function"),
        (lambda qp, tol=1: tol, "fresh", {"tl": 1}, "options: found {'tl': 1}; allowed: tol"),
        (lambda qp: qp, "fresh", {"a": 1}, "options: found {'a': 1}; allowed: none, as the fun"),
    ],
)
def test_a_function_is_opened_with_what_it_has(
    function: Any, policy: Any, options: dict[str, object], words: str
) -> None:
    with pytest.raises(InputError) as caught:
        opener("mine", function)(policy, options)
    assert str(caught.value).startswith(f"solver mine: {words}")
    assert opener("any", lambda qp, **others: qp)("fresh", {"a": 1}).policy == "fresh"
    with pytest.raises(TypeError, match=r"for your own function, use `opener\(name, function\)\("):
        replay("paper-30-5", function)


@pytest.mark.parametrize(
    ("name", "function", "words"),
    [
        ("mine", 3, "solver mine: found 3; allowed: a function of one QP"),
        ("daqp", len, "opener: name: found 'daqp'; allowed: a name that no solver of dpbench has"),
        ("no_op", len, "opener: name: found 'no_op'; allowed: a name that no solver of dpbench"),
        ("a/b", len, "opener: name: found 'a/b'; allowed: a name without a path"),
    ],
)
def test_a_function_or_name_that_cannot_be_is_refused_at_once(
    name: str, function: Any, words: str
) -> None:
    with pytest.raises(InputError) as caught:
        opener(name, function)
    assert str(caught.value).startswith(words)


def test_a_function_shows_its_options() -> None:
    opened = opener("mine", lambda qp, tol=1.0: qp)
    shown = [repr(opened("fresh", options)) for options in ({}, {"tol": np.float64(1e-2)})]
    assert shown == [
        "<Workspace of mine (native, fresh)>",
        "<Workspace of mine (native, fresh, tol=0.01)>",
    ]


def test_a_run_carries_the_settings_of_its_solver() -> None:
    own = {"eps_abs": 1e-5, "max_iter": 400}
    runs = [
        replay("paper-30-5", open_workspace("osqp", route="native", settings=settings), repeats=1)
        for settings in ("default", "high", own)
    ]
    names = ["default", "high", "eps_abs=1e-5,max_iter=400"]
    assert [run.summary["settings"] for run in runs] == names
    assert [run.summary["options"] for run in runs[:2]] == ["", ""]
    assert json.loads(runs[2].summary["options"]) == own
    assert [run.label for run in runs] == [
        "osqp (native, fresh)",
        "osqp (native, fresh, high)",
        "osqp (native, fresh, eps_abs=1e-5,max_iter=400)",
    ]


def test_a_run_names_the_version_of_its_solver(loop: Run, replayed: Run) -> None:
    assert loop.summary["solver_version"] == version("daqp") == replayed.summary["solver_version"]


def test_a_run_that_is_always_late_says_so() -> None:
    """A computer so slow that no answer arrives in its sample."""
    late = run_closed_loop("paper", open_workspace("daqp", route="native"), slowdown=1e7, steps=4)
    assert late.summary["deadline_misses"] == 4
    assert "100 % verified, deadline missed in 4 steps, " in repr(late)
    assert "deadline missed in 4 steps" in late._repr_html_()


def test_a_ship_that_only_the_solver_loses_is_named() -> None:
    """By the rule of the reference loop; an approach to a setpoint is no departure."""

    def give_zeros(qp: QuadraticProgram) -> Solution:
        return Solution(Status.SOLVED, np.zeros(qp.n), np.zeros(qp.m), np.zeros(qp.n))

    zero = opener("zero", give_zeros)("fresh", {})
    lost, near = (run_closed_loop("weather", zero, steps=steps) for steps in (400, 100))
    far_m = f"{lost.summary['r_max_m']:.3g}"
    words = rf"With this solver, the ship leaves its station \(5 m, 5°\) at .* offset {far_m} m"
    for text in (repr(lost), lost._repr_html_()):
        assert re.search(words, text)
    assert "With this solver" not in repr(near) + near._repr_html_()
    exact = replace(lost, steps=run_closed_loop("weather", "daqp", steps=400).steps)
    assert "With this solver" not in repr(exact)
    words = "With this solver, the ship is not at its setpoint at the end (offset 95.8 m, "
    assert words in repr(run_closed_loop("move", zero))
    text = repr(run_closed_loop("move", zero, steps=30))
    assert "With this solver" not in text
    exact = "; reference loop: The ship is not at its setpoint at the end of `move`"
    own = r"is not at its setpoint at the end \(largest offset 25\.0 m of 5 m, heading .+° of 5°\)"
    assert re.search(rf"; In this run, the ship {own}{exact}", text)


def test_a_run_shows_whether_its_ship_stays_on_station(loop: Run, replayed: Run) -> None:
    """With its largest offset and heading error beside the limits, also of a lost ship."""
    turned = rf"{loop.summary['heading_max_deg']:.3g}° of 5°\)"
    far = r"largest offset 1\.77 m of 5 m"
    words = rf"In this run, the ship stays on station \({far}, heading error {turned}"
    cells = _Cells(loop._repr_html_()).cells
    for text in (repr(loop), cells[cells.index("ship") + 1]):
        assert re.search(words, text)
    assert "In this run" not in repr(replayed) + replayed._repr_html_()
    steps = loop.steps.assign(e_m=np.linspace(1.0, 9.0, STEPS))
    lost = replace(loop, steps=steps, summary=loop.summary.copy())
    lost.summary["exact_left_s"] = 0.3  # the reference loop loses it, too
    words = (
        r"In this run, the ship leaves its station at \d\.\d* s \(largest offset 9\.\d* m of 5 m"
    )
    assert re.search(words, repr(lost))
    moved = run_closed_loop("move", "daqp")
    assert "the ship stays on station (largest offset after its arrival 0.4" in repr(moved)


def test_a_function_that_fails_is_named_with_its_reason() -> None:
    def fail(qp: QuadraticProgram) -> Solution:
        raise ValueError(f"no answer to {qp.n} variables " + 99 * "long ")

    run = replay("paper-30-5", opener("failing", fail)("fresh", {}), repeats=1)
    words = r"75 failed \(ValueError: no answer to 15 variables long .{,70} …\), "
    assert re.search(words, repr(run))


def test_the_failures_of_a_replay_are_those_of_the_rows_of_its_steps() -> None:
    """Not those of the solves before each round, which have no row."""

    def fail(qp: QuadraticProgram) -> Solution:
        raise ZeroDivisionError

    run = replay("paper-30-5", opener("failing", fail)("fresh", {}), repeats=2, warmup_steps=9)
    cells = _Cells(run._repr_html_()).cells
    number = cells[cells.index("failures in all rounds and the warm-up") + 1].partition(" × ")[0]
    assert int(number) == len(run.steps) == 2 * 75 + 9
    assert cells[cells.index("failed steps") + 1] == "75"
    loop = run_closed_loop("paper", opener("failing", fail)("fresh", {}), steps=3)
    assert "3 × ZeroDivisionError: " in loop._repr_html_()


def test_objects_say_what_they_are_in_a_line(loop: Run, replayed: Run) -> None:
    scenario = load_scenario("paper")
    qp = condense(scenario).problem(condense(scenario).emit(np.ones(9), np.zeros(3), np.zeros(3)))
    for shown, words in (
        (scenario, ("paper", "supply_fs99", "30/5", "1000 steps")),
        (certify(qp), ("15 variables", "limits active")),
        (loop, ("daqp", "native", "closed loop paper", "12 of 12 steps")),
        (replayed, ("daqp", "replay paper", "12 of 12 steps")),
    ):
        text = repr(shown)
        assert len(text) < 220 and "\n" not in text
        assert all(word in text for word in words), text


def test_an_inaccurate_run_says_so_first(loop: Run, clipped: Run) -> None:
    """And how many answers the solver reports as solved although they are wrong."""
    sequence = record_sequence(load_scenario("paper").truncate(24))
    osqp = open_workspace("osqp", route="native", settings={"eps_abs": 0.5, "eps_rel": 0.5})
    run = replay(sequence, osqp, repeats=2, warmup_steps=2)
    counting = run.steps.query("counts")
    wrong = int((counting["claimed"] & ~counting["true"]).sum())
    assert wrong > 0 and len(counting) == 48
    words = f"{wrong} of 48 answers"
    assert repr(run).startswith("<Inaccurate run of osqp (native")
    assert f"{words} reported solved but not verified" in repr(run)
    cells = _Cells(run._repr_html_()).cells
    assert cells[cells.index("reported solved but not verified") + 1] == words
    assert cells[cells.index("warning") + 1] == "inaccurate"
    assert repr(clipped).startswith("<Inaccurate run of unconstrained_clipped")
    assert repr(loop).startswith("<Run of daqp") and "100 % verified" in repr(loop)
    assert "warning" not in _Cells(loop._repr_html_()).cells


def test_what_only_the_library_refuses_is_in_the_outcome(replayed: Run) -> None:
    """Such as a value that it reads at the first step: its words, with their number."""
    sequence = record_sequence(load_scenario("paper").truncate(12))
    run = replay(sequence, open_workspace("daqp", settings={"cycle_tol": [1]}), repeats=1)
    assert re.fullmatch(r"\d+ × TypeError: an integer is required", run.summary["outcome_detail"])
    assert run.summary["outcome_detail"] in _Cells(run._repr_html_()).cells
    assert replayed.summary["outcome_detail"] == ""
    assert "failures" not in replayed._repr_html_()


def test_the_time_of_a_replay_is_the_least_over_its_rounds(loop: Run) -> None:
    """As on the page and in the verdict; the summary has the median of all timings, too."""
    run = replay(
        record_sequence(load_scenario("paper").truncate(24)), "daqp", repeats=3, warmup_steps=0
    )
    shown = replace(run, summary=run.summary.copy())
    shown.summary["algo_p50_ns"], shown.summary["raw_p50_ns"] = 2e3, 9e3
    assert "p50 2.00 µs (minimum over rounds)" in repr(shown)
    cells = _Cells(shown._repr_html_()).cells
    assert cells[cells.index("median step time, minimum over rounds") + 1] == "2.00 µs"
    least = run.steps.query("counts").groupby("k")["total_ns"].min()
    assert run.summary["algo_p50_ns"] == pytest.approx(least.median())
    assert "over rounds" not in repr(loop)


def test_an_optimum_without_a_point_says_so() -> None:
    qp = condense(load_scenario("paper"))
    problem = qp.problem(qp.emit(np.zeros(9), np.zeros(3), np.zeros(3)))
    problem.l[0], problem.u[0] = 1e6, 2e6
    assert "no point is feasible" in repr(certify(problem))


def test_html_is_plain_tables_with_the_numbers_of_the_run(loop: Run, replayed: Run) -> None:
    for shown in (load_scenario("paper"), loop, replayed):
        page = _Cells(shown._repr_html_())
        assert page.tags <= {"table", "caption", "tbody", "tr", "td"}
    cells = _Cells(loop._repr_html_()).cells
    assert cells[cells.index("failed steps") + 1] == str(loop.summary["failed_steps"])
    largest = cells.index("position error, largest")
    assert cells[largest + 1] == f"{math.hypot(1.2, 1.3):.3g} m"  # at the start
    assert largest < cells.index("reference loop")
    assert "fallbacks" not in _Cells(replayed._repr_html_()).cells


def test_text_in_html_is_escaped() -> None:
    scenario = replace(load_scenario("paper"), title="<script>x</script>")
    assert "<script" not in scenario._repr_html_()


def test_the_path_is_that_of_the_steps(loop: Run, clipped: Run) -> None:
    chart = loop.plot.ship(clipped)
    chart.to_dict()  # against the grammar
    lines = chart.layer[1].data
    assert list(dict.fromkeys(lines["law"])) == [loop.label, clipped.label]
    own = lines[lines["law"] == clipped.label]
    np.testing.assert_array_equal(own["e"], clipped.steps["e_m"])


def test_errors_are_those_of_the_steps(loop: Run) -> None:
    chart = loop.plot.errors(loop)
    chart.to_dict()
    north = chart.vconcat[0].data
    first, second = dict.fromkeys(north["law"])
    assert (first, second) == (f"{loop.label} #1", f"{loop.label} #2")
    own = north[north["law"] == first]
    np.testing.assert_allclose(own["value"], loop.steps["n_m"], atol=1e-12)


def test_runs_in_two_weathers_are_drawn_together() -> None:
    """Errors, forces and paths share setpoint, limits and start; another setpoint is refused."""
    weather = load_scenario("weather").truncate(3)
    storm = weather.with_keys({"environment.wind.speed_mps": 16.0})
    calm, rough = (run_closed_loop(scenario, "daqp") for scenario in (weather, storm))
    for chart in (calm.plot.errors(rough), calm.plot.forces(rough), calm.plot.ship(rough)):
        text = chart.to_json()
        labels = [str(run.summary["scenario"]) for run in (calm, rough)]
        assert all(f'"{label}"' in text for label in labels)
    quick = run_closed_loop(storm, open_workspace("daqp", route="native"))
    text = quick.plot.ship(calm, rough).to_json()
    assert all(f'"{rough.label} in {label}"' in text for label in labels)
    assert '"labelLimit": 0' in text
    moved = run_closed_loop(weather.with_keys({"reference.north_m": 5.0}), "daqp")
    with pytest.raises(InputError, match="allowed: closed loops with the same setpoint"):
        calm.plot.errors(moved)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["loop", "replayed"])
def test_steps_are_those_of_the_run(kind: str, request: pytest.FixtureRequest) -> None:
    run: Run = request.getfixturevalue(kind)
    chart = run.plot.steps()
    chart.to_dict()
    shown = pd.DataFrame(chart.vconcat[0].layer[0].data.values)
    counting = run.steps[run.steps["counts"]].groupby("k")["total_ns"]
    np.testing.assert_allclose(shown["time_us"], counting.min() / 1e3)
    if kind == "replayed":
        np.testing.assert_allclose(shown["raw_us"], counting.max() / 1e3)
    else:
        assert shown["raw_us"].isna().all()
        forces = pd.DataFrame(chart.vconcat[3].layer[0].data.values)
        sway = forces[forces["force"] == "sway"]["share"]
        assert loop_limit(run) * sway.to_numpy() == pytest.approx(run.steps["tau_y_N"].to_numpy())


def loop_limit(run: Run) -> float:
    """The largest sway force [N]."""
    assert run.scenario is not None
    return float(run.scenario.vessel.tau_max[1])


def test_an_answer_that_is_none_can_be_drawn(loop: Run) -> None:
    steps = loop.steps.copy()
    steps.loc[3, "error_move"] = np.inf
    chart = Run(steps, loop.summary, loop.scenario).plot.steps()
    shown = pd.DataFrame(chart.vconcat[1].layer[0].data.values)
    assert np.isfinite(shown["error"]).all() and shown["error"][3] > 1.0


@pytest.mark.slow
def test_steps_of_several_runs_have_a_line_each(loop: Run, replayed: Run) -> None:
    chart = loop.plot.steps(replayed)
    chart.to_dict()
    times = chart.vconcat[0].data
    for run, mode in ((loop, "closed loop"), (replayed, "replay")):
        own = times[times["law"] == f"{mode} {run.summary['scenario']}"]
        least = run.steps[run.steps["counts"]].groupby("k")["total_ns"].min()
        np.testing.assert_allclose(own["value"], least / 1e3)
    again = loop.plot.steps(loop).vconcat[0].data
    assert {*again["law"]} == {f"{loop.label} #1", f"{loop.label} #2"}
    assert chart.vconcat[1].layer[1].data["limit"].tolist() == [0.01]
    pytest.importorskip("matplotlib", reason="an extra")
    figure = loop.plot.steps(replayed, backend="matplotlib")
    assert figure.axes[-1].get_xlabel() == "step k"
    with pytest.raises(TypeError, match="allowed: runs of `run_closed_loop` and `replay`"):
        loop.plot.steps(3)  # type: ignore[arg-type] # the mistake that is tested


def test_a_legend_has_the_settings_that_differ(replayed: Run) -> None:
    runs = [
        replace(replayed, summary=pd.Series({**replayed.summary, "settings": settings}))
        for settings in ("eps_abs=1e-6,eps_rel=0.0,rho=0.1", "eps_abs=1e-6,rho=1.0,eps_rel=0.0")
    ]
    chart = runs[0].plot.steps(runs[1])
    assert {*chart.vconcat[0].data["law"]} == {
        "daqp (native, fresh, rho=0.1)",
        "daqp (native, fresh, rho=1.0)",
    }
    assert chart.vconcat[1].to_dict()["layer"][0]["encoding"]["y"]["title"] == [
        "error of the",
        "first move",
    ]


@pytest.mark.slow
def test_a_printed_figure_has_no_type_3_fonts(loop: Run) -> None:
    pytest.importorskip("matplotlib", reason="an extra")
    file = io.BytesIO()
    loop.plot.ship(backend="matplotlib").savefig(file, format="pdf")
    assert b"/Type3" not in file.getvalue() and b"/CIDFontType2" in file.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize("figure", ["steps", "ship", "errors", "forces"])
def test_every_figure_is_drawn_by_either_backend(loop: Run, figure: str) -> None:
    printed = pytest.importorskip("matplotlib.figure", reason="an extra")
    draw = getattr(loop.plot, figure)
    assert "$schema" in draw().to_dict()
    assert isinstance(draw(backend="matplotlib"), printed.Figure)
    with pytest.raises(InputError, match="one of altair, matplotlib"):
        draw(backend="bokeh")


def test_matplotlib_is_named_where_it_is_missing(
    loop: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "dpbench.report.charts.printed", raising=False)
    monkeypatch.delattr("dpbench.report.charts.printed", raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(InputError) as refused:
        loop.plot.errors(backend="matplotlib")
    assert "pip install 'dpbench[matplotlib]'" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_what_has_no_ship_draws_none(loop: Run, replayed: Run) -> None:
    with pytest.raises(InputError, match="replay"):
        replayed.plot.ship()
    with pytest.raises(InputError, match="replay"):
        loop.plot.errors(replayed)
    other = run_closed_loop(load_scenario("rough"), open_workspace("daqp"), steps=2)
    with pytest.raises(InputError, match="paper and rough"):
        loop.plot.ship(other)


@pytest.mark.slow
def test_a_run_does_not_load_what_draws() -> None:
    script = (
        "import sys, dpbench; dpbench.load_results, dpbench.run_closed_loop, dpbench.Run.plot;"
        "raise SystemExit(bool({'altair', 'matplotlib'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0


@pytest.mark.parametrize(
    ("figures", "remembers"),
    [
        ({}, False),
        ({"first_visit_ratio": 40.0}, True),
        ({"first_visit_ratio": 1.0, "first_visit_excess": 0.25}, True),
        ({"first_visit_ratio": 1.0, "first_visit_excess": 0.0}, False),
    ],
)
def test_a_replay_from_memory_is_named_as_such(figures: dict[str, float], remembers: bool) -> None:
    sequence = record_sequence(load_scenario("paper").truncate(8))
    run = replay(sequence, open_workspace("daqp"), repeats=1, warmup_steps=2)
    summary = run.summary.copy()
    for name, value in figures.items():
        summary[name] = value
    shown = replace(run, summary=summary)
    assert shown.remembers is remembers
    assert ("first solved" in repr(shown)) is remembers
    assert ("first solved" in shown._repr_html_()) is remembers
    # The adapter of daqp keeps no answers; what a function does is not known.
    other = replace(run, summary=pd.Series(summary.to_dict() | {"solver": "my_function"}))
    assert "cached answers" not in repr(shown)
    assert ("cached answers" in repr(other)) is remembers


def test_a_replay_names_what_disturbed_it() -> None:
    run = replay("paper-30-5", open_workspace("daqp", route="native"), repeats=2)
    quiet = {"rounds": 2, "disturbed_rounds": 0, "counting_disturbed": 0}
    still = run.steps.assign(waited_ns=0)
    calm = replace(run, steps=still, summary=pd.Series(run.summary.to_dict() | quiet))
    # A late timing names the machine and its waits too, so the whole warnings are looked for.
    for warning in ("the machine was disturbed", "of the timed span the solver waited"):
        assert warning not in repr(calm)
    assert ">machine<" not in calm._repr_html_()
    busy = replace(calm, summary=pd.Series(calm.summary.to_dict() | {"disturbed_rounds": 3}))
    assert "the machine was disturbed in 3 of 5 rounds" in repr(busy)
    assert ">machine<" in busy._repr_html_()
    ratios = {"first_visit_ratio": 40.0}
    both = replace(busy, summary=pd.Series(busy.summary.to_dict() | ratios))
    for text in (repr(both), both._repr_html_()):
        assert text.index("the machine was disturbed") < text.index("first solved")
    waiting = replace(calm, steps=still.assign(waited_ns=still["total_ns"] // 4))
    assert WAITS in repr(waiting)


def test_a_closed_loop_names_its_wait_for_the_core(loop: Run) -> None:
    timed = replace(loop, summary=pd.Series(loop.summary.to_dict() | {"raw_p50_ns": 1e5}))
    calm = replace(timed, steps=loop.steps.assign(waited_ns=0))
    busy = replace(timed, steps=loop.steps.assign(waited_ns=loop.steps["total_ns"] // 4))
    for text in (repr, Run._repr_html_):
        assert WAITS in text(busy) and "the solver waited" not in text(calm)
    # Without a p50, as here in 12 steps, no time is shown that a wait could explain.
    assert "the solver waited" not in repr(replace(loop, steps=busy.steps))


def test_steps_without_a_certified_optimum_are_counted() -> None:
    """An unbounded QP: min z₂ over the plane."""
    none = np.zeros((3, 0))
    qp = QuadraticProgram(np.zeros((2, 2)), [0.0, 1.0])
    run = replay(QPSequence("open", qp, np.tile(qp.q, (3, 1)), none, none), "daqp", repeats=2)
    assert "– verified, 3 steps without a certified optimum, 3 failed (not found), " in repr(run)
    cells = _Cells(run._repr_html_()).cells
    assert cells[cells.index("warning") + 1] == "3 steps without a certified optimum"
    assert "P is singular, and the QP may be unbounded" in repr(certify(qp))


def test_a_sequence_with_nan_is_not_saved(tmp_path: Path) -> None:
    qp, none = QuadraticProgram(np.eye(1), [1.0]), np.zeros((1, 0))
    with pytest.raises(InputError, match="save_sequence: sequence: q: found NaN"):
        save_sequence(tmp_path / "nan.npz", QPSequence("nan", qp, [[np.nan]], none, none))


def test_a_scenario_in_place_of_a_sequence_and_a_step_in_place_of_a_qp_are_named() -> None:
    words = r"found 'paper', a scenario; .*`record_sequence\('paper'\)`"
    for take in (load_sequence, lambda name: replay(name, "daqp")):
        with pytest.raises(UnknownNameError, match=words):
            take("paper")
    step = QPStep(np.ones(1), np.zeros(0), np.zeros(0))
    with pytest.raises(AttributeError, match="QPStep has no 'm'; a QuadraticProgram has"):
        open_workspace("daqp").setup(step)  # type: ignore[arg-type]  # the wrong type is the test
