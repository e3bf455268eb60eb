"""The arguments of the command line, one function per command, and their completion in a shell.

An argument has the name of the parameter that it is for.
"""

import argparse
import sys
from collections.abc import Callable, Mapping
from functools import partial
from importlib.metadata import version
from typing import Any, NoReturn

Command = Any  # A parser of a command, or a group of its arguments
HOW_TO_END = ("open", "json", "quiet", "strict")  # Arguments of what comes after a run or report
_LISTED = ("vessels", "scenarios", "suites", "sequences", "solvers")
_STORED = {
    "suite": "suites",
    "scenario": "scenarios",
    "scenarios": "scenarios",
    "sequence": "sequences",
    "what": "scenarios",
    "file": "scenarios",
    "vessel": "vessels",
}
"""Arguments whose values are names of stored files, with their kind."""
_LOST_CELLS = "1 cells were lost by the benchmark itself, give the same command again; 2 bad input."


class _TerseParser(argparse.ArgumentParser):
    """An argument parser that prints an error on one line."""

    def error(self, message: str) -> NoReturn:
        """Print an error in the command line on one line; exit with code 2."""
        print(f"dpbench: {message} (see dpbench --help)", file=sys.stderr)
        raise SystemExit(2)


def make_parser(calls: Mapping[str, Callable[..., int | None]]) -> argparse.ArgumentParser:
    """Return the command line's parser; `calls` maps commands to the functions that run them."""
    whole = _TerseParser(prog="dpbench", description="Benchmark QP solvers inside a ship's DP MPC.")
    whole.add_argument("--version", action="version", version=f"dpbench {version('dpbench')}")
    commands = whole.add_subparsers(
        dest="command", metavar="COMMAND", required=True, parser_class=_TerseParser
    )
    for name, (define, summary, epilog) in _COMMANDS.items():
        command = commands.add_parser(name, help=summary, epilog=epilog)
        define(command)
        command.set_defaults(call=calls[name])
    return whole


def offer_completions(whole: argparse.ArgumentParser) -> None:
    """Print shell completions of solver and file names and exit, when a shell requests them."""
    import argcomplete

    commands: Any = next(a for a in whole._actions if isinstance(a, argparse._SubParsersAction))
    for command in commands.choices.values():
        for action in command._actions:
            is_solver, kind = action.dest in ("solver", "solvers"), _STORED.get(action.dest)
            if action.choices is None and (is_solver or kind):
                stored = partial(_list_stored_files, str(kind))
                action.completer = _list_solvers if is_solver else stored
    argcomplete.autocomplete(whole)


def _list_stored_files(kind: str, **_: object) -> list[str]:
    """Return the names of stored files of a kind, to complete words in a shell."""
    from dpbench.scenario.problem_files import list_shipped_problem_names

    return list_shipped_problem_names(kind)


def _list_solvers(**_: object) -> list[str]:
    """Return the names of all solvers, to complete words in a shell."""
    from dpbench.solvers.table import list_all_solver_names

    return list(list_all_solver_names())


def _add_option(command: Command, name: str, value: str, meaning: str, **keywords: Any) -> None:
    """Add an option with the name of its value and its help to a command's parser."""
    command.add_argument(name, metavar=value, help=meaning, **keywords)


def _add_run_arguments(run: Command) -> None:
    """Add the arguments of `dpbench run` to its parser."""
    option = partial(_add_option, run)
    run.add_argument("--out", help="result folder (default: results/<suite>)")
    _add_suite_arguments(run)
    option("--engine", "E", "local (default), or dask", default="local")
    option("--scheduler", "ADDRESS", "of Dask (default: --jobs workers on this machine)")
    tls = "PEM files for a scheduler at tls://HOST:PORT (default: Dask's configuration)"
    run.add_argument("--tls", nargs=3, metavar=("CA", "CERT", "KEY"), help=tls)
    estimate = "estimate cells, time and size by the runs in --out, or by stated rates"
    run.add_argument("--dry-run", action="store_true", help=estimate)
    _add_ending_arguments(run)


