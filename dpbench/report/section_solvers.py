"""The section on what each solver can do: the records that the conformance tests are made from."""

from __future__ import annotations

import re
from collections.abc import Sequence

from dpbench.analysis.records import Records
from dpbench.errors import UnknownNameError
from dpbench.report.blocks import Block, Paragraph, Section, Tabular, missing
from dpbench.report.formats import MISSING, and_list, plural
from dpbench.report.table import Cell, Table, row_of
from dpbench.solvers.contract import Route
from dpbench.solvers.record import POLICIES, Fact, SolverRecord
from dpbench.solvers.table import record


def solvers_section(view: Records) -> Section:
    """What each solver can do on each route, and what its own documentation says."""
    section = Section("solvers", "What each solver can do")
    known, unknown = _records(view)
    if not known:
        section.add(missing("no solver of these records is in the table of solvers."))
        return section
    section.add(
        Paragraph(
            "A workspace can do what its library can. The first table is the one that the "
            "conformance tests are made from; the second holds what a controller's author asks "
            "next, as each project's own documentation answers it."
        )
    )
    if unknown:
        section.add(Paragraph(f"Not in the table of this installation: {and_list(unknown)}."))
    sources: list[str] = []
    project = _project_table(known, sources)
    found: list[Table | None] = [
        _abilities_table(known),
        _faults_table(known),
        project,
        _sources_table(sources),
    ]
    blocks: list[Block] = [Tabular(table) for table in found if table is not None]
    section.add(*blocks)
    return section


def _records(view: Records) -> tuple[list[SolverRecord], list[str]]:
    """Records of the ranked solvers, and the names that have none here."""
    known, unknown = [], []
    for solver in sorted(view.solvers):
        try:
            known.append(record(solver))
        except UnknownNameError:
            unknown.append(solver)
    return known, unknown


def _abilities_table(known: Sequence[SolverRecord]) -> Table:
    rows = [_ability_row(solver, route) for solver in known for route in solver.policies]
    return Table(
        title="What each solver can do",
        note=(
            f"{plural(len(known), 'solver')}, {plural(len(rows), 'route')}; the default route of a "
            "solver first. Updates: what the library takes over without a new set-up. Start: what "
            "a warm start is made of. Keeps: what a kept workspace carries from step to step "
            "beside factors, memory and a start, so that its answers differ from those of fresh "
            "within the tolerance. Two-sided: l ≤ Az ≤ u reaches the library as such. Says "
            "infeasible: an infeasible problem is reported so, and not only as no answer."
        ),
        heads=(
            "solver",
            "method",
            "route",
            "policies",
            "matrices",
            "updates",
            "start",
            "keeps",
            "two-sided",
            "multipliers",
            "says infeasible",
            "needs P > 0",
            "policies it has not",
        ),
        rows=tuple(rows),
        text_columns=13,
    )


def _ability_row(solver: SolverRecord, route: Route) -> tuple[Cell, ...]:
    can = solver.on(route)
    refused = {p: why for p in POLICIES if (why := solver.refusal(route, p))}
    return row_of(
        solver.name,
        solver.method,
        route,
        ", ".join(policy for policy in POLICIES if policy in can.policies),
        solver.form,
        can.updates,
        can.start,
        can.keeps or MISSING,
        _yes(can.two_sided),
        _yes(can.gives_multipliers),
        _yes(can.detects_infeasibility),
        _yes(solver.needs_strict_convexity),
        "; ".join(f"{policy}: {why}" for policy, why in refused.items()) or MISSING,
    )


def _yes(can: bool) -> str:
    return "yes" if can else "no"


def _faults_table(known: Sequence[SolverRecord]) -> Table | None:
    rows = [
        row_of(solver.name, route, test.replace("_", " "), fault)
        for solver in known
        for route in solver.policies
        for test, fault in solver.on(route).faults.items()
    ]
    if not rows:
        return None
    return Table(
        title="Known faults",
        note=(
            f"{plural(len(rows), 'fault')}, each shown by the conformance test of that name, which "
            "fails when the fault disappears."
        ),
        heads=("solver", "route", "conformance test", "fault"),
        rows=tuple(rows),
        text_columns=4,
        folded=True,
    )


def _project_table(known: Sequence[SolverRecord], sources: list[str]) -> Table:
    rows = []
    for solver in known:
        project = solver.project
        facts = (
            project.licence,
            project.language,
            project.c_code,
            project.allocation_free,
            project.single_precision,
        )
        rows.append(row_of(solver.name, *(_fact(fact, sources) for fact in facts)))
    return Table(
        title="What a controller's author asks next",
        note=(
            f"{plural(len(known), 'solver')}; each statement is that of the project's own "
            "documentation, under the number of its source. Not stated: no source was found, "
            "which says nothing about the solver."
        ),
        heads=(
            "solver",
            "licence",
            "language",
            "C code",
            "solves without allocating",
            "single precision",
        ),
        rows=tuple(rows),
        text_columns=6,
    )


def _fact(fact: Fact, sources: list[str]) -> Cell:
    """A statement with the number of its source; a new source is appended to `sources`."""
    if not fact.source:
        return Cell(fact.value, "")
    if fact.source not in sources:
        sources.append(fact.source)
    return Cell(f"{fact.value} [{sources.index(fact.source) + 1}]")


def _sources_table(sources: Sequence[str]) -> Table | None:
    if not sources:
        return None
    return Table(
        title="Sources of these statements",
        note=f"{plural(len(sources), 'source')}, in the order of their first use.",
        heads=("number", "source"),
        # Without the scheme: the page loads nothing, and no link leads out of it.
        rows=tuple(
            row_of(str(i + 1), re.sub(r"https?://", "", source)) for i, source in enumerate(sources)
        ),
        text_columns=2,
        folded=True,
    )
