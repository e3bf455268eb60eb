"""The command line: commands by group, their help with examples, completion in a shell."""

import argparse
import re
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from typing import Any, NoReturn

from dpbench.cli import options
from dpbench.errors import format_allowed_names

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
_BAD_INPUT = "2 bad input"
_LOST = "1 a run was lost through a fault of dpbench or the machine (repeat the command)"
_NOT_HELD = "with --strict, a ship does not stay on station although its QPs are solved exactly"
_BUSY = (
    f"{_BAD_INPUT}, or another dpbench command was using the machine: at the start (with "
    "--no-wait) or still when the --wait time ended"
)


@dataclass(frozen=True)
class CommandHelp:
    """Help of a command: its group, a summary, its options, two examples, exit codes, a text.

    An example is the command's arguments, or a whole shell command that contains `dpbench `.
    """

    group: str
    summary: str
    add_options: Callable[[options.Command], None]
    examples: tuple[str, ...]
    exit_codes: str = f"0 done; {_BAD_INPUT}"
    text: str = ""

    @property
    def epilog(self) -> str:
        """Examples and exit codes of the command."""
        lines = [
            f"  {example}" if "dpbench " in example else f"  dpbench {example}"
            for example in self.examples
        ]
        codes = [f"  {code.strip()}" for code in self.exit_codes.split(";")]
        return "\n".join(["examples:", *lines, "", "exit codes:", *codes])


_PARSER_ERRORS = {
    r"argument (.+): invalid int value: (.+)": r"\1: found \2; allowed: a whole number",
    r"argument (.+): invalid float value: (.+)": r"\1: found \2; allowed: a number",
    r"argument (.+): expected one argument": r"\1: found no value; allowed: one value",
    r"argument (.+): expected (\d+) arguments": r"\1: wrong number of values; required: \2 values",
    r"argument (.+): not allowed with argument (.+)": r"\1: found with \2; allowed: one of the two",
    r"argument (.+): ignored explicit argument (.+)": r"\1: found \2; allowed: no value",
    r"the following arguments are required: (.+)": r"\1: missing",
    r"unrecognized arguments: (.+)": r"unknown argument: \1",
}
"""Messages of argparse as patterns, with those that are printed in their place."""


class _TerseParser(argparse.ArgumentParser):
    """An argument parser that prints an error on one line, in the form of an `InputError`."""

    def error(self, message: str) -> NoReturn:
        """Print an error in the command line on one line; exit with code 2."""
        for pattern, text in _PARSER_ERRORS.items():
            message = re.sub(f"^{pattern}$", text, message)
        print(f"dpbench: {message} (see {self.prog} --help)", file=sys.stderr)
        raise SystemExit(2)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse a value that is not among an argument's choices, of which it names the nearest."""
        if action.choices is not None and value not in action.choices:
            allowed = format_allowed_names(str(value), [str(name) for name in action.choices])
            self.error(f"{action.metavar}: found {str(value)!r}; allowed: {allowed}")


class _HelpFormatter(argparse.HelpFormatter):
    """A formatter of help that wraps descriptions and keeps the lines of examples."""

    def _split_lines(self, text: str, width: int) -> list[str]:
        """Return the lines of an option's help, without a break in the name of an option."""
        return textwrap.wrap(" ".join(text.split()), width, break_on_hyphens=False)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        """Return a text wrapped; of a text with lines of its own, those of exit codes alone."""
        lines = [
            super(_HelpFormatter, self)._fill_text(
                line, width, line[: len(line) - len(line.lstrip())]
            )
            if line[2:3].isdigit() or line[:1].strip()
            else line
            for line in text.splitlines()
        ]
        return "\n".join(lines) if len(lines) > 1 else super()._fill_text(text, width, indent)


def make_parser(calls: Mapping[str, Callable[..., int | None]]) -> argparse.ArgumentParser:
    """Return the command line's parser; `calls` maps commands to the functions that run them."""
    whole = _TerseParser(
        prog="dpbench",
        usage="dpbench COMMAND [OPTIONS]",
        description="Benchmark QP solvers in the MPC of a dynamically positioned ship.",
        epilog=_list_commands(),
        formatter_class=_HelpFormatter,
    )
    whole.add_argument("--version", action="version", version=f"dpbench {version('dpbench')}")
    commands = whole.add_subparsers(
        dest="command",
        metavar="COMMAND",
        parser_class=_TerseParser,
        prog="dpbench",
        help=argparse.SUPPRESS,
    )
    for name, command in COMMANDS.items():
        parser = commands.add_parser(
            name,
            help=command.summary,
            description=command.text or f"{command.summary}.",
            epilog=command.epilog,
            formatter_class=_HelpFormatter,
        )
        command.add_options(parser)
        parser.set_defaults(call=calls[name])
    return whole


