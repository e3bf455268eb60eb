"""`dpbench embedded`: count what solvers' C executes on an emulated core, and show it.

With `--fit` it is the largest control horizon whose program fits in a memory.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

from dpbench.bench.sequences.sequence_file import Recorded
from dpbench.bench.sequences.source import load_named_sequence, record_scenario, thin_sequence
from dpbench.cli.terminal import make_console, make_report_table, print_wrapped
from dpbench.embedded.count import (
    compare_counts_with_second_tool,
    count_instructions_along_sequence,
)
from dpbench.embedded.fit import (
    KILOBYTE,
    Fit,
    Trial,
    find_largest_horizon_for_memory,
    summarise_fit_as_dict,
)
from dpbench.embedded.recipe import Recipe, Setting, select_recipes
from dpbench.embedded.table import (
    SIZES,
    StepCounts,
    save_counted_steps_in_folder,
    summarise_counted_runs,
    tabulate_counted_steps,
)
from dpbench.embedded.toolchain import (
    TARGETS,
    Target,
    compiler_version,
    find_target_by_name,
    require_extra,
)
from dpbench.errors import DpbenchError, InputError, format_allowed_names
from dpbench.report.formats import MISSING, Table, format_count, format_error
from dpbench.scenario.scenario import Scenario, load_scenario
from dpbench.solvers.own_settings import format_options_as_toml

REMARK = (
    "Instruction counts compare solvers built with one compiler and the same flags. They are not "
    "times: they ignore caches, pipeline and bus. The worst step is that of this sequence."
)

COMPARED_STEPS = 3
"""Steps that a second opinion is asked on, unless told otherwise: it is a hundred times slower."""
STEPS = 5
"""Steps of each trial, unless told otherwise."""
NOTE = (
    "kB: 1024 bytes of code, constants, static data, heap and the deepest stack of a step. Next: "
    "the memory at N_c + 1, which does not fit."
)


def count_and_print(arguments: argparse.Namespace) -> int:
    """Print counts as options ask; return 1 if a solver could not be counted, or tools differ."""
    require_extra()
    targets = [find_target_by_name(name) for name in arguments.target or ["m7"]]
    sources = _read_sources(arguments.source)
    recipes = select_recipes(arguments.solver, map(Path, arguments.recipe), sources)
    settings = _read_settings(arguments.settings, recipes)
    if arguments.fit:
        return print_largest_horizons(
            arguments.sequences,
            targets,
            recipes,
            settings,
            kilobytes=parse_kilobytes(arguments.fit),
            steps=arguments.steps,
            single=arguments.single,
            out=Path(arguments.out),
            as_json=arguments.json,
        )
    if arguments.second_opinion:
        steps = arguments.steps or COMPARED_STEPS
        sequences = [_read_sequence(name, steps) for name in arguments.sequences or ["paper-30-5"]]
        return _print_counts_of_two_tools(
            sequences, targets, recipes, settings, single=arguments.single
        )
    return _count_and_print_all_steps(arguments, targets, recipes, settings)


def _count_and_print_all_steps(
    arguments: argparse.Namespace,
    targets: list[Target],
    recipes: list[Recipe],
    settings: dict[str, dict[str, Setting]],
) -> int:
    """Count all steps, print tables or JSON, write the steps; return 1 if a solver was refused."""
    counts: list[StepCounts] = []
    refused: list[DpbenchError] = []
    for name in arguments.sequences or ["paper-30-5"]:
        recorded = _read_sequence(name, arguments.steps)
        for recipe, target in ((r, t) for t in targets for r in recipes):
            single, own = arguments.single, settings.get(recipe.solver, {})
            try:
                counts.append(_count_recipe(recipe, recorded, target, single=single, settings=own))
            except DpbenchError as error:
                refused.append(error)
    for text in dict.fromkeys(map(str, refused)):
        print(f"dpbench: {text}", file=sys.stderr)
    if not counts:
        return 2
    path = save_counted_steps_in_folder(counts, Path(arguments.out))
    if arguments.json:
        print(
            json.dumps(
                {
                    "steps": str(path),
                    "runs": summarise_counted_runs(tabulate_counted_steps(counts)),
                },
                indent=2,
            )
        )
    else:
        _print_tables(counts, path, _describe_settings(recipes, settings))
    return int(bool(refused))


def _print_counts_of_two_tools(
    sequences: list[Recorded],
    targets: list[Target],
    recipes: list[Recipe],
    settings: dict[str, dict[str, Setting]],
    *,
    single: bool,
) -> int:
    """Print counts of the first steps by Unicorn and by another tool; return 1 if they differ."""
    agrees, screen = True, make_console()
    for recorded in sequences:
        rows = []
        for target, recipe in product(targets, recipes):
            own = settings.get(recipe.solver, {})
            opinion = compare_counts_with_second_tool(
                recipe, recorded.sequence, target, single=single, settings=own
            )
            agrees &= opinion.has_equal_answers_and_counts
            rows.append(
                {
                    "solver": recipe.solver,
                    "target": target.name,
                    "Unicorn": format_count(opinion.instructions.sum()),
                    "other": format_count(opinion.others.sum()),
                    "tool": opinion.tool,
                    "bytes differ": str(opinion.differing_bytes),
                }
            )
        title = f"{recorded.sequence.name}: instructions of all steps by Unicorn and another tool"
        note = "Bytes differ: bytes of all answers and statuses that differ; expected: 0."
        screen.print(make_report_table(Table.from_rows(rows, title, note=note), screen))
    return int(not agrees)


def _count_recipe(recipe: Recipe, recorded: Recorded, target: Target, **options: Any) -> StepCounts:
    """Return step by step counts of the instructions of a solver's C on a recorded sequence."""
    return count_instructions_along_sequence(
        recipe, recorded.sequence, target, optima=recorded.optima, **options
    )


