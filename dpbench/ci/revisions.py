"""Compare two revisions of a solver by its benchmarks, measured by turns.

    python -m dpbench.ci.revisions BASE HEAD [--pairs 5] [--markdown FILE] [-- PYTEST ARGUMENTS]

BASE and HEAD are working trees. pytest runs in each by turns, with `.venv/bin/python` of the tree
where there is one. Pairs of runs that other load disturbed are repeated, each once at most. Exit 0:
no regression shown, or a base without benchmarks; 1: a regression, wrong answers, a benchmark that
failed or is gone, with --fail-disturbed also a disturbed one; 2: bad input, or a tree whose
benchmarks import files of the other.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from dpbench.bench.workers.interrupts import first_signal_only
from dpbench.ci import MARGIN
from dpbench.ci.benchmarks import BenchmarkRun, is_in_site_packages, load_run
from dpbench.ci.comparison import DISTURBED, NOT_TIMED, Row, RunComparison, compare_runs
from dpbench.errors import InputError, SituationError
from dpbench.files.regular_files import write_bytes_to_file_or_pipe
from dpbench.report.formats import plural

REMEDY = 'give each tree a .venv, or pytest `pythonpath = ["src"]`'
"""Ways to have a tree measured with its own files."""
SHOWN_LINES = 5
"""Last lines of a pytest run that has no benchmarks."""


@dataclass(frozen=True)
class Measured:
    """One run of a tree's benchmarks; the reason where pytest did not come to its end."""

    run: BenchmarkRun
    reason: str = ""

    @property
    def is_quiet(self) -> bool:
        """True if nothing disturbed the machine."""
        return not any(one.complaints for one in self.run.benchmarks.values())


def measure_tree(tree: Path, arguments: Sequence[str]) -> Measured:
    """Run a working tree's benchmarks with pytest; return the times, or why there are none."""
    own = tree.resolve() / ".venv" / "bin" / "python"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.json"
        command = [str(own) if own.exists() else sys.executable, "-m", "pytest", "-q"]
        command += ["--rootdir=.", "--benchmark-only", f"--benchmark-json={path}", *arguments]
        done = subprocess.run(
            command, cwd=tree, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False
        )
        lines = [line for line in done.stdout.decode(errors="replace").splitlines() if line.strip()]
        reason = (
            f"pytest ended with exit code {done.returncode}: {' | '.join(lines[-SHOWN_LINES:])}"
        )
        # 0 and 1: every test was run to its end.
        if done.returncode > 1 or not path.exists():
            return Measured(BenchmarkRun(), reason)
        try:
            return Measured(load_run(path))
        except InputError:
            return Measured(BenchmarkRun(), reason)


def require_imports_of_own_files(
    trees: tuple[Path, Path], runs: tuple[BenchmarkRun, BenchmarkRun]
) -> None:
    """Raise SituationError where both trees were not measured with files of their own.

    That is where a run of one has imported a file of the other (a file is of the innermost tree,
    as one tree may lie in the other), or both the same installed copy of a package of both.
    """
    folders = [tree.resolve() for tree in trees]
    for side, other, own, run in zip(
        ("base", "head"), reversed(folders), folders, runs, strict=True
    ):
        for file in map(Path, run.imported):
            owners = [one for one in folders if file.is_relative_to(one)]
            if owners and max(owners, key=lambda one: len(one.parts)) == other != own:
                raise SituationError(side, f"imports {file}: {REMEDY}")
    if folders[0] != folders[1]:
        for file in map(Path, sorted({*runs[0].imported}.intersection(runs[1].imported))):
            if is_in_site_packages(file) and all(_has_module(one, file) for one in folders):
                raise SituationError("base and head", f"both import {file}: {REMEDY}")


def _has_module(tree: Path, installed: Path) -> bool:
    """Return True if a tree has the source of an installed top-level module or package."""
    name = installed.parts[-2:] if installed.stem == "__init__" else installed.parts[-1:]
    return any((tree / folder).joinpath(*name).exists() for folder in (".", "src"))


