"""Compare two revisions of a solver by running its benchmarks alternately in both.

    python -m dpbench.ci.revisions BASE HEAD [--pairs 5] [--attempts N] [--markdown FILE]
        [-- PYTEST ARGUMENTS]

BASE and HEAD are working trees. pytest alternates between them, with `.venv/bin/python` of a tree
where there is one. Pairs of runs that other load disturbed are repeated, each once at most; two
such pairs in a row end the measurement. Exit 0: no regression shown, or a base without benchmarks;
1: a regression, wrong answers, a benchmark that failed or is gone; 2: bad input, a tree without
dpbench or with imports of files of the other, or no benchmark in either; the code of
--disturbed-exit: times not judged, no regression shown; 128 and the number of the signal:
interrupted, the complete pairs are compared.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console

from dpbench.bench.estimate import format_duration
from dpbench.bench.record.git_commit import run_git
from dpbench.bench.workers.interrupts import first_signal_only
from dpbench.ci import ALLOW, DISTURBED_EXIT, MARGIN_SHARE
from dpbench.ci.benchmarks import (
    COLLECTED,
    IMPORTED,
    PATHS,
    WRONG_ANSWERS,
    BenchmarkRun,
    is_in_site_packages,
    load_run,
)
from dpbench.ci.comparison import NO_BASELINE, NOT_TIMED, Allowed, Row, RunComparison, compare_runs
from dpbench.errors import InputError, SituationError, require_integer_at_least
from dpbench.files.regular_files import write_bytes_to_file_or_pipe
from dpbench.report.formats import plural

REMEDY = 'install the package in a .venv of each tree, or set `pythonpath = ["src"]` for pytest'
"""Ways to have a tree measured with its own package."""
STOPPED = "stopped after two disturbed pairs in a row"
ADVICE = (
    f"{STOPPED}: run again when no other program is active, or with --attempts N (up to N pairs "
    "without this stop), or on another machine"
)
HELP_EPILOG = """\
Arguments after -- are passed to pytest.

disturbed:
  A benchmark is disturbed if other programs, the host of a virtual machine or
  throttling slow the machine while it runs. Its time is then not judged,
  unless in at least two pairs of runs the head takes more than 1.5 times as
  long and load does not explain this. Iterations, errors and failed tests are
  still judged. A disturbed pair of runs is repeated; two in a row end the
  measurement, unless --attempts is set.

exit codes:
  0     no regression shown, or a base without benchmarks
  1     a regression: longer times, more iterations, larger errors, or a failed
        or missing benchmark
  2     bad input
  CODE  (--disturbed-exit) times not judged, no regression shown
  130   interrupted by Ctrl-C (143: SIGTERM); the complete pairs are compared

examples:
  python -m dpbench.ci.revisions ../base . --markdown out.md -- test_slsqp.py
  python -m dpbench.ci.revisions ../base . --disturbed-exit 75 -- -k transfer
"""
CODES_WITHOUT_ERROR = (0, 1, 5)
"""Exit codes of a pytest that ran all its tests, or found none."""
SHOWN_LINES, LEFT_OUT = 5, "PytestBenchmarkWarning"
"""Last lines of a pytest run that has no benchmarks, without the warning that it has none."""


@dataclass(frozen=True)
class Measured:
    """One run of a tree's benchmarks; the reason where pytest did not come to its end.

    is_broken : whether pytest ended with an error, so that the tree may have benchmarks.
    """

    run: BenchmarkRun
    reason: str = ""
    is_broken: bool = False

    @property
    def is_quiet(self) -> bool:
        """True if nothing disturbed the machine."""
        return not self.run.disturbed


def _find_python(tree: Path) -> str:
    """Return the path of the Python that measures a working tree."""
    own = tree.resolve() / ".venv" / "bin" / "python"
    return str(own) if own.exists() else sys.executable


def _run_pytest(tree: Path, path: Path, arguments: Sequence[str]) -> tuple[int, str]:
    """Run pytest in a working tree, its JSON file to `path`; return exit code and output."""
    command = [_find_python(tree), "-m", "pytest", "-q"]
    command += ["--rootdir=.", "--benchmark-only", f"--benchmark-json={path}", *arguments]
    done = subprocess.run(
        command, cwd=tree, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False
    )
    return done.returncode, done.stdout.decode(errors="replace")


def collect_imports(tree: Path, arguments: Sequence[str]) -> BenchmarkRun:
    """Collect the tests of a working tree; return a run of none with the files they import.

    SituationError where the Python of the tree has no dpbench with its extra `ci`.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "collected.json"
        _run_pytest(tree, path, ["--collect-only", *arguments])
        # A tree may have a dpbench that stores nothing here, or none.
        stored = json.loads((path.read_bytes() if path.exists() else b"") or "{}")
    if not stored:
        _require_dpbench(tree)
    imported, paths = tuple(stored.get(IMPORTED, ())), tuple(stored.get(PATHS, ()))
    return BenchmarkRun(imported=imported, collected=stored.get(COLLECTED), paths=paths)


