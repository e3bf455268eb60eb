"""The gate on JSON files of pytest-benchmark with planted changes."""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import MagicMock

import pytest

from dpbench.ci import gate
from dpbench.ci.benchmarks import SELECTION
from dpbench.ci.failures import FailedBenchmarks

Write = Callable[..., Path]
DESCRIBED = cache(gate.describe_machine)


@pytest.fixture(autouse=True)
def described_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Describe this machine once for all runs of the gate."""
    monkeypatch.setattr(gate, "describe_machine", DESCRIBED)


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Writes a run of ten benchmarks of 1 to 10 ms, some changed, the first `own` of one solver.

    noted : whether the others have each a solver.
    """

    def run(
        name: str,
        *,
        slow: dict[int, float] | None = None,
        machine: float = 1.0,
        kernel: bool = True,
        count: int = 10,
        own: int = 0,
        noted: bool = True,
        **exact: float,
    ) -> Path:
        benchmarks: list[dict[str, Any]] = []
        for i in range(count):
            # Ratios of two runs scatter by some 1 %, in a fixed pattern.
            wobble = 1.0 + 0.01 * ((i * len(name)) % 3 - 1)
            smallest = 1e-3 * (i + 1) * (slow or {}).get(i, 1.0) * machine * wobble
            measures = {"iterations": 100, "peak_bytes": 1000, "error_move_max": 1e-9}
            measures |= exact if i == 4 else {}
            solver = f"mine (native, {i})" if i < own else f"other-{i}" * noted
            benchmarks.append(
                {
                    "fullname": f"test_x.py::test[{i}]",
                    "stats": {"min": smallest, "q1": 1.01 * smallest, "rounds": 50},
                    "extra_info": {"exact": measures}
                    | ({"reference_ns": 4e4 * machine} if kernel else {})
                    | ({"solver": solver} if solver else {}),
                }
            )
        path = tmp_path / f"{name}.json"
        path.write_text(json.dumps({"benchmarks": benchmarks}), encoding="utf-8")
        return path

    return run


def judged(folder: Path, *runs: Path) -> list[int]:
    """Exit codes of one run after the other; nothing is measured again."""
    return [gate.main([str(run), str(folder / "baseline"), "--retries", "0"]) for run in runs]