def _add_suite_arguments(run: Command) -> None:
    """Add the arguments that choose and vary a suite to a command's parser."""
    option = partial(_add_option, run)
    repeated = partial(option, action="append")
    sequence = "instead: a stored sequence, or a file or folder of QPs (.npz, .json, .mat)"
    scenario = "only this scenario; another one, or a file, replaces those of the suite"
    run.add_argument("suite", nargs="?", help="a suite by name, or a TOML file")
    option("--sequence", "S", sequence)
    solver = "only this solver, as osqp or with options as 'osqp[rho=[0.1,1]]'; repeatable"
    repeated("--solver", "S", solver, dest="solvers")
    repeated("--scenario", "N", scenario, dest="scenarios")
    settings = "only at default, low, mid, high or [settings.L] of the suite; repeatable"
    repeated("--settings", "L", settings)
    route = "instead of the suite's: native, qpsolvers or default, each solver's own; repeatable"
    repeated("--route", "R", route, dest="routes")
    policy = "instead of the suite's: fresh, reuse or warm; repeatable"
    repeated("--policy", "P", policy, dest="policies")
    option("--steps", "N", "at most N steps of each run", type=int)
    option("--jobs", "J", "loops or random configurations at a time", type=int)
    option("--solver-module", "FILE.py", "a plug-in that brings a solver")
    run.add_argument("--fresh", action="store_true", help="run finished cells again too")
    _add_wait_arguments(run)


def _add_wait_arguments(command: Command) -> None:
    """Add the options on how long to wait for another campaign to a command's parser."""
    wait = command.add_mutually_exclusive_group()
    longest = "the longest wait for another campaign on this machine (no limit)"
    _add_option(wait, "--wait", "SECONDS", longest, type=float, dest="wait_s")
    never = "exit with 2 where another campaign would be waited for"
    wait.add_argument("--no-wait", action="store_const", const=0.0, dest="wait_s", help=never)


def _add_cells_arguments(cells: Command) -> None:
    """Add the arguments of `dpbench cells`, which runs one shard, to its parser."""
    cells.description = (
        "For schedulers that only start commands: the cells of one of N shards, which "
        "several machines may run at a time. Give the same command again after an interruption."
    )
    _add_option(cells, "--shard", "I/N", "which one (1/1)", default="1/1")
    _add_option(cells, "--out", "DIR", "a folder of its own", required=True)
    _add_suite_arguments(cells)


def _add_gather_arguments(gather: Command) -> None:
    """Add the arguments of `dpbench gather`, which joins shards, to its parser."""
    gather.add_argument("folders", metavar="DIR", nargs="+", help="a folder of each shard")
    option = partial(_add_option, gather)
    option("--out", "DIR", "result folder", required=True)
    option("--suite", "FILE", "path of the suite, if it was moved")
    option("--solver-module", "FILE.py", "the plug-in that the shards were run with")
    _add_ending_arguments(gather)


def _add_ending_arguments(command: Command) -> None:
    """Add the options on what a command prints at its end, and exits with, to its parser."""
    command.add_argument("--open", action="store_true", help="open the page in a browser")
    command.add_argument("--json", action="store_true", help="print the result as JSON")
    command.add_argument("--quiet", action="store_true", help="print only the path of the page")
    strict = "exit with 1 where the controller does not hold a ship, whatever the solver"
    command.add_argument("--strict", action="store_true", help=strict)


def _add_report_arguments(report: Command) -> None:
    """Add the arguments of `dpbench report` to its parser."""
    report.add_argument("dir", help="a folder written by `dpbench run`")
    option = partial(_add_option, report)
    repeated = partial(option, action="append", default=[])
    option("--baseline", "S", "the solver set beside the answer")
    repeated("--figures", "FORMAT", "figures as pdf or png too; repeatable")
    option("--statement", "FILE.pdf", "a one-page statement for a class society")
    beside = "also DIR/S.md: this solver beside others, for a pull request, and its worst steps"
    option("--for", "S", beside, dest="solver")
    repeated("--against", "S", "with --for: beside this one (osqp and daqp); repeatable")
    option("--send", "FOLDER", "make a folder for results/community, to be sent to us")
    named = "instead: name the tables of the folder, with what each has"
    report.add_argument("--tables", action="store_true", help=named)
    option("--latex", "TABLE", "instead: print one of them as a LaTeX tabular (booktabs)")
    _add_ending_arguments(report)


