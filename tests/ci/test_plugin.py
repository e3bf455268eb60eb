"""The plug-in of pytest in sessions of its own."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from dpbench import load_scenario, open_workspace, record_sequence, replay
from dpbench.ci import benchmarks, failures, gate, machine_state, plugin, replays

pytest.importorskip("pytest_benchmark", reason="is of the extra ci")
pytest_plugins = ["pytester"]
ROOT = Path(__file__).parents[2]
TEST = """
from dpbench import load_scenario, record_sequence

def test_replay(dpbench_replay):
    dpbench_replay(record_sequence(load_scenario("paper").truncate(5)), "quadprog")
"""


@pytest.fixture(scope="module", autouse=True)
def loaded() -> None:
    """Modules that pytester unloads behind a session where they were new; C cannot load twice."""
    assert all((failures, gate, machine_state, replays))
    replay(record_sequence(load_scenario("paper").truncate(5)), open_workspace("quadprog"))


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """In a worker of pytest-xdist pytest-benchmark would measure nothing."""
    for name in [name for name in os.environ if name.startswith("PYTEST_XDIST")]:
        monkeypatch.delenv(name)


def run(pytester: pytest.Pytester, *arguments: str) -> pytest.RunResult:
    """A session in this process, with the plug-in whether or not its entry point is installed."""
    quick = ("--benchmark-min-rounds=2", "--benchmark-max-time=0.01", "--benchmark-warmup=off")
    # The warnings of this session, which are errors, are not those of the one in it.
    loaded = ("-p", "no:dpbench", "-p", plugin.__name__, "-p", "no:xdist", "-W", "default")
    return pytester.runpytest_inprocess(*loaded, *quick, *arguments)


def write_baseline(folder: Path, name: str, seconds: float, **exact: float) -> str:
    """A stored run of one benchmark, on a machine as fast as most."""
    stats = {"min": seconds, "q1": seconds, "rounds": 5}
    entry = {"fullname": name, "stats": stats, "extra_info": {"exact": exact, "reference_ns": 4e4}}
    path = folder / "base.json"
    path.write_text(json.dumps({"benchmarks": [entry]}), encoding="utf-8")
    return str(path)


def test_the_plug_in_is_an_entry_point_and_imports_nothing_heavy() -> None:
    """Every pytest run of an environment loads it."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["entry-points"]["pytest11"] == {"dpbench": plugin.__name__}
    script = (
        f"import sys, {plugin.__name__};"
        "print(*sorted({'numpy', 'pandas', 'numba', 'scipy', 'rich'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("exact", "code", "text"), [({"x": 1}, 1, "*a regression*"), ({}, 0, "*no regression *")]
)
def test_a_session_compared_with_a_stored_one(
    pytester: pytest.Pytester, exact: dict[str, float], code: int, text: str
) -> None:
    """A lost measure fails the session, a smaller time does not; what is measured is stored."""
    pytester.makepyfile(test_it=TEST)
    base = write_baseline(pytester.path, "test_it.py::test_replay", 1e3, **exact)
    result = run(pytester, f"--dpbench-compare={base}", "--benchmark-json=now.json")
    result.assert_outcomes(passed=1)
    assert result.ret == code
    result.stdout.fnmatch_lines(["*dpbench comparison*", "*test_it.py::test_replay*", text])
    assert result.outlines[-1] in (
        ["dpbench: worse (exit code 1)"]
        if code
        # Other load may disturb this session.
        else ["dpbench: no regression (exit code 0)", "dpbench: disturbed (exit code 0)"]
    )
    (entry,) = json.loads((pytester.path / "now.json").read_text(encoding="utf-8"))["benchmarks"]
    info = entry["extra_info"]
    assert info["reference_ns"] > 0 and info["true_share"] == 1.0
    assert info["machine"]["processor_s"] > 0.0


def test_a_session_names_its_own_option_of_an_allowance(pytester: pytest.Pytester) -> None:
    """The options of pytest begin with --dpbench."""
    test = (
        "def test_x(benchmark):\n    benchmark.extra_info['exact'] = {'x': 2}\n    benchmark(int)"
    )
    pytester.makepyfile(test_it=test)
    base = write_baseline(pytester.path, "test_it.py::test_x", 1e3, x=1)
    result = run(pytester, f"--dpbench-compare={base}")
    assert result.ret == 1
    assert "(to accept: --dpbench-allow x:test_it.py::test_x=100%)" in " ".join(
        word for word in result.stdout.str().split() if word != "│"
    )


@pytest.mark.parametrize("value", ["'7'", "None", "[1]", "float('nan')"])
def test_a_measure_that_is_no_number_fails_its_test(pytester: pytest.Pytester, value: str) -> None:
    """One line names test and measure; the stored file has it as a benchmark that failed."""
    info = f"benchmark.extra_info['exact'] = {{'x': {value}}}"
    pytester.makepyfile(test_it=f"def test_x(benchmark):\n    benchmark(int)\n    {info}")
    base = write_baseline(pytester.path, "test_it.py::test_x", 1e3, x=1)
    result = run(pytester, f"--dpbench-compare={base}", "--benchmark-json=now.json")
    result.assert_outcomes(failed=1)
    assert result.outlines[-1] == "dpbench: failed, not timed (exit code 1)"
    found = value.replace("float('nan')", "nan")
    reason = f'extra_info["exact"]["x"]: found {found}; allowed: a number'
    assert f"test_it.py::test_x: {reason}" in result.outlines
    assert "Traceback" not in result.stdout.str() + result.stderr.str()
    run_again = benchmarks.load_run(pytester.path / "now.json")
    assert run_again.failed == {"test_it.py::test_x": reason}


