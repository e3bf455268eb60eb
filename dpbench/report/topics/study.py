"""A study: what holds where, what a configuration costs in the same seas, how loose it may be."""

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from dpbench.analysis.suites import study_tables
from dpbench.analysis.suites.study import (
    ALPHA,
    NOTHING,
    SMALL_COST,
    SMALL_M,
    PairedDifference,
    StudiedConfiguration,
    Study,
)
from dpbench.analysis.suites.study_effects import ERROR, LARGEST, STEP_TIME, compute_study_effects
from dpbench.analysis.verdict.verdict import explain_outcome
from dpbench.report.charts.study import (
    draw_effects,
    draw_excess_errors,
    draw_within_lines,
    draw_within_maps,
)
from dpbench.report.formats import (
    MISSING,
    Table,
    format_count,
    format_estimate_with_bounds,
    format_rounded_up,
    format_share,
    join_with_and,
    mark_solver,
    plural,
    significant,
)
from dpbench.report.page.section import Figure, Topic
from dpbench.report.study_effects_table import (
    BEYOND_LOAD,
    WIDENED,
    convert_effect_and_interval,
    describe_dominated_effects,
    make_head_of_measure,
    tabulate_effects,
    tabulate_interactions,
)
from dpbench.report.verdict.verdict_text import name_counts

CHEAPER_THAN_EXACT = (
    "A cost below that of the reference loop is no error: an exact solution minimises the "
    "predicted cost of its step, not the cost summed over the run, which inaccurate moves may "
    "lower by chance."
)
OF_CONSTANT = (
    "In every realisation: all differences of a point are equal to within "
    f"{100.0 * NOTHING:.4f} cm or %; a mean not above that is 0."
)
MOST_DRAWN = 6
"""The reference and the first of the others are drawn."""
MOST_NAMED = 3
"""Points that a sentence names."""
DRAWN = (STEP_TIME, ERROR, LARGEST)


def build_study_topic(known: Sequence[Study]) -> Topic | None:
    """Return the report's part on studies over many sea realisations; None without one."""
    if not known:
        return None
    return Topic(
        id="study",
        title="Studies: paired over realisations",
        lines=tuple(line for study in known for line in _yield_study_sentences(study)),
        figures=tuple(figure for study in known for figure in _draw_study_figures(study)),
        tables=tuple(table for study in known for table in _make_study_tables(study)),
    )


def _yield_study_sentences(study: Study) -> Iterator[str]:
    """Yield sentences on a study: larger errors, unfinished runs, runs within the radius."""
    runs, points = study.runs, len(study.points)
    seas = plural(study.seas_per_point, "realisation")
    reference = study.results_by_cost[0]
    stays = (
        f"in {_format_share_with_bound(reference.within, study)} of the runs with "
        f"{mark_solver(reference.name)} the ship stays within {study.radius_m:g} m in the second "
        "half"
    )
    is_alone = len(study.results_by_cost) == 1
    yield (
        f"`{study.name}`: {plural(len(runs), 'run')} at {plural(points, 'point')} in {seas}; "
        f"{f'{stays}.' if is_alone else _describe_larger_errors(study)}"
    )
    yield from yield_excluded_points_sentences([study])
    yield from _yield_unfinished_sentences(study)
    yield from yield_disturbance_sentences([study])
    yield from _yield_failed_steps_sentences(study)
    worst = min(study.results_by_cost, key=lambda c: c.share_within_radius)
    if not is_alone:
        others = (
            f"; with {mark_solver(worst.name)}, in {_format_share_with_bound(worst.within, study)}"
            if worst.within < reference.within
            else ", as with all other configurations"
        )
        yield f"{stays[0].upper()}{stays[1:]}{others}."
    yield from yield_tolerance_sentences([study])
    if dominated := describe_dominated_effects(study):
        yield dominated


def yield_excluded_points_sentences(studies: Sequence[Study]) -> Iterator[str]:
    """Yield a sentence on the points of each study that are in no difference between solvers."""
    for study in studies:
        left_out = study.points_left_out
        if left_out and len(study.results_by_cost) > 1:
            named = join_with_and([str(point) for point in left_out[:MOST_NAMED]])
            more = f" and {len(left_out) - MOST_NAMED} more" if left_out[MOST_NAMED:] else ""
            yield (
                f"`{study.name}`: {plural(len(left_out), 'point')} excluded from every difference "
                f"to {mark_solver(study.reference_name)}, as the reference loop leaves its station "
                f"there: {named}{more}."
            )