def measure_by_turns(
    trees: tuple[Path, Path], count: int, arguments: Sequence[str]
) -> list[tuple[Measured, Measured]]:
    """Measure two trees by turns until so many pairs are undisturbed; return all pairs.

    One pair is enough where the base has no benchmark or the head has one that fails.
    SituationError where a tree is not measured with its own files.
    """
    pairs: list[tuple[Measured, Measured]] = []
    while len(pairs) < 2 * count and _count_undisturbed_pairs(pairs) < count:
        # Neither is always the second.
        turns = (0, 1) if len(pairs) % 2 == 0 else (1, 0)
        pair = f"pair {1 + _count_undisturbed_pairs(pairs)} of {count}"
        measured: dict[int, Measured] = {}
        for turn in turns:
            start_s = time.monotonic()
            measured[turn] = measure_tree(trees[turn], arguments)
            seconds = time.monotonic() - start_s
            _print_progress(f"{pair}, {('base', 'head')[turn]}: {seconds:.0f} s")
        pairs.append((measured[0], measured[1]))
        base, head = pairs[-1]
        require_imports_of_own_files(trees, (base.run, head.run))
        if not base.run.benchmarks or not head.run.benchmarks or head.run.failed:
            break
        if not (base.is_quiet and head.is_quiet):
            again = "repeated" if len(pairs) < 2 * count else "no repeat left"
            _print_progress(f"{pair} disturbed: {again}")
    return pairs


def _count_undisturbed_pairs(pairs: Sequence[tuple[Measured, Measured]]) -> int:
    """Count the pairs of runs that nothing disturbed."""
    return sum(base.is_quiet and head.is_quiet for base, head in pairs)


def _print_progress(line: str) -> None:
    """Print a line on standard error at once."""
    print(line, file=sys.stderr, flush=True)


def compare_trees(
    trees: tuple[Path, Path],
    count: int,
    arguments: Sequence[str],
    margin: float,
    *,
    allow_gone: bool,
) -> tuple[RunComparison, list[str]]:
    """Compare two working trees; return the comparison and lines on how it was measured.

    InputError where the head has no benchmark and the base has none either.
    """
    pairs = measure_by_turns(trees, count, arguments)
    found = compare_runs(
        [(base.run, head.run) for base, head in pairs], margin=margin, allow_gone=allow_gone
    )
    lines = [f"{plural(len(pairs), 'run')} of each revision, by turns"]
    base, head = pairs[-1]
    if base.reason:
        lines.append(f"base: {base.reason}")
    if head.reason:
        if base.reason:
            raise InputError(str(trees[1]), "", head.reason, "a working tree with benchmarks")
        # Its benchmarks are not gone: nobody knows.
        row = Row("all benchmarks of the head", NOT_TIMED, remarks=(head.reason,))
        found = RunComparison([row, *found.rows], allow_gone)
    return found, lines


def _build_parser() -> argparse.ArgumentParser:
    """Return the parser of the arguments before --."""
    parser = argparse.ArgumentParser(
        prog="dpbench.ci.revisions",
        description=__doc__.splitlines()[0],
        epilog="What follows -- is for pytest.",
    )
    parser.add_argument("base", type=Path, metavar="BASE", help="working tree to compare with")
    parser.add_argument("head", type=Path, metavar="HEAD", help="working tree of the change")
    parser.add_argument("--pairs", type=int, default=5, help="runs of each revision (5)")
    parser.add_argument(
        "--margin", type=float, default=MARGIN, help=f"how much slower is no regression ({MARGIN})"
    )
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write Markdown")
    parser.add_argument(
        "--allow-gone", action="store_true", help="pass where a benchmark of the base is gone"
    )
    parser.add_argument(
        "--fail-disturbed", action="store_true", help="exit with 1 where load took a verdict"
    )
    return parser


def main(argv: list[str] | None = None) -> int:
    """Measure both trees, print and write the comparison; return the exit code."""
    given = sys.argv[1:] if argv is None else argv
    # argparse does not take the rest of a line behind options and positional arguments.
    end = given.index("--") if "--" in given else len(given)
    arguments = _build_parser().parse_args(given[:end])
    trees = arguments.base, arguments.head
    try:
        for tree in trees:
            if not tree.is_dir():
                raise InputError(str(tree), "", "no folder", "a working tree")
        found, lines = compare_trees(
            trees,
            max(1, arguments.pairs),
            given[end + 1 :],
            arguments.margin,
            allow_gone=arguments.allow_gone,
        )
    except InputError as error:
        print(f"revisions: {error}", file=sys.stderr)
        return 2
    found.print(Console() if sys.stdout.isatty() else Console(width=200), lines)
    if arguments.markdown is not None:
        write_bytes_to_file_or_pipe(arguments.markdown, found.markdown(lines).encode())
    is_disturbed = any(row.verdict == DISTURBED for row in found.rows)
    return int(found.worse or (arguments.fail_disturbed and is_disturbed))


def run() -> int:
    """Run `main` and return its exit code; at a signal end pytest first: 128 and its number."""
    with first_signal_only() as interruption:
        try:
            return main()
        except KeyboardInterrupt:
            _print_progress("revisions: interrupted")
            return 128 + interruption.signal


if __name__ == "__main__":
    raise SystemExit(run())