@pytest.mark.slow
def test_a_disturbed_baseline_has_an_exit_code_and_a_line(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No repeat of the head gives a verdict: storing fails, and the first line is the remedy."""
    monkeypatch.setattr(machine_state.MachineState, "complaints", lambda _: ["load"])
    pytester.makepyfile(test_it=TEST)
    arguments = ("--benchmark-json=now.json", "--dpbench-disturbed-exit=75")
    stored = run(pytester, *arguments)
    assert stored.ret == 75
    assert stored.outlines[-1] == "dpbench: disturbed baseline stored (exit code 75)"
    result = run(pytester, "--dpbench-compare=now.json", "--dpbench-disturbed-exit=75")
    assert result.ret == 75
    lines = [line for line in result.outlines if line]
    at = next(i for i, line in enumerate(lines) if "dpbench comparison" in line)
    assert lines[at + 1] == (
        "the machine was disturbed in 1 of 1 benchmark of the baseline now.json: no repeat of the "
        "head gives a verdict on their times; store the baseline again on a quiet machine"
    )


@pytest.mark.slow
def test_a_benchmark_that_fails_is_in_the_json_file(pytester: pytest.Pytester) -> None:
    """A comparison says why it has no time, also where no benchmark has one."""
    pytester.makepyfile(test_it=TEST.replace('"quadprog"', '"quadprog", error_move=-1.0'))
    result = run(pytester, "--benchmark-json=now.json")
    assert result.ret == 1
    stored = json.loads((pytester.path / "now.json").read_text(encoding="utf-8"))
    assert stored["benchmarks"] == []
    (reason,) = stored["dpbench_failed"].values()
    assert reason.startswith("wrong answers: quadprog (")
    result.assert_outcomes(failed=1, warnings=0)


@pytest.mark.slow
def test_under_xdist_a_replay_is_checked_and_not_timed(pytester: pytest.Pytester) -> None:
    """One line says so, and no comparison is made of nothing."""
    pytester.makepyfile(test_it=TEST)
    loaded = ("-p", "no:dpbench", "-p", plugin.__name__, "-n", "1")
    result = pytester.runpytest_subprocess(*loaded)
    result.assert_outcomes(passed=1, warnings=1)
    result.stdout.fnmatch_lines(["*benchmarks are not timed under xdist: run with -n0*"])
    base = write_baseline(pytester.path, "test_it.py::test_replay", 1.0)
    result = pytester.runpytest_inprocess(*loaded, f"--dpbench-compare={base}")
    assert result.ret == pytest.ExitCode.USAGE_ERROR


@pytest.mark.slow
def test_a_comparison_of_nothing_fails(pytester: pytest.Pytester) -> None:
    """An unmeasured benchmark is not called unchanged, and a bad file ends before any test."""
    pytester.makepyfile("def test_nothing(): pass")
    base = write_baseline(pytester.path, "gone", 1.0)
    result = run(pytester, f"--dpbench-compare={base}")
    assert result.ret == 1
    result.stdout.fnmatch_lines(["gone *", "*1 passed*", "dpbench: gone (exit code 1)"])
    pytester.makepyfile("def test_nothing(): assert False")
    result = run(pytester, f"--dpbench-compare={base}", "--dpbench-allow-gone")
    assert result.outlines[-1] == "dpbench: no regression (exit code 1: pytest did not pass)"
    pytester.makepyfile("def test_nothing(): pass")
    assert run(pytester, f"--dpbench-compare={base}", "--dpbench-allow-gone").ret == 0
    result = run(pytester, "--dpbench-compare=none.json")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["*none.json*no such file*"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "argument", "code", "text"),
    [
        ("test_it", "-kother", 2, "new (*): 1 new, 1 not run"),
        ("test_it", "test_it.py::test_other", 2, "new (*): 1 new, 1 not run"),
        ("test_old", "test_it.py", 2, "gone (*): 1 gone, 2 new"),
        ("test_it", "--dpbench-disturbed-exit=256", 4, "*found 256; allowed: 0 to 255"),
    ],
)
def test_a_benchmark_that_is_left_out_is_not_gone(
    pytester: pytest.Pytester, name: str, argument: str, code: int, text: str
) -> None:
    """Only one that could have been run is missed; where none is compared, the session fails."""
    tests = [f"def {one}(benchmark): benchmark(int)" for one in ("test_it", "test_other")]
    pytester.makepyfile(test_it="\n".join(tests))
    base = write_baseline(pytester.path, f"test_it.py::{name}", 1.0)
    result = run(pytester, f"--dpbench-compare={base}", argument)
    assert result.ret == code
    (result.stderr if code == 4 else result.stdout).fnmatch_lines([text])
    if code == 2:
        fault = f"no benchmark in common with {base}"
        assert result.outlines[-1] == f"dpbench: {fault} (exit code 2)"
        assert fault in result.outlines and "no regression" not in result.stdout.str()