def parse_words(whole: argparse.ArgumentParser, words: Sequence[str]) -> argparse.Namespace:
    """Parse a command line; exit with code 2 on a mistake, naming the help of its command."""
    arguments, unknown = whole.parse_known_args(words)
    if unknown:
        whole.prog = f"{whole.prog} {arguments.command or ''}".strip()
        whole.error(f"unrecognized arguments: {' '.join(unknown)}")
    if arguments.command is None:
        whole.error("the following arguments are required: COMMAND")
    return arguments


def _list_commands() -> str:
    """Return the commands by group with their summaries, and two examples, as lines."""
    lines = []
    for group in dict.fromkeys(command.group for command in COMMANDS.values()):
        lines.append(f"{group}:")
        lines += [
            f"  {name:<16} {command.summary[0].lower()}{command.summary[1:]}"
            for name, command in COMMANDS.items()
            if command.group == group
        ]
        lines.append("")
    examples = ("  dpbench run smoke --open", "  dpbench run standard --solver daqp --solver osqp")
    return "\n".join(
        [*lines, "examples:", *examples, "", "help for a command:", "  dpbench COMMAND --help"]
    )


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


def _add_list_options(listing: options.Command) -> None:
    """Add the arguments of `dpbench list` to its parser."""
    listing.add_argument(
        "what",
        metavar="KIND",
        choices=_LISTED,
        type=lambda word: f"{word}s" if f"{word}s" in _LISTED else word,
        help=f"what to list: {', '.join(_LISTED[:-1])} or {_LISTED[-1]}",
    )
    listing.add_argument(
        "name",
        metavar="NAME",
        nargs="?",
        default="",
        help="with KIND solvers: show this solver and its options",
    )


