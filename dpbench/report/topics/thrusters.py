"""Commanded thrusters: power and wear by solver, and the conclusion for an operator.

Against the best loop in the same scenario: of those right on every step and run as far, the one
nearest to the reference loop.
"""

import math
from collections.abc import Iterator, Sequence
from math import isfinite

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord, group_by_key
from dpbench.analysis.suites.capability import (
    HELD,
    build_consequence_analyses,
    find_largest_solve_time_share,
    select_configurations_in_all_analyses,
)
from dpbench.analysis.verdict.requirements import MISSED, Requirements, is_right_to_the_end
from dpbench.analysis.verdict.ship_results import find_ship_results
from dpbench.analysis.verdict.thruster_verdicts import (
    ThrusterVerdicts,
    compare_thrusters_with_forces,
    find_largest_ratio_to_best,
    is_mostly_thruster_control,
    list_late_losses,
    select_thruster_control_loops,
)
from dpbench.analysis.verdict.time_findings import SpeedMargin, compute_speed_margins
from dpbench.analysis.verdict.verdict import Verdict, Verdicts, choose_solver
from dpbench.report.formats import (
    MISSING,
    Table,
    format_rounded_up,
    format_sample_share,
    join_with_and,
    plural,
    significant,
)
from dpbench.report.page.section import Topic
from dpbench.report.ship.capability_text import describe_losses_before, list_analysis_cautions
from dpbench.report.ship.thrust_text import describe_thrust_used, tabulate_thruster_use
from dpbench.report.verdict.verdict_text import describe_hardest_wait

MOST_ROWS = 8
"""Rows on the page, the most often right first; the file has all."""
LIKE = 0.01
"""Relative difference of power or wear that counts as equal."""


def build_thrusters_topic(records: Records, requirements: Requirements) -> Topic | None:
    """Return the report's part on thruster power and wear by solver; None without such runs."""
    found = select_thruster_control_loops(records, requirements)
    if not found.best:
        return None
    best, configurations = found.best, found.configurations
    lead = _describe_thruster_load(best, configurations, requirements)
    use = [table] if (table := tabulate_thruster_use(find_ship_results(records))) else []
    if not is_mostly_thruster_control(records):
        # Where thrusters are one scenario among others, what they cost is not what is asked.
        return Topic("thrusters", "Thrusters", (lead,), tables=tuple(use))
    rows = [
        make_wear_row(name, of_it, best, requirements) for name, of_it in configurations.items()
    ]
    rows.sort(key=lambda row: (-int(row["accurate in"].split(" ")[0]), row["configuration"]))
    by_solver = {row["configuration"].split(" (")[0]: row for row in reversed(rows)}
    kept = list(by_solver.values())[::-1]
    note = (
        "Power (Σ|f|^1.5 over all thrusters), wear (Σ|Δf|/T) and azimuth travel are divided by "
        "those of a baseline: of the complete closed loops of a scenario that are accurate on "
        "every step, the one with the smallest maximum distance from the ship of the reference "
        "loop. The table gives the largest ratio over the completed scenarios, for the "
        "configuration of each solver that is accurate in the most scenarios."
    )
    if len(kept) > MOST_ROWS:
        note += " All rows: tables/thrusters.csv."
    wear = Table.from_rows(kept, shown=MOST_ROWS)
    return Topic("thrusters", "Thrusters", (lead, note), (), (wear, *use))


def _describe_thruster_load(
    best: dict[str, RunRecord],
    configurations: dict[str, list[RunRecord]],
    requirements: Requirements,
) -> str:
    """Return a text on how often thrusters are at limits, and how many solvers stay right."""
    hardest = max(best.values(), key=lambda run: run.at_limit_thrusters)
    whole = sum(
        {run.scenario for run in runs if is_right_to_the_end(run, requirements)} == set(best)
        for runs in configurations.values()
    )
    names = join_with_and([f"`{name}`" for name in sorted(best)])
    all_runs = " of all these scenarios" * (len(best) > 1)
    return (
        f"In the closed loop of {hardest.configuration.marked_label}, at least one thruster is at "
        f"its thrust limit in {100.0 * hardest.at_limit_thrusters:.0f} % of the "
        f"{plural(hardest.steps_done, 'step')} of `{hardest.scenario}`. Of all solvers' loops, "
        "this one is nearest to the reference loop. "
        f"{whole} of the {plural(len(configurations), 'configuration')} run in {names} "
        f"{'is' if whole == 1 else 'are'} accurate on every step{all_runs}."
    )


