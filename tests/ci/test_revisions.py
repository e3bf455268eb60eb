"""Two working trees measured alternately, with tests that need no solver."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from dpbench.ci import gate, plugin, revisions
from dpbench.ci.benchmarks import BenchmarkRun, list_imported_files
from dpbench.ci.revisions import (
    ADVICE,
    STOPPED,
    Measured,
    main,
    measure_by_turns,
    require_imports_of_own_files,
)
from dpbench.errors import InputError

pytest.importorskip("pytest_benchmark", reason="is of the extra ci")


def stub_runs(
    monkeypatch: pytest.MonkeyPatch, *, seconds: dict[str, float], loud: int = 0, **failed: str
) -> list[str]:
    """Replace pytest by runs of known times, the first `loud` ones disturbed; return the order."""
    order: list[str] = []

    def measure(tree: Path, arguments: list[str]) -> Measured:
        assert arguments in ([], ["-k", "t"])
        order.append(tree.name)
        if tree.name not in seconds:
            return Measured(BenchmarkRun(), "pytest ended with exit code 5")
        switches = 1e3 if len(order) <= loud else 0.0
        machine = {"wall_s": 1.0, "processor_s": 1.0, "involuntary_switches": switches}
        stats = {"min": seconds[tree.name], "q1": seconds[tree.name], "rounds": 9}
        info = {"reference_ns": 4e4, "machine": machine}
        entry = {"fullname": "t", "stats": stats, "extra_info": info}
        return Measured(
            BenchmarkRun.from_json_entries([entry], failed if tree.name == "head" else {})
        )

    monkeypatch.setattr(revisions, "collect_imports", lambda tree, arguments: BenchmarkRun())
    monkeypatch.setattr(revisions, "measure_tree", measure)
    return order


@pytest.fixture
def trees(tmp_path: Path) -> tuple[Path, Path]:
    """Two empty working trees."""
    for name in ("base", "head"):
        (tmp_path / name).mkdir()
    return tmp_path / "base", tmp_path / "head"


def test_turns_alternate_and_one_disturbed_pair_is_repeated(
    monkeypatch: pytest.MonkeyPatch,
    trees: tuple[Path, Path],
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Three undisturbed pairs are wanted; load that stays ends the measurement after two."""
    order = stub_runs(monkeypatch, seconds={"base": 1.0, "head": 1.0}, loud=2)
    assert len([*measure_by_turns(trees, 3, [])]) == 4
    assert order[:4] == ["base", "head", "head", "base"]
    lines = capsys.readouterr().err.splitlines()
    assert lines[2] == "pair 1 disturbed: repeated"
    assert lines[3].startswith("pair 2 of at most 6 (0 of 3 undisturbed), head: 0 s, ")
    assert lines[-1] == "pair 4 of at most 6 (2 of 3 undisturbed), base: 0 s"
    assert len(lines) == 9
    stub_runs(monkeypatch, seconds={"base": 1.0, "head": 1.0}, loud=99)
    assert main([*map(str, trees), "--pairs", "3"]) == 0
    found = capsys.readouterr()
    assert found.err.splitlines()[-1] == f"pair 2 disturbed: {STOPPED}"
    scope, verdict, advice, exact, passes, last = found.out.splitlines()[-6:]
    assert scope.endswith("; 2 pairs of runs, 2 of them disturbed")
    assert verdict.startswith("times not judged (machine disturbed) in 1 of 1 benchmark; ")
    assert advice == ADVICE
    assert 'iterations, errors, counts in extra_info["exact"]' in exact
    assert passes.startswith("times not judged give exit code 0; --disturbed-exit CODE")
    assert last == "exit code 0 (disturbed)"
    stub_runs(monkeypatch, seconds={"base": 1.0, "head": 1.0}, loud=99)
    assert main([*map(str, trees), "--pairs", "3", "--disturbed-exit", "75"]) == 75
    end = [ADVICE, exact, "exit code 75 (disturbed)"]
    assert capsys.readouterr().out.splitlines()[-3:] == end


