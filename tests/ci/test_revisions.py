"""Two working trees measured by turns, with tests that need no solver."""

from pathlib import Path

import pytest

from dpbench.ci import revisions
from dpbench.ci.benchmarks import BenchmarkRun
from dpbench.ci.revisions import Measured, main, measure_by_turns

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
        return Measured(BenchmarkRun.of([entry], failed if tree.name == "head" else {}))

    monkeypatch.setattr(revisions, "measure_tree", measure)
    return order


@pytest.fixture
def trees(tmp_path: Path) -> tuple[Path, Path]:
    """Two empty working trees."""
    for name in ("base", "head"):
        (tmp_path / name).mkdir()
    return tmp_path / "base", tmp_path / "head"


def test_turns_alternate_and_disturbed_pairs_are_repeated(
    monkeypatch: pytest.MonkeyPatch, trees: tuple[Path, Path]
) -> None:
    """Three undisturbed pairs are wanted; with load that stays, twice as many are the most."""
    order = stub_runs(monkeypatch, seconds={"base": 1.0, "head": 1.0}, loud=3)
    assert len(measure_by_turns(trees, 3, [])) == 5
    assert order[:4] == ["base", "head", "head", "base"]
    stub_runs(monkeypatch, seconds={"base": 1.0, "head": 1.0}, loud=99)
    assert len(measure_by_turns(trees, 3, [])) == 6


@pytest.mark.parametrize(
    ("seconds", "failed", "code", "text"),
    [
        ({"base": 1.0, "head": 2.0}, {}, 1, "slower"),
        ({"base": 1.0, "head": 1.0}, {}, 0, "no change shown"),
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
    assert capsys.readouterr().out.startswith(text)
    if code < 2:
        assert markdown.read_text(encoding="utf-8").startswith(f"**dpbench: {text}")


def test_a_missing_tree_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One line names it."""
    assert main([str(tmp_path / "none"), str(tmp_path)]) == 2
    assert "none: found no folder" in capsys.readouterr().err


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
