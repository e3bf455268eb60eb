"""The command line: parse arguments, call one public function, choose the exit code.

Exit 0: done (a solver's failure is data). 1: a comparison shows a regression. 2: bad input, said
in one line. The only module that prints.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn

from dpbench.errors import DpbenchError, InputError


class _Parser(argparse.ArgumentParser):
    """An argument parser whose complaints are one line, like every other complaint."""

    def error(self, message: str) -> NoReturn:
        print(f"dpbench: {message} (see dpbench --help)", file=sys.stderr)
        raise SystemExit(2)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="dpbench", description="Benchmark QP solvers inside a ship's DP MPC.")
    parser.add_argument("--version", action="version", version=f"dpbench {version('dpbench')}")
    commands = parser.add_subparsers(dest="command", required=True, parser_class=_Parser)
    run = commands.add_parser("run", help="run a suite and write its report")
    run.add_argument("suite", nargs="?", help="a suite by name, or a TOML file")
    run.add_argument(
        "--sequence",
        metavar="S",
        help="instead: a stored sequence, a .npz, or a folder",
    )
    run.add_argument("--out", help="result folder (default: results/<suite>)")
    run.add_argument("--solver", action="append", metavar="S", help="only this solver; repeatable")
    run.add_argument("--scenario", action="append", metavar="N", help="only this scenario")
    run.add_argument("--jobs", type=int, metavar="J", help="loops or random arms at a time")
    run.add_argument("--solver-module", metavar="FILE.py", help="a plug-in that brings a solver")
    run.add_argument("--fresh", action="store_true", help="run finished cells again too")
    run.set_defaults(call=_run)
    report = commands.add_parser("report", help="write the report of a result folder again")
    report.add_argument("dir", help="a folder written by `dpbench run`")
    report.add_argument("--baseline", metavar="S", help="compare step times with this solver's")
    report.set_defaults(call=_report)
    compare = commands.add_parser("compare", help="what became slower or worse from A to B")
    compare.add_argument("a", metavar="A", help="a result folder, the baseline")
    compare.add_argument("b", metavar="B", help="another one of the same suite")
    compare.add_argument("--any-machine", action="store_true", help="also of another machine")
    compare.add_argument("--margin", type=float, default=0.05, help="what is no difference (0.05)")
    compare.add_argument("--alpha", type=float, default=0.05, help="family-wise error (0.05)")
    compare.add_argument("--markdown", metavar="FILE", help="write Markdown; - for the screen")
    compare.set_defaults(call=_compare)
    export = commands.add_parser("export", help="write QPs with certified optima for others")
    export.add_argument(
        "what", nargs="?", help="a scenario, a sequence (by name or .npz) or a folder of problems"
    )
    export.add_argument("--all", action="store_true", help="instead: all stored sequences anew")
    export.add_argument("--format", default="npz", help="npz (default) or qpbenchmark")
    export.add_argument(
        "--out", metavar="PATH", help="the file to write; of --all a folder (results/sequences)"
    )
    export.add_argument("--horizons", metavar="N_p/N_c", help="instead of the tuning's")
    export.add_argument("--steps", type=int, metavar="N", help="only the first N steps")
    export.add_argument("--every", type=int, default=1, metavar="K", help="each K-th of them")
    export.set_defaults(call=_export)
    hunt = commands.add_parser("hunt", help="search for a solver's slowest or least accurate step")
    hunt.add_argument("solver", help="the solver to hunt")
    hunt.add_argument("--goal", default="iterations", help="iterations (default) or error")
    hunt.add_argument("--scenario", default="paper", metavar="N", help="whose starts are varied")
    hunt.add_argument("--route", help="native (default where there is one) or qpsolvers")
    hunt.add_argument("--policy", default="fresh", help="fresh (default), reuse or warm")
    hunt.add_argument("--settings", default="default", help="default, low, mid or high")
    hunt.add_argument("--budget", type=int, default=300, metavar="B", help="cases to try (300)")
    hunt.add_argument("--steps", type=int, default=60, metavar="N", help="length of a case (60)")
    hunt.add_argument("--seed", type=int, default=1, help="of the search (1)")
    hunt.add_argument("--out", metavar="FILE.npz", help="default: hunts/<solver>-<goal>.npz")
    hunt.add_argument("--solver-module", metavar="FILE.py", help="a plug-in that brings the solver")
    hunt.set_defaults(call=_hunt)
    listing = commands.add_parser("list", help="what there is")
    kinds = ("vessels", "scenarios", "suites", "sequences", "solvers")
    listing.add_argument("what", choices=kinds)
    listing.set_defaults(call=_list)
    check = commands.add_parser("check", help="check a vessel, scenario, suite or sequence file")
    check.add_argument("file", help="a TOML file, or a .npz whose every step is certified anew")
    check.set_defaults(call=_check)
    doctor = commands.add_parser("doctor", help="is this machine quiet, is the harness right")
    doctor.set_defaults(call=_doctor)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    arguments = _parser().parse_args(argv)
    try:
        return int(arguments.call(arguments))
    except InputError as error:
        print(f"dpbench: {error}", file=sys.stderr)
        return 2
    except DpbenchError as error:
        print(f"dpbench: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        # The last net under all that is read and written: a full disk, a folder in a file's place.
        name = f"{error.filename}: " if error.filename else ""
        print(
            f"dpbench: {name}found {error.strerror or error}; allowed: a file or folder that "
            "can be read and written",
            file=sys.stderr,
        )
        return 2
    except KeyboardInterrupt:
        kept = "; finished cells are kept, run again to go on" if arguments.call is _run else ""
        print(f"dpbench: interrupted{kept}", file=sys.stderr)
        return 130


class _Bar:
    """A progress bar with the time left, fed by the campaign; a transient one leaves no line."""

    def __init__(self, *, transient: bool = False) -> None:
        from rich.progress import (
            BarColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        self._progress = Progress(
            TextColumn("{task.description:<44}"),
            BarColumn(),
            TextColumn("{task.percentage:3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            transient=transient,
            disable=transient and not sys.stdout.isatty(),
        )
        self._task = self._progress.add_task("starting", total=None)

    def __enter__(self) -> _Bar:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._progress.live.is_started:
            self._progress.stop()

    def start(self, work: int) -> None:
        """So much is to be done; until now the input could still be refused, without a bar."""
        self._progress.start()
        self._progress.update(self._task, total=work)

    def advance(self, work: int, what: str) -> None:
        """So much is done now, the last of it on `what`."""
        self._progress.update(self._task, advance=work, description=what[:44])


def _run(arguments: argparse.Namespace) -> int:
    from dpbench.bench.campaign import run_campaign
    from dpbench.report.write import report_and_verdict

    with _Bar() as bar:
        out = run_campaign(
            arguments.suite,
            arguments.out,
            solvers=arguments.solver,
            scenarios=arguments.scenario,
            jobs=arguments.jobs,
            fresh=arguments.fresh,
            solver_module=arguments.solver_module,
            sequence=arguments.sequence,
            progress=bar,
        )
        bar.advance(0, "writing the report")
        found = report_and_verdict(out)
    _say_verdict(*found)
    return 0


def _report(arguments: argparse.Namespace) -> int:
    from dpbench.report.write import report_and_verdict

    _say_verdict(*report_and_verdict(arguments.dir, baseline=arguments.baseline))
    return 0


def _say_verdict(page: Path, lines: list[str]) -> None:
    for line in lines:
        print(line)
    print(f"report: {page}")


def _compare(arguments: argparse.Namespace) -> int:
    from dpbench.listing import rich_table
    from dpbench.report.compare import compare

    found = compare(
        arguments.a,
        arguments.b,
        any_machine=arguments.any_machine,
        margin=arguments.margin,
        alpha=arguments.alpha,
    )
    if arguments.markdown == "-":
        print(found.markdown(), end="")
        return int(found.worse)
    if arguments.markdown is not None:
        Path(arguments.markdown).write_text(found.markdown(), encoding="utf-8")
    console = _console()
    for table in found.tables:
        console.print(rich_table(table), "")
    for line in found.lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    return int(found.worse)


def _export(arguments: argparse.Namespace) -> int:
    from dpbench.bench.export import check_asked, export

    check_asked(vars(arguments))
    if arguments.all:
        from dpbench.bench.stored import regenerate

        with _Bar(transient=True) as bar:
            said = regenerate(arguments.out or "results/sequences", progress=bar)
        print(said)
        return 0
    print(
        export(
            arguments.what,
            arguments.out,
            format=arguments.format,
            horizons=arguments.horizons,
            steps=arguments.steps,
            every=arguments.every,
        )
    )
    return 0


def _hunt(arguments: argparse.Namespace) -> int:
    from dpbench.bench.hunt import hunt

    with _Bar() as bar:
        found = hunt(
            arguments.solver,
            scenario=arguments.scenario,
            goal=arguments.goal,
            route=arguments.route,
            policy=arguments.policy,
            settings=arguments.settings,
            budget=arguments.budget,
            steps=arguments.steps,
            seed=arguments.seed,
            out=arguments.out,
            solver_module=arguments.solver_module,
            progress=bar,
        )
    for line in found.lines:
        print(line)
    return 130 if found.search.stopped == "interrupted" else 0


def _list(arguments: argparse.Namespace) -> int:
    from dpbench.listing import listing

    _console().print(listing(arguments.what))
    return 0


def _doctor(arguments: argparse.Namespace) -> int:
    from dpbench.report.doctor import doctor_lines

    for line in doctor_lines():
        print(line)
    return 0


def _console() -> Any:
    from rich.console import Console

    # Into a file or a pipe a table takes the room it needs instead of 80 columns.
    return Console() if sys.stdout.isatty() else Console(width=200)


def _check(arguments: argparse.Namespace) -> int:
    from dpbench.listing import check_file

    with _Bar(transient=True) as bar:
        said = check_file(arguments.file, bar)
    print(said)
    return 0
