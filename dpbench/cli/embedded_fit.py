"""`dpbench embedded --fit`: the largest control horizon whose program fits in a memory."""

import json
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from dpbench.bench.sequences.recording import record_scenario
from dpbench.bench.sequences.sequence_file import Recorded
from dpbench.cli.terminal import make_console, make_report_table, print_wrapped
from dpbench.embedded.count import count_instructions_along_sequence
from dpbench.embedded.fit import (
    KILOBYTE,
    Fit,
    Trial,
    find_largest_fitting_horizon,
    summarise_fit_as_dict,
)
from dpbench.embedded.recipe import Recipe, Setting
from dpbench.embedded.step_counts import StepCounts
from dpbench.embedded.table import save_counted_steps_in_folder
from dpbench.embedded.toolchain import TARGETS, Target, compiler_version
from dpbench.errors import DpbenchError, InputError
from dpbench.report.formats import MISSING, format_count, format_error
from dpbench.report.table import Table
from dpbench.scenario.scenario import Scenario, load_scenario

STEPS = 5
"""Steps of each trial, unless told otherwise."""
NOTE = (
    "kB: 1024 bytes, of code, constants, static data, heap and the deepest stack of a step. Next: "
    "of N_c + 1, which does not fit."
)


class _Trials:
    """Programs of a scenario at several horizons, each compiled and run once."""

    def __init__(self, scenario: Scenario, steps: int, *, single: bool) -> None:
        self._record = cache(lambda N_c: record_horizon(scenario, N_c, steps or STEPS))
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

        return [find_largest_fitting_horizon(try_horizon, size) for size in kilobytes]


def record_horizon(scenario: Scenario, N_c: int, steps: int) -> Recorded:
    """Record a scenario's first QPs at a control horizon; N_p grows in proportion."""
    own = scenario.problem
    N_p = -(-N_c * own.N_p // own.N_c)
    return record_scenario(scenario, horizons=(N_p, N_c), steps=steps)


def print_fits(
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
        for table in _make_tables(fits, single=single):
            screen.print(make_report_table(table, screen))
            screen.print()
        print_wrapped([f"Compiled by ziglang {compiler_version()} with -O2. Steps: {path}"])
    return int(bool(reasons))


def _make_tables(fits: list[dict[str, Any]], *, single: bool) -> Iterator[Table]:
    """Yield a table of the largest control horizons for each scenario and target."""
    for scenario, target in dict.fromkeys((row["scenario"], row["target"]) for row in fits):
        rows = [
            {
                "solver": row["solver"],
                "limit kB": str(row["kilobytes"]),
                "N_c": _number(row["control_horizon"]),
                "n": _number(row["variables"]),
                "kB": _kilobytes(row["memory_bytes"]),
                "next kB": _kilobytes(row["next_memory_bytes"]),
                "worst": _number(row["instructions_max"]),
                "error": MISSING if row["error_move"] is None else format_error(row["error_move"]),
            }
            for row in fits
            if (row["scenario"], row["target"]) == (scenario, target)
        ]
        kind = "float" if single else "double"
        title = f"{scenario} on {TARGETS[target].title}, {kind}: largest control horizon"
        yield Table.from_rows(rows, title, note=NOTE)


def _number(value: int | None) -> str:
    """Format a count; a dash for None, which is unknown."""
    return MISSING if value is None else format_count(value)


def _kilobytes(size: int | None) -> str:
    """Format a size [B] in kB; a dash for None, which is unknown."""
    return MISSING if size is None else f"{size / KILOBYTE:.1f}"


def read_kilobytes(texts: list[str]) -> list[int]:
    """Parse sizes of memory in kB; InputError for one that is no whole number above 0."""
    for text in texts:
        if not text.isdecimal() or not int(text):
            raise InputError("--fit", "", repr(text), "kB of memory, as 128")
    return [int(text) for text in texts]