def _require_dpbench(tree: Path) -> None:
    """Raise SituationError where the Python of a working tree has no dpbench for its tests."""
    python = _find_python(tree)
    command = [python, "-c", "import pytest, pytest_benchmark, dpbench.ci.plugin"]
    done = subprocess.run(command, cwd=tree, capture_output=True, check=False)
    if done.returncode:
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
        raise SituationError(
            str(tree),
            f"{python} has no dpbench with its extra ci ({''.join(last)[:120]}): install "
            "'dpbench[ci]' there",
        )


def measure_tree(tree: Path, arguments: Sequence[str]) -> Measured:
    """Run a working tree's benchmarks with pytest; return the times, or why there are none."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.json"
        code, output = _run_pytest(tree, path, arguments)
        lines = [line for line in output.splitlines() if line.strip() and LEFT_OUT not in line]
        reason = f"pytest ended with exit code {code}: {' | '.join(lines[-SHOWN_LINES:])}"
        reason += _find_remedy(tree, output)
        # 0 and 1: every test was run to its end.
        with suppress(InputError):  # `reason` is reported in place of an unreadable file
            if code <= 1:
                return Measured(load_run(path))
    return Measured(BenchmarkRun(), reason, code not in CODES_WITHOUT_ERROR)


def _find_remedy(tree: Path, output: str) -> str:
    """Return what to do where pytest found no module that is in `src`; "" otherwise."""
    missing = re.findall(r"No module named '(\w+)", output)
    names = [name for name in missing if _has_source(name, tree / "src")]
    return f"; {names[0]} is in src, which is not on Python's path: {REMEDY}" if names else ""


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
                raise SituationError(side, f"imports {file}, a file of the other tree; {REMEDY}")
    if folders[0] != folders[1]:
        for file in map(Path, sorted({*runs[0].imported}.intersection(runs[1].imported))):
            name = file.parent.name if file.stem == "__init__" else file.stem
            sources = [[one, one / "src"] for one in folders]
            if is_in_site_packages(file) and all(_has_source(name, *pair) for pair in sources):
                fault = f"both import {file}, so both would run the same code"
                raise SituationError("base and head", f"{fault}; {REMEDY}")


def _has_source(name: str, *folders: Path) -> bool:
    """Return True if one of the folders has the Python source of a module or package."""
    files = f"{name}.py", f"{name}/__init__.py"
    return any((folder / file).exists() for folder in folders for file in files)


@dataclass(frozen=True)
class Arguments:
    """Arguments of pytest in one tree, without the paths that only the other tree contains.

    absent : these paths; where the tree contains none of the given paths, all remain in `given`.
    """

    given: list[str]
    absent: tuple[str, ...] = ()

    @property
    def has_no_path(self) -> bool:
        """True if paths are given and the tree contains none of them."""
        return any(path in self.given for path in self.absent)

    def measure(self, tree: Path) -> Measured:
        """Measure the tree; a benchmark of a path that it does not contain is not left out.

        A tree that contains none of the given paths has no benchmark, so pytest does not run.
        """
        if self.has_no_path:
            return Measured(BenchmarkRun())
        found = measure_tree(tree, self.given)
        selection = found.run.selection
        selection = replace(
            selection, given=(*selection.given, *map(os.path.normpath, self.absent))
        )
        return replace(found, run=replace(found.run, selection=selection))


def _select_arguments(
    trees: tuple[Path, Path], arguments: Sequence[str], paths: Collection[str]
) -> list[Arguments]:
    """Return the arguments of each tree; InputError for a path that neither tree contains."""
    absent = [
        [path for path in paths if not (tree / path.partition("::")[0]).exists()] for tree in trees
    ]
    for path in absent[0]:
        if path in absent[1]:
            fault = "no such file or folder in either tree"
            raise InputError(path, "", fault, "a file or folder of a working tree")
    selected = []
    for missing in absent:
        left_out = missing if len(missing) < len(paths) else []
        given = [one for one in arguments if one not in left_out]
        selected.append(Arguments(given, tuple(missing)))
    return selected


def _collect_trees(
    trees: tuple[Path, Path], arguments: Sequence[str]
) -> tuple[Arguments, Arguments]:
    """Collect the tests of both trees; return the arguments of pytest in each.

    InputError where neither has a benchmark or contains a given path; SituationError where their
    tests import files of the other tree.
    """
    collected = [collect_imports(tree, arguments) for tree in trees]
    paths = dict.fromkeys(path for run in collected for path in run.paths)
    base, head = _select_arguments(trees, arguments, paths)
    for side, one in enumerate((base, head)):
        if one.given != [*arguments]:
            collected[side] = collect_imports(trees[side], one.given)
    if not any(run.collected is None or run.collected for run in collected):
        found = "no test with dpbench_replay or another benchmark in either tree"
        raise InputError(" and ".join(map(str, trees)), "", found, "a working tree with benchmarks")
    require_imports_of_own_files(trees, (collected[0], collected[1]))
    return base, head


def _require_baseline(tree: Path, base: Measured) -> None:
    """Raise SituationError where an error of pytest in the base hides its benchmarks."""
    if base.is_broken:
        required = "a base in which pytest ends without an error, or only files that it can collect"
        raise SituationError(str(tree), f"{base.reason}; required: {required}")


def measure_by_turns(
    trees: tuple[Path, Path], count: int, arguments: Sequence[str], attempts: int | None = None
) -> Iterator[tuple[Measured, Measured]]:
    """Measure two trees alternately until so many pairs are undisturbed; yield each pair.

    attempts : largest number of pairs; by default twice `count`, and two disturbed pairs in a row
        are the last ones.

    One pair is enough where the base has no benchmark or the head has one that fails.
    SituationError where a tree is not measured with its own files, before the first run where the
    files that its tests import show that; or where pytest ends with an error in the base.
    """
    given = _collect_trees(trees, arguments)
    pairs: list[tuple[Measured, Measured]] = []
    spent_s: list[float] = []
    limit = max(count, attempts or 2 * count)
    while len(pairs) < limit and (done := _count_undisturbed_pairs(pairs)) < count:
        # Neither is always the second.
        turns = (0, 1) if len(pairs) % 2 == 0 else (1, 0)
        pair, end = f"pair {1 + len(pairs)}", ""
        of_all = f"{pair} of at most {limit} ({done} of {count} undisturbed)"
        measured: dict[int, Measured] = {}
        for turn in turns:
            start_s = time.monotonic()
            measured[turn] = given[turn].measure(trees[turn])
            spent_s.append(time.monotonic() - start_s)
            if not pairs:
                _require_baseline(trees[0], measured[0])
            if len(measured) == len(trees):
                pairs.append((measured[0], measured[1]))
                end = describe_early_end(pairs, count, attempts)
            missing = count - done - all(one.is_quiet for one in measured.values())
            runs = 2 * limit - len(spent_s)
            # A tree without benchmarks takes no time, and one pair is enough.
            is_last = end or any(one.has_no_path for one in given)
            left = "" if is_last else _describe_time_left(float(np.mean(spent_s)), runs, missing)
            line = f"{('base', 'head')[turn]}: {spent_s[-1]:.0f} s{left}"
            print(f"{of_all}, {line}", file=sys.stderr)
        base, head = pairs[-1]
        require_imports_of_own_files(trees, (base.run, head.run))
        if not (base.is_quiet and head.is_quiet):
            again = end or ("no repeat left" if len(pairs) == limit else "repeated")
            print(f"{pair} disturbed: {again}", file=sys.stderr)
        elif end:
            print(end, file=sys.stderr)
        yield base, head
        if end:
            break


def _describe_time_left(run_s: float, runs: int, missing: int) -> str:
    """Return the time left without repeats and with all; "" if no run is left.

    runs : largest number of further runs, odd within a pair.
    missing : undisturbed pairs still needed if the present pair stays as it is.
    """
    least = min(runs, runs % 2 + 2 * missing)
    if least == 0:
        return ""
    if least == runs:
        return f", about {format_duration(least * run_s)} left"
    return f", {format_duration(least * run_s)} to {format_duration(runs * run_s)} left"


def describe_early_end(
    pairs: Sequence[tuple[Measured, Measured]], count: int, attempts: int | None = None
) -> str:
    """Return why no pair follows though fewer than `count` are undisturbed; "" if one may.

    attempts : None if two disturbed pairs in a row end the measurement.
    """
    if _count_undisturbed_pairs(pairs) >= count:
        return ""
    base, head = pairs[-1]
    why = ""
    if any(reason.startswith(WRONG_ANSWERS) for reason in head.run.failed.values()):
        why = "a benchmark of the head has wrong answers"
    elif head.run.failed:
        why = "a benchmark of the head failed"
    elif head.reason:
        why = "pytest failed in the head"
    elif not head.run.benchmarks:
        why = "the head has no benchmark"
    elif not base.run.benchmarks:
        why = "the base has no benchmark with a time"
    if why:
        return f"stopped after {plural(len(pairs), 'pair')} of runs, as {why}"
    is_hopeless = attempts is None and len(pairs) > 1 and not _count_undisturbed_pairs(pairs[-2:])
    return STOPPED if is_hopeless else ""


def _count_undisturbed_pairs(pairs: Sequence[tuple[Measured, Measured]]) -> int:
    """Count the pairs of runs that nothing disturbed."""
    return sum(base.is_quiet and head.is_quiet for base, head in pairs)


def _collect_pairs(
    measured: Iterator[tuple[Measured, Measured]],
) -> tuple[list[tuple[Measured, Measured]], bool]:
    """Return the complete pairs, and whether a signal ended the measurement after at least one."""
    pairs: list[tuple[Measured, Measured]] = []
    try:
        for pair in measured:
            pairs.append(pair)
    except KeyboardInterrupt:
        if not pairs:
            raise
        return pairs, True
    return pairs, False


def compare_trees(
    trees: tuple[Path, Path],
    count: int,
    arguments: Sequence[str],
    margin: float,
    *,
    allow_gone: bool,
    allow: Allowed = (),
    disturbed_exit: int,
    attempts: int | None = None,
) -> tuple[RunComparison, list[str]]:
    """Compare two working trees; return the comparison and lines on how it was measured.

    InputError where the head has no benchmark and the base has none either. A signal ends the
    measurement: the complete pairs are compared; KeyboardInterrupt if there is none.
    """
    pairs, is_interrupted = _collect_pairs(measure_by_turns(trees, count, arguments, attempts))
    disturbed = len(pairs) - _count_undisturbed_pairs(pairs)
    found = compare_runs(
        [(base.run, head.run) for base, head in pairs],
        margin=margin,
        allow_gone=allow_gone,
        allow=allow,
    )
    base, head = pairs[-1]
    if head.reason:
        if not base.run.names:
            required = "a working tree with benchmarks"
            raise SituationError(str(trees[1]), f"{head.reason}; required: {required}")
        # Its benchmarks are not gone: nobody knows.
        row = Row("all benchmarks of the head", NOT_TIMED, remarks=(head.reason,))
        found = replace(found, rows=[row, *found.rows])
    names = [_name_tree(*side) for side in zip(("base", "head"), trees, strict=True)]
    runs = f"{plural(len(pairs), 'pair')} of runs, {disturbed} of them disturbed"
    lines = [f"{found.describe_scope(*names)}; {runs}", found.describe_verdict(names[0])]
    end = describe_early_end(pairs, count, attempts)
    end = ADVICE if end == STOPPED else end * (found.verdict != NO_BASELINE)
    lines += [line for line in (end, base.reason and f"base: {base.reason}") if line]
    # Disturbed times of an interrupted measurement do not pass.
    lines += found.describe_unjudged(1 if is_interrupted else disturbed_exit)
    interrupted = f"interrupted after {plural(len(pairs), 'pair')} of runs"
    return found, [*lines, interrupted if is_interrupted else found.describe_exit(disturbed_exit)]


def _name_tree(side: str, tree: Path) -> str:
    """Name a side of the comparison with its git commit, where there is one."""
    commit = run_git(tree, "describe", "--always", "--dirty", "--exclude=*")
    return f"{side} {commit.strip()}" if commit else side


def _build_parser() -> argparse.ArgumentParser:
    """Return the parser of the arguments before --."""
    parser = argparse.ArgumentParser(
        prog="dpbench.ci.revisions",
        description=__doc__.splitlines()[0],
        usage="python -m %(prog)s [OPTIONS] BASE HEAD [-- PYTEST ARGUMENTS]",
        epilog=HELP_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("base", type=Path, metavar="BASE", help="working tree to compare with")
    parser.add_argument("head", type=Path, metavar="HEAD", help="working tree of the change")
    parser.add_argument(
        "--pairs", type=int, default=5, metavar="N", help="undisturbed pairs of runs (default: 5)"
    )
    parser.add_argument(
        "--attempts",
        type=int,
        metavar="N",
        help="measure up to N pairs and do not stop after two disturbed pairs in a row (without "
        "this option: up to twice --pairs)",
    )
    parser.add_argument("--margin", **MARGIN_SHARE)
    parser.add_argument(
        "--markdown", type=Path, metavar="FILE", help="write the comparison as Markdown"
    )
    parser.add_argument(
        "--allow-gone", action="store_true", help="pass even if a benchmark of the base is missing"
    )
    parser.add_argument("--allow", **ALLOW)
    parser.add_argument("--disturbed-exit", **DISTURBED_EXIT)
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
                raise InputError(str(tree), "", "no such folder", "a working tree")
        found, lines = compare_trees(
            trees,
            require_integer_at_least("--pairs", arguments.pairs, 1),
            given[end + 1 :],
            arguments.margin,
            allow_gone=arguments.allow_gone,
            allow=arguments.allow,
            disturbed_exit=arguments.disturbed_exit,
            attempts=arguments.attempts,
        )
    except InputError as error:
        print(f"revisions: {error}", file=sys.stderr)
        return 2
    found.print(Console() if sys.stdout.isatty() else Console(width=200), lines)
    if arguments.markdown is not None:
        write_bytes_to_file_or_pipe(arguments.markdown, found.markdown(lines).encode())
    return found.exit_code(arguments.disturbed_exit)


def run() -> int:
    """Run `main` and return its exit code; at a signal end pytest first: 128 and its number."""
    with first_signal_only() as interruption:
        code = 0
        with suppress(KeyboardInterrupt):  # the signal selects the exit code
            code = main()
        if interruption.signal:
            print("revisions: interrupted", file=sys.stderr)
            code = 128 + interruption.signal
        return code


if __name__ == "__main__":
    raise SystemExit(run())