def _read_sequence(name: str, steps: int) -> Recorded:
    """Return a sequence by name or file, its first `steps` QPs with certified optima."""
    recorded = load_named_sequence(name)
    if not steps or steps >= len(recorded.sequence):
        return recorded
    optima = None if recorded.optima is None else recorded.optima[:steps]
    return Recorded(thin_sequence(recorded.sequence, steps), optima)


def _read_sources(texts: list[str]) -> dict[str, Path]:
    """Return folders by solver of SOLVER=DIR texts; InputError where DIR is no folder."""
    sources: dict[str, Path] = {}
    for text in texts:
        solver, _, folder = text.partition("=")
        if not folder or not Path(folder).is_dir():
            raise InputError("--source", "", repr(text), "SOLVER=DIR with an existing folder DIR")
        sources[solver] = Path(folder)
    return sources


def _read_settings(texts: list[str], recipes: list[Recipe]) -> dict[str, dict[str, Setting]]:
    """Return settings by solver of SOLVER.KEY=VALUE texts; InputError for a solver not counted."""
    solvers = [recipe.solver for recipe in recipes]
    settings: dict[str, dict[str, Setting]] = {}
    for text in texts:
        name, _, value = text.partition("=")
        solver, _, key = name.partition(".")
        if solver in solvers and key and not value:
            raise InputError("--settings", "", repr(text), "SOLVER.KEY=N, such as osqp.rho=0.1")
        if solver not in solvers or not key:
            raise InputError(
                "--settings",
                "",
                repr(text),
                f"SOLVER.KEY=N, where SOLVER is {format_allowed_names(solver, solvers)}",
            )
        try:
            number = float(value)
        except ValueError:
            raise InputError("--settings", name, repr(value), "a number") from None
        settings.setdefault(solver, {})[key] = int(number) if number.is_integer() else number
    return settings


def _describe_settings(recipes: list[Recipe], settings: dict[str, dict[str, Setting]]) -> list[str]:
    """Return a line with all settings of the C code of each solver that has settings."""
    used = {r.solver: r.with_settings(settings.get(r.solver, {})) for r in recipes}
    return [
        f"Settings of {name}: {format_options_as_toml(own)}." for name, own in used.items() if own
    ]


def _print_tables(counts: list[StepCounts], path: Path, settings: list[str]) -> None:
    """Print a table of counts and one of sizes for each sequence and target, then settings."""
    screen = make_console()
    for table in _make_tables(summarise_counted_runs(tabulate_counted_steps(counts))):
        screen.print(make_report_table(table, screen))
        screen.print()
    compiler = f"Compiled by ziglang {compiler_version()} with -O2. Steps: {path}"
    print_wrapped([*settings, REMARK, compiler])


def _make_tables(runs: list[dict[str, Any]]) -> Iterator[Table]:
    """Yield a table of counts and one of sizes for each sequence and target."""
    for name, target in dict.fromkeys((run["sequence"], run["target"]) for run in runs):
        group = [run for run in runs if (run["sequence"], run["target"]) == (name, target)]
        kind = "float" if group[0]["single"] else "double"
        title = f"{name} on {TARGETS[target].title}, {kind}: "
        rows = [
            {
                "solver": run["solver"],
                "median": format_count(run["instructions_p50"]),
                "p99": format_count(run["instructions_p99"]),
                "worst": format_count(run["instructions_max"]),
                "k": str(run["worst_step"]),
                "iterations": _format_known_count(run["worst_iterations"]),
                "active": _format_known_count(run["worst_active"]),
            }
            for run in group
        ]
        note = "k, iterations and active rows are those of the worst step."
        yield Table.from_rows(rows, f"{title}instructions per step", note=note)
        sizes = [
            {"solver": run["solver"]}
            | {size: format_count(run[f"{size}_bytes"]) for size in (*SIZES, "stack")}
            | {"error": format_error(run["error_move"])}
            for run in group
        ]
        unit = "input limit" if name.startswith("random_mpc") else "maximum increment"
        note = f"Error: largest error of the first move, as a share of the {unit}."
        yield Table.from_rows(sizes, f"{title}bytes of memory, error", note=note)