def test_the_first_run_is_stored_and_the_second_compared(
    write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No baseline is no failure; it says so and keeps the run, byte for byte."""
    first = write("first")
    assert judged(tmp_path, first) == [0]
    assert "no baseline of this machine yet" in capsys.readouterr().out
    (stored,) = (tmp_path / "baseline").iterdir()
    assert stored.read_bytes() == first.read_bytes()
    assert judged(tmp_path, write("second")) == [0]
    out = capsys.readouterr().out
    assert "no difference shown: 10 benchmarks" in out
    assert f"10 of 10 benchmarks compared; 10 in {stored}, 10 in {tmp_path / 'second.json'}" in out


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"slow": {4: 2.0}}, 1),
        ({"slow": {4: 0.5}}, 0),
        ({"slow": {4: 1.1}}, 0),
        ({"machine": 2.0}, 0),
        ({"machine": 2.0, "slow": {4: 2.0}}, 1),
        ({"iterations": 101}, 1),
        ({"iterations": 99}, 0),
        ({"peak_bytes": 1300}, 1),
        ({"peak_bytes": 1100}, 0),
        ({"error_move_max": 1e-7}, 1),
        ({"error_move_max": 1.9e-9}, 0),
    ],
)
def test_planted_changes(
    write: Write,
    tmp_path: Path,
    changes: dict[str, Any],
    code: int,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A slower benchmark, one iteration more or 30 % more memory fail; slow machines pass."""
    assert judged(tmp_path, write("before"), write("later", **changes)) == [0, code]
    out = capsys.readouterr().out
    assert ("test_x.py::test[4]" in out) or code == 0
    words = "largest error of the first move 1.00e-09 → 1.00e-07 maximum increments"
    assert (words in out) == (changes.get("error_move_max") == 1e-7)


@pytest.mark.parametrize(("count", "machine"), [(4, 1.0), (4, 2.0), (10, 1.0), (10, 2.0)])
def test_a_solver_that_became_slower_as_a_whole_fails(
    write: Write, tmp_path: Path, count: int, machine: float
) -> None:
    """Its own benchmarks do not stand for the machine: others' do, or the reference kernel."""
    before = write("before", count=count, own=4)
    slow = write("later", count=count, own=4, slow=dict.fromkeys(range(4), 3.0), machine=machine)
    same = write("again", count=count, own=4, machine=machine)
    assert judged(tmp_path, before, slow, same) == [0, 1, 0]


@pytest.mark.parametrize(
    ("kernel", "slow", "code", "verdict", "count"),
    [
        (False, dict.fromkeys(range(4), 10.0), 0, "no reference kernel", 4),
        (True, dict.fromkeys(range(4), 3.0), 1, "slower", 4),
        (True, {1: 10.0}, 1, "slower", 1),
        (True, {}, 0, "no difference shown", 4),
    ],
)
def test_benchmarks_without_a_solver_do_not_stand_for_the_machine(
    write: Write,
    tmp_path: Path,
    kernel: bool,
    slow: dict[int, float],
    code: int,
    verdict: str,
    count: int,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Any of them may be of the changed code: the reference kernel does, or nothing."""
    common: dict[str, Any] = {"count": 4, "noted": False, "kernel": kernel}
    before, later = write("before", **common), write("later", slow=slow, **common)
    assert judged(tmp_path, before, later) == [0, code]
    rows = [line.split("│") for line in capsys.readouterr().out.splitlines() if "│" in line]
    rest = ["no difference shown"] * (4 - count)
    assert [row[1].strip() for row in rows] == [verdict] * count + rest
    for row in rows[:count]:
        assert float(row[2].split()[0]) == pytest.approx(max(slow.values(), default=1.0), rel=0.03)


def test_a_run_without_a_benchmark_of_the_baseline_fails(
    write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A benchmark of the baseline that is gone is no pass, unless that is allowed."""
    renamed = write("later")
    renamed.write_text(renamed.read_text("utf-8").replace("[4]", "[x]"), encoding="utf-8")
    assert judged(tmp_path, write("before"), renamed) == [0, 1]
    out = capsys.readouterr().out
    counts = "1 gone, 9 no difference shown, 1 new"
    assert f"gone (a benchmark of the base is missing or skipped): {counts}" in out
    arguments = [str(renamed), str(tmp_path / "baseline"), "--retries", "0", "--allow-gone"]
    assert gate.main(arguments) == 0


@pytest.mark.parametrize("options", [(), ("--allow-gone",)])
def test_files_without_a_benchmark_in_common_are_not_compared(
    write: Write, tmp_path: Path, options: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    """Two files of other tests, of which neither session has run the other's."""
    base, other = write("base"), write("other")
    stored = json.loads(other.read_text("utf-8").replace("test_x", "test_y"))
    stored[SELECTION] = {"given": ["test_y.py"], "deselected": []}
    other.write_text(json.dumps(stored), encoding="utf-8")
    assert gate.main([str(other), str(base), *options]) == 2
    out, err = capsys.readouterr()
    (line,) = err.splitlines()
    assert not out
    fault = f"gate: {other}: found no benchmark in common with {base}"
    assert line.startswith(f"{fault}; --renew replaces {base} with {other}")
    assert gate.main([str(other), str(tmp_path / "none.json"), *options]) == 0


def test_the_margin_is_that_of_the_option(
    write: Write, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A slowdown within it is neither a regression nor measured again."""
    before, later = write("before"), write("later", slow={4: 2.0})
    repeated: list[list[str]] = []
    monkeypatch.setattr(gate, "_run_benchmarks", lambda names: repeated.append(names) or {})
    arguments = [str(later), str(before), "--retries", "1"]
    assert gate.main([*arguments, "--margin", "2"]) == 0 and not repeated
    assert gate.main(arguments) == 1 and len(repeated) == 1
    for margin in ("0", "nan", "15%"):
        with pytest.raises(SystemExit):
            gate.main([*arguments, "--margin", margin])
        assert f"--margin: found {margin}; allowed: " in capsys.readouterr().err


def test_a_baseline_of_a_disturbed_machine_has_a_warning(
    write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A stored run names its benchmarks whose times have no verdict later."""
    path = write("first", count=2)
    stored = json.loads(path.read_text("utf-8"))
    machine = {"wall_s": 1.0, "processor_s": 1.0, "involuntary_switches": 99.0}
    stored["benchmarks"][1]["extra_info"]["machine"] = machine
    path.write_text(json.dumps(stored), encoding="utf-8")
    assert judged(tmp_path, path) == [0]
    warning = "machine disturbed in 1 of 2 benchmarks: as a baseline, their times will not be"
    assert warning in capsys.readouterr().out
    arguments = [str(path), str(tmp_path / "baseline"), "--renew", "--disturbed-exit", "75"]
    assert gate.main(arguments) == 75
    assert capsys.readouterr().out.splitlines()[-1] == "exit code 75 (baseline stored)"
    config: Any = MagicMock(args=["."])
    config.option.collectonly = False
    config.rootpath = config.invocation_params.dir = tmp_path
    notes, terminal = FailedBenchmarks(config), MagicMock()
    notes.pytest_benchmark_update_json(stored)
    notes.pytest_terminal_summary(terminal)
    assert terminal.write_line.call_args.args[0].startswith(f"stored times: {warning}")
    machine["involuntary_switches"] = 3.0
    notes.pytest_benchmark_update_json(stored)
    notes.pytest_terminal_summary(terminal)
    line = "stored times: machine quiet; reference kernel stored in 1 of 2 benchmarks"
    terminal.write_line.assert_called_with(line, yellow=False)


@pytest.mark.parametrize(("kernel", "count", "warns"), [(0, 3, 1), (0, 5, 0), (1, 3, 0)])
def test_a_baseline_without_a_reference_kernel_has_a_warning(
    write: Write,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    kernel: int,
    count: int,
    warns: int,
) -> None:
    """Its times have no verdict later; three other solvers take the place of the kernel."""
    run = write("first", kernel=bool(kernel), count=count)
    arguments = [str(run), str(tmp_path / "baseline"), "--disturbed-exit", "75"]
    assert gate.main(arguments) == 75 * warns
    out = capsys.readouterr().out
    cause = f"too few other solvers and no reference kernel in {count} of {count} benchmarks"
    warning = f"{cause}: as a baseline, their times will not be compared; add the fixture dpbench_"
    assert (warning in out) is bool(warns)
    assert gate.main(arguments) == 75 * warns
    assert ("times not judged (too few" in capsys.readouterr().out) is bool(warns)


def test_nothing_is_repeated_against_a_disturbed_baseline(
    write: Write,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its warning comes first; a benchmark with more iterations is measured again."""
    base, now = write("first", count=2), write("later", count=2, slow={1: 3.0})
    stored = json.loads(base.read_text("utf-8"))
    machine = {"wall_s": 1.0, "processor_s": 1.0, "involuntary_switches": 99.0}
    stored["benchmarks"][1]["extra_info"]["machine"] = machine
    base.write_text(json.dumps(stored), encoding="utf-8")
    repeated: list[list[str]] = []
    monkeypatch.setattr(gate, "_run_benchmarks", lambda names: repeated.append(names) or {})
    assert gate.main([str(now), str(base)]) == 0
    out = capsys.readouterr().out
    assert out.startswith("the machine was disturbed in 1 of 2 benchmarks of the baseline")
    assert out.splitlines()[-1] == "exit code 0 (disturbed)" and not repeated
    stored["benchmarks"][1]["extra_info"]["exact"]["iterations"] = 99
    base.write_text(json.dumps(stored), encoding="utf-8")
    assert gate.main([str(now), str(base), "--retries", "1"]) == 1
    assert repeated == [["test_x.py::test[1]"]]


def test_an_increase_is_allowed_by_an_option(
    write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before, later = write("before", own=10), write("later", own=10, iterations=101)
    arguments = [str(later), str(before), "--retries", "0"]
    assert gate.main(arguments) == 1
    assert gate.main([*arguments, "--allow", "iterations:mine"]) == 0
    assert "iterations 100 → 101 (allowed)" in capsys.readouterr().out
    assert gate.main([*arguments, "--allow", "iterations:mine=1%"]) == 0
    assert gate.main([*arguments, "--allow", "iterations:mine=0.5%"]) == 1
    with pytest.raises(SystemExit):
        gate.main([*arguments, "--allow", "iterations:mine=ten"])


def test_a_benchmark_that_the_session_left_out_is_not_gone(write: Write, tmp_path: Path) -> None:
    """A file of `pytest -k` names the deselected tests; the gate compares the rest."""
    part = write("later", count=9)
    stored = json.loads(part.read_text("utf-8"))
    assert judged(tmp_path, write("before"), part) == [0, 1]
    stored[SELECTION] = {"given": ["test_x.py"], "deselected": ["test_x.py::test[9]"]}
    part.write_text(json.dumps(stored), encoding="utf-8")
    assert judged(tmp_path, part) == [0]


def test_renewing_the_baseline(write: Write, tmp_path: Path) -> None:
    """An accepted change becomes the baseline, and then is no change."""
    slow, folder = write("later", slow={4: 2.0}), str(tmp_path / "baseline")
    assert judged(tmp_path, write("before"), slow) == [0, 1]
    assert gate.main([str(slow), folder, "--renew"]) == 0
    assert judged(tmp_path, slow) == [0]


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("{", "cannot be read"),
        ('{"benchmarks": []}', "benchmarks: found none"),
        ('{"benchmarks": [{"fullname": "a", "stats": {"min": 1}}]}', "q1: missing"),
        ('{"benchmarks": [{"fullname": "a", "stats": {"min": "x", "q1": 1}}]}', "cannot be read"),
        ('{"benchmarks": [{"fullname": "a", "stats": {"min": 0, "q1": 1, "rounds": 1}}]}', "times"),
    ],
)  # fmt: skip
def test_a_damaged_file_is_one_line(
    tmp_path: Path, text: str, part: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit 2 and a line with the file's name, also where there is no file."""
    path = tmp_path / "run.json"
    path.write_text(text, encoding="utf-8")
    assert judged(tmp_path, path, tmp_path / "none.json") == [2, 2]
    first, second = capsys.readouterr().err.strip().splitlines()
    assert "run.json" in first and part in first
    assert "none.json" in second
    assert not (tmp_path / "baseline").exists()


@pytest.mark.parametrize(
    ("kernel", "count", "factor", "code"),
    [(False, 10, 2.0, 1), (False, 1, 2.0, 0), (True, 1, 2.0, 1), (True, 1, 1.2, 0)],
)
def test_few_benchmarks_need_the_reference_kernel(
    write: Write, tmp_path: Path, kernel: bool, count: int, factor: float, code: int
) -> None:
    """Ten stand for the machine; one alone has a verdict by the kernel, and only if clear."""
    at, common = (4 if count > 4 else 0), {"kernel": kernel, "count": count}
    runs = write("before", **common), write("later", slow={at: factor}, **common)
    assert judged(tmp_path, *runs) == [0, code]


@pytest.mark.parametrize(("options", "code"), [([], 0), (["--disturbed-exit", "75"], 75)])
def test_times_without_a_reference_kernel_have_the_exit_code_of_disturbed_ones(
    write: Write, capsys: pytest.CaptureFixture[str], options: list[str], code: int
) -> None:
    """The first line is the remedy; more iterations are a regression all the same."""
    common: dict[str, Any] = {"kernel": False, "count": 2}
    before, slow = write("before", **common), write("later", slow={0: 2.0}, **common)
    assert gate.main([str(slow), str(before), *options]) == code
    lines = capsys.readouterr().out.splitlines()
    cause = "too few other solvers and no reference kernel"
    remedy = "add the fixture dpbench_reference_kernel to the tests and measure the baseline again"
    assert lines[0] == (f"no reference kernel (times not judged, {cause}: {remedy}): 2 benchmarks")
    assert any(one.startswith(f"times not judged ({cause}) in 2 of 2 benchmarks") for one in lines)
    hint = "times not judged give exit code 0; --disturbed-exit CODE changes it"
    assert (hint in lines) == (code == 0)
    assert lines[-1] == f"exit code {code} (times not judged)"
    worse = write("worse", kernel=False, count=5, iterations=200)
    assert (
        gate.main(
            [str(worse), str(write("base", kernel=False, count=5)), "--retries", "0", *options]
        )
        == 1
    )


def test_a_baseline_may_be_one_file(write: Write, tmp_path: Path) -> None:
    """A path that ends in .json is the baseline itself, whatever the machine."""
    before, slow = write("before"), write("later", slow={4: 2.0})
    arguments = [str(slow), str(before), "--retries", "0"]
    assert gate.main(arguments) == 1


@pytest.mark.parametrize("value", ["7", None, [1]])
def test_a_measure_that_is_no_number_is_bad_input(
    write: Write, value: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line names file, benchmark, measure, what was found and what is allowed."""
    base, now = write("base"), write("now", x=value)
    assert gate.main([str(now), str(base)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    place = f'{now}: test_x.py::test[4]: extra_info["exact"]["x"]'
    assert line == f"gate: {place}: found {value!r}; allowed: a number"
