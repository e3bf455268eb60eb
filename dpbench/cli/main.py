"""The command line: parse arguments, call one public function, print, choose the exit code.

Exit 0: done (a solver's failure is data). 1: a comparison shows a regression, the benchmark lost
cells of a run by an accident of its own, or with `--strict` a ship does not stay on station.
2: bad input.
"""

from __future__ import annotations

import argparse
import atexit
import json
import os
import re
import resource
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dpbench.bench.workers.interrupts import Interruption, first_signal_only
from dpbench.cli.arguments import HOW_TO_END, make_parser, offer_completions, parse_words
from dpbench.cli.streams import PIPE_CLOSED, flush_streams, is_output_lost, open_streams
from dpbench.errors import (
    DpbenchError,
    InputError,
    RenamedWarning,
    SituationError,
    begin_in_lower_case,
    warn_of_outdated_name,
)
from dpbench.files.regular_files import write_bytes_to_file_or_pipe

if TYPE_CHECKING:
    from dpbench.report.formats import Table

INTERRUPTED = 130  # The exit code after Ctrl-C; after another signal 128 and its number
OLD_COMMANDS = {"hunt": "worst-case"}
"""Old names of commands that are still read, with the new ones."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a dpbench command, by default that of this process; return the exit code."""
    if argv is not None:
        with first_signal_only() as interruption:
            return _run_until_signal(argv, interruption)
    open_streams()
    if resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY:
        # Arrow's own allocator reserves 1 GB of addresses, which may be half of all.
        os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
    try:
        with first_signal_only(for_good=True) as interruption:
            return _run_until_signal(sys.argv[1:], interruption)
    finally:
        flush_streams()


def _run_until_signal(argv: Sequence[str], interruption: Interruption) -> int:
    """Run a dpbench command until it ends or a stop signal arrives; return the exit code."""
    try:
        code = _call_command(argv, interruption)
    except KeyboardInterrupt:
        code = INTERRUPTED
    except OSError:
        # Nothing is printed to a terminal that was closed.
        if not interruption.signal and not is_output_lost():
            raise
        code = PIPE_CLOSED
    if interruption.signal:
        # Python kills itself with SIGINT at its end if a KeyboardInterrupt once left a call of
        # `exec` (as of dataclasses), although it was caught; the next call makes it forget that.
        exec("")
    return 128 + interruption.signal if interruption.signal and code else code


def _call_command(argv: Sequence[str], interruption: Interruption) -> int:
    """Parse a dpbench command line and run its command; return the exit code."""
    words = list(argv)
    with warnings.catch_warnings():
        warnings.simplefilter("always", RenamedWarning)
        warnings.showwarning = _print_warning
        if words and words[0] in OLD_COMMANDS:
            warn_of_outdated_name("command", words[0], OLD_COMMANDS[words[0]])
            words[0] = OLD_COMMANDS[words[0]]
        whole = make_parser(_CALLS)
        if "_ARGCOMPLETE" in os.environ:
            offer_completions(whole)
        return _call_and_report_errors(parse_words(whole, words), interruption)


def _print_warning(
    message: Warning | str, category: type[Warning], *where: Any, **file: Any
) -> None:
    """Print a Python warning on one line, with its class unless it is about a renamed word."""
    kind = "" if issubclass(category, RenamedWarning) else f"{category.__name__}: "
    print(f"dpbench: {kind}{message}", file=sys.stderr)


_FUNCTIONS = {
    re.compile(r'`list_solvers\(\)\.options\("(.+?)"\)`'): r"`dpbench list solvers \1`",
    re.compile(r"`list_(\w+)\(\)`"): r"`dpbench list \1`",
    re.compile(r"`run_campaign\(\)`"): "`dpbench run`",
    re.compile(r'`run_campaign\((\w+), scenarios=\["(.+?)"\]\)`'): (
        r"`dpbench run \1 --scenario \2`"
    ),
    re.compile(r"`export_sequence\(\)`"): "`dpbench export`",
}
"""Commands in place of functions of the library."""
_ARGUMENT = re.compile(r"`(\w+)(?:=True)?`")
_OPTIONS = {
    "solvers": "solver",
    "choices": "solver",
    "scenarios": "scenario",
    "routes": "route",
    "policies": "policy",
    "wait_s": "wait",
    "table": "latex",
}
"""Options that are not called as the argument of the function."""