def _format_known_count(number: int) -> str:
    """Return a count as text; a dash for a negative one, which is unknown."""
    return format_count(number) if number >= 0 else "–"


class _Trials:
    """Programs of a scenario at several horizons, each compiled and run once."""

    def __init__(self, scenario: Scenario, steps: int, *, single: bool) -> None:
        self._record = cache(lambda N_c: record_qps_at_horizon(scenario, N_c, steps or STEPS))
        self._single = single
        self.counts: list[StepCounts] = []

    def fit(
        self, recipe: Recipe, target: Target, settings: dict[str, Setting], kilobytes: list[int]
    ) -> list[Fit]:
        """Return the largest horizon of a solver on a core for each memory."""

        @cache
        def try_horizon(N_c: int) -> Trial:
            recorded = self._record(N_c)
            try:
                counts = count_instructions_along_sequence(
                    recipe,
                    recorded.sequence,
                    target,
                    single=self._single,
                    settings=settings,
                    optima=recorded.optima,
                )
            except DpbenchError as error:
                return Trial(N_c, None, str(error))
            self.counts.append(counts)
            return Trial(N_c, counts)

        return [find_largest_horizon_for_memory(try_horizon, size) for size in kilobytes]


def record_qps_at_horizon(scenario: Scenario, N_c: int, steps: int) -> Recorded:
    """Return a scenario's first QPs at a control horizon, recorded; N_p grows in proportion."""
    own = scenario.problem
    N_p = -(-N_c * own.N_p // own.N_c)
    return record_scenario(scenario, horizons=(N_p, N_c), steps=steps)


def print_largest_horizons(
    names: list[str],
    targets: list[Target],
    recipes: list[Recipe],
    settings: dict[str, dict[str, Setting]],
    *,
    kilobytes: list[int],
    steps: int,
    single: bool,
    out: Path,
    as_json: bool,
) -> int:
    """Print the largest horizons as tables or JSON, write the steps; return 1 if one is unknown."""
    fits: list[dict[str, Any]] = []
    counts: list[StepCounts] = []
    for name in names or ["paper"]:
        trials = _Trials(load_scenario(name), steps, single=single)
        for target in targets:
            for recipe in recipes:
                own = settings.get(recipe.solver, {})
                key = {"scenario": name, "target": target.name, "solver": recipe.solver}
                found = trials.fit(recipe, target, own, kilobytes)
                fits += [{**key, **summarise_fit_as_dict(fit)} for fit in found]
        counts += trials.counts
    reasons = dict.fromkeys(row["next_reason"] for row in fits if row["next_reason"])
    for reason in reasons:
        print(f"dpbench: {reason}", file=sys.stderr)
    if not counts:
        return 2
    path = save_counted_steps_in_folder(counts, out)
    if as_json:
        print(json.dumps({"steps": str(path), "fits": fits}, indent=2))
    else:
        screen = make_console()
        for table in _make_fit_tables(fits, single=single):
            screen.print(make_report_table(table, screen))
            screen.print()
        compiler = f"Compiled by ziglang {compiler_version()} with -O2. Steps: {path}"
        print_wrapped([*_describe_settings(recipes, settings), compiler])
    return int(bool(reasons))


def _make_fit_tables(fits: list[dict[str, Any]], *, single: bool) -> Iterator[Table]:
    """Yield a table of the largest control horizons for each scenario and target."""
    for scenario, target in dict.fromkeys((row["scenario"], row["target"]) for row in fits):
        rows = [
            {
                "solver": row["solver"],
                "limit kB": str(row["kilobytes"]),
                "N_c": _format_number(row["control_horizon"]),
                "n": _format_number(row["variables"]),
                "kB": _format_kilobytes(row["memory_bytes"]),
                "next kB": _format_kilobytes(row["next_memory_bytes"]),
                "worst": _format_number(row["instructions_max"]),
                "error": MISSING if row["error_move"] is None else format_error(row["error_move"]),
            }
            for row in fits
            if (row["scenario"], row["target"]) == (scenario, target)
        ]
        kind = "float" if single else "double"
        title = f"{scenario} on {TARGETS[target].title}, {kind}: largest control horizon"
        yield Table.from_rows(rows, title, note=NOTE)


def _format_number(value: int | None) -> str:
    """Return a count as text; a dash for None, which is unknown."""
    return MISSING if value is None else format_count(value)


def _format_kilobytes(size: int | None) -> str:
    """Return a size [B] as text in kB; a dash for None, which is unknown."""
    return MISSING if size is None else f"{size / KILOBYTE:.1f}"


def parse_kilobytes(texts: list[str]) -> list[int]:
    """Return sizes of memory in kB from texts; InputError for no whole number above 0."""
    for text in texts:
        if not text.isdecimal() or not int(text):
            raise InputError("--fit", "", repr(text), "a whole number of kB above 0, such as 128")
    return [int(text) for text in texts]