def _add_compare_arguments(compare: Command) -> None:
    """Add the arguments of `dpbench compare` to its parser."""
    compare.add_argument("folders", metavar="DIR", nargs="+", help="two result folders, A and B")
    releases = "instead: each solver over its versions, in two folders or more"
    compare.add_argument("--releases", action="store_true", help=releases)
    reference = "compare ratios to this solver; of two machines always (paper_active_set or daqp)"
    _add_option(compare, "--reference", "S", reference)
    compare.add_argument("--any-machine", action="store_true", help=argparse.SUPPRESS)
    compare.add_argument("--margin", type=float, default=0.05, help="what is no difference (0.05)")
    compare.add_argument("--alpha", type=float, default=0.05, help="family-wise error (0.05)")
    _add_option(compare, "--markdown", "FILE", "write Markdown; - for the screen")
    _add_option(compare, "--html", "FILE", "write a page with figures")


def _add_export_arguments(export: Command) -> None:
    """Add the arguments of `dpbench export` to its parser."""
    problems = "a scenario, a sequence (name, .npz, random_mpc-NX-NU-N) or a folder of problems"
    export.add_argument("what", nargs="?", help=problems)
    export.add_argument("--all", action="store_true", help="instead: all stored sequences anew")
    export.add_argument(
        "--format", default="npz", help="npz (default), qpbenchmark, mat, csv or qps"
    )
    option = partial(_add_option, export)
    option("--out", "PATH", "the file or folder to write (--all: results/sequences)")
    option("--horizons", "N_p/N_c", "instead of the tuning's")
    option("--steps", "N", "only the first N steps", type=int)
    option("--every", "K", "each K-th of them", type=int, default=1)
    option("--at", "K", "instead: step K alone", type=int)
    part = "controller (default), or allocation of a cascade"
    export.add_argument("--part", default="controller", help=part)


def _add_worst_case_arguments(worst_case: Command) -> None:
    """Add the arguments of `dpbench worst-case` to its parser."""
    add, option = worst_case.add_argument, partial(_add_option, worst_case)
    add("solver", help="the solver to search")
    add("--goal", default="iterations", help="iterations (default) or error")
    option("--scenario", "N", "whose starts are varied", default="paper")
    add("--route", help="native (default where there is one) or qpsolvers")
    add("--policy", default="fresh", help="fresh (default), reuse or warm")
    add("--settings", default="default", help="default, low, mid or high")
    option("--budget", "B", "cases to try (300)", type=int, default=300)
    option("--steps", "N", "length of a case (60)", type=int, default=60)
    add("--seed", type=int, default=1, help="of the search (1)")
    option("--out", "FILE.npz", "default: worst-cases/<solver>-<goal>.npz")
    option("--solver-module", "FILE.py", "a plug-in that brings the solver")


def _add_iteration_bound_arguments(bound: Command) -> None:
    """Add the arguments of `dpbench iteration-bound` to its parser."""
    option = partial(_add_option, bound)
    bound.add_argument("axes", metavar="AXES", help="surge or sway-yaw")
    option("--scenario", "N", "whose controller (default: paper)", default="paper")
    option(
        "--box", "FACTOR", "of the box of parameters (1)", type=float, dest="factor", default=1.0
    )
    limit = "time after which the proof stops (600)"
    option("--limit", "SECONDS", limit, type=float, dest="limit_s", default=600.0)


def _add_check_arguments(check: Command) -> None:
    """Add the arguments of `dpbench check` to its parser."""
    file = (
        "a name, scenario@vessel, a TOML file, or a file or folder of QPs, whose every "
        "step is certified anew; or a folder of results/community"
    )
    check.add_argument("file", help=file)
    quick = "of a ship or scenario: simulate no offsets; the output names what is left out"
    check.add_argument("--quick", action="store_true", help=quick)