def _yield_unfinished_sentences(study: Study) -> Iterator[str]:
    """Yield sentences on the runs that did not finish: those that their limit stopped apart."""
    runs, every = study.runs, plural(len(study.runs), "run")
    stopped, refused = int(runs["stopped"].sum()), len(study.refused)
    unfinished = int((~runs["finished"]).sum()) - refused
    if refused:
        counts = Counter(
            f"{mark_solver(run.solver_label)} ({explain_outcome(run)})" for run in study.refused
        )
        yield (
            f"`{study.name}`: {refused} of {every} refused and not judged: "
            f"{name_counts(counts.most_common())}."
        )
    if stopped:
        named = [(mark_solver(c.name), c.stopped) for c in study.results_by_cost if c.stopped]
        yield (
            f"`{study.name}`: {stopped} of {every} stopped at the time limit (`cell_limit_s`) and "
            f"not judged: {name_counts(named)}. They are in no share of runs within the radius."
        )
    if unfinished:
        yield (
            f"`{study.name}`: {unfinished} of {every} did not finish. Every difference is "
            "conditional on the realisations that both configurations finished."
        )


def yield_disturbance_sentences(studies: Sequence[Study]) -> Iterator[str]:
    """Yield a sentence on other load that disturbed the step times of each disturbed study."""
    for study in studies:
        if study.disturbance and study.is_disturbed:
            yield (
                f"`{study.name}`: other load disturbed the machine: "
                f"{join_with_and(study.disturbance.complaints())}. An effect on step times is "
                f"shown only if its whole interval is {BEYOND_LOAD}: other load may cause a "
                "smaller one."
            )


def _yield_failed_steps_sentences(study: Study) -> Iterator[str]:
    """Yield a sentence on the runs in which the solver failed steps; none without such a run."""
    failing = study.runs[study.runs["failed_steps"] > 0]
    if failing.empty:
        return
    shares = failing["failed_steps"] / failing["steps_done"]
    worst = failing.iloc[int(np.argmax(shares))]
    yield (
        f"`{study.name}`: steps failed in {len(failing)} of {plural(len(study.runs), 'run')}, most "
        f"of them with {mark_solver(worst['configuration'])} at point {worst['point']}, "
        f"realisation {worst['replicate']}: {worst['failed_steps']:.0f} of "
        f"{plural(worst['steps_done'], 'step')}. In these steps the fallback or an unconverged "
        "iterate acted on the ship."
    )


def _describe_larger_errors(study: Study) -> str:
    """Return which configurations have significantly larger errors than the reference, as text."""
    others, reference = study.results_by_cost[1:], mark_solver(study.reference_name)
    excess_m = {c.name: c.error_excess_m.mean_interval.value for c in others if c.error_excess_m}
    worse = sorted(
        (c for c in others if c.has_larger_error_than_reference), key=lambda c: -excess_m[c.name]
    )
    wording = [
        f"{mark_solver(c.name)} by {significant(100.0 * excess_m[c.name], 2)} cm" for c in worse[:3]
    ]
    unnamed = f" and {len(worse) - 3} more" if len(worse) > 3 else ""
    laws = set(study.runs.loc[study.runs["baseline_law"], "configuration"])
    solvers = {c.solver for c in study.results_by_cost if c.name not in laws}
    lone = f"only `{', '.join(solvers)}` was run; " if len(solvers) == 1 else ""
    if lone and not worse and all(c.name in laws for c in others):
        return f"only {reference} was run, so no other solver is compared."
    if not worse:
        return (
            f"{lone}no radial error is significantly larger than that of {reference} in the same "
            "realisation."
        )
    same = len(others) - len(worse)
    rest = f"; not significantly larger with {same} more" if same else ""
    return (
        f"{lone}radial errors significantly larger than with {reference} in the same realisation: "
        f"{', '.join(wording)}{unnamed}{rest}."
    )


def _format_share_with_bound(share: float, study: Study) -> str:
    """Format a share in percent, at 0 % or 100 % with its 95 % bound; return a dash for none."""
    if np.isnan(share):
        return MISSING
    bound = study.bound_of_none_percent
    wording = f"{100 * share:.0f} %"
    if share in (0.0, 1.0):
        wording += f" (at {'least' if share else 'most'} {100 - bound if share else bound} %)"
    return wording


