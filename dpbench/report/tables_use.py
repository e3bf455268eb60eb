"""Tables of what the wrapper costs and what a kept workspace and a warm start gain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dpbench.analysis.times.routes import (
    ABOVE,
    KEPT,
    LEVELS,
    NATIVE,
    SLOWER_NS,
    SLOWER_SHARE,
    WARM,
    WRAPPED,
    Comparison,
    RouteComparison,
    RoutePolicy,
    route_policy_text,
)
from dpbench.report.formats import (
    MISSING,
    count_text,
    interval_text,
    micro_text,
    plural,
    share_text,
    significant,
)
from dpbench.report.table import Cell, Table, row_of

SLOWER = (
    f"A step counts as slower when it takes more than {100 * SLOWER_SHARE:g} % and more than "
    f"{SLOWER_NS / 1e3:g} µs longer"
)


def route_table(
    ways: Sequence[RouteComparison], sequence: str, *, others: bool = False
) -> Table | None:
    """From the wrapper down to a warm start, one row a solver; None without a native configuration.

    `others` gives the folded table of all settings but `default`.
    """
    shown = [w for w in ways if (w.settings != "default") == others]
    if not shown:
        return None
    # Three ratios a row, whose intervals are to hold together.
    count = sum(
        way in w.times and w.neighbour(way) is not None
        for w in shown
        for way in (NATIVE, KEPT, WARM)
    )
    named = ("solver", "settings") if others else ("solver",)
    kind = "other settings" if others else "settings default"
    return Table(
        title=f"From wrapper to warm start in the replay of `{sequence}`, {kind}",
        note=(
            f"{plural(len(shown), 'row')}, fastest by median first; p50 of the algorithmic "
            "step time in µs. Wrapper: qpsolvers fresh less native fresh, and their ratio. "
            "Reuse: native fresh over native reuse. Warm: native reuse (where there is none, "
            "native fresh) over native warm. Ratios are geometric means over paired "
            f"steps, above 1 is a gain, with intervals that hold for all "
            f"{plural(count, 'ratio')} together at 95 %; grey where the interval "
            f"holds 1. {SLOWER}; wrong: the referee finds the warm answer not true "
            "and the neighbour's true."
        ),
        heads=(
            *named,
            *(route_policy_text(way) for way in LEVELS),
            "wrapper costs [µs]",
            "wrapper ratio",
            "reuse gains",
            "warm gains",
            "iterations p50 fresh → warm",
            "warm slower",
            "warm wrong",
        ),
        rows=tuple(_route_row(w, count, others=others) for w in shown),
        text_columns=len(named),
        folded=others,
    )


def _route_row(ways: RouteComparison, count: int, *, others: bool) -> tuple[Cell, ...]:
    wrapper = ways.compare(NATIVE, ways.neighbour(NATIVE), count)
    kept = ways.compare(KEPT, ways.neighbour(KEPT), count)
    warm = ways.compare(WARM, ways.neighbour(WARM), count)
    return row_of(
        ways.solver,
        *([ways.settings] if others else []),
        *(_median(ways, way) for way in LEVELS),
        micro_text(wrapper.saved_ns) if wrapper else MISSING,
        _gain(wrapper),
        _gain(kept),
        _gain(warm, usual=KEPT),
        _iterations(ways),
        _slower(warm),
        _wrong(warm),
    )


def _median(ways: RouteComparison, way: RoutePolicy) -> Cell:
    if way in ways.times:
        return Cell(micro_text(ways.median_ns(way)))
    row = ways.runs.get(way)
    return Cell(row.outcome.replace("_", " ") if row else MISSING, "quiet")


def _gain(found: Comparison | None, usual: RoutePolicy | None = None) -> Cell:
    if found is None:
        return Cell(MISSING, "quiet")
    gain = found.gain
    text = f"{significant(gain.value)} {interval_text(gain.low, gain.high)}"
    if usual is not None and found.above != usual:
        text += f" on {found.above[1]}"
    if gain.spans(1.0):
        return Cell(text, "quiet")
    return Cell(text, "good" if gain.value > 1.0 else "bad")


def _iterations(ways: RouteComparison) -> str:
    fresh = next((ways.times[w] for w in (NATIVE, WRAPPED) if w in ways.times), None)
    before = significant(fresh.iterations[0]) if fresh else MISSING
    after = significant(ways.times[WARM].iterations[0]) if WARM in ways.times else MISSING
    return f"{before} → {after}"


def _slower(found: Comparison | None) -> Cell:
    if found is None:
        return Cell(MISSING, "quiet")
    if found.slower == 0:
        return Cell("0")
    return Cell(f"{count_text(found.slower)} ({share_text(found.slower / found.steps)})", "warn")


def _wrong(found: Comparison | None) -> Cell:
    if found is None:
        return Cell(MISSING, "quiet")
    return Cell(count_text(len(found.wrong)), "bad" if found.wrong else "")


def kept_table(ways: Sequence[RouteComparison], sequence: str) -> Table | None:
    """Every kept workspace beside its neighbour, on all routes and settings; None without one."""
    found = [
        (w, way, comparison)
        for w in ways
        for way in ABOVE
        if way[1] != "fresh" and (comparison := w.compare(way, w.neighbour(way))) is not None
    ]
    if not found:
        return None
    return Table(
        title=f"What a kept workspace gains in the replay of `{sequence}`",
        note=(
            f"{plural(len(found), 'configuration')}, each beside its neighbour: the neighbour's "
            "time over "
            "this one's, geometric mean of paired ratios per step; 95 % interval, block bootstrap "
            "over steps. Where the interval holds 1 the policy measurably makes no difference. "
            f"{SLOWER}. Wrong: not true here, true there; mended: the other way round."
        ),
        heads=(
            "solver",
            "settings",
            "route",
            "policy",
            "",
            "neighbour",
            "neighbour / policy",
            "interval",
            "iterations, mean",
            "steps",
            "slower",
            "slower by at most [µs]",
            "wrong",
            "mended",
        ),
        rows=tuple(_kept_row(*configuration) for configuration in found),
        text_columns=6,
        folded=True,
    )


def _kept_row(ways: RouteComparison, way: RoutePolicy, found: Comparison) -> tuple[Cell, ...]:
    gain = found.gain
    if gain.spans(1.0):
        verdict = Cell("no difference", "quiet")
    else:
        verdict = Cell("gain", "good") if gain.value > 1.0 else Cell("loss", "bad")
    return row_of(
        ways.solver,
        ways.settings,
        *way,
        verdict,
        route_policy_text(found.above),
        significant(gain.value),
        interval_text(gain.low, gain.high),
        f"{significant(ways.times[found.above].iterations[1])} → "
        f"{significant(ways.times[way].iterations[1])}",
        count_text(found.steps),
        _slower(found),
        micro_text(found.slower_ns),
        _wrong(found),
        count_text(found.mended),
    )


def missing_table(by_sequence: Mapping[str, Sequence[RouteComparison]]) -> Table | None:
    """The routes and policies that are not there, and why; None when all are."""
    places: dict[tuple[str, str, str], list[str]] = {}
    for sequence, ways in by_sequence.items():
        for w in ways:
            for way in LEVELS:
                if way not in w.times:
                    key = (w.solver, route_policy_text(way), w.why_missing(way))
                    places.setdefault(key, []).append(f"{sequence} ({w.settings})")
    if not places:
        return None
    every = sum(len(ways) for ways in by_sequence.values())
    rows = [
        row_of(solver, way, _places(where), reason)
        for (solver, way, reason), where in sorted(places.items())
    ]
    return Table(
        title="RouteComparison that are missing",
        note=(
            f"Of the {plural(4 * every, 'configuration')} behind the tables above; the reasons "
            "are the "
            "library's or the harness's own words. A gain is then taken over the next way above "
            "that was measured, or not given."
        ),
        heads=("solver", "way", "where", "reason"),
        rows=tuple(rows),
        text_columns=4,
        folded=True,
    )


def _places(where: Sequence[str]) -> str:
    return "; ".join(where) if len(where) <= 2 else plural(len(where), "replay")