def _add_init_arguments(init: Command) -> None:
    """Add the arguments of `dpbench init` to its parser."""
    init.description = (
        "Write NAME.toml (the ship), NAME_weather.toml and NAME_suite.toml, with what "
        "was derived how in their comments; with --thrusters also NAME_thrusters.toml, whose "
        "controller commands them, NAME_loss_*.toml, which lose other switchboards, and the "
        "plot NAME_capability.svg. Sectors and barred zones of azimuths are directions in which "
        "they push the ship, clockwise from ahead; the race (wash) goes the other way. A port "
        "azimuth whose race may not go 60 to 120 deg, to the starboard one, has barred_from_deg "
        "240 and barred_to_deg 300. With NAME.toml there "
        "and --sea N alone: the same ship in another sea."
    )
    init.add_argument("name", metavar="NAME", help="of the ship: letters, digits, _ and -")
    option = partial(_add_option, init)
    option("--length", "M", "between perpendiculars [m]")
    option("--breadth", "M", "[m]")
    option("--draught", "M", "[m]")
    option("--displacement", "T", "[t]")
    option("--thrust", "KN", "largest force ahead [kN]")
    option("--sway-thrust", "KN", "sideways [kN] (a third of --thrust)")
    option("--yaw-moment", "KNM", "[kN·m] (0.57 sway thrust times length)")
    option("--thrusters", "FILE.csv", "instead of --thrust: one row each; - prompts for them")
    option("--like", "V", "library vessel to scale (the nearest)")
    option("--from-mss", "FILE.mat", "a vessel of the MSS toolbox")
    option("--from-csv", "FILE", "rows coefficient,value (see docs)")
    option("--sea", "N", "DP number, 1 to 9 (what the ship can hold)")
    option("--out", "DIR", "folder to write to (here)", default=".")
    init.add_argument("--force", action="store_true", help="write over files that are there")


def _add_capability_arguments(capability: Command) -> None:
    """Add the arguments of `dpbench capability` to its parser."""
    capability.description = (
        "For 36 directions, intact and after the loss of each failure group; with "
        "--solver, which solvers answer the loads at that limit correctly."
    )
    capability.add_argument("vessel", help="a vessel with thrusters by name, or a TOML file")
    option = partial(_add_option, capability)
    option("--sides", "N", "polygons with N sides instead of circles", type=int)
    solver = (
        "judge the answers of this solver to the QPs at the edge; repeatable; all: of every "
        "one that is installed"
    )
    option("--solver", "S", solver, action="append")
    option("--out", "DIR", "where these QPs go (results/capability-<vessel>)")
    option("--figure", "FILE", "write the rose: .svg, .html, .png or .pdf")
    planned = "also with the half turns that controllers plan with for azimuths"
    capability.add_argument("--planned", action="store_true", help=planned)
    capability.add_argument("--json", action="store_true", help="print the result as JSON")


def _add_codegen_arguments(codegen: Command) -> None:
    """Add the options and arguments of `dpbench codegen` to its parser."""
    codegen.description = (
        "Write the complete control step of a scenario as C99: measurement, QP, solver, limits and "
        "fallback, with an example that replays a recorded trajectory."
    )
    codegen.add_argument("scenario", help="a scenario by name, or a TOML file")
    option = partial(_add_option, codegen)
    solver = "the solver in it: paper_active_set (default), daqp or osqp"
    option("--solver", "S", solver, default="paper_active_set")
    option("--out", "DIR", "folder to write to", required=True)
    option("--steps", "N", "length of the trajectory (1000)", type=int, default=1000)
    option("--fmu", "FILE.fmu", "write it as a functional mock-up unit too (extra: embedded)")
    option("--fmi", "V", "version of that: 2 (default) or 3", type=int, default=2)


