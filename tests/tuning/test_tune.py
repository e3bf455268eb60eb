"""`dpbench tune-solver` from its arguments to the settings it writes."""

import re
import shlex
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from dpbench import load_results
from dpbench.analysis.records.run_record import RunRecord, build_run_records
from dpbench.analysis.verdict.requirements import Finding
from dpbench.bench.plan.run_request import RunRequest
from dpbench.bench.progress import Progress, Silent
from dpbench.bench.record.schema import convert_to_run_columns
from dpbench.cli.main import main
from dpbench.errors import InputError, SettingsError
from dpbench.solvers.contract import LEVELS, Options
from dpbench.solvers.own_settings import format_options_as_toml
from dpbench.solvers.settings import find_options_of_preset, format_library_call
from dpbench.tuning import tune
from dpbench.tuning.campaigns import MeasuredRuns, TunedProblem
from dpbench.tuning.request import estimate_tuning, list_edges, make_request
from dpbench.tuning.search import make_space
from dpbench.tuning.tune import tune_solver


@pytest.mark.parametrize(
    ("solver", "arguments", "message"),
    [
        ("osqp", {"training": ["paper"], "test": ["paper-60-10"]}, "--test: .*same closed loop"),
        ("osqp", {"trials": 0}, "--trials: found 0"),
        ("osqp", {"error_move": 0.0}, "--error: found 0"),
        ("osqp", {"name": "high"}, "--name: found 'high'"),
        ("osqp", {"name": "../x"}, "--name: found '../x'; allowed: 1 to 80 letters"),
        ("osqp", {"ranges": ["rhoo=[1,2]"]}, "settings of osqp: rhoo: found an unknown option"),
        ("osqp", {"route": "c"}, "`route`: found 'c'"),
        ("clarabel", {"policy": "warm"}, "`policy`: found 'warm' .*no interface.*; allowed: "),
        ("nobody", {}, "found 'nobody'"),
        ("osqp[rhoo=1]", {}, "settings of osqp: rhoo: found an unknown option"),
        ("osqp[rho=[1,2]]", {}, r"found osqp\[rho=\[1,2\]\]; allowed: one value per option"),
    ],
)
def test_a_mistake_is_found_before_anything_runs(
    solver: str, arguments: dict[str, Any], message: str, tmp_path: Path
) -> None:
    with pytest.raises((InputError, SettingsError), match=message):
        tune_solver(solver, out=tmp_path / "out", **arguments)
    assert not (tmp_path / "out").exists()


class _Campaigns:
    """Campaigns in which every setting is accurate and faster than the one before it."""

    def __init__(
        self,
        *,
        interrupted_at: int,
        error: float = 1e-9,
        fault: Callable[[RunRecord], list[Finding]] = lambda _: [],
        iterations: int = 10,
    ) -> None:
        self.batches, self._error = list[int](), error
        self._fault, self._iterations = fault, iterations
        self._interrupted_at, self._runs = interrupted_at, 0
        self.presets = list[list[str]]()

    def __call__(
        self,
        solver: object,
        problems: Sequence[TunedProblem],
        settings: Sequence[Options],
        folder: Path,
        progress: Progress,
        presets: Sequence[str] = ("default",),
        *,
        purpose: str = "",
        wait_s: float | None = None,
    ) -> MeasuredRuns:
        self.batches.append(len(settings))
        self.presets.append([*presets])
        if len(self.batches) == self._interrupted_at:
            raise KeyboardInterrupt
        progress.start(0)
        folder.mkdir(parents=True)
        done = {"mode": "replay", "outcome": "finished", "steps_planned": 75, "steps_done": 75}
        rows = []
        named = isinstance(settings, dict)
        for name in [*presets, *(settings if named else map(format_options_as_toml, settings))]:
            self._runs += 1
            run = {"settings": name, "algo_p50_ns": 1e6 / self._runs}
            run["iterations_max"] = self._iterations
            accurate = {"failed_steps": 0, "error_move_max": self._error}
            rows += [
                done | run | accurate | {"sequence": one.name, "run_id": f"{name} {one.name}"}
                for one in problems
            ]
        runs = build_run_records(convert_to_run_columns(pd.DataFrame(rows)))
        return MeasuredRuns(runs, self._find_faults(runs))

    def _find_faults(self, runs: Sequence[RunRecord]) -> dict[str, list[Finding]]:
        """Return what is wrong with each run; nothing, unless told."""
        return {run.run_id: self._fault(run) for run in runs if self._fault(run)}


