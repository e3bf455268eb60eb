"""Mutation testing: the share of planted faults that the quick tests of a package find.

`make mutants` plants a sample of faults in every target below. The operators and the sessions are
those of Cosmic Ray: `cr-report` and `cr-html` read the sessions in `build/mutants/`.

A mutant never reaches the disk. A process that has imported the libraries, but no module of the
project, forks a child for each mutant; the child compiles the mutated text when it is imported.
Numba is off where a target has kernels: it would load the machine code of the original.
"""

import argparse
import ast
import importlib
import multiprocessing
import os
import random
import re
import signal
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, field
from importlib.machinery import SourceFileLoader
from multiprocessing.connection import Connection
from pathlib import Path
from types import CodeType

ROOT = Path(__file__).resolve().parents[1]
SESSIONS = ROOT / "build" / "mutants"
EQUIVALENT = ROOT / "tests" / "equivalent_mutants.toml"
LEAST_SHARE = 0.9
TARGETS = {
    "dpbench/bench/judge": "tests/bench/judge",
    "dpbench/analysis/verdict": "tests/analysis/verdict",
    "dpbench/analysis/statistics.py": "tests/analysis/test_statistics.py",
    "dpbench/analysis/records/run_steps.py": "tests/analysis/records",
    "dpbench/analysis/suites/study.py": "tests/analysis/suites",
    "dpbench/mpc/condense.py": "tests/mpc",
    "dpbench/mpc/condensed_qp.py": "tests/mpc",
    "dpbench/ship/plant.py": "tests/ship",
    "dpbench/qp/residuals.py": "tests/qp",
}
"""Files and packages to mutate, and the tests that must fail."""
EXCLUDED = re.compile(
    # A kernel without its decorator is slower; a cache without it is gone.
    r"core/RemoveDecorator"
    # Most of these raise a TypeError on floats: any test kills them, and the share would rise.
    r"|core/ReplaceBinaryOperator_\w+_(RShift|LShift|BitXor)"
    r"|core/ReplaceBinaryOperator_(?!Bit)\w+_Bit\w+"
    r"|core/ReplaceBinaryOperator_Bit\w+_(?!Bit)\w+"
    r"|core/ReplaceUnaryOperator_\w*(UAdd|Invert)"
    # `is` and `==` agree on None and on small integers.
    r"|core/ReplaceComparisonOperator_(?!Is_IsNot|IsNot_Is)((Is|IsNot)_\w+|\w+_(Is|IsNot)$)"
)


@dataclass
class Mutant:
    """One fault: its job in the session, its place, and its line before and after."""

    job: str
    path: Path
    text: str
    line: int
    old: str
    new: str

    def __str__(self) -> str:
        return f"{self.path.relative_to(ROOT)}:{self.line}\n  - {self.old}\n  + {self.new}"


@dataclass
class Count:
    """Outcomes of the mutants of one target."""

    target: str
    outcomes: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0

    @property
    def share(self) -> float:
        """The share of the mutants that did not survive; 1 without mutants."""
        return 1.0 - self.outcomes["survived"] / (self.outcomes.total() or 1)

    def __str__(self) -> str:
        n = self.outcomes
        numbers = f"{n.total():7} {n['killed']:7} {n['survived']:9} {n['timed out']:10}"
        return f"{self.target:40} {numbers} {self.share:6.1%} {self.seconds:8.0f}"