def _add_embedded_arguments(embedded: Command) -> None:
    """Add the options and arguments of `dpbench embedded` to its parser."""
    embedded.description = (
        "Compile solvers' C for an embedded core, run it on an emulated one along a sequence of "
        "QPs, and count instructions, memory and errors of each step (extra: embedded)."
    )
    embedded.add_argument(
        "sequences",
        metavar="SEQUENCE",
        nargs="*",
        help="a stored sequence, a .npz, or random_mpc-NX-NU-N (paper-30-5)",
    )
    option = partial(_add_option, embedded)
    repeated = partial(option, action="append", default=[])
    repeated("--target", "T", "m7 (default), a53, riscv or x86; repeatable")
    repeated("--solver", "S", "only this solver; repeatable (all with a recipe)")
    repeated("--recipe", "DIR", "a recipe of your own: recipe.toml and shim.c; repeatable")
    repeated("--source", "SOLVER=DIR", "a folder of a solver's sources, as hpipm; repeatable")
    repeated("--settings", "S.KEY=N", "a setting of a solver, as osqp.rho=0.1; repeatable")
    fit = "find the largest control horizon of a scenario (paper) that fits in this; repeatable"
    repeated("--fit", "KB", fit)
    single = "compile in single precision"
    embedded.add_argument("--float", action="store_true", dest="single", help=single)
    opinion = "compare the counts with those of valgrind (x86) or QEMU (a53, m7) if installed"
    embedded.add_argument("--second-opinion", action="store_true", help=opinion)
    option("--steps", "N", "at most N steps of each sequence (all)", type=int, default=0)
    option(
        "--out", "DIR", "folder of embedded.parquet (results/embedded)", default="results/embedded"
    )
    embedded.add_argument("--json", action="store_true", help="print a summary as JSON")


def _add_tune_solver_arguments(tune: Command) -> None:
    """Add the options and arguments of `dpbench tune-solver` to its parser."""
    tune.description = (
        "Find the fastest settings of a solver that are accurate on the training sequences, and "
        "measure them on test sequences of other loops. Ctrl-C writes the best so far; give the "
        "same command again to go on."
    )
    add, option = tune.add_argument, partial(_add_option, tune)
    repeated = partial(option, action="append", default=[])
    start = "the solver to tune, as osqp, or with settings to start from as 'osqp[rho=1.6]'"
    add("solver", help=start)
    training = "search on this sequence or scenario; repeatable (paper, rough, turn)"
    repeated("--train", "S", training, dest="training")
    repeated("--test", "S", "measure on this one; repeatable (move, extreme, weather)")
    ranges = "search this option, as 'rho=[1e-3,10]', instead of the usual ones; repeatable"
    repeated("--range", "RANGE", ranges, dest="ranges")
    widened = "search this option in this range, beside the other ones; repeatable"
    repeated("--widen", "RANGE", widened, dest="widened")
    add("--route", help="native (default where there is one) or qpsolvers")
    add("--policy", default="fresh", help="fresh (default), reuse or warm")
    error = "largest error of the first move, in maximum increments (0.01)"
    option("--error", "E", error, type=float, default=0.01, dest="error_move")
    option("--trials", "N", "settings to try (48)", type=int, default=48)
    option("--steps", "N", "at most N steps of each scenario (all)", type=int, default=0)
    add("--seed", type=int, default=1, help="of the search (1)")
    option("--name", "NAME", "of the settings found (tuned)", default="tuned")
    option("--out", "DIR", "folder (results/tune-SOLVER)")
    option("--solver-module", "FILE.py", "a plug-in that brings the solver")
    tune.add_argument("--dry-run", action="store_true", help="forecast the time, run nothing")
    _add_wait_arguments(tune)


def _add_tune_arguments(tune: Command) -> None:
    """Add the options and arguments of `dpbench tune` to its parser."""
    tune.description = (
        "Find weights and horizons that hold the ship with margin at little wear, try them in "
        "realisations of the sea that the search never met, and write the scenario with them. Give "
        "the same command again after an interruption."
    )
    add, option = tune.add_argument, partial(_add_option, tune)
    add("scenario", help="a scenario by name, or a TOML file")
    option("--seas", "N,N", "DP numbers, as 4,5 (the scenario's own weather)", default="")
    option("--trials", "N", "controllers to try (48)", type=int, default=48)
    option("--realisations", "R", "of each sea, and as many fresh ones (2)", type=int, default=2)
    margin = "largest offset, as a share of the station of 5 m and 5° (0.7)"
    option("--margin", "SHARE", margin, type=float, default=0.7)
    option("--steps", "N", "at most N steps of each loop (all)", type=int, default=0)
    add("--seed", type=int, default=1, help="of the search (1)")
    option("--out", "DIR", "folder (results/tune-SCENARIO)")


