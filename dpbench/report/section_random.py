"""The section on random problems: what solvers claimed of them, against the referee."""

from __future__ import annotations

from dpbench.analysis.random_claims import RandomClaims
from dpbench.analysis.records import Records
from dpbench.report.blocks import Block, Card, Cards, Paragraph, Section, Tabular
from dpbench.report.formats import and_list, count_text, plural
from dpbench.report.tables_random import (
    configuration_tables,
    configurations_of,
    family_table,
    where_table,
)

INTRODUCTION = (
    "Every QP here is random, with an optimum that was planted: chosen first, and the cost and the "
    "limits around it. q, l and u walk along smooth paths with jumps while P, A and the bounds "
    "stay. The referee certified them all again without being told. A solver that says *solved* "
    "of an answer that is not true, or *infeasible* of a problem with an optimum, is counted "
    "below; no step time is compared, since configurations ran side by side."
)


def random_section(view: Records) -> Section | None:
    """False claims of random problems; None where the records hold no such problem."""
    if not view.random:
        return None
    section = Section("random", "Random problems: claims against the referee")
    claims = RandomClaims(view)
    where = where_table(claims)
    tables: list[Block] = [Tabular(family_table(claims))]
    tables += [
        Tabular(table) for table in (where, *configuration_tables(claims)) if table is not None
    ]
    section.add(
        Paragraph(" ".join(_summary(claims)), lead=True),
        _cards(claims),
        Paragraph(INTRODUCTION),
        *tables,
    )
    return section


def random_lines(view: Records) -> list[str]:
    """The same in a few plain lines for a terminal; none without random problems."""
    if not view.random:
        return []
    return [line.replace("`", "").replace("*", "") for line in _summary(RandomClaims(view))]


def _honest(claims: RandomClaims) -> list[str]:
    """Solvers of which no configuration made a false claim."""
    return sorted(solver for (solver,), t in claims.by("solver").items() if t.steps and not t.wrong)


def _summary(claims: RandomClaims) -> list[str]:
    configurations = configurations_of(claims)
    wrong = [tally for _, tally in configurations if tally.wrong]
    sequences = {row.sequence for row in claims.runs}
    whole = claims.of(claims.runs)
    kinds = claims.certificates().values()
    unknown = sum(found.get("none", 0) for found in kinds)
    lines = [
        f"{plural(sum(sum(found.values()) for found in kinds), 'random QP')} in "
        f"{plural(len(sequences), 'sequence')}, put to "
        f"{plural(len(configurations), 'configuration')}: "
        f"{plural(whole.lies[0], 'answer')} claimed *solved* that the referee finds untrue, "
        f"{plural(whole.empty_wrong, 'optimum', 'optima')} called infeasible or unbounded; "
        f"{plural(len(wrong), 'configuration')} made such a claim."
    ]
    honest = _honest(claims)
    if honest:
        lines.append(f"Without any: {and_list([f'`{solver}`' for solver in honest])}.")
    if unknown:
        lines.append(f"{plural(unknown, 'QP')} could not be certified and stand for nothing.")
    return lines


def _cards(claims: RandomClaims) -> Cards:
    whole, honest = claims.of(claims.runs), _honest(claims)
    solvers = {row.solver for row in claims.runs}
    return Cards(
        (
            Card(
                "solvers without a false claim",
                f"{len(honest)} of {len(solvers)}",
                ", ".join(honest) or "none",
                "good" if honest else "bad",
            ),
            Card(
                "claimed solved, not true",
                count_text(whole.lies[0]),
                f"of {plural(whole.told + whole.lies[0], 'claim')}, at 1e-3",
                "bad" if whole.lies[0] else "good",
            ),
            Card(
                "called infeasible, with an optimum",
                count_text(whole.empty_wrong),
                f"beside {count_text(whole.empty_right)} that rightly were",
                "bad" if whole.empty_wrong else "good",
            ),
        )
    )