def yield_tolerance_sentences(studies: Sequence[Study]) -> Iterator[str]:
    """Yield sentences on each study's loosest tolerances, and on those of them that do not pass."""
    for study in studies:
        if study.loosest_cheap_by_solver:
            yield f"`{study.name}`: {_describe_loosest_tolerances(study)}"


def _describe_loosest_tolerances(study: Study) -> str:
    """Return in words each solver's loosest tolerance that costs no more than a small limit."""
    cheap = {s: c for s, c in study.loosest_cheap_by_solver.items() if c is not None}
    none = [f"`{s}`" for s, c in study.loosest_cheap_by_solver.items() if c is None]
    limits = (
        f"excess error significantly below {100 * SMALL_M:g} cm and excess cost significantly "
        f"below {100 * SMALL_COST:g} %"
    )
    parts = [
        f"{mark_solver(c.name)} with {format_share(c.accurate)} of the steps verified"
        for c in cheap.values()
    ]
    wording = (
        "The loosest tolerance (`default` is not compared) with an "
        f"{limits.replace('and excess', 'and an excess')}: "
        f"{join_with_and(parts)}"
        if parts
        else ""
    )
    without = f"No tolerance of {join_with_and(none)} has an {limits}" if none else ""
    failing = (_describe_inaccuracy(c, study) for c in cheap.values() if not c.is_accurate_enough)
    return ". ".join(filter(None, (wording, *failing, without))) + "."


def _describe_inaccuracy(configuration: StudiedConfiguration, study: Study) -> str:
    """Return that a configuration does not pass the accuracy requirements, with its errors."""
    c, limit = configuration, study.requirements.error_move
    reasons = []
    if c.error_move > limit:
        found = format_rounded_up(c.error_move, 2)
        reasons.append(f"the error of the first move is up to {found} (limit {limit:g})")
    if c.false_claims:
        steps = f"{format_count(c.false_claims)} of {plural(c.steps, 'step')}"
        reasons.append(f"{steps} were reported as solved but not verified")
    wording = f"{mark_solver(c.name)} does not pass the requirements"
    return f"{wording}: {join_with_and(reasons)}" if reasons else wording