_COMMANDS: dict[str, tuple[Callable[[Command], None], str, str | None]] = {
    "run": (
        _add_run_arguments,
        "run a suite and write its report",
        f"Exit code: 0 done (a solver's failure is data); {_LOST_CELLS}",
    ),
    "cells": (
        _add_cells_arguments,
        "run a shard of a suite, for `gather`",
        f"Exit code: 0 done (a solver's failure is data); {_LOST_CELLS}",
    ),
    "gather": (
        _add_gather_arguments,
        "put the shards of a suite together that `cells` ran, and write the report",
        "Exit code: 0 done; 1 cells are missing: `dpbench run` into the folder runs them on "
        "this machine; 2 bad input.",
    ),
    "report": (_add_report_arguments, "write the report of a result folder again", None),
    "compare": (
        _add_compare_arguments,
        "what became slower or worse from A to B; solvers over their releases",
        "Exit code: 0 no regression is shown; 1 one is; 2 bad input.",
    ),
    "export": (_add_export_arguments, "write QPs with certified optima for others", None),
    "worst-case": (
        _add_worst_case_arguments,
        "search for a solver's slowest or least accurate step",
        None,
    ),
    "iteration-bound": (
        _add_iteration_bound_arguments,
        "prove the largest number of iterations of paper_active_set in a box",
        "Exit code: 0 proved; 1 the time was too short, or the C library takes other iterations; "
        "2 bad input.",
    ),
    "active-sets": (
        lambda visited: visited.add_argument(
            "names", nargs="+", metavar="NAME", help="a scenario, or a sequence or its .npz"
        ),
        "count the active sets that a controller's QPs visit",
        None,
    ),
    "tune": (
        _add_tune_arguments,
        "search for weights and horizons that hold a ship with margin",
        "Exit code: 0 found; 1 none keeps the margin in the search and in fresh realisations; "
        "2 bad input.",
    ),
    "tune-solver": (
        _add_tune_solver_arguments,
        "search for a solver's fastest accurate settings",
        "Exit code: 0 settings found; 1 none is accurate on every training sequence; 2 bad input; "
        "130 interrupted.",
    ),
    "embedded": (
        _add_embedded_arguments,
        "count what solvers cost as C on an embedded core",
        "Exit code: 0 done; 1 a solver could not be counted; 2 bad input, or none could be.",
    ),
    "codegen": (_add_codegen_arguments, "write a scenario's controller as C code", None),
    "paper": (
        lambda paper: _add_option(paper, "--out", "DIR", "folder (default: results/paper)"),
        "reproduce the paper: Figures 4-7, the data behind them, its claims",
        "Exit code: 0 done, whatever became of the claims; 1 runs were lost by the "
        "benchmark itself, give the same command again; 2 bad input.",
    ),
    "list": (
        lambda listing: listing.add_argument(
            "what", choices=_LISTED, type=lambda word: f"{word}s" if f"{word}s" in _LISTED else word
        ),
        "what there is",
        None,
    ),
    "check": (
        _add_check_arguments,
        "check a vessel, scenario, suite, sequence or sent result",
        None,
    ),
    "doctor": (
        lambda doctor: doctor.add_argument(
            "--offline", action="store_true", help="do not look for newer releases of solvers"
        ),
        "is this machine quiet, is the harness right",
        None,
    ),
    "completion": (
        lambda completion: completion.add_argument("shell", choices=("bash", "zsh", "fish")),
        "complete names in a shell",
        'bash, zsh: eval "$(dpbench completion bash)"; fish: dpbench completion fish | source',
    ),
    "init": (_add_init_arguments, "write vessel, scenario and suite of your own ship", None),
    "capability": (
        _add_capability_arguments,
        "the largest wind a ship's thrusters hold (DNV-ST-0111 level 1)",
        None,
    ),
}
"""Commands by name: the function that adds the arguments, the summary and the epilog."""