@pytest.mark.parametrize(("at", "tried", "left"), [(2, 8, "4 of 12 settings to try"), (3, 12, "")])
def test_an_interrupted_search_writes_the_best_so_far(
    at: int,
    tried: int,
    left: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Exit code 130; text and file name what was not done."""
    monkeypatch.setattr(tune, "measure_settings", _Campaigns(interrupted_at=at))
    words = "--train calm-30-5 --test move-30-5 --trials 12"
    assert main(["tune-solver", "osqp", *words.split(), "--out", str(tmp_path)]) == 130
    said = capsys.readouterr()
    shown, text = " ".join(said.out.split()), (tmp_path / "tuned.toml").read_text()
    best = f"best so far, of {tried + 3} settings of osqp (native fresh), including the presets "
    assert f"{best}low, mid and high: " in shown
    for written in (shown, text):
        # The last of a first batch of default, three presets and eight settings.
        assert "accurate; 0.0833 times the step time of default" in written
        assert f"interrupted, not done: {left}" in written
        assert "the measurement on test sequences" in written
    assert "dpbench: interrupted; finished cells are kept" in said.err
    assert set(tomllib.loads(text)["settings"]["tuned"]) == {"route", "policy", "osqp"}


def _late_p95(run: RunRecord) -> list[Finding]:
    """A p95 above 3 ms, by the rule of verdicts."""
    return [Finding("p95 late", (run,), 9.74e6, limit=3e6, factor=1.05)]


def test_a_best_that_is_late_says_where_and_by_which_percentile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In the table, on training and test sequences, in the file, the last line and exit code."""
    monkeypatch.setattr(tune, "measure_settings", _Campaigns(interrupted_at=0, fault=_late_p95))
    monkeypatch.setattr(tune, "find_step_of_largest_error", lambda *_: 0)
    words = "--train calm --test move --steps 75 --trials 3"
    assert main(["tune-solver", "osqp", *words.split(), "--out", str(tmp_path)]) == 1
    out = capsys.readouterr().out
    failed = "the best settings fail on the training and test sequences: do not use them"
    assert out.splitlines()[-1] == failed
    shown, text = " ".join(out.split()), (tmp_path / "tuned.toml").read_text()
    assert text.startswith(f"# {failed}\n")
    rows = [row for row in out.splitlines() if "│ best " in row]
    assert [row.split("│")[-1].strip() for row in rows] == ["late", "late"]
    assert "all accurate settings that were tried are late on a training sequence" in shown
    for written in (shown, " ".join(text.split())):
        for role, sequence in (("training", "calm"), ("test", "move")):
            reason = rf"p95 of 9.74 ms in the replay of {sequence} exceeds .*?3.00 ms"
            assert re.search(rf"{role} sequences .*?late on 1 of 1: its {reason}", written)
        assert "times the step time of default, which is late on 1 of 1" in written


def test_settings_in_time_are_found_before_faster_ones_that_are_late(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All but one of the presets are late; the later trials are faster."""

    def fault(run: RunRecord) -> list[Finding]:
        return [] if run.settings in ("low", "best") else _late_p95(run)

    monkeypatch.setattr(tune, "measure_settings", _Campaigns(interrupted_at=0, fault=fault))
    monkeypatch.setattr(tune, "find_step_of_largest_error", lambda *_: 0)
    found = tune_solver("osqp", training=["calm"], test=["move"], steps=75, trials=8, out=tmp_path)
    assert found.best.options == find_options_of_preset("low", "osqp")
    assert not found.best.score.late
    summaries = [role.summarise_best_settings(found.solver.requirements) for role in found.roles]
    assert all(summary.startswith("accurate; ") for summary in summaries)


def test_the_best_is_compared_with_the_fastest_accurate_preset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each setting is faster than those before it: high is the fastest preset, or else mid."""
    monkeypatch.setattr(tune, "measure_settings", _Campaigns(interrupted_at=0))
    monkeypatch.setattr(tune, "find_step_of_largest_error", lambda *_: 0)
    found = tune_solver("osqp", training=["calm"], test=["move"], steps=75, trials=8, out=tmp_path)
    role, limits = found.roles[0], found.solver.requirements
    times = {name: runs[0].algo_p50_ns for name, runs in role.runs.items()}
    assert list(times) == [*LEVELS, "best"]

    def summarise(**changed: Any) -> list[str]:
        summary = replace(role, runs={**role.runs, **changed}).summarise_best_settings(limits)
        return summary.split("; ")[1:]

    gain = f"{times['best'] / times['high']:.3f} times the step time of high"
    assert summarise()[1:] == [f"{gain}, the fastest preset that is accurate on them"]
    partly = [replace(run, true_share=0.81) for run in role.runs["best"]]
    (sequence,) = {run.sequence for run in partly}
    assert summarise(best=partly)[0] == f"19.0 % of the solutions of {sequence} not verified"
    wrong = [replace(run, error_move_max=0.5) for run in role.runs["high"]]
    gain = f"{times['high'] / times['mid']:.3f} times the step time of mid"
    assert summarise(high=wrong, best=role.runs["high"])[1:] == [
        f"{gain}, the fastest preset that is accurate on them"
    ]
    equal = "1.00 times the step time of high, the fastest preset that is accurate on them: no gain"
    assert summarise(best=role.runs["high"])[1:] == [equal]


def test_a_preset_as_fast_as_the_best_is_recommended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only one that passes on the training sequences too, and only without a gain on the test."""
    monkeypatch.setattr(tune, "measure_settings", _Campaigns(interrupted_at=0))
    monkeypatch.setattr(tune, "find_step_of_largest_error", lambda *_: 0)
    found = tune_solver("osqp", training=["calm"], test=["move"], steps=75, trials=8, out=tmp_path)
    training, test = found.roles
    assert "use the preset" not in found.toml
    equal = replace(test, runs={**test.runs, "best": test.runs["high"]})
    text = "use the preset high: the best settings are not more than 3 % faster on the test sequenc"
    alike = replace(found, roles=(training, equal))
    assert alike.lines[-1].startswith(text) and alike.toml.startswith(f"# {text}")
    assert alike.lines[-1].endswith(" (ratio 1.00)")
    wrong = [replace(run, error_move_max=0.5) for run in training.runs["high"]]
    inaccurate = replace(training, runs={**training.runs, "high": wrong})
    assert "use the preset" not in replace(found, roles=(inaccurate, equal)).toml


def test_a_search_ends_with_the_settings_to_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each setting is faster than those before it; only one that passes everywhere counts."""
    monkeypatch.setattr(tune, "measure_settings", _Campaigns(interrupted_at=0))
    monkeypatch.setattr(tune, "find_step_of_largest_error", lambda *_: 0)
    found = tune_solver(
        "osqp[rho=1.6]", training=["calm"], test=["move"], steps=75, trials=8, out=tmp_path
    )
    training, test = found.roles
    best, times = test.runs["best"], {n: runs[0].algo_p50_ns for n, runs in test.runs.items()}

    def conclude(*wrong: str, **changed: Any) -> str:
        spoilt = {
            name: [replace(run, error_move_max=0.5) for run in training.runs[name]]
            for name in wrong
        }
        roles = (
            replace(training, runs={**training.runs, **spoilt}),
            replace(test, runs={**test.runs, **changed}),
        )
        return replace(found, roles=roles).lines[-1]

    advice = "use the best settings if they pass in closed loops"
    gain = advice + ": on the test sequences, they take {} times the step time of {}, "
    for wrong, other, name in (
        ((), "yours", "your settings"),
        (("yours",), "high", "the preset high"),
        (("yours", "high"), "mid", "the preset mid"),
    ):
        ratio = f"{times['best'] / times[other]:.3f}"
        assert conclude(*wrong).startswith(gain.format(ratio, name))
    none = f"{advice}: no others that were measured are accurate and in time on all seq"
    assert conclude("yours", *LEVELS).startswith(none)
    fail = "the best settings fail on the training sequences: do not use them"
    assert conclude("best", "yours") == f"{fail}; use the preset high"
    assert conclude("best") == f"{fail}; keep your settings"
    assert conclude("best", "yours", *LEVELS) == fail
    kept = (
        "keep your settings: the best settings are not more than 3 % faster on the test sequences"
    )
    assert conclude(yours=best) == f"{kept} (ratio 1.00)"


def test_own_settings_that_are_the_best_are_to_be_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not where others are the best, or before the measurement on test sequences."""
    monkeypatch.setattr(tune, "measure_settings", _Campaigns(interrupted_at=0))
    monkeypatch.setattr(tune, "find_step_of_largest_error", lambda *_: 0)
    found = tune_solver(
        "osqp[rho=1.6]", training=["calm"], test=["move"], steps=75, trials=3, out=tmp_path
    )
    text = "keep your settings: the search found none faster"
    own = replace(found, best=replace(found.best, options={"rho": 1.6}))
    assert own.lines[-1] == text and own.toml.startswith(f"# {text}\n")
    assert text not in found.lines and text not in replace(own, roles=()).lines


def test_failed_steps_have_a_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The row has their number, a line the number of all steps and the status."""

    def fault(run: RunRecord) -> list[Finding]:
        status = Finding("failed", (run,), 30, 6, status="MAX_ITERATIONS")
        return [status] if run.settings == "high" and run.sequence == "move" else []

    monkeypatch.setattr(tune, "measure_settings", _Campaigns(interrupted_at=0, fault=fault))
    monkeypatch.setattr(tune, "find_step_of_largest_error", lambda *_: 0)
    words = "--train calm --test move --steps 75 --trials 3"
    assert main(["tune-solver", "osqp", *words.split(), "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    (row,) = (row for row in out.splitlines() if "│ high" in row and "move" in row)
    assert row.split("│")[-1].strip() == "6 failed"
    reason = "high: 6 of 75 steps fail in the replay of move, as the solver reaches its iteration"
    assert reason in " ".join(out.split())


@pytest.mark.parametrize(("iterations", "shown"), [(3886, True), (1900, False)])
def test_iterations_near_their_limit_are_named(
    iterations: int, shown: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaigns = _Campaigns(interrupted_at=0, iterations=iterations)
    monkeypatch.setattr(tune, "measure_settings", campaigns)
    monkeypatch.setattr(tune, "find_step_of_largest_error", lambda *_: 0)
    found = tune_solver(
        "osqp[max_iter=4000]", training=["calm"], test=["move"], steps=75, trials=3, out=tmp_path
    )
    line = "iterations of the best: up to 3886 of max_iter = 4000, in calm"
    for text in ("\n".join(found.lines), found.toml):
        assert (line in text) == shown
    # With one's own and the three presets.
    assert "this is not a proven optimum; " in found.lines[1]


def test_the_file_ends_with_the_call_of_the_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As comments, so that it is still a table of a suite."""
    monkeypatch.setattr(tune, "measure_settings", _Campaigns(interrupted_at=0))
    monkeypatch.setattr(tune, "find_step_of_largest_error", lambda *_: 0)
    found = tune_solver(
        "osqp", training=["calm"], test=["move"], steps=75, trials=3, policy="warm", out=tmp_path
    )
    call = format_library_call("osqp", "native", "warm", found.best.options)
    assert "m.setup(P, 0 * q, A, l, u, " in call and "adaptive_rho_interval=50" in call
    commented = "".join(f"# {line}\n" for line in call.splitlines())
    assert found.toml.endswith(f"# Without dpbench:\n{commented}")
    assert set(tomllib.loads(found.toml)["settings"]) == {"tuned"}


class _RemarkingProgress(Silent):
    """Progress that keeps the remarks."""

    def __init__(self) -> None:
        self.remarks = list[str]()

    def remark(self, text: str) -> None:
        self.remarks.append(text)


def test_the_expected_time_is_shown_before_the_first_batch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tune, "measure_settings", _Campaigns(interrupted_at=1))
    progress = _RemarkingProgress()
    with pytest.raises(KeyboardInterrupt):
        tune_solver(
            "osqp", training=["calm"], test=["move"], steps=75, out=tmp_path, progress=progress
        )
    first = progress.remarks[0]
    assert re.match(
        r"51 settings of osqp in 6 batches, then the .* best: about \d+ (s|min), plus waits", first
    )


@pytest.mark.parametrize(("eps_rel", "advised"), [(1.22e-6, False), (1e-8, True)])
def test_no_wider_range_of_a_tolerance_that_another_dominates(
    eps_rel: float, advised: bool
) -> None:
    """A solve ends by the larger of two tolerances."""
    options = {"eps_abs": 1e-9, "eps_rel": eps_rel, "rho": 100.0}
    edges = list_edges("osqp", make_space("osqp"), options)
    assert any(edge.startswith("eps_abs") for edge in edges) == advised
    assert any(edge.startswith("rho") for edge in edges)


class _CountingProgress(Silent):
    """Progress that counts the work that was planned and finished."""

    def __init__(self) -> None:
        self.planned = self.finished = 0
        self.parts = list[str]()

    def start(self, work: int) -> None:
        self.planned += work

    def advance(self, work: int, what: str) -> None:
        self.finished += work
        self.parts.append(what.partition(":")[0])


def test_the_presets_are_in_the_first_batch_and_the_call_mode_is_in_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Low, mid and high by their names; the file runs in its mode in a suite of another one."""
    campaigns = _Campaigns(interrupted_at=0)
    monkeypatch.setattr(tune, "measure_settings", campaigns)
    monkeypatch.setattr(tune, "find_step_of_largest_error", lambda *_: 0)
    words = {"training": ["calm-30-5"], "test": ["move-30-5"], "trials": 8, "policy": "warm"}
    found = tune_solver("osqp", out=tmp_path, **words)  # type: ignore[arg-type] # mixed values
    assert campaigns.presets == [
        ["default", "low", "mid", "high"],
        ["default"],
        ["default", "low", "mid", "high"],
    ]
    assert found.trials == 8 + 3
    suite = (
        'title = "mine"\nsolvers = ["osqp"]\nbaseline_law = false\n[[closed_loop]]\n'
        'scenarios = ["paper"]\nsettings = ["default", "tuned"]\n'
    )
    (tmp_path / "mine.toml").write_text(suite + (tmp_path / "tuned.toml").read_text())
    modes = {
        (planned.cell.settings, planned.cell.route, planned.cell.policy)
        for planned in RunRequest(str(tmp_path / "mine.toml")).make_plan().cells
    }
    assert modes == {("default", "qpsolvers", "fresh"), ("tuned", "native", "warm")}
    request = RunRequest(str(tmp_path / "mine.toml"), policies=["fresh"])
    assert {planned.cell.policy for planned in request.make_plan().cells} == {"fresh"}


@pytest.mark.parametrize("solver", ["osqp", "osqp[rho=1.6]"])
def test_finished_batches_are_progress(
    solver: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A search whose campaigns have nothing to do any more ends at 100 %."""
    monkeypatch.setattr(tune, "measure_settings", _Campaigns(interrupted_at=0))
    monkeypatch.setattr(tune, "find_step_of_largest_error", lambda *_: 0)
    bar = _CountingProgress()
    words = {"training": ["calm-30-5"], "test": ["move-30-5"], "trials": 11}
    tune_solver(solver, out=tmp_path, progress=bar, **words)  # type: ignore[arg-type] # mixed values
    assert bar.finished == bar.planned > 0
    assert bar.parts == ["batch 1/2", "batch 2/2", "measurement of the best"]


@pytest.mark.parametrize(
    ("words", "error", "share"),
    [
        (
            "--train calm-30-5 --test move-30-5",
            0.0077,
            "77 % of the limit, at step 7 of calm-30-5[:300:4] (75 of 300 steps",
        ),
        (
            "--train calm-30-5 --test move-30-5",
            1e-4,
            "1 % of the limit, at step 7 of calm-30-5[:300:4] (75 of 300 steps",
        ),
        (
            "--train calm --test move --steps 75",
            0.0051,
            "51 % of the limit, at step 7 of calm (75 of 75 steps",
        ),
        ("--train calm --test move --steps 75", 0.005, ""),
    ],
)
def test_settings_near_the_limit_are_to_be_checked(
    words: str, error: float, share: str, tmp_path: Path, monkeypatch: Any, capsys: Any
) -> None:
    """Half of the limit of 0.01 and a sequence of all steps need no caution."""
    monkeypatch.setattr(tune, "measure_settings", _Campaigns(interrupted_at=0, error=error))
    monkeypatch.setattr(tune, "find_step_of_largest_error", lambda *_: 7)
    command = ["tune-solver", "osqp", *words.split(), "--trials", "11", "--out", str(tmp_path)]
    assert main(command) == 0
    said = capsys.readouterr().out
    for shown in (" ".join(said.split()), (tmp_path / "tuned.toml").read_text()):
        assert (
            (f"largest error {share} meas" in shown) if share else ("% of the limit" not in shown)
        )
    proposed = [shlex.split(line) for line in said.splitlines() if line.startswith("dpbench run")]
    assert len(proposed) == 1
    for words_of_command in proposed:
        assert words_of_command[-2] == "--out"
        assert Path(words_of_command[-1]).parent == tmp_path


def test_a_search_interrupted_in_its_first_batch_has_no_best(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tune, "measure_settings", _Campaigns(interrupted_at=1))
    words = "--train calm-30-5 --test move-30-5"
    assert main(["tune-solver", "osqp", *words.split(), "--out", str(tmp_path)]) == 130
    assert not re.search("best (so far|of)", capsys.readouterr().out)
    assert not (tmp_path / "tuned.toml").exists()


def test_a_dry_run_forecasts_and_writes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    words = "--train calm-30-5 --test move-30-5 --trials 11 --dry-run --wait 5"
    assert main(["tune-solver", "osqp[rho=1.6]", *words.split()]) == 0
    unwrapped = capsys.readouterr().out.replace("\n  ", " ")
    first, given, then, time, waits, *_ = unwrapped.splitlines()
    assert first == "15 settings of osqp on calm-30-5[:300:4]: 2 batches"
    assert given == "the first batch includes yours and the presets low, mid and high"
    measured = "default, low, mid, high, yours, best are measured on these and on move-30-5[:300:4]"
    assert then == f"then {measured}"
    assert time.startswith("about ") and waits.startswith("not included: waits")
    assert list(tmp_path.iterdir()) == []


def test_more_settings_and_longer_sequences_take_longer(tmp_path: Path) -> None:
    """Without a finished batch the forecast goes by stated rates."""
    usual = {"training": ["calm"], "test": ["move"], "steps": 100, "trials": 8, "out": tmp_path}
    time_s, more_s, longer_s = (
        estimate_tuning("osqp", **usual | other).time_s
        for other in ({}, {"trials": 40}, {"steps": 400})
    )
    assert time_s < more_s and time_s < longer_s


@pytest.mark.parametrize(
    ("solver", "ranges", "lines"),
    [
        ("osqp", [], ["not searched: max_iter (4000); a step that needs more iterations fails"]),
        ("osqp", [], ["rho is only an initial value in osqp, as adaptive_rho is on"]),
        ("osqp[max_iter=77]", [], ["not searched: max_iter (77); a step that needs"]),
        ("osqp", ["max_iter=[10,99]"], ["searched: max_iter 10 to 99", "max_iter: a step that"]),
        ("daqp", [], ["not searched: iter_limit (as in the library); a step that"]),
    ],
)
def test_iteration_limits_are_named(solver: str, ranges: list[str], lines: list[str]) -> None:
    request = make_request(solver, training=["calm-30-5"], test=["move-30-5"], ranges=ranges)
    assert request.searched[0].startswith("searched: ")
    for line in lines:
        assert any(text.startswith(line) for text in request.searched)


@pytest.mark.slow
def test_settings_are_found_measured_and_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """OSQP with few iterations is wrong; the settings written are accurate, and run in a suite."""
    monkeypatch.chdir(tmp_path)
    words = "--train calm-60-10 --test move-60-10 --trials 16 --range max_iter=[1,4000] --out out"
    command = ["tune-solver", "osqp", *words.split(), "--range", "eps_abs=[1e-8,1e-3]"]
    code = main(command)
    said = capsys.readouterr().out
    failed = "the best settings fail on the test sequences: do not use them"
    assert code == (failed in " ".join(said.split()))
    options = tomllib.loads(Path("out/tuned.toml").read_text())["settings"]["tuned"]["osqp"]
    assert set(options) == {"max_iter", "eps_abs"}
    assert f"max_iter={options['max_iter']}" in said
    assert "training sequences (calm-60-10[:300:8]): accurate; " in " ".join(said.split())
    assert "test sequences (move-60-10[:300:8]): " in " ".join(said.split())
    final = load_results(Path("out/final"))
    runs = final.runs
    assert final.suite["title"] == (
        "Settings of osqp (training: calm-60-10[:300:8]; test: move-60-10[:300:8])"
    )
    steps = final.steps.merge(runs[runs["settings"] == "best"][["run_id", "sequence"]])
    (named,) = re.findall(r"% of the limit, at step (\d+) of (\S+) \(", " ".join(said.split()))
    errors = steps[steps["sequence"] == named[1]].groupby("k")["error_move"].max()
    assert errors[int(named[0])] == errors.max() > errors.median()
    assert set(runs["sequence"]) == {"calm-60-10[:300:8]", "move-60-10[:300:8]"}
    assert set(runs["settings"]) == {"default", "low", "mid", "high", "best"} and len(runs) == 10
    searched = [load_results(folder).runs for folder in sorted(Path("out").glob("batch-??"))]
    assert {name for batch in searched for name in batch["sequence"]} == {"calm-60-10[:300:8]"}
    wrong = {name for batch in searched for name in batch["settings"][batch["failed_steps"] > 0]}
    assert wrong and f"max_iter={options['max_iter']}" not in wrong
    assert main([*command, "--dry-run"]) == 0
    forecast = " ".join(capsys.readouterr().out.split())
    assert "2 batches, 2 of them finished" in forecast
    assert "about 0 s on this machine, estimated from finished batches" in forecast
    # The same command goes on where it ended: nothing is run again.
    before = {path: path.stat().st_mtime_ns for path in Path("out").rglob("runs.parquet")}
    assert main(command) == code
    assert before == {path: path.stat().st_mtime_ns for path in Path("out").rglob("runs.parquet")}


@pytest.mark.slow
def test_own_settings_are_measured_beside_the_best(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The search keeps an option that it does not vary; yours, at the edge, get a wider range."""
    words = "--train calm-60-10 --test move-60-10 --trials 16 --policy warm"
    choice, ranges = "osqp[rho=100,max_iter=3000]", ["--range", "rho=[50,100]"]
    assert main(["tune-solver", choice, *ranges, *words.split(), "--out", str(tmp_path)]) in (0, 1)
    said = capsys.readouterr()
    notes = " ".join((said.out + said.err).split())
    assert "warm starts on calm-60-10[:300:8] (one step of 8) and move-60-10[:300:8]" in notes
    assert "your settings are at the edge of the searched range, rho = 100: widen" in notes
    first = load_results(tmp_path / "batch-01").runs["settings"]
    assert first.iloc[1] == "max_iter=3000,rho=100"
    assert all("max_iter=3000" in name for name in first if name != "default")
    final = load_results(tmp_path / "final").runs
    # Without faster settings, yours are the best.
    assert set(final["settings"]) | {"best"} == {*LEVELS, "yours", "best"}
    tables = [row for row in said.out.splitlines() if "│ yours" in row]
    assert [row.split("│")[1].strip() for row in tables] == [
        "calm-60-10[:300:8]",
        "move-60-10[:300:8]",
    ]


@pytest.mark.slow
def test_a_search_without_accurate_settings_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit code 1 and no file."""
    words = "--train calm-60-10 --test move-60-10 --trials 16 --range max_iter=[1,2]"
    command = ["tune-solver", "osqp", *words.split(), "--out", str(tmp_path)]
    assert main(command) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "settings of osqp (native fresh) is accurate on every training sequence" in said
    assert not (tmp_path / "tuned.toml").exists()