def _use_command_words(error: DpbenchError) -> str:
    """Return an error's text with options and commands in place of arguments and functions."""
    text = str(error)
    for function, command in _FUNCTIONS.items():
        text = function.sub(command, text)
    if not (isinstance(error, InputError) and error.where.startswith("`")):
        return text
    return _ARGUMENT.sub(_write_option, text)


def _write_option(argument: re.Match[str]) -> str:
    """Return the option or SUITE of the command line for an argument of a function."""
    if argument[1] == "suite":
        return "SUITE"
    return f"--{_OPTIONS.get(argument[1], argument[1]).replace('_', '-')}"


_REQUIRED: dict[type[OSError], str] = {
    FileExistsError: "a folder",
    NotADirectoryError: "a path in which every parent is a folder",
    IsADirectoryError: "a file",
    FileNotFoundError: "a path in an existing folder",
}
"""Required kind of path, by the error with which the system refuses another."""


def _call_and_report_errors(arguments: argparse.Namespace, interruption: Interruption) -> int:
    """Run a parsed command; print an error on one line; return the exit code."""
    try:
        if sys.flags.optimize > 1:
            found = f"{sys.flags.optimize}, which removes docstrings that Altair reads"
            raise InputError("PYTHONOPTIMIZE", "", found, "0 or 1")
        code = int(arguments.call(arguments) or 0)
        # A full disk or a closed pipe is an error here, and not at the end of Python.
        sys.stdout.flush()
        return code
    except DpbenchError as error:
        print(f"dpbench: {_use_command_words(error)}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 1
    except OSError as error:
        if is_output_lost():
            raise
        # Whatever else cannot be read or written: a full disk, a folder in a file's place.
        # A file is written under a name of its own first.
        name = f"{str(error.filename).removesuffix('.part')}: " if error.filename else ""
        required = "a file or folder that can be read and written, on a disk with free space"
        required = _REQUIRED.get(type(error), required)
        fault = begin_in_lower_case(error.strerror or str(error))
        print(f"dpbench: {name}{fault}; required: {required}", file=sys.stderr)
        return 2
    except MemoryError as error:
        print(f"dpbench: out of memory: {error or 'no details'}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return _print_interrupted(arguments)
    except Exception:
        # A library whose code is loading when a signal comes makes an error of its own of it.
        if not interruption.signal:
            raise
        return _print_interrupted(arguments)
    finally:
        # Keep colorama, which Numba starts, from printing a control code at the end.
        colorama = sys.modules.get("colorama.initialise")
        if colorama is not None:
            atexit.unregister(colorama.reset_all)


def _print_interrupted(arguments: argparse.Namespace) -> int:
    """Print that a command was stopped by a signal; return its exit code."""
    resumes = arguments.call in (_run_suite, _run_shard, _tune_controller, _tune_solver)
    kept = "; finished cells are kept; run the same command again to continue" if resumes else ""
    print(f"dpbench: interrupted{kept}", file=sys.stderr)
    return INTERRUPTED


def _collect_options(arguments: argparse.Namespace, *without: str) -> dict[str, Any]:
    """Return parsed command-line options by name, except the command and those in `without`."""
    others = ("command", "call", *without)
    return {name: value for name, value in vars(arguments).items() if name not in others}


def _print_estimate(arguments: argparse.Namespace) -> int:
    """Print a campaign's cells, time and size without running it (`run --dry-run`); return 0."""
    from dpbench.bench.estimate import estimate_campaign

    estimate = estimate_campaign(**_collect_options(arguments, "dry_run", *HOW_TO_END))
    lines = [*estimate.lines, *estimate.refusal_lines]
    print(json.dumps(vars(estimate), indent=2) if arguments.json else "\n".join(lines))
    return 0


def _run_suite(arguments: argparse.Namespace) -> int:
    """Run a suite and write its report (`dpbench run`); return the exit code."""
    if arguments.dry_run:
        return _print_estimate(arguments)
    from dpbench.bench.campaign import run_campaign
    from dpbench.cli.terminal import ProgressBar, print_ending
    from dpbench.report.write import write_report_with_summary

    with ProgressBar(quiet=arguments.quiet or arguments.json) as bar:
        out = run_campaign(**_collect_options(arguments, "dry_run", *HOW_TO_END), progress=bar)
        page_and_ending = write_report_with_summary(out, progress=bar)
    lost_ship = print_ending(*page_and_ending, arguments)
    return _print_accidents(out) or lost_ship


def _print_accidents(out: Path) -> int:
    """Print failures of the benchmark itself, one per line; return 1 if runs were lost."""
    from dpbench.bench.record.result_folder import read_lost_count_and_remarks

    lost, remarks = read_lost_count_and_remarks(out)
    for line in remarks:
        print(f"dpbench: {line}", file=sys.stderr)
    return int(lost > 0)


def _run_shard(arguments: argparse.Namespace) -> int:
    """Run one shard of a suite (`dpbench cells`); return the exit code."""
    from dpbench.bench.campaign import run_campaign
    from dpbench.cli.terminal import ProgressBar

    with ProgressBar() as bar:
        out = run_campaign(**_collect_options(arguments), progress=bar)
    print(f"shard {arguments.shard} is in {out}")
    return _print_accidents(out)


def _gather_shards(arguments: argparse.Namespace) -> int:
    """Join the folders of shards, write the report (`dpbench gather`); return the exit code."""
    from dpbench.bench.gather import join_result_folders
    from dpbench.cli.terminal import ProgressBar, print_ending
    from dpbench.report.write import write_report_with_summary

    with ProgressBar(transient=True, quiet=arguments.quiet or arguments.json) as bar:
        bar.start(0)
        out = join_result_folders(**_collect_options(arguments, *HOW_TO_END), progress=bar)
        page_and_ending = write_report_with_summary(out, progress=bar)
    lost_ship = print_ending(*page_and_ending, arguments)
    return _print_accidents(out) or lost_ship


WRITTEN_OR_WARNED = ("warning", "statement", "comment")
"""Lines that `report --send` prints beside that of the folder."""


def _rewrite_report(arguments: argparse.Namespace) -> int:
    """Write the report of a result folder anew (`dpbench report`); return the exit code."""
    if arguments.columns and not arguments.latex:
        allowed = "together with --latex TABLE, the table to print"
        raise InputError("--columns", "", "without --latex", allowed)
    if arguments.tables or arguments.latex:
        return _print_tables(arguments)
    from dpbench.bench.record.cell_store import count_batches_newer_than_tables
    from dpbench.cli.terminal import ProgressBar, print_ending
    from dpbench.report.documents.sent import describe_sent_folder
    from dpbench.report.write import write_report_with_summary

    if arguments.against and arguments.solver is None:
        allowed = "together with --for SOLVER, the solver to compare with these"
        raise InputError("--against", "", "without --for", allowed)
    later = count_batches_newer_than_tables(Path(arguments.dir))
    interrupted = f"a later run was interrupted, and its results (batches: {later}) are in no table"
    if later and arguments.statement:
        raise SituationError(
            "--statement",
            f"{interrupted}; finish it with the same `dpbench run` in {arguments.dir}",
        )
    options = _collect_options(arguments, "dir", "tables", "latex", "columns", *HOW_TO_END)
    with ProgressBar(transient=True, quiet=arguments.quiet or arguments.json) as bar:
        bar.start(0)
        page, ending = write_report_with_summary(arguments.dir, **options, progress=bar)
    if arguments.statement:
        ending = [*ending, ("statement", arguments.statement)]
    if arguments.send:
        # The results are those of the run, which has printed them.
        kept = ending if arguments.json else [row for row in ending if row[0] in WRITTEN_OR_WARNED]
        ending = [*kept, ("sent", describe_sent_folder(Path(arguments.send)))]
    if later:
        ending = [("caution", f"{interrupted}; this report shows the run before it"), *ending]
    return print_ending(page, ending, arguments)


def _print_tables(arguments: argparse.Namespace) -> int:
    """Print the names of a folder's tables, or one of them in LaTeX; return 0."""
    from dpbench.cli.listing import list_tables_of_folder
    from dpbench.cli.terminal import print_wrapped

    if arguments.latex:
        from dpbench.notebook.results import load_results

        columns = [name.strip() for name in (arguments.columns or "").split(",") if name.strip()]
        print(load_results(arguments.dir).to_latex(arguments.latex, columns or None), end="")
    else:
        print_wrapped(list_tables_of_folder(Path(arguments.dir)))
    return 0


def _print_completion(arguments: argparse.Namespace) -> None:
    """Print the shell code that completes words (`dpbench completion`)."""
    from argcomplete.shell_integration import shellcode

    code = shellcode(["dpbench"], shell=arguments.shell)  # type: ignore[no-untyped-call] # argcomplete types nothing
    print(code)


def _compare_folders(arguments: argparse.Namespace) -> int:
    """Compare result folders, configurations or releases; return the exit code."""
    from dpbench.report.compare.comparison import compare

    if arguments.any_machine:
        print("dpbench: --any-machine is no longer needed", file=sys.stderr)
    for file in map(Path, filter(None, (arguments.html, arguments.markdown))):
        if file.is_file():
            file.unlink()  # of an earlier comparison, not to be taken for this one's if it fails
    if arguments.releases:
        _compare_releases(arguments)
        return 0
    if arguments.choices:
        _compare_configurations(arguments)
        return 0
    if len(arguments.folders) != 2:
        count = len(arguments.folders)
        given = "1 folder" if count == 1 else f"{count} folders"
        others = "one with two or more --solver" if count == 1 else "two or more with --releases"
        allowed = f"two, from before and after a change, or {others}"
        raise InputError("compare", "", given, allowed)
    limits = {"margin": arguments.margin, "alpha": arguments.alpha}
    compared = compare(*arguments.folders, reference=arguments.reference, **limits)
    if arguments.html is not None:
        from dpbench.report.compare.page import write_comparison

        write_comparison(Path(arguments.html), compared)
    unjudged = "" if compared.worse else compared.reason_without_verdict
    code = 1 if compared.worse else arguments.disturbed_exit * bool(unjudged)
    lines, why = list(compared.lines), unjudged or compared.note_on_times or "no regression"
    if unjudged and not code:
        lines.append("times not judged give exit code 0; --disturbed-exit CODE changes it")
    lines.append(f"exit code {code} ({compared.headline if compared.worse else why})")
    _print_comparison(compared.markdown(), compared.tables, lines, arguments.markdown)
    return code


def _compare_configurations(arguments: argparse.Namespace) -> None:
    """Compare and print configurations of one folder (`dpbench compare --solver`)."""
    from dpbench.report.compare.chosen import compare_configurations_of_folder

    given = {
        f"{len(arguments.folders)} folders": len(arguments.folders) != 1,
        "--html": arguments.html,
        "--reference": arguments.reference,
    }
    if found := [name for name, is_given in given.items() if is_given]:
        allowed = "--solver with one folder, and without --html or --reference"
        raise InputError("--solver", "", f"with {' and '.join(found)}", allowed)
    chosen = compare_configurations_of_folder(arguments.folders[0], arguments.choices)
    _print_comparison(chosen.markdown(), [chosen.table], chosen.lines, arguments.markdown)


def _compare_releases(arguments: argparse.Namespace) -> None:
    """Compare and print solvers' versions over result folders (`dpbench compare --releases`)."""
    from dpbench.report.compare.releases import releases, write_releases

    over = releases(arguments.folders, reference=arguments.reference)
    if arguments.html is not None:
        write_releases(Path(arguments.html), over)
    lines = [*over.warnings, *over.ships, *over.lines, *over.lead]
    _print_comparison(over.markdown(), over.tables, lines, arguments.markdown)


def _print_comparison(
    markdown: str, tables: Sequence[Table], lines: Sequence[str], file: str | None
) -> None:
    """Print the tables and lines of a comparison; with `file`, write its Markdown there too."""
    from dpbench.cli.terminal import make_console, make_report_table, print_wrapped

    if file == "-":
        print(markdown, end="")
        return
    if file is not None:
        write_bytes_to_file_or_pipe(Path(file), markdown.encode())
    screen = make_console()
    for table in tables:
        screen.print(make_report_table(table, screen))
        screen.print()
    print_wrapped(lines)


def _export_qps(arguments: argparse.Namespace) -> None:
    """Write QPs in one of several file formats (`dpbench export`)."""
    from dpbench.bench.sequences.export import check_export_options, export_sequence
    from dpbench.cli.terminal import print_wrapped

    check_export_options(vars(arguments))
    if arguments.all:
        from dpbench.bench.sequences.shipped import record_shipped_sequences
        from dpbench.cli.terminal import ProgressBar

        with ProgressBar(transient=True) as bar:
            text = record_shipped_sequences(arguments.out or "results/sequences", progress=bar)
    else:
        text = export_sequence(**_collect_options(arguments, "all"))
    print_wrapped(text.splitlines())


def _find_worst_case(arguments: argparse.Namespace) -> int:
    """Search a solver's worst step and print it (`dpbench worst-case`); return the exit code."""
    from dpbench.bench.worst_case.find import find_worst_case
    from dpbench.cli.terminal import ProgressBar, print_wrapped

    with ProgressBar() as bar:
        worst_case = find_worst_case(**_collect_options(arguments), progress=bar)
    print_wrapped(worst_case.lines)
    return INTERRUPTED if worst_case.search.stopped == "interrupted" else 0


def _prove_iteration_bound(arguments: argparse.Namespace) -> int:
    """Prove and print a bound (`dpbench iteration-bound`); return the exit code."""
    from dpbench.bench.worst_case.iteration_bound import prove_iteration_bound
    from dpbench.cli.terminal import ProgressBar, print_wrapped

    with ProgressBar() as bar:
        bound = prove_iteration_bound(**_collect_options(arguments), progress=bar)
    print_wrapped(bound.lines)
    return 0 if bound.is_complete and not bound.differing else 1


def _count_active_sets(arguments: argparse.Namespace) -> None:
    """Print how many active sets QPs visit, and what their laws save (`dpbench active-sets`)."""
    from dpbench.analysis.suites.active_sets import count_saved_work, count_visited_sets_of
    from dpbench.cli.terminal import make_console, make_report_table
    from dpbench.report.active_sets_text import make_table_of_saved_work, make_table_of_visited_sets

    screen, names = make_console(), arguments.names
    visited = make_table_of_visited_sets([*map(count_visited_sets_of, names)])
    screen.print(make_report_table(visited, screen))
    if arguments.instructions:
        saved = make_table_of_saved_work([*map(count_saved_work, names)])
        screen.print(make_report_table(saved, screen))


def _tune_controller(arguments: argparse.Namespace) -> int:
    """Search a scenario's weights and horizons (`dpbench tune`); return the exit code."""
    from dpbench.cli.terminal import ProgressBar, print_wrapped
    from dpbench.locks import find_machine_lock_holders
    from dpbench.tuning.tune_controller import tune_controller

    if holders := find_machine_lock_holders():
        others = " and ".join(map(str, holders))
        print(f"dpbench: this search may disturb the step times of {others}", file=sys.stderr)
    with ProgressBar() as bar:
        tuning = tune_controller(**_collect_options(arguments), progress=bar)
    print_wrapped(tuning.lines)
    return 0 if tuning.keeps_margin else 1


def _tune_solver(arguments: argparse.Namespace) -> int:
    """Search a solver's settings, test them (`dpbench tune-solver`); return the exit code."""
    from dpbench.cli.terminal import ProgressBar, make_console, make_report_table, print_wrapped

    if arguments.dry_run:
        from dpbench.locks import WaitLimit
        from dpbench.tuning.request import estimate_tuning

        WaitLimit(arguments.wait_s)
        print_wrapped(estimate_tuning(**_collect_options(arguments, "dry_run", "wait_s")).lines)
        return 0
    from dpbench.tuning.tune import tune_solver

    with ProgressBar() as bar:
        tuning = tune_solver(**_collect_options(arguments, "dry_run"), progress=bar)
    if tuning.roles:
        screen = make_console()
        screen.print(make_report_table(tuning.table, screen))
        screen.print()
    print_wrapped(tuning.lines)
    if tuning.is_interrupted:
        return _print_interrupted(arguments)
    return 0 if tuning.is_successful else 1


def _generate_controller(arguments: argparse.Namespace) -> None:
    """Write a scenario's controller as C code (`dpbench codegen`)."""
    from dpbench.cli.terminal import print_wrapped
    from dpbench.codegen.generate import generate_controller

    print_wrapped(generate_controller(**_collect_options(arguments)))


def _reproduce_paper(arguments: argparse.Namespace) -> int:
    """Reproduce the paper's figures and claims (`dpbench paper`); return the exit code."""
    from dpbench.cli.terminal import ProgressBar, print_wrapped
    from dpbench.report.reproduce import reproduce_paper

    with ProgressBar(transient=True) as bar:
        reproduction = reproduce_paper(arguments.out, progress=bar)
    print_wrapped(reproduction.lines)
    for line in reproduction.remarks:
        print(f"dpbench: {line}", file=sys.stderr)
    return 0 if reproduction.complete else 1


def _print_listing(arguments: argparse.Namespace) -> None:
    """Print a table of solvers or stored files (`dpbench list`)."""
    from dpbench.cli.listing import list_table
    from dpbench.cli.terminal import make_console

    make_console().print(list_table(arguments.what, arguments.name))


def _write_own_ship(arguments: argparse.Namespace) -> None:
    """Write the files of the user's ship (`dpbench init`)."""
    from dpbench.cli.ship.own_ship import write_own_ship
    from dpbench.cli.terminal import print_wrapped

    print_wrapped(write_own_ship(arguments))


def _print_embedded_counts(arguments: argparse.Namespace) -> int:
    """Count what solvers' C executes on a core (`dpbench embedded`); return the exit code."""
    from dpbench.cli.embedded import count_and_print

    return count_and_print(arguments)


def _print_capability(arguments: argparse.Namespace) -> None:
    """Print the wind that a ship holds from each direction (`dpbench capability`)."""
    from dpbench.cli.ship.capability import describe_capability

    print(describe_capability(arguments))


def _print_machine_check(arguments: argparse.Namespace) -> None:
    """Print facts about this machine (`dpbench doctor`)."""
    from dpbench.cli.doctor import describe_machine_and_clock

    print("\n".join(describe_machine_and_clock(offline=arguments.offline)))


def _check_named_file(arguments: argparse.Namespace) -> None:
    """Check a file of the user, or a stored one by name, and print the result (`dpbench check`)."""
    from dpbench.cli.check import check_file
    from dpbench.cli.terminal import ProgressBar, print_wrapped

    with ProgressBar(transient=True) as bar:
        text = check_file(arguments.file, bar, quick=arguments.quick)
    print_wrapped(text.splitlines())


_CALLS = {
    "run": _run_suite,
    "cells": _run_shard,
    "gather": _gather_shards,
    "report": _rewrite_report,
    "compare": _compare_folders,
    "export": _export_qps,
    "worst-case": _find_worst_case,
    "iteration-bound": _prove_iteration_bound,
    "active-sets": _count_active_sets,
    "tune": _tune_controller,
    "tune-solver": _tune_solver,
    "codegen": _generate_controller,
    "embedded": _print_embedded_counts,
    "paper": _reproduce_paper,
    "list": _print_listing,
    "check": _check_named_file,
    "doctor": _print_machine_check,
    "completion": _print_completion,
    "init": _write_own_ship,
    "capability": _print_capability,
}