def _draw_study_figures(study: Study) -> Iterator[Figure]:
    """Yield figures of a study: share within the radius over points, errors by realisation."""
    name = study.name.replace("@", "-").replace("/", "-")
    maps, whole = (
        study_tables.tabulate_shares_in_position(study),
        study_tables.has_few_enough_points_for_tiles(study),
    )
    labels = study_tables.label_numeric_factors(study)
    keys = list(labels)
    title = f"Within {study.radius_m:g} m, {study.name}"
    if len(keys) > 1:
        own = study.points[keys[0]].nunique() > max(8, len(study.points) // 2)
        drawn = bool(own) or not whole
        chart = draw_within_maps(maps, title, labels[keys[0]], labels[keys[1]], drawn=drawn)
        where = (
            "at each point" if whole else f"in {study_tables.FIELDS} × {study_tables.FIELDS} fields"
        )
        caption = (
            f"Share of realisations within the radius {where}; a run that did not end counts as "
            "outside."
        )
        yield Figure(f"study-within-{name}", chart, caption)
    elif keys:
        chart = draw_within_lines(maps, title, labels[keys[0]])
        caption = "Share of realisations within the radius at each value."
        yield Figure(f"study-within-{name}", chart, caption)
    yield from draw_effect_figures(study, name)
    table, seas, seas_all = study_tables.tabulate_error_excess_by_sea(study)
    if len(table):
        chart = draw_excess_errors(
            table, seas, f"Excess error over {study.reference_name}, {study.name}", 100 * SMALL_M
        )
        of = "" if len(seas) == seas_all else f" ({len(seas)} of {seas_all}, evenly spaced by rank)"
        caption = (
            f"Dot: one realisation{of}; line: mean with its 95 % interval, if any; band: 1 cm to "
            "either side, cut off at the axis."
        )
        yield Figure(f"study-excess-{name}", chart, caption)


def _make_study_tables(study: Study) -> Iterator[Table]:
    """Yield the tables of a study: its configurations, its points, the effects of its factors."""
    rows = [
        _make_configuration_row(configuration, study) for configuration in study.results_by_cost
    ]
    title = f"{study.name}: comparison with {study.reference_name} in the same realisation"
    note = (
        "Intervals hold at 95 % for each row alone, not for all at once, and are conditional on "
        "the realisations that both finished. No interval is given where fewer than half of the "
        "points have two realisations. Significant: the error differs, with a family-wise error of "
        f"{100 * ALPHA:g} % over all rows (Holm). The reference is selected by "
        "completeness and settings, not by accuracy or cost. At least, at most: 95 % bound where "
        "all or none of the runs are within the radius, from 3 divided by the number of "
        "realisations."
    )
    if any(c.cost < -NOTHING for c in study.results_by_cost):
        note += f" {CHEAPER_THAN_EXACT}"
    differences = [(c.error_excess_m, c.log_cost_excess) for c in study.results_by_cost]
    if any(one is not None and one.is_constant for pair in differences for one in pair):
        note += f" {OF_CONSTANT}"
    if study.aliases:
        same = [f"{alias} with {own}" for alias, own in study.aliases.items()]
        note += f" Settings without an effect share a row: {join_with_and(same)}."
    yield Table.from_rows(rows, title, note=note)
    axes = tuple(
        (str(key), str(values.nunique()), str(values.min()), str(values.max()))
        for key, values in study.points.items()
    )
    if axes:
        yield Table(("key", "values", "least", "largest"), axes, f"{study.name}: points")
    yield from filter(None, (tabulate_effects(study), tabulate_interactions(study)))


def _make_configuration_row(configuration: StudiedConfiguration, study: Study) -> dict[str, str]:
    """Return the table row of a configuration in a study."""
    behind_it, dearer = configuration.error_excess_m, configuration.log_cost_excess
    cost = configuration.cost
    row = {
        "configuration": configuration.name,
        "runs": f"{configuration.finished} of {configuration.runs}"
        + (f", {configuration.stopped} stopped" if configuration.stopped else ""),
        "within": _format_share_with_bound(configuration.within, study),
        "verified steps": format_share(configuration.accurate),
        # Rounding alone is 0.
        "cost over exact": f"{0 if abs(cost) < NOTHING else significant(100.0 * cost, 2)} %",
        "excess error [cm]": "reference"
        if behind_it is None
        else _format_difference(behind_it, 100.0),
        "excess cost [%]": "" if dearer is None else _format_difference(dearer, 100.0),
    }
    if behind_it is None:
        return row | {"significant": "", "realisations for 1 cm": ""}
    seas = str(behind_it.count_seas_needed_for(SMALL_M) or MISSING)
    return row | {
        "significant": "yes" if configuration.differs_from_reference else "no",
        "realisations for 1 cm": seas,
    }


def _format_difference(difference: PairedDifference, scale: float) -> str:
    """Format a mean difference between configurations, times a scale, with its interval."""
    mean = difference.mean_interval
    if not np.isfinite(mean.low):
        return f"{significant(scale * mean.value, 2)} (no interval)"
    if difference.is_constant:
        return f"{significant(scale * difference.stated_numbers[0], 2)} in every realisation"
    scaled = (scale * number for number in (mean.value, mean.low, mean.high))
    middle, low, high = format_estimate_with_bounds(*scaled)
    widened = WIDENED if difference.estimate.is_clearly_widened else ""
    return f"{middle} [{low}, {high}]{widened}"


def draw_effect_figures(study: Study, name: str) -> Iterator[Figure]:
    """Yield figures of what each factor changes in the step time and the radial error."""
    names = [configuration.name for configuration in study.results_by_cost][:MOST_DRAWN]
    rows = [
        {
            "measure": make_head_of_measure(effect.measure, study),
            "effect": f"{_shorten_factor(effect.factor)}: {effect.levels_text}",
            "configuration": effect.configuration,
            **dict(zip(("value", "low", "high"), convert_effect_and_interval(effect), strict=True)),
        }
        for effect in compute_study_effects(study)
        if effect.configuration in names and effect.measure in DRAWN and not effect.is_disturbed
    ]
    table = pd.DataFrame(rows)
    if len(table) and np.isfinite(table["value"]).any():
        left = len(study.results_by_cost) - len(names)
        caption = (
            "Change of each factor, with its 95 % interval where there is one; zero: no effect."
            + (f" {left} more configurations are in the table." if left > 0 else "")
            + " Effects on step times that other load can explain are not drawn."
            * study.is_disturbed
        )
        chart = draw_effects(table, f"Effect of each factor, {study.name}", names)
        yield Figure(f"study-effects-{name}", chart, caption)


def _shorten_factor(factor: str) -> str:
    """Return a factor's dotted keys, each shortened to its last part."""
    return ", ".join(key.rpartition(".")[2] for key in factor.split(", "))