_BENCHMARK, _ANALYSE = "benchmark", "analysis"
_SHIP, _DEPLOY, _HELP = "your ship", "ship's computer", "information"
COMMANDS: dict[str, CommandHelp] = {
    "run": CommandHelp(
        _BENCHMARK,
        "Run a suite and write its report",
        options.add_run_options,
        ("run smoke --open", "run standard --solver daqp --solver 'osqp[rho=[0.1,1]]'"),
        f"0 done, even if solvers failed; {_LOST} or, {_NOT_HELD}; {_BUSY}",
    ),
    "cells": CommandHelp(
        _BENCHMARK,
        "Run one shard of a suite, for a batch scheduler",
        options.add_cells_options,
        ("cells standard --shard 1/8 --out shard-1", "gather shard-* --out results/all"),
        f"0 done, even if solvers failed; {_LOST}; {_BUSY}",
        "Run one of N shards (parts) of a suite; several machines can run different shards at the "
        "same time. To continue after an interruption, run the same command again.",
    ),
    "gather": CommandHelp(
        _BENCHMARK,
        "Join the shards of a suite and write the report",
        options.add_gather_options,
        ("gather shard-* --out results/all", "gather a b --out results/all --open"),
        "0 done; 1 runs of the suite are missing (complete them on this machine with `dpbench run` "
        f"and the --out of this command) or, {_NOT_HELD}; {_BAD_INPUT}",
    ),
    "report": CommandHelp(
        _BENCHMARK,
        "Rewrite the report of a result folder",
        options.add_report_options,
        (
            "report results/standard --open",
            "report results/standard --statement statement.pdf",
        ),
        f"0 done; 1 {_NOT_HELD}; {_BAD_INPUT}",
    ),
    "compare": CommandHelp(
        _BENCHMARK,
        "Compare result folders, solver settings or solver releases",
        options.add_compare_options,
        (
            "compare results/before results/after --html compare.html",
            "compare results/mine --solver 'osqp[rho=1.6]' --solver daqp",
        ),
        f"0 no significant regression; 1 a significant regression; {_BAD_INPUT}; "
        "CODE (--disturbed-exit) a step time could not be judged, and nothing regressed",
    ),
    "paper": CommandHelp(
        _BENCHMARK,
        "Reproduce Figures 4-7 and claims of the paper by Xia et al.",
        options.add_paper_options,
        ("paper", "paper --out results/figures"),
        f"0 done, even if claims are not reproduced; {_LOST}; {_BAD_INPUT}",
        'Reproduce Figures 4-7 and the claims of the paper "Constrained Model Predictive Control '
        'Design for Dynamic Positioning of a Supply Ship" (Xia et al.).',
    ),
    "export": CommandHelp(
        _ANALYSE,
        "Write QPs with certified optima",
        options.add_export_options,
        ("export rough --steps 100 --out rough.npz", "export turn --at 190 --out step.npz"),
    ),
    "worst-case": CommandHelp(
        _ANALYSE,
        "Search for a solver's worst case in iterations or error",
        options.add_worst_case_options,
        ("worst-case osqp --budget 100", "worst-case daqp --goal error --policy warm"),
        f"0 done; {_BAD_INPUT}; 130 interrupted (the worst case so far is written)",
    ),
    "iteration-bound": CommandHelp(
        _ANALYSE,
        "Prove an iteration bound for the solver paper_active_set",
        options.add_iteration_bound_options,
        ("iteration-bound surge", "iteration-bound sway-yaw --box 0.016"),
        "0 proved; 1 not proved within --limit, or the C code of paper_active_set takes a "
        f"different number of iterations on a tested QP than in the proof; {_BAD_INPUT}",
        "Prove a bound on the iterations that the solver paper_active_set takes from a cold start "
        "on the QPs of a controller. The bound covers every QP whose parameters (offset, speed, "
        "previous force and change of speed) lie in a box. With --box 1, the box contains "
        "offsets up to 50 m and 30°, speeds up to 1 m/s and 1°/s, and all forces within the "
        "limits. The command prints the whole box.",
    ),
    "active-sets": CommandHelp(
        _ANALYSE,
        "Count the distinct active sets at the optima of QP sequences",
        options.add_active_sets_options,
        ("active-sets paper", "active-sets rough-30-5 --instructions"),
    ),
    "tune-solver": CommandHelp(
        _ANALYSE,
        "Search for a solver's fastest accurate settings",
        options.add_tune_solver_options,
        ("tune-solver osqp", "tune-solver 'osqp[rho=1.6]' --range 'rho=[0.1,10]'"),
        "0 done: with the best settings, the solver is accurate and within the p99 limit and the "
        "deadline on every training and test sequence; 1 no settings are accurate on every "
        "training sequence, or the best settings do not meet these requirements in the final "
        f"measurement; {_BUSY}; 130 interrupted "
        "(the best settings so far are written)",
        "Search for the fastest settings with which a solver is accurate on all training "
        "sequences. Then measure the best settings on the training sequences and on test "
        "sequences (by default, of other scenarios). Faster settings may exist. Ctrl-C writes the "
        "best settings so far; the same command continues the search.",
    ),
    "init": CommandHelp(
        _SHIP,
        "Write vessel, scenario and suite files for your own ship",
        options.add_init_options,
        (
            "init my_ship --length 80 --breadth 18 --draught 6 \\\n"
            "      --displacement 6000 --thrust 300",
            "init my_ship --sea 4",
        ),
        text="Write NAME.toml (vessel), NAME_weather.toml (scenario) and NAME_suite.toml (suite). "
        "Comments in them explain how the main values were derived. With --thrusters, also "
        "write a capability plot and scenarios in which the controller commands each thruster. "
        "In most of these scenarios, the ship loses a failure group (thrusters that fail "
        "together). The further files are:\n"
        "  NAME_thrusters.toml   loss of the worst failure group that the ship can lose\n"
        "                        and still hold station\n"
        "  NAME_loss_*.toml      losses of other failure groups, in the same sea\n"
        "  NAME_intact.toml      no loss, in the largest sea in which the ship holds\n"
        "                        station (written only if --sea is not given and this\n"
        "                        sea is larger than that of NAME_thrusters.toml)\n"
        "  NAME_weak_side.toml   same loss as in NAME_thrusters.toml; weather from the\n"
        "                        direction in which the ship withstands the least wind\n"
        "  NAME_capability.svg   capability plot\n"
        "In the other scenarios, the weather comes from 30° off the bow; with --thrusters, "
        "this is 30° to port or to starboard, whichever is the side on which the ship withstands "
        "less wind.\n"
        "In the --thrusters file, give the allowed sector or the barred zone of an azimuth "
        "thruster in degrees clockwise from ahead. The angles are the directions in which the "
        "thruster pushes the ship; its race (wash) goes the opposite way. For example, if the race "
        "of a port azimuth thruster must not point between 60° and 120°, towards the starboard "
        "one, set the columns barred_from_deg and barred_to_deg to 240 and 300.\n"
        "If NAME.toml exists and only --sea is given, write the scenario and the suite of that "
        "ship for that sea.",
    ),
    "check": CommandHelp(
        _SHIP,
        "Check a vessel, scenario, suite, sequence or submitted result",
        options.add_check_options,
        ("check my_ship.toml", "check paper@osv --quick"),
        "0 valid, even if a CAUTION is printed; 2 not valid, or not found",
    ),
    "tune": CommandHelp(
        _SHIP,
        "Search for controller weights and horizons for a ship",
        options.add_tune_options,
        ("tune my_ship_weather.toml --seas 4,5", "tune my_ship_weak_side.toml my_ship_intact.toml"),
        "0 with the best controller, the ship stays on station within --margin; 1 with the best "
        "controller, the largest offset exceeds --margin in the search or in the test; "
        f"{_BAD_INPUT}",
        "Search for controller weights and horizons with which the ship stays on station with a "
        "margin and with little thruster wear. Test them in other realisations of the sea and "
        "write a scenario with them. The largest offset in any of the scenarios is compared with "
        "--margin. To continue after an interruption, run the same command again.",
    ),
    "capability": CommandHelp(
        _SHIP,
        "Compute the highest wind speed at which a ship holds station",
        options.add_capability_options,
        ("capability osv --figure osv.svg", "capability my_ship.toml --solver daqp"),
        text="For each of 36 wind directions, compute the highest wind speed at which the ship "
        "holds station (DNV-ST-0111, level 1), intact and after the loss of each failure group "
        "(thrusters that fail together). With --solver, also check solvers' solutions of thrust "
        "allocation QPs near this wind speed.",
    ),
    "embedded": CommandHelp(
        _DEPLOY,
        "Count instructions and measure memory of solvers' C code",
        options.add_embedded_options,
        ("embedded paper-30-5 --target m7 --target a53", "embedded rough-60-10 --solver daqp"),
        "0 done; 1 a solver's instructions could not be counted, its largest horizon (--fit) is "
        "unknown or, with --second-opinion, two tools give different solutions or counts; "
        f"{_BAD_INPUT}, or no solver's instructions could be counted",
        "Compile the C code of solvers and run it on an emulated core over a sequence of QPs. "
        "Report the instructions, memory and error of each step. Requires "
        "pip install 'dpbench[embedded]'.",
    ),
    "codegen": CommandHelp(
        _DEPLOY,
        "Write a scenario's controller as C code",
        options.add_codegen_options,
        ("codegen paper --out controller", "codegen rough --solver daqp --out c --fmu rough.fmu"),
        text="Write the complete control step of a scenario as C99: measurement, QP, solver, "
        "limits and fallback, with an example that replays a recorded trajectory.",
    ),
    "list": CommandHelp(
        _HELP,
        "List vessels, scenarios, suites, sequences or solvers",
        _add_list_options,
        ("list solvers osqp", "list suites"),
    ),
    "doctor": CommandHelp(
        _HELP,
        "Check that the machine is quiet and timing is correct",
        options.add_doctor_options,
        ("doctor", "doctor --offline"),
        f"0 done, even if the machine is not quiet or timing is not correct; {_BAD_INPUT}",
    ),
    "completion": CommandHelp(
        _HELP,
        "Print a shell completion script",
        options.add_completion_options,
        (
            'eval "$(dpbench completion bash)"  # in ~/.bashrc',
            "dpbench completion fish | source  # in ~/.config/fish/config.fish",
        ),
    ),
}
"""Help of each command by name, in the order of `dpbench --help`."""
