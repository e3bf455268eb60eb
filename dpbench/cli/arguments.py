"""The arguments of the command line: one function per command.

Each is kept under the name of the parameter that it is for.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import Any, NoReturn

Commands = Any
"""What `add_subparsers` gives, which argparse has no public name for."""


class _Parser(argparse.ArgumentParser):
    """An argument parser whose complaints are one line, like every other complaint."""

    def error(self, message: str) -> NoReturn:
        print(f"dpbench: {message} (see dpbench --help)", file=sys.stderr)
        raise SystemExit(2)


def parser(
    calls: Mapping[str, Callable[[argparse.Namespace], int]],
) -> argparse.ArgumentParser:
    """Make the parser.

    `calls` has for every command what is called with its arguments, as `call`.
    """
    whole = _Parser(prog="dpbench", description="Benchmark QP solvers inside a ship's DP MPC.")
    whole.add_argument("--version", action="version", version=f"dpbench {version('dpbench')}")
    commands = whole.add_subparsers(
        dest="command", metavar="COMMAND", required=True, parser_class=_Parser
    )
    for add in (
        _run,
        _cells,
        _gather,
        _report,
        _compare,
        _export,
        _worst_case,
        _paper,
        _list,
        _check,
        _doctor,
        _completion,
        _init,
        _capability,
    ):
        add(commands)
    for name, command in commands.choices.items():
        command.set_defaults(call=calls[name])
    return whole


def _option(command: Any, name: str, value: str, meaning: str, **keywords: Any) -> None:
    """Add an option that takes a value; `keywords` as of `add_argument`."""
    command.add_argument(name, metavar=value, help=meaning, **keywords)


def _run(commands: Commands) -> None:
    run = commands.add_parser(
        "run",
        help="run a suite and write its report",
        epilog="Exit code: 0 done (a solver's failure is data); 1 cells were lost by the benchmark "
        "itself, give the same command again; 2 bad input.",
    )
    run.add_argument("--out", help="result folder (default: results/<suite>)")
    _what_to_run(run)
    _option(run, "--engine", "E", "local (default), or dask", default="local")
    _option(run, "--scheduler", "ADDRESS", "of Dask (default: --jobs workers on this machine)")
    run.add_argument(
        "--tls",
        nargs=3,
        metavar=("CA", "CERT", "KEY"),
        help="PEM files for a scheduler at tls://HOST:PORT (default: Dask's configuration)",
    )
    run.add_argument(
        "--dry-run",
        action="store_true",
        help="estimate cells, time and size by the runs in --out, or by stated rates",
    )
    _how_to_end(run)


def _what_to_run(run: Any) -> None:
    """Add the suite, and what of it is run."""
    run.add_argument("suite", nargs="?", help="a suite by name, or a TOML file")
    _option(
        run,
        "--sequence",
        "S",
        "instead: a stored sequence, a .npz, or a folder of them by qpsolvers",
    )
    _option(run, "--solver", "S", "only this solver; repeatable", action="append", dest="solvers")
    _option(
        run,
        "--scenario",
        "N",
        "only this scenario; another one, or a file, takes the place of the suite's",
        action="append",
        dest="scenarios",
    )
    _option(run, "--settings", "L", "only at default, low, mid or high", action="append")
    _option(run, "--steps", "N", "at most N steps of each run", type=int)
    _option(run, "--jobs", "J", "loops or random configurations at a time", type=int)
    _option(run, "--solver-module", "FILE.py", "a plug-in that brings a solver")
    run.add_argument("--fresh", action="store_true", help="run finished cells again too")
    wait = run.add_mutually_exclusive_group()
    _option(
        wait,
        "--wait",
        "SECONDS",
        "the longest wait for another campaign on this machine (no limit)",
        type=float,
        dest="wait_s",
    )
    wait.add_argument(
        "--no-wait",
        action="store_const",
        const=0.0,
        dest="wait_s",
        help="exit with 2 where another campaign would be waited for",
    )


def _cells(commands: Commands) -> None:
    cells = commands.add_parser(
        "cells",
        help="run a shard of a suite, for `gather`",
        description="For schedulers that know only commands: the cells of one of N shards, which "
        "several machines may run at a time. Give the same command again after an interruption.",
        epilog="Exit code: 0 done (a solver's failure is data); 1 cells were lost by the benchmark "
        "itself, give the same command again; 2 bad input.",
    )
    _option(cells, "--shard", "I/N", "which one (1/1)", default="1/1")
    _option(cells, "--out", "DIR", "a folder of its own", required=True)
    _what_to_run(cells)


def _gather(commands: Commands) -> None:
    gather = commands.add_parser(
        "gather",
        help="put the shards of a suite together that `cells` ran, and write the report",
        epilog="Exit code: 0 done; 1 cells are missing: `dpbench run` into the folder runs them on "
        "this machine; 2 bad input.",
    )
    gather.add_argument("folders", metavar="DIR", nargs="+", help="a folder of each shard")
    _option(gather, "--out", "DIR", "result folder", required=True)
    _option(gather, "--suite", "FILE", "where the suite lies, if it lay elsewhere")
    _option(gather, "--solver-module", "FILE.py", "the plug-in that the shards were run with")
    _how_to_end(gather)


HOW_TO_END = ("open", "json", "quiet")
"""Arguments of what comes after a run or report."""


def _how_to_end(command: Any) -> None:
    command.add_argument("--open", action="store_true", help="open the page in a browser")
    command.add_argument("--json", action="store_true", help="say how it ended as JSON")
    command.add_argument("--quiet", action="store_true", help="say nothing but where the page is")


def _report(commands: Commands) -> None:
    report = commands.add_parser("report", help="write the report of a result folder again")
    report.add_argument("dir", help="a folder written by `dpbench run`")
    _option(report, "--baseline", "S", "the solver set beside the answer")
    _option(
        report,
        "--figures",
        "FORMAT",
        "figures as pdf or png too; repeatable",
        action="append",
        default=[],
    )
    _option(report, "--statement", "FILE.pdf", "a one-page statement for a class society")
    _option(
        report,
        "--for",
        "S",
        "also DIR/S.md: this solver beside others, for a pull request, and its worst steps",
        dest="solver",
    )
    _option(
        report,
        "--against",
        "S",
        "with --for: beside this one (osqp and daqp); repeatable",
        action="append",
        default=[],
    )
    _option(report, "--send", "FOLDER", "make a folder for results/community, to be sent to us")
    _how_to_end(report)


def _compare(commands: Commands) -> None:
    compare = commands.add_parser(
        "compare",
        help="what became slower or worse from A to B; solvers over their releases",
        epilog="Exit code: 0 no regression is shown; 1 one is; 2 bad input.",
    )
    compare.add_argument("folders", metavar="DIR", nargs="+", help="two result folders, A and B")
    compare.add_argument(
        "--releases",
        action="store_true",
        help="instead: each solver over its versions, in two folders or more",
    )
    _option(
        compare,
        "--reference",
        "S",
        "compare ratios to this solver; of two machines always (paper_active_set or daqp)",
    )
    compare.add_argument("--any-machine", action="store_true", help=argparse.SUPPRESS)
    compare.add_argument("--margin", type=float, default=0.05, help="what is no difference (0.05)")
    compare.add_argument("--alpha", type=float, default=0.05, help="family-wise error (0.05)")
    _option(compare, "--markdown", "FILE", "write Markdown; - for the screen")
    _option(compare, "--html", "FILE", "write a page with figures")


def _export(commands: Commands) -> None:
    export = commands.add_parser("export", help="write QPs with certified optima for others")
    export.add_argument(
        "what", nargs="?", help="a scenario, a sequence (by name or .npz) or a folder of problems"
    )
    export.add_argument("--all", action="store_true", help="instead: all stored sequences anew")
    export.add_argument("--format", default="npz", help="npz (default) or qpbenchmark")
    _option(export, "--out", "PATH", "the file to write; of --all a folder (results/sequences)")
    _option(export, "--horizons", "N_p/N_c", "instead of the tuning's")
    _option(export, "--steps", "N", "only the first N steps", type=int)
    _option(export, "--every", "K", "each K-th of them", type=int, default=1)
    _option(export, "--at", "K", "instead: step K alone", type=int)
    export.add_argument(
        "--part", default="controller", help="controller (default), or allocation of a cascade"
    )


def _worst_case(commands: Commands) -> None:
    worst_case = commands.add_parser(
        "worst-case", help="search for a solver's slowest or least accurate step"
    )
    worst_case.add_argument("solver", help="the solver to search")
    worst_case.add_argument("--goal", default="iterations", help="iterations (default) or error")
    _option(worst_case, "--scenario", "N", "whose starts are varied", default="paper")
    worst_case.add_argument("--route", help="native (default where there is one) or qpsolvers")
    worst_case.add_argument("--policy", default="fresh", help="fresh (default), reuse or warm")
    worst_case.add_argument("--settings", default="default", help="default, low, mid or high")
    _option(worst_case, "--budget", "B", "cases to try (300)", type=int, default=300)
    _option(worst_case, "--steps", "N", "length of a case (60)", type=int, default=60)
    worst_case.add_argument("--seed", type=int, default=1, help="of the search (1)")
    _option(worst_case, "--out", "FILE.npz", "default: worst-cases/<solver>-<goal>.npz")
    _option(worst_case, "--solver-module", "FILE.py", "a plug-in that brings the solver")


def _paper(commands: Commands) -> None:
    paper = commands.add_parser(
        "paper",
        help="reproduce the paper: Figures 4-7, the data behind them, its claims",
        epilog="Exit code: 0 done, whatever became of the claims; 1 runs were lost by the "
        "benchmark itself, give the same command again; 2 bad input.",
    )
    _option(paper, "--out", "DIR", "folder (default: results/paper)")


def _list(commands: Commands) -> None:
    listing = commands.add_parser("list", help="what there is")
    listing.add_argument("what", choices=_LISTED, type=_plural)


_LISTED = ("vessels", "scenarios", "suites", "sequences", "solvers")


def _plural(word: str) -> str:
    """`solver` is as good as `solvers`; what is neither stays as it is."""
    return f"{word}s" if f"{word}s" in _LISTED else word


def _check(commands: Commands) -> None:
    check = commands.add_parser(
        "check", help="check a vessel, scenario, suite, sequence or sent result"
    )
    check.add_argument(
        "file",
        help="a name, scenario@vessel, a TOML file, or a .npz or folder of problems, whose every "
        "step is certified anew; or a folder of results/community",
    )


def _doctor(commands: Commands) -> None:
    commands.add_parser("doctor", help="is this machine quiet, is the harness right")


def _completion(commands: Commands) -> None:
    completion = commands.add_parser(
        "completion",
        help="complete names in a shell",
        epilog='bash, zsh: eval "$(dpbench completion bash)"; '
        "fish: dpbench completion fish | source",
    )
    completion.add_argument("shell", choices=("bash", "zsh", "fish"))


def _init(commands: Commands) -> None:
    init = commands.add_parser(
        "init",
        help="write vessel, scenario and suite of your own ship",
        description="Write NAME.toml (the ship), NAME_weather.toml and NAME_suite.toml, with what "
        "was derived how in their comments. With NAME.toml there and --sea N alone: the same ship "
        "in another sea.",
    )
    init.add_argument("name", metavar="NAME", help="of the ship: letters, digits, _ and -")
    _option(init, "--length", "M", "between perpendiculars [m]")
    _option(init, "--breadth", "M", "[m]")
    _option(init, "--draught", "M", "[m]")
    _option(init, "--displacement", "T", "[t]")
    _option(init, "--thrust", "KN", "largest force ahead [kN]")
    _option(init, "--sway-thrust", "KN", "sideways [kN] (a third of --thrust)")
    _option(init, "--yaw-moment", "KNM", "[kN·m] (0.57 sway thrust times length)")
    _option(init, "--like", "V", "library vessel to scale (the nearest)")
    _option(init, "--from-mss", "FILE.mat", "a vessel of the MSS toolbox")
    _option(init, "--from-csv", "FILE", "rows coefficient,value (see docs)")
    _option(init, "--sea", "N", "DP number, 1 to 9 (what the ship can hold)")
    _option(init, "--out", "DIR", "folder to write to (here)", default=".")
    init.add_argument("--force", action="store_true", help="write over files that are there")


def _capability(commands: Commands) -> None:
    capability = commands.add_parser(
        "capability",
        help="the largest wind a ship's thrusters hold (DNV-ST-0111 level 1)",
        description="For 36 directions, intact and after the loss of each failure group; with "
        "--solver, which solvers tell the loads at that edge apart.",
    )
    capability.add_argument("vessel", help="a vessel with thrusters by name, or a TOML file")
    _option(capability, "--sides", "N", "polygons with N sides in place of circles", type=int)
    capability.add_argument(
        "--solver",
        action="append",
        metavar="S",
        help="judge the answers of this solver to the QPs at the edge; repeatable; all: of every "
        "one that is installed",
    )
    _option(capability, "--out", "DIR", "where these QPs go (results/capability-<vessel>)")
    _option(capability, "--figure", "FILE", "write the rose: .svg, .html, .png or .pdf")
    capability.add_argument("--json", action="store_true", help="say it as JSON")
