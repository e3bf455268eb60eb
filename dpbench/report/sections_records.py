"""The sections on what was run, on accuracy and on units."""

from __future__ import annotations

from typing import Any

from dpbench.analysis.demand import Demand
from dpbench.analysis.records import Records
from dpbench.analysis.run_record import as_float
from dpbench.bench.workers.interleaved import FEWEST_ROUNDS
from dpbench.report.blocks import Block, Bullets, Paragraph, Picture, Section, Tabular, missing
from dpbench.report.figures import units_heat_map
from dpbench.report.formats import and_list, count_text, plural, significant
from dpbench.report.tables_accuracy import accuracy_table, units_matrix, units_table
from dpbench.report.tables_runs import experiments_table, population_table, unfinished_table


def runs_section(view: Records) -> Section:
    """What was run, on what machine, and what did not finish."""
    section = Section("runs", "What was run")
    if not view.all_runs:
        section.add(missing("the results hold no cell."))
        return section
    ended = sum(row.outcome == "finished" for row in view.all_runs)
    section.add(
        Paragraph(
            f"{plural(len(view.all_runs), 'cell')} with {plural(len(view.solvers), 'solver')} in "
            f"{and_list(_problems(view))}; {count_text(ended)} finished. {_effort(view)}"
        ),
        Bullets(tuple(machine_lines(view.machine))),
        Tabular(population_table(view)),
        Tabular(experiments_table(view)),
    )
    unfinished = unfinished_table(view)
    if unfinished is None:
        section.add(Paragraph("Every cell finished."))
    else:
        section.add(Tabular(unfinished))
    return section


def _problems(view: Records) -> list[str]:
    """What was run: scenarios by name, random sequences by number."""
    drawn = {row.sequence for row in view.random}
    slowed = [row.scenario for row in view.delayed]
    names = [f"`{scenario}`" for scenario in dict.fromkeys([*view.scenarios, *slowed])]
    return [*names, plural(len(drawn), "random sequence")] if drawn else names


def _effort(view: Records) -> str:
    suite = view.suite
    words = []
    replayed = any(row.mode == "replay" for row in view.all_runs)
    if "rounds" in suite and replayed:
        rounds = f"each replay has {plural(as_float(suite['rounds']), 'round')}"
        budget_s = as_float(suite.get("replay_budget_s"))
        if budget_s > 0.0:
            fewest = f"{FEWEST_ROUNDS} if those take {significant(budget_s)} s or more"
            rounds += f", but only {fewest}"
        words.append(rounds)
    if suite.get("warmup_steps") and replayed:
        words.append(f"a warm-up of {plural(as_float(suite['warmup_steps']), 'step')}")
    if "cell_limit_s" in suite:
        own = {table.get("limit_s") for table in suite.get("closed_loop", [])} - {None}
        others = ", ".join(f"{significant(as_float(limit))} s" for limit in sorted(own))
        words.append(
            f"a cell stops after {significant(as_float(suite['cell_limit_s']))} s"
            + (f" ({others} where a table of closed loops says so)" if own else "")
        )
    if replayed:
        disturbed = [row.disturbed_rounds for row in view.select(mode="replay")]
        count = sum(value for value in disturbed if value > 0)
        words.append(f"{plural(count, 'round')} marked as disturbed by a slow machine")
        kept = [row for row in view.select(mode="replay") if row.counting_disturbed > 0]
        if kept:
            words.append(
                f"in {plural(len(kept), 'replay')} every round was, so all of them count but the "
                "warm-up"
            )
    if view.calibration:
        words.append(f"{plural(len(view.calibration), 'cell')} more measure the harness itself")
    text = "; ".join(words)
    return f"{text[0].upper()}{text[1:]}." if text else ""


def machine_lines(machine: dict[str, Any]) -> list[str]:
    """The machine in sentences, with the verdict on what it hides."""

    def of(key: str) -> str:
        return str(machine.get(key, "not recorded"))

    lines = [
        f"Processor {of('cpu_model')}, {of('cores')} cores, {of('memory_GiB')} GiB memory; "
        f"{of('kernel')}, {of('python')}; every numerical library is asked for one thread "
        f"(BLAS: {', '.join(machine.get('blas') or ['none seen'])}).",
        f"Reading the clock costs {of('clock_read_ns')} ns; its resolution is "
        f"{of('timer_resolution_ns')} ns.",
    ]
    lines += _load_line(machine)
    if machine.get("governor", "not visible") == "not visible":
        lines.append(
            "The frequency governor is not visible (as in most virtual machines), so frequency "
            "changes cannot be ruled out; the minimum over rounds and the reference kernel "
            "between rounds guard against them."
        )
    else:
        lines.append(f"Frequency governor: {of('governor')}.")
    versions = machine.get("versions", {})
    if versions:
        lines.append(
            "Versions: " + ", ".join(f"{k} {v}" for k, v in sorted(versions.items())) + "."
        )
    return lines


def _load_line(machine: dict[str, Any]) -> list[str]:
    """How busy the machine was at the start, with a warning when others took much of it."""
    loads = [as_float(load) for load in machine.get("load_average") or []]
    if not loads:
        return []
    text = f"Load average at the start {', '.join(f'{load:.2f}' for load in loads)}."
    if loads[0] > as_float(machine.get("cores")) / 2.0:
        text += (
            " **Warning**: more than half of the cores were busy with other work when the run "
            "began, so its times may be too long."
        )
    return [text]


def accuracy_section(view: Records, demand: Demand) -> Section:
    """How right the answers are in the full-length closed loops."""
    section = Section("accuracy", "Accuracy")
    section.add(
        Paragraph(
            "*Claimed* is what the solver says, *true* what the referee finds: feasible and "
            "stationary to 1e-3 and the whole plan within 1e-2 of a rate-limit step of the "
            "certified optimum. The two are counted apart."
        )
    )
    tables = [accuracy_table(view, name, demand) for name in view.scenarios]
    found: list[Block] = [Tabular(table) for table in tables if table is not None]
    section.add(*(found or [missing("no full-length closed loop left a step.")]))
    return section


def units_section(view: Records) -> Section:
    """What raw SI units do to each solver."""
    section = Section("units", "Units and settings")
    matrix = units_matrix(view)
    if matrix is None:
        section.add(missing("no closed loop was run in SI units."))
        return section
    raw = [c for c in matrix.columns if c[1:] == ("si", "default")]
    right = [
        solver
        for solver in matrix.solvers
        if raw
        and all(
            (cell := matrix.cells.get((solver, c))) is not None and cell.true_share == 1.0
            for c in raw
        )
    ]
    section.add(
        Paragraph(
            f"In raw SI units (N, N·m) with default settings "
            f"{plural(len(right), 'solver')} of {len(matrix.solvers)} still "
            f"{'gives' if len(right) == 1 else 'give'} a true answer on every step"
            f"{': ' + and_list(sorted(right)) if right else ''}. The same problem scaled by the "
            "limits is the default everywhere else in this report."
        ),
        Picture(
            "units",
            "Largest error of the first move by units and settings",
            "First number: largest error_move of the steps reached; second: share of steps with "
            "a true answer. Errors below 1e-12 and above 10 share the end colours. Hatched: "
            "stopped early; the second number is then the steps it reached.",
            units_heat_map(matrix),
        ),
        Tabular(units_table(matrix)),
    )
    return section