def make_wear_row(
    name: str, runs: Sequence[RunRecord], best: dict[str, RunRecord], requirements: Requirements
) -> dict[str, str]:
    """Return the table row of a solver's closed loops: loops right, power, wear, largest offset."""
    ended = [run for run in runs if run.steps_done == best[run.scenario].steps_done]
    right = sum(is_right_to_the_end(run, requirements) for run in runs)
    off = [run.dev_position_max_m for run in ended if math.isfinite(run.dev_position_max_m)]
    return {
        "configuration": name,
        "accurate in": f"{right} of {len(best)}",
        "power": _format_largest_ratio(ended, best, "power_share"),
        "wear": _format_largest_ratio(ended, best, "thrust_variation"),
        "azimuth travel": _format_largest_ratio(ended, best, "azimuth_travel_deg"),
        "largest deviation": f"{significant(max(off))} m" if off else MISSING,
    }


def _format_largest_ratio(
    runs: Sequence[RunRecord], best: dict[str, RunRecord], column: str
) -> str:
    """Format the largest ratio of a loop's metric, as wear, to that of the best loop."""
    largest = find_largest_ratio_to_best(runs, best, column)
    if math.isnan(largest):
        return MISSING
    return "equal to within 1 %" if abs(largest - 1.0) < LIKE else f"× {significant(largest)}"


def build_conclusion_topic(records: Records, verdicts: Verdicts) -> Topic | None:
    """Return the report's conclusions for an operator; None unless most loops command thrusters."""
    if not is_mostly_thruster_control(records):
        return None
    requirements, chosen = verdicts.requirements, choose_solver(verdicts).chosen
    commanded = compare_thrusters_with_forces(records, requirements)
    if not commanded.with_thrusters:
        return None
    margins = compute_speed_margins(records, requirements, of_thrusters=True)
    margin = None if chosen is None else margins.get(chosen.configuration)
    ships = find_ship_results(records)
    is_lost = any(ship.has_left_station or ship.overload > 1.0 for ship in ships)
    is_alone = sum(state != "not run" for state in commanded.with_thrusters.values()) == 1
    first = [
        _describe_solver_to_use(records, chosen, margin, is_alone=is_alone, is_lost=is_lost),
        _compare_with_forces(commanded),
    ]
    second = [
        *_yield_offset_after_loss_sentences(records, chosen, requirements),
        *_yield_consequence_sentences(records, chosen),
    ]
    lines = [" ".join(part for part in parts if part) for parts in (first, second)]
    return Topic("conclusion", "Conclusions", tuple(line for line in lines if line))


def _describe_solver_to_use(
    records: Records,
    chosen: Verdict | None,
    margin: SpeedMargin | None,
    *,
    is_alone: bool,
    is_lost: bool,
) -> str:
    """Return a text on the solver to use if MPC commands thrusters, and its deadline share.

    is_alone : whether no other solver was run. is_lost : whether a ship leaves its
    station, or cannot hold it for long.
    """
    if chosen is None:
        return "No solver can be recommended for a controller that commands thrusters."
    c = chosen.configuration
    label = f"For commanded thrusters use {c.solver} ({c.route} {c.policy}, {c.settings})"
    if is_alone and chosen.state == "pass":
        label = f"With commanded thrusters {c.label} passes; only {c.solver} was run"
    elif chosen.state != "pass":
        label = f"With commanded thrusters {c.label} is {chosen.state}"
    elif is_lost:
        call = f"{c.solver} ({c.route} {c.policy}, {c.settings})"
        label = f"As a solver of these QPs alone, {call} passes with commanded thrusters"
    if margin is None:
        return f"{label}; no replay times its QPs."
    step = margin.hardest
    share = format_sample_share(1.0 / margin.deadline)
    where = f"step {step.k} of the replay of {step.run.sequence}"
    wait = describe_hardest_wait(records, step.run)
    return f"{label}: its longest step, {where}, takes {share} of the sample time{wait}."


def _compare_with_forces(commanded: ThrusterVerdicts) -> str:
    """Return a text on solvers of three forces that fail with thrusters; "" without such runs."""
    before = commanded.passing_with_forces
    if not before:
        return ""
    missed, where = (
        commanded.list_solvers_with_state(*MISSED),
        join_with_and(list(commanded.forces)),
    )
    lost = [solver for solver in before if solver in missed]
    is_one = len(before) == 1
    verb = "passes" if is_one else "pass"
    head = f"{plural(len(before), 'solver')} {verb} with three forces ({where})"
    if not lost:
        return f"{head}; {'it does not fail' if is_one else 'none of them fails'} with thrusters."
    fail = "fails" if len(lost) == 1 else "fail"
    which = "it" if is_one else f"{len(lost)} of them"
    return f"{head}; {which} {fail} with thrusters: {_group_by_fault(commanded, lost)}."


