"""The gate of `make bench-compare` on JSON files with planted changes."""

import importlib.util
import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

GATE = Path(__file__).parents[1] / "benchmarks" / "gate.py"
Write = Callable[..., Path]


@pytest.fixture(scope="module")
def gate() -> ModuleType:
    """The script as a module; `benchmarks` is no package."""
    spec = importlib.util.spec_from_file_location("bench_gate", GATE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Writes a run of ten benchmarks of 1 to 10 ms, some of them changed."""

    def run(
        name: str, *, slow: dict[int, float] | None = None, machine: float = 1.0, **exact: int
    ) -> Path:
        benchmarks: list[dict[str, Any]] = []
        for i in range(10):
            # Ratios of two runs scatter by some 1 %, in a fixed pattern.
            wobble = 1.0 + 0.01 * ((i * len(name)) % 3 - 1)
            smallest = 1e-3 * (i + 1) * (slow or {}).get(i, 1.0) * machine * wobble
            measures = {"iterations": 100, "peak_bytes": 1000} | (exact if i == 4 else {})
            benchmarks.append(
                {
                    "fullname": f"test_x.py::test[{i}]",
                    "stats": {"min": smallest, "q1": 1.01 * smallest, "rounds": 50},
                    "extra_info": {"reference_ns": 4e4 * machine, "exact": measures},
                }
            )
        path = tmp_path / f"{name}.json"
        path.write_text(json.dumps({"benchmarks": benchmarks}), encoding="utf-8")
        return path

    return run


def judged(gate: ModuleType, folder: Path, *runs: Path) -> list[int]:
    """Exit codes of one run after the other; nothing is measured again."""
    return [gate.main([str(run), str(folder / "baseline"), "--retries", "0"]) for run in runs]


def test_the_first_run_is_stored_and_the_second_compared(
    gate: ModuleType, write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """No baseline is no failure; it says so and keeps the run, byte for byte."""
    first = write("first")
    assert judged(gate, tmp_path, first) == [0]
    assert "no baseline of this machine yet" in capsys.readouterr().out
    (stored,) = (tmp_path / "baseline").iterdir()
    assert stored.read_bytes() == first.read_bytes()
    assert judged(gate, tmp_path, write("second")) == [0]
    assert "nothing worse" in capsys.readouterr().out


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
    ],
)
def test_planted_changes(
    gate: ModuleType,
    write: Write,
    tmp_path: Path,
    changes: dict[str, Any],
    code: int,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A slower benchmark, one iteration more or 30 % more memory fail; slow machines pass."""
    assert judged(gate, tmp_path, write("before"), write("later", **changes)) == [0, code]
    assert ("test_x.py::test[4]" in capsys.readouterr().out) or code == 0


def test_renewing_the_baseline(gate: ModuleType, write: Write, tmp_path: Path) -> None:
    """An accepted change becomes the baseline, and then is no change."""
    slow, folder = write("later", slow={4: 2.0}), str(tmp_path / "baseline")
    assert judged(gate, tmp_path, write("before"), slow) == [0, 1]
    assert gate.main([str(slow), folder, "--renew"]) == 0
    assert judged(gate, tmp_path, slow) == [0]


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("{", "no such numbers"),
        ('{"benchmarks": []}', "benchmarks: found none"),
        ('{"benchmarks": [{"fullname": "a", "stats": {"min": 1}}]}', "extra_info"),
        ('{"benchmarks": [{"fullname": "a", "stats": {"min": "x"}, "extra_info": '
         '{"reference_ns": 1}}]}', "no such numbers"),
    ],
)  # fmt: skip
def test_a_damaged_file_is_one_line(
    gate: ModuleType, tmp_path: Path, text: str, part: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Exit 2 and a line with the file's name, also where there is no file."""
    path = tmp_path / "run.json"
    path.write_text(text, encoding="utf-8")
    assert judged(gate, tmp_path, path, tmp_path / "none.json") == [2, 2]
    first, second = capsys.readouterr().err.strip().splitlines()
    assert "run.json" in first and part in first
    assert "none.json" in second
    assert not (tmp_path / "baseline").exists()