def test_the_remaining_time_falls_and_ends(
    monkeypatch: pytest.MonkeyPatch, trees: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """Runs of 10 s, all disturbed: a run is 10 s less of the larger time, and the last has none."""
    stub_runs(monkeypatch, seconds={"base": 1.0, "head": 1.0}, loud=99)
    clock = iter(range(0, 1000, 10))
    monkeypatch.setattr(revisions.time, "monotonic", lambda: next(clock))
    assert len([*measure_by_turns(trees, 2, [], attempts=3)]) == 3
    found = [line.partition("10 s")[2] for line in capsys.readouterr().err.splitlines()]
    assert found == [
        *(", about 50 s left", ", about 40 s left", ""),
        *(", about 30 s left", ", about 20 s left", ""),
        *(", about 10 s left", "", ""),
    ]


def test_attempts_go_on_after_disturbed_pairs(
    monkeypatch: pytest.MonkeyPatch,
    trees: tuple[Path, Path],
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Until enough pairs are undisturbed, or for so many pairs."""
    times = {"base": 1.0, "head": 1.0}
    stub_runs(monkeypatch, seconds=times, loud=8)
    assert len([*measure_by_turns(trees, 2, [], attempts=9)]) == 6
    stub_runs(monkeypatch, seconds=times, loud=99)
    assert len([*measure_by_turns(trees, 2, [], attempts=5)]) == 5
    assert capsys.readouterr().err.splitlines()[-1] == "pair 5 disturbed: no repeat left"
    stub_runs(monkeypatch, seconds=times, loud=99)
    assert main([*map(str, trees), "--pairs", "3", "--attempts", "1"]) == 0
    found = capsys.readouterr()
    assert "; 3 pairs of runs, 3 of them disturbed" in found.out and STOPPED not in found.out


@pytest.mark.parametrize(
    ("seconds", "failed", "code", "text"),
    [
        ({"base": 1.0, "head": 2.0}, {}, 1, "slower"),
        ({"base": 1.0, "head": 1.0}, {}, 0, "no difference shown"),
        ({"base": 1.0, "head": 1.0}, {"t": "wrong answers: 3"}, 1, "wrong answers"),
        ({"head": 1.0}, {}, 0, "no baseline"),
        ({"base": 1.0}, {}, 1, "failed, not timed"),
        ({}, {}, 2, ""),
    ],
)
def test_exit_codes_and_first_lines(
    monkeypatch: pytest.MonkeyPatch,
    trees: tuple[Path, Path],
    seconds: dict[str, float],
    failed: dict[str, str],
    code: int,
    text: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A base without benchmarks passes; a head without them, or with wrong answers, does not."""
    stub_runs(monkeypatch, seconds=seconds, **failed)
    markdown = trees[0].parent / "compare.md"
    assert main([*map(str, trees), "--markdown", str(markdown), "--", "-k", "t"]) == code
    found = capsys.readouterr()
    assert found.out.startswith(text)
    end = "stopped after 1 pair of runs, as a benchmark of the head has wrong answers"
    assert [end in stream for stream in found] == [text == "wrong answers"] * 2
    if code < 2:
        word = text if code or text == "no baseline" else "no regression"
        assert found.out.splitlines()[-1] == f"exit code {code} ({word})"
        assert markdown.read_text(encoding="utf-8").startswith(f"**dpbench: {text}")


def test_the_help_of_an_exit_code_is_of_what_the_command_does(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Only the gate stores a baseline."""
    for command, stores in ((main, False), (gate.main, True)):
        with pytest.raises(SystemExit):
            command(["--help"])
        words = " ".join(capsys.readouterr().out.split())
        assert (
            "stores a baseline that is disturbed or has no times of the reference kernel" in words
        ) is stores
        assert "times are not judged and no regression is shown" in words


def test_a_missing_tree_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One line names it."""
    assert main([str(tmp_path / "none"), str(tmp_path)]) == 2
    assert "none: no such folder" in capsys.readouterr().err


def test_no_pair_is_bad_input(trees: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    """It is not measured as one pair."""
    assert main([*map(str, trees), "--pairs", "0"]) == 2
    line = "revisions: --pairs: found 0; allowed: a whole number, 1 or more\n"
    assert capsys.readouterr().err == line


@pytest.mark.slow
def test_a_tree_without_dpbench_or_benchmarks_is_refused_before_the_first_run(
    trees: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line each: an environment of its own without dpbench, and no test that uses it."""
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    monkeypatch.setattr(revisions, "measure_tree", lambda *_: pytest.fail("a run was started"))
    loaded = ["-p", "no:xdist", "-p", "no:dpbench", "-p", plugin.__name__]
    for tree in trees:
        (tree / "test_it.py").write_text("def test_it(): pass\n", encoding="utf-8")
    assert main([*map(str, trees), "--", *loaded]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no test with dpbench_replay or another benchmark in either tree" in line
    own = trees[0] / ".venv" / "bin" / "python"
    own.parent.mkdir(parents=True)
    own.write_text(f'#!/bin/sh\nexec {sys.executable} -S -E "$@"\n', encoding="utf-8")
    own.chmod(0o755)
    assert main([*map(str, trees), "--", *loaded]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"revisions: {trees[0]}: {own} has no dpbench with its extra ci (")


@pytest.mark.slow
def test_a_tree_is_measured_by_its_own_tests(
    trees: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Times come back by name; a tree without tests has a reason."""
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    test = "def test_it(benchmark):\n    benchmark(lambda: 1)\n"
    (trees[1] / "test_it.py").write_text(test, encoding="utf-8")
    quick = ["--benchmark-min-rounds=2", "--benchmark-max-time=0.01", "-p", "no:xdist"]
    found = revisions.measure_tree(trees[1], quick)
    assert set(found.run.benchmarks) == {"test_it.py::test_it"}
    assert "exit code 5" in revisions.measure_tree(trees[0], quick).reason


TIMED = "def test_it(benchmark):\n    benchmark.extra_info['exact'] = {'calls': %d}\n"
TIMED += "    benchmark(lambda: 1)\n"
LOADED = ["-p", "no:xdist", "-p", "no:dpbench", "-p", plugin.__name__]
LOADED += ["--benchmark-min-rounds=2", "--benchmark-max-time=0.01"]


def compare_files(trees: tuple[Path, Path], *arguments: str) -> int:
    """Exit code of one pair of runs with the arguments of pytest."""
    return main([*map(str, trees), "--pairs", "1", "--", *LOADED, *arguments])


@pytest.mark.slow
@pytest.mark.parametrize("only_in", [0, 1])
def test_a_file_of_one_tree_does_not_hide_the_common_benchmarks(
    trees: tuple[Path, Path],
    only_in: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A new one is new, one that is missing is gone; what both have is compared."""
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    for count, tree in enumerate(trees, 1):
        (tree / "test_counts.py").write_text(TIMED % count, encoding="utf-8")
    (trees[only_in] / "test_other.py").write_text(TIMED % 1, encoding="utf-8")
    assert compare_files(trees, "test_counts.py", "test_other.py::test_it", "-k", "test_it") == 1
    found = capsys.readouterr().out
    assert found.startswith("worse (an exact measure grew): 1 worse, 1 " + ("gone", "new")[only_in])
    assert "calls 1 → 2" in found
    code, text = ((1, "gone"), (0, "no baseline"))[only_in]
    assert compare_files(trees, "test_other.py") == code
    out, err = capsys.readouterr()
    assert out.startswith(text) and "pytest ended" not in out and " left" not in err
    assert main([*map(str, trees), "--allow-gone", "--", *LOADED, "test_other.py"]) == 0


@pytest.mark.slow
def test_a_file_of_neither_tree_is_bad_input(
    trees: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line names it; a value of an option that looks like a file is none."""
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    for tree in trees:
        (tree / "test_it.py").write_text(TIMED % 1, encoding="utf-8")
    assert compare_files(trees, "test_it.py", "test_typo.py", "--deselect", "none.py") == 2
    (line,) = capsys.readouterr().err.splitlines()
    required = "required: a file or folder of a working tree"
    assert line == f"revisions: test_typo.py: no such file or folder in either tree; {required}"
    assert compare_files(trees, "test_it.py", "--deselect", "none.py") == 0


@pytest.mark.slow
def test_an_error_of_pytest_in_the_base_is_no_missing_baseline(
    trees: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file that cannot be imported hides the benchmarks of the others."""
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    for tree in trees:
        (tree / "test_it.py").write_text(TIMED % 1, encoding="utf-8")
    (trees[0] / "test_broken.py").write_text("import missing_module", encoding="utf-8")
    assert compare_files(trees) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"revisions: {trees[0]}: pytest ended with exit code 2: ")
    assert "ERROR test_broken.py" in line and "; required: a base in which pytest ends" in line
    assert compare_files(trees, "test_it.py") == 0


def test_a_file_is_of_the_innermost_tree(trees: tuple[Path, Path]) -> None:
    """A worktree of the base may lie in the head; one tree may be compared with itself."""
    head, base = trees[1], trees[1] / "old"
    files = (str(base / "src" / "it.py"),)
    require_imports_of_own_files((base, head), (BenchmarkRun(imported=files), BenchmarkRun()))
    require_imports_of_own_files(
        (base, base), (BenchmarkRun(imported=files), BenchmarkRun(imported=files))
    )
    with pytest.raises(InputError, match=r"head: imports .*it\.py, a file of the other tree; "):
        require_imports_of_own_files((base, head), (BenchmarkRun(), BenchmarkRun(imported=files)))


def test_of_installed_packages_only_the_top_is_listed() -> None:
    """The file of a package, not those of its modules; nothing of the standard library."""
    listed = list_imported_files()
    assert [name for name in listed if "numpy" in Path(name).parts] == [np.__file__]
    assert {json.__file__, __file__}.intersection(listed) == {__file__}


@pytest.mark.parametrize("folder", [".", "src"])
def test_one_installed_copy_for_both_trees_is_bad_input(
    trees: tuple[Path, Path], folder: str
) -> None:
    """The package is in both trees, and neither's is measured; other packages may be shared."""
    site = trees[0].parent / "lib" / "site-packages"
    both = BenchmarkRun(
        imported=(str(site / "numpy" / "__init__.py"), str(site / "it" / "__init__.py"))
    )
    require_imports_of_own_files(trees, (both, both))
    for tree in trees:
        require_imports_of_own_files(trees, (both, both))
        (tree / folder / "it").mkdir(parents=True)
        (tree / folder / "it" / "__init__.py").touch()
    with pytest.raises(
        InputError, match=r"both import .*it/__init__\.py, so both .*; install the package in"
    ):
        require_imports_of_own_files(trees, (both, both))
    require_imports_of_own_files(trees, (both, BenchmarkRun(imported=both.imported[:1])))


@pytest.mark.slow
@pytest.mark.parametrize(("installed", "misled"), [(1, "base"), (0, "head")])
def test_a_tree_measured_with_the_package_of_the_other_is_bad_input(
    trees: tuple[Path, Path],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    installed: int,
    misled: str,
) -> None:
    """An editable package of one tree is imported in both, until each has its `pythonpath`."""
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    for tree in trees:
        (tree / "src").mkdir()
        (tree / "src" / "mysolver.py").write_text("def solve():\n    return 1\n", encoding="utf-8")
        test = "from mysolver import solve\ndef test_it(benchmark):\n    benchmark(solve)\n"
        (tree / "test_it.py").write_text(test, encoding="utf-8")
    source = trees[installed] / "src"
    monkeypatch.setenv("PYTHONPATH", str(source), prepend=os.pathsep)
    quick = ["--benchmark-min-rounds=2", "--benchmark-max-time=0.01"]
    loaded = ["-p", "no:xdist", "-p", "no:dpbench", "-p", plugin.__name__]
    given = [*map(str, trees), "--pairs", "1", "--", *quick, *loaded]
    assert main(given) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"revisions: {misled}: imports {source / 'mysolver.py'}")
    assert main([*given, "-o", "pythonpath=src"]) == 0


@pytest.mark.slow
def test_a_package_in_src_is_missed_before_the_first_run(
    trees: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One installed copy for both is refused, and one that is not found has a remedy."""
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)
    site = trees[0].parent / "site-packages"
    for folder in (site, *(tree / "src" for tree in trees)):
        (folder / "mysolver").mkdir(parents=True)
        (folder / "mysolver" / "__init__.py").touch()
    for tree in trees:
        # As by a plug-in, which is loaded when its test runs.
        test = "def test_it(benchmark):\n    import mysolver\n    benchmark(int)\n"
        (tree / "test_it.py").write_text(test, encoding="utf-8")
    loaded = ["-p", "no:xdist", "-p", "no:dpbench", "-p", plugin.__name__]
    with monkeypatch.context() as installed:
        installed.setenv("PYTHONPATH", str(site), prepend=os.pathsep)
        assert main([*map(str, trees), "--", *loaded]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"base and head: both import {site / 'mysolver' / '__init__.py'}, so both would" in line
    (trees[1] / "test_it.py").write_text("import mysolver", encoding="utf-8")
    reason = revisions.measure_tree(trees[1], loaded).reason
    assert (
        "mysolver is in src, which is not on Python's path: install the package in a .venv"
        in reason
    )


@pytest.mark.parametrize(("options", "code"), [([], 0), (["--disturbed-exit", "75"], 75)])
def test_a_disturbed_comparison_fails_on_request(
    monkeypatch: pytest.MonkeyPatch, trees: tuple[Path, Path], options: list[str], code: int
) -> None:
    """A check that must end with a verdict does not pass without one."""
    stub_runs(monkeypatch, seconds={"base": 1.0, "head": 1.0}, loud=99)
    assert main([*map(str, trees), "--pairs", "1", *options]) == code


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_keeps_the_complete_pairs(
    monkeypatch: pytest.MonkeyPatch,
    trees: tuple[Path, Path],
    capsys: pytest.CaptureFixture[str],
    number: signal.Signals,
) -> None:
    """In the second run of the third pair: two pairs are compared, on the screen and in a file."""
    order = stub_runs(monkeypatch, seconds={"base": 1.0, "head": 2.0})
    measure = revisions.measure_tree

    def measure_five(tree: Path, arguments: list[str]) -> Measured:
        if len(order) == 5:
            signal.raise_signal(number)
        return measure(tree, arguments)

    monkeypatch.setattr(revisions, "measure_tree", measure_five)
    markdown = trees[0].parent / "compare.md"
    given = ["revisions", *map(str, trees), "--markdown", str(markdown)]
    monkeypatch.setattr(sys, "argv", given)
    assert revisions.run() == 128 + number
    found = capsys.readouterr()
    assert found.out.startswith("slower: 1 benchmark\n")
    assert "; 2 pairs of runs, 0 of them disturbed" in found.out
    assert found.out.splitlines()[-1] == "interrupted after 2 pairs of runs"
    assert found.err.splitlines()[-1] == "revisions: interrupted"
    assert markdown.read_text(encoding="utf-8").startswith("**dpbench: slower: 1 benchmark**")


@pytest.mark.slow
def test_sigterm_ends_the_pytest_that_it_has_started(trees: tuple[Path, Path]) -> None:
    """Nothing goes on measuring behind a job that was cancelled."""
    started = trees[0] / "started"
    test = (
        "import os, pathlib, time\n"
        "pathlib.Path('pid').write_text(str(os.getpid()))\n"
        "pathlib.Path('pid').rename('started')\n"
        "def test_it(benchmark):\n    time.sleep(600)\n"
    )
    (trees[0] / "test_it.py").write_text(test, encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "dpbench.ci.revisions",
        *map(str, trees),
        "--",
        "-p",
        "no:xdist",
    ]
    # Of a session that runs side by side, in which nothing is timed.
    inherited = {name: x for name, x in os.environ.items() if not name.startswith("PYTEST_XDIST")}
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=inherited) as process:
        while not started.exists():
            assert process.poll() is None, process.communicate()[1]
            time.sleep(0.05)
        child = int(started.read_text(encoding="utf-8"))
        process.terminate()
        assert process.communicate()[1].splitlines()[-1] == "revisions: interrupted"
    assert process.returncode == 128 + signal.SIGTERM
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)
