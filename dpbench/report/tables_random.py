"""Tables of the random problems: by configuration, by family, and who claimed wrongly where."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from dpbench.analysis.random_claims import CONFIGURATION, RandomClaims, Tally
from dpbench.qp.random.recipe import FAMILIES
from dpbench.report.formats import MISSING, count_text, error_text, plural
from dpbench.report.table import Cell, Table, good_if, row_of

HOW = (("off", "off"), ("outside", "outside"), ("empty", "empty"), ("dual", "multipliers"))


def configurations_of(claims: RandomClaims) -> list[tuple[tuple[str, ...], Tally]]:
    """Every configuration with its tally, the most wrong claims first."""
    found = claims.by(*CONFIGURATION).items()
    return sorted(
        found,
        key=lambda configuration: (
            -configuration[1].wrong,
            -configuration[1].lies[2],
            configuration[0],
        ),
    )


def configuration_tables(claims: RandomClaims) -> list[Table]:
    """The configurations with a wrong claim, and, folded, those without."""
    configurations = configurations_of(claims)
    wrong = [configuration for configuration in configurations if configuration[1].wrong]
    right = [configuration for configuration in configurations if not configuration[1].wrong]
    tables = []
    if wrong:
        tables.append(
            _configuration_table(
                "Configurations that claimed what is not true", wrong, folded=False
            )
        )
    if right:
        tables.append(
            _configuration_table(
                "Configurations without a false claim", right, folded=len(wrong) > 0
            )
        )
    return tables


def _configuration_table(
    title: str, configurations: Sequence[tuple[tuple[str, ...], Tally]], *, folded: bool
) -> Table:
    return Table(
        title=title,
        note=(
            f"{plural(len(configurations), 'configuration')}, most false claims first. Every "
            "certified step that was "
            "reached stands in one column: true and claimed; claimed solved and not true (at 1e-3; "
            "those at 1e-4 and 1e-6 contain them); true and not claimed; called infeasible or "
            "unbounded, rightly or wrongly; neither a claim nor a true answer. Worst: the largest "
            "distance to the certified optimum among the false claims of an optimum. Not reached: "
            "the cell was stopped, or its process ended, before. How the claims are false: off the "
            "optimum, outside the limits, of a problem with an empty feasible set, or by the "
            "multipliers alone."
        ),
        heads=(
            "solver",
            "route",
            "policy",
            "settings",
            "steps",
            "true, claimed",
            "claimed, not true",
            "at 1e-4",
            "at 1e-6",
            "worst",
            "true, not claimed",
            "infeasible: right",
            "infeasible: wrong",
            "no answer",
            "not reached",
            "how",
        ),
        rows=tuple(
            _configuration_row(configuration, tally) for configuration, tally in configurations
        ),
        text_columns=4,
        folded=folded,
    )


def _configuration_row(configuration: tuple[str, ...], tally: Tally) -> tuple[Cell, ...]:
    lies = tally.lies
    return row_of(
        *configuration,
        count_text(tally.steps),
        count_text(tally.told),
        good_if(count_text(lies[0]), not lies[0]),
        count_text(lies[1]),
        count_text(lies[2]),
        worst_text(tally),
        count_text(tally.silent),
        count_text(tally.empty_right),
        good_if(count_text(tally.empty_wrong), not tally.empty_wrong),
        count_text(tally.nothing),
        Cell(count_text(tally.missed), "warn" if tally.missed else ""),
        how_text(tally),
    )


def worst_text(tally: Tally) -> str:
    """The largest error of a false claim; a dash where there is none, or none has an error."""
    return error_text(tally.worst) if tally.lies[0] else MISSING


def how_text(tally: Tally) -> str:
    """In what way the false claims are false."""
    parts = {word: getattr(tally, name) for name, word in HOW if getattr(tally, name)}
    if len(parts) == 1:
        return next(iter(parts))
    return ", ".join(f"{count} {word}" for word, count in parts.items()) or MISSING


def family_table(claims: RandomClaims) -> Table:
    """One row per family: what was run, how it was certified, and who claimed wrongly."""
    certificates, by_configuration = claims.certificates(), claims.by("family", *CONFIGURATION)
    rows = []
    for (family,), tally in claims.by("family").items():
        configurations = {key: t for key, t in by_configuration.items() if key[0] == family}
        rows.append(
            _family_row(claims, family, tally, configurations, certificates.get(family, {}))
        )
    return Table(
        title="Families of random problems",
        note=(
            "Steps: different QPs; each configuration solves them all. Certificates: how the "
            "referee knows "
            "the optimum, or that there is none. A configuration is a solver on one route with "
            "one policy "
            "and one settings name."
        ),
        heads=(
            "family",
            "what it is",
            "certificates",
            "n",
            "m",
            "steps",
            "not certified",
            "configurations",
            "of them wrong",
            "claimed, not true",
            "infeasible: wrong",
            "worst",
            "of",
        ),
        rows=tuple(rows),
        text_columns=3,
    )


def _family_row(
    claims: RandomClaims,
    family: str,
    tally: Tally,
    configurations: Mapping[tuple[str, ...], Tally],
    kinds: Mapping[str, int],
) -> tuple[Cell, ...]:
    mine = [row for row in claims.runs if row.family == family]
    wrong = sum(t.wrong > 0 for t in configurations.values())
    return row_of(
        family.replace("_", " "),
        FAMILIES[family].shows if family in FAMILIES else MISSING,
        ", ".join(f"{kind} {count}" for kind, count in kinds.items()) or MISSING,
        _range([row.drawn_n for row in mine]),
        _range([row.drawn_m for row in mine]),
        count_text(sum(kinds.values())),
        Cell(count_text(kinds.get("none", 0)), "warn" if "none" in kinds else ""),
        count_text(len(configurations)),
        good_if(count_text(wrong), not wrong),
        good_if(count_text(tally.lies[0]), not tally.lies[0]),
        good_if(count_text(tally.empty_wrong), not tally.empty_wrong),
        worst_text(tally),
        _worst_configuration(configurations),
    )


def _range(numbers: Sequence[int]) -> str:
    low, high = min(numbers), max(numbers)
    return str(low) if low == high else f"{low}–{high}"


def _worst_configuration(configurations: Mapping[tuple[str, ...], Tally]) -> str:
    """The solver and settings with the largest error of a false claim."""
    known = {key: t.worst for key, t in configurations.items() if not math.isnan(t.worst)}
    if not known:
        return MISSING
    _, solver, _, _, settings = max(known, key=lambda key: known[key])
    return solver if settings == "default" else f"{solver} ({settings})"


def where_table(claims: RandomClaims) -> Table | None:
    """Solver and settings against family: false claims and the worst of them; None without any."""
    cells = claims.by("solver", "settings", "family")
    totals = claims.by("solver", "settings")
    families = list(dict.fromkeys(row.family for row in claims.runs))
    liars = sorted((key for key, t in totals.items() if t.wrong), key=lambda k: -totals[k].wrong)
    if not liars:
        return None
    rows = [
        row_of(solver, settings, *(_where(cells.get((solver, settings, f))) for f in families))
        for solver, settings in liars
    ]
    return Table(
        title="Who claimed wrongly where",
        note=(
            "All routes and policies of a solver together. Each cell: false claims of certified "
            "steps, then the worst error of those that claimed an optimum; a second number after "
            "a plus sign counts feasible steps that were called infeasible or unbounded."
        ),
        heads=("solver", "settings", *(family.replace("_", " ") for family in families)),
        rows=tuple(rows),
        text_columns=2,
    )


def _where(tally: Tally | None) -> Cell:
    if tally is None or tally.steps == 0:
        return Cell(MISSING, "quiet")
    if not tally.wrong:
        return Cell("0", "quiet")
    worst = "" if math.isnan(tally.worst) else f", {worst_text(tally)}"
    also = f" + {tally.empty_wrong}" if tally.empty_wrong else ""
    return Cell(f"{count_text(tally.lies[0])}{worst}{also}", "bad")