def _annotations_and_decorators(text: str) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Start and end of what never runs, or only sets a compiler."""
    for node in ast.walk(ast.parse(text)):
        of_node = [getattr(node, name, None) for name in ("annotation", "returns")]
        for e in of_node + getattr(node, "decorator_list", []):
            if isinstance(e, ast.expr):
                yield (e.lineno, e.col_offset), (e.end_lineno or 0, e.end_col_offset or 0)


def _session(target: str) -> str:
    SESSIONS.mkdir(parents=True, exist_ok=True)
    return str(SESSIONS / (target.removesuffix(".py").replace("/", ".") + ".sqlite"))


def _mutants(target: str, seed: int) -> Iterator[Mutant]:
    """All mutants of a target in random order; its session is written."""
    import cosmic_ray.plugins
    from cosmic_ray.commands import init
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.work_db import WorkDB, use_db

    files = sorted((ROOT / target).glob("*.py")) or [ROOT / target]
    texts = {path: path.read_text(encoding="utf-8") for path in files}
    spans = {path: list(_annotations_and_decorators(text)) for path, text in texts.items()}
    equivalent = {
        (ROOT / entry["file"], entry["line"], entry["mutant"])
        for entry in tomllib.loads(EQUIVALENT.read_text(encoding="utf-8"))["equivalent"]
    }
    with use_db(_session(target), WorkDB.Mode.create) as session:
        init(files, session, {})
        items = [(item.job_id, item.mutations[0]) for item in session.work_items]
    # The identifiers of jobs are random, so that the order of the session is too.
    items.sort(key=lambda item: (item[1].module_path, item[1].operator_name, item[1].occurrence))
    random.Random(seed).shuffle(items)
    for job, spec in items:
        path, start = spec.module_path, tuple(spec.start_pos)
        if EXCLUDED.match(spec.operator_name) or any(a <= start < b for a, b in spans[path]):
            continue
        # The star before keyword arguments is no operator.
        if texts[path].splitlines()[start[0] - 1][start[1] :].startswith("*,"):
            continue
        operator = cosmic_ray.plugins.get_operator(spec.operator_name)(**spec.operator_args)
        text = mutate_code(texts[path], operator, spec.occurrence) or texts[path]
        lines = zip(texts[path].splitlines(), text.splitlines(), strict=False)
        for line, (old, new) in enumerate(lines, 1):
            if old != new and (path, old.strip(), new.strip()) not in equivalent:
                with suppress(SyntaxError):
                    compile(text, str(path), "exec", dont_inherit=True)
                    yield Mutant(job, path, text, line, old.strip(), new.strip())
            if old != new:
                break


def _pytest(arguments: list[str], mutant: Mutant | None = None) -> int:
    """Run the quick tests in this process, with the text of a mutant where there is one."""
    import hypothesis
    import pytest

    get_code = SourceFileLoader.get_code

    def get_mutated_code(loader: SourceFileLoader, name: str) -> CodeType | None:
        if mutant is not None and Path(loader.get_filename(name)) == mutant.path:
            return compile(mutant.text, str(mutant.path), "exec", dont_inherit=True)
        return get_code(loader, name)

    SourceFileLoader.get_code = get_mutated_code  # type: ignore[method-assign,assignment] # the patch
    # One failing example is enough, and none is kept for the next mutant.
    phases = hypothesis.Phase.explicit, hypothesis.Phase.generate
    checks = list(hypothesis.HealthCheck)
    hypothesis.settings.register_profile(
        "mutants", database=None, deadline=None, phases=phases, suppress_health_check=checks
    )
    # Pytest would load a rewritten copy of the original: it rewrites what its plug-ins come with.
    plain = "--assert=plain"
    quick = [
        "-x",
        "-q",
        plain,
        "-m",
        "not slow and not alone",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
    ]
    drawn = ["--hypothesis-profile=mutants", "--hypothesis-seed=0"]
    # Hypothesis is a plugin that is imported already.
    quiet = ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        return int(pytest.main([*quick, *drawn, *quiet, *arguments]))


def _send_libraries(tests: str, answer: Connection) -> None:
    """Send the names of all modules outside the project that the tests import."""
    _pytest(["--collect-only", tests])
    own = "dpbench", "tests", "__main__", "__mp_main__"
    answer.send([name for name in list(sys.modules) if name.partition(".")[0] not in own])


def _import_libraries(tests: str) -> None:
    """Import what every mutant needs and none changes."""
    receive, send = multiprocessing.Pipe(duplex=False)
    child = multiprocessing.get_context("fork").Process(target=_send_libraries, args=(tests, send))
    child.start()
    send.close()
    for name in receive.recv():
        with suppress(Exception):
            importlib.import_module(name)
    child.join()


def _exit_with_tests(arguments: list[str], mutant: Mutant | None) -> None:
    os.setsid()
    sys.dont_write_bytecode = True
    os._exit(_pytest(arguments, mutant))


def _outcome(limit_s: float, arguments: list[str], mutant: Mutant | None = None) -> str:
    """Run tests in a child of this process and end all that they started."""
    fork = multiprocessing.get_context("fork")
    child = fork.Process(target=_exit_with_tests, args=(arguments, mutant))
    child.start()
    child.join(limit_s)
    late = child.exitcode is None
    with suppress(ProcessLookupError):
        os.killpg(child.pid or 0, signal.SIGKILL)
    child.join()
    return "timed out" if late else "killed" if child.exitcode else "survived"


def _outcome_of(mutant: Mutant, tests: str, limit_s: float) -> str:
    """The outcome of the tests of its file, then of all: few need to collect the latter."""
    mirror = f"{tests}/test_{mutant.path.stem}.py"
    outcome = _outcome(limit_s, [mirror], mutant) if (ROOT / mirror).is_file() else "survived"
    return _outcome(limit_s, [tests], mutant) if outcome == "survived" else outcome


def run(target: str, tests: str, sample: int | None, seed: int) -> Count:
    """Plant mutants in one target, print those that survive its tests and count all."""
    began = time.monotonic()
    files = sorted((ROOT / target).glob("*.py")) or [ROOT / target]
    if any("@njit" in path.read_text(encoding="utf-8") for path in files):
        os.environ["NUMBA_DISABLE_JIT"] = "1"
    _import_libraries(tests)
    if _outcome(1800.0, [tests]) != "survived":
        raise SystemExit(f"{tests}: these tests fail without a mutant; run pytest on them first")
    limit_s = 20.0 + 3.0 * (time.monotonic() - began)
    # Late imports: no test needs them, and a fork would carry them along.
    from cosmic_ray.work_db import WorkDB, use_db
    from cosmic_ray.work_item import TestOutcome, WorkerOutcome, WorkResult

    count, results = Count(target), []
    for mutant in _mutants(target, seed):
        if count.outcomes.total() == sample:
            break
        outcome = _outcome_of(mutant, tests, limit_s)
        count.outcomes[outcome] += 1
        if outcome == "survived":
            print(mutant, flush=True)
        found = TestOutcome.SURVIVED if outcome == "survived" else TestOutcome.KILLED
        results.append((mutant.job, WorkResult(WorkerOutcome.NORMAL, outcome, found, str(mutant))))
    with use_db(_session(target), WorkDB.Mode.open) as session:
        for result in results:
            session.set_result(*result)
    count.seconds = time.monotonic() - began
    return count


def _tests_of(file: str) -> str:
    for target, tests in TARGETS.items():
        if file == target or file.startswith(f"{target}/"):
            return tests
    raise SystemExit(f"{file} is not part of a target; targets: {', '.join(TARGETS)}")


def main() -> int:
    """Plant mutants and print those that survive; exit with 1 where fewer than 90 % are killed."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("files", nargs="*", metavar="FILE", help="mutate only this file or package")
    parser.add_argument("--sample", type=int, default=60, metavar="N", help="mutants of a target")
    parser.add_argument("--all", action="store_true", help="plant all mutants")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="seed of the sample")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="targets at a time")
    options = parser.parse_args()
    targets = {file.rstrip("/"): _tests_of(file.rstrip("/")) for file in options.files} or TARGETS
    sample = None if options.all else options.sample
    spawn = multiprocessing.get_context("spawn")
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(options.jobs, spawn, max_tasks_per_child=1) as pool,
    ):
        os.environ["TMPDIR"] = folder
        runs = [
            pool.submit(run, file, tests, sample, options.seed) for file, tests in targets.items()
        ]
        counts = [one.result() for one in runs]
    print(f"\n{'module':40} mutants  killed  survived  timed out  share  seconds")
    print(*counts, sep="\n")
    return int(any(count.share < LEAST_SHARE for count in counts))


if __name__ == "__main__":
    sys.exit(main())
