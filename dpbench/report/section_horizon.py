"""The section on the horizon sweep: how step times grow with the number of moves."""

from __future__ import annotations

from collections.abc import Sequence

from dpbench.analysis.demand import Demand
from dpbench.analysis.records import Records
from dpbench.analysis.times.growth import Growth
from dpbench.analysis.times.horizon_sweep import Sweep, SweptConfiguration, moves_of, sweeps
from dpbench.report.blocks import Block, Paragraph, Picture, Section, Tabular
from dpbench.report.figures_horizon import growth_figure
from dpbench.report.formats import interval_text, plural, significant, time_text
from dpbench.report.tables_horizon import growth_table, horizons_text
from dpbench.report.time_marks import marks_legend, timed_name
from dpbench.scenario.horizons import Horizons

INTRODUCTION = (
    "The same scenario under longer and longer horizons: a plan of N_c moves has n = 3 N_c "
    "variables in condensed form, whose matrices are dense, while the sparse form has more "
    "variables and few entries. Each horizon has an exactly solved loop of its own, so solvers "
    "get identical QPs at each horizon and different ones from horizon to horizon."
)

NO_POWER = 1.5
"""Times that leave the fitted line by a larger factor grow by no single power of n."""


def horizon_section(view: Records, demand: Demand) -> Section | None:
    """Growth with the horizon; None where no scenario was replayed under two horizons."""
    found = [
        sweep
        for sweep in sweeps(view, demand)
        if any(configuration.timed for configuration in sweep.swept)
    ]
    if not found:
        return None
    section = Section("horizon", "Horizon")
    section.add(Paragraph(INTRODUCTION))
    for i, sweep in enumerate(found):
        section.add(*_blocks(i, sweep))
    return section


def _blocks(i: int, sweep: Sweep) -> list[Block]:
    best = [configuration for configuration in sweep.best if configuration.timed]
    every = sorted(
        sweep.swept,
        key=lambda a: (
            a.configuration.solver,
            a.configuration.formulation,
            a.configuration.options,
        ),
    )
    forms = " and ".join(form.replace("_", " ") for form in sweep.formulations)
    picture = Picture(
        f"horizon_{i + 1}",
        f"Step time against the number of moves in {sweep.name}",
        f"Median over {plural(sweep.steps, 'step')} of the algorithmic step time, {forms}; of each "
        "solver the way that is right at most horizons, and of these the fastest at the longest. "
        "A line ends at the longest horizon at which every step was done in the cell's time. "
        "Hollow: an answer misses the demand.",
        growth_figure(sweep, best),
    )
    return [
        Paragraph(" ".join(_summary(sweep, best))),
        picture,
        Tabular(growth_table(sweep, best)),
        Tabular(growth_table(sweep, every, every=True)),
    ]


def _summary(sweep: Sweep, best: Sequence[SweptConfiguration]) -> list[str]:
    """Who is fastest at either end, and whose time grows least."""
    ends = (sweep.horizons[0], sweep.horizons[-1])
    words = [text for h in ends if (text := _fastest(best, h))]
    grown = [
        (configuration, growth)
        for configuration in best
        if configuration.right
        and len(configuration.timed) == len(sweep.horizons)
        and (growth := configuration.growth)
    ]
    if grown:
        grown.sort(key=lambda found: found[1].exponent.value)
        among = "Of the configurations that are right at every horizon"
        said = [_growth_text(configuration, growth) for configuration, growth in grown]
        words.append(
            f"{among}, the time grows least with {said[0]}"
            + (f" and most with {said[-1]}." if len(said) > 1 else ".")
        )
    legend = marks_legend(row for configuration in best for row in configuration.runs).lstrip()
    marked = [legend] if legend else []
    return [f"Scenario `{sweep.name}`, {plural(sweep.steps, 'step')} a horizon.", *words, *marked]


def _fastest(best: Sequence[SweptConfiguration], horizons: Horizons) -> str:
    right = [
        configuration
        for configuration in best
        if horizons in configuration.timed and configuration.timed[horizons].right
    ]
    if not right:
        return ""
    first = min(right, key=lambda configuration: configuration.timed[horizons].median_ns)
    return (
        f"At {horizons_text(horizons)} (n = {moves_of(horizons)}) the fastest of "
        f"{plural(len(right), 'configuration')} whose answers meet the demand there is "
        f"**{timed_name(first.runs[0])}** ({_how(first)}), "
        f"{time_text(first.timed[horizons].median_ns)}."
    )


def _how(swept: SweptConfiguration) -> str:
    configuration = swept.configuration
    return f"{configuration.formulation.replace('_', ' ')}, {configuration.options}"


def _growth_text(configuration: SweptConfiguration, growth: Growth) -> str:
    exponent = growth.exponent
    interval = interval_text(exponent.low, exponent.high)
    average = (
        f", an average, as its times leave that line by up to × {significant(growth.misfit)}"
        if growth.misfit > NO_POWER
        else ""
    )
    power = f"like n to the {significant(exponent.value)} {interval}{average}"
    return f"**{timed_name(configuration.runs[0])}** ({_how(configuration)}), {power}"