def _group_by_fault(commanded: ThrusterVerdicts, solvers: Sequence[str]) -> str:
    """Return solvers as text, grouped by why they fail with thrusters."""
    of_fault = group_by_key(solvers, lambda solver: commanded.faults[solver])
    return "; ".join(f"{join_with_and(names)}, {fault}" for fault, names in of_fault.items())


def _yield_offset_after_loss_sentences(
    records: Records, chosen: Verdict | None, requirements: Requirements
) -> Iterator[str]:
    """Yield sentences on how far from its reference the ship stays after thrusters are lost."""
    if chosen is None:
        return
    for run in records.select_runs(mode="closed_loop", units="scaled"):
        lost, own = (
            list_late_losses(run),
            run.configuration.moved_to_common_formulation == chosen.configuration,
        )
        if own and lost and isfinite(run.r_tail_max_m) and is_right_to_the_end(run, requirements):
            opening = f"After the loss of {join_with_and(lost)} ({run.scenario}), the ship"
            use = run.thruster_use
            thrust = f" It uses {describe_thrust_used(use)}." if use else ""
            if run.r_tail_max_m > run.station_radius_m:
                far, after = (
                    significant(run.r_tail_max_m),
                    f"{_compute_seconds_after_loss(run):.0f} s",
                )
                yield (
                    f"{opening} with this solver drifts away: its offset, at the start of each "
                    f"step, reaches {far} m within {after} of the loss.{thrust}"
                )
            else:
                within = format_rounded_up(run.r_tail_max_m, 2)
                yield f"{opening} with this solver stays within {within} m.{thrust}"


def _compute_seconds_after_loss(run: RunRecord) -> float:
    """Return how long a closed loop runs after its first loss of thrusters [s]."""
    scenario = (run.scenario_documents or {})["scenario"]
    at_s = min(fault["at_s"] for fault in scenario["faults"] if fault.get("lost"))
    return float(scenario["sample_s"] * run.steps_done - at_s)


def _yield_consequence_sentences(records: Records, chosen: Verdict | None) -> Iterator[str]:
    """Yield sentences: thruster losses that could be held, solvers that report so rightly."""
    analyses = build_consequence_analyses(records)
    if not analyses:
        return
    held_at_end = []
    for analysis in analyses:
        spans = analysis.spans
        last = spans[spans["losses"] == spans["losses"].max()].groupby("group").last()
        if last.empty:
            continue
        held = int((last["state"] == HELD).sum())
        count = {0: "none", len(last): "all"}.get(held, str(held))
        before = describe_losses_before(analysis, int(last["losses"].iloc[0]))
        after, further = (f", {before},", "further ") if before else ("", "")
        losses = f"{further}{'losses' if len(last) > 1 else 'loss'}"
        where = f"at {last['to_s'].max():.0f} s of {analysis.name.split('[')[0]}{after}"
        held_at_end.append(f"{where} {count} of {len(last)} {losses} could be held")
    if held_at_end:
        yield f"In the static consequence analysis, {', '.join(held_at_end)}."
    yield from dict.fromkeys(text for one in analyses for text in list_analysis_cautions(one))
    own = select_configurations_in_all_analyses(analyses)
    right = [name for name, of_it in own.items() if all(a.has_only_right_answers for a in of_it)]
    shares = {name: find_largest_solve_time_share(own[name]) for name in right}
    timed = {name: share for name, share in shares.items() if isfinite(share)}
    wording = ["No solver answers all these QPs correctly"]
    if timed:
        best = min(timed, key=lambda name: timed[name])
        share = format_sample_share(timed[best])
        wording = [f"{best} finds this at every sample in at most {share} of a sample"]
    label = ""
    if chosen is not None:
        c = chosen.configuration
        level = "" if c.settings == "default" else f", {c.settings}"
        modes = (f" ({c.route}, {c.policy}{level})", f" ({c.route}{level})", "")
        label = next((c.solver + mode for mode in modes if c.solver + mode in own), "")
    if label and label not in right:
        wrong = sum(a.asked - a.held - a.refused for a in own[label])
        requested = plural(sum(a.asked for a in own[label]), "QP")
        wording.append(f"{label} leaves {wrong} of {requested} without a correct answer")
    missing = sorted({a.solver for of_it in own.values() for a in of_it if a.missed})
    misses = "misses" if len(missing) == 1 else "miss"
    wording += [f"{join_with_and(missing)} {misses} alarms"] if missing else []
    yield f"{'; '.join(wording)}."
