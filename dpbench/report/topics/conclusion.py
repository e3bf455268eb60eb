"""What an operator whose controller steers thrusters should conclude, in a few sentences."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from math import isfinite

from dpbench.analysis.records.grouping import grouped
from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.consequence import (
    HELD,
    Analysis,
    consequence_analyses,
    in_all,
    largest_share,
)
from dpbench.analysis.verdict.fastest import choose_solver
from dpbench.analysis.verdict.requirements import Requirements, is_right_to_the_end
from dpbench.analysis.verdict.steering import Steering, is_about_thrusters, lost_late, steering_of
from dpbench.analysis.verdict.verdict import Verdict, Verdicts
from dpbench.report.formats import and_list, of_sample_text, plural, rounded_up
from dpbench.report.page.section import Topic


def conclusion_topic(records: Records, verdicts: Verdicts) -> Topic | None:
    """Return the conclusion for a suite about thrusters, else None."""
    if not is_about_thrusters(records):
        return None
    requirements, chosen = verdicts.requirements, choose_solver(verdicts).chosen
    steering = steering_of(records, requirements)
    if not steering.with_thrusters:
        return None
    first = [_use(chosen, requirements), _others(steering)]
    second = [*_after_a_loss(records, chosen, requirements), *_consequence(records, chosen)]
    lines = [" ".join(part for part in parts if part) for parts in (first, second)]
    return Topic("conclusion", "What to conclude", tuple(line for line in lines if line))


def _use(chosen: Verdict | None, requirements: Requirements) -> str:
    """Name the solver to use, and its share of the deadline."""
    if chosen is None:
        return "No solver can be recommended for a controller that steers thrusters."
    share = of_sample_text(chosen.algo_max_ns / requirements.deadline_ns)
    if chosen.state != "pass":
        label = chosen.configuration.label
        return f"Nothing contradicts {label}; its largest step takes {share} of the sample."
    return (
        f"To steer thrusters take {_label(chosen)}: its largest step takes {share} of the sample."
    )


def _label(verdict: Verdict) -> str:
    c = verdict.configuration
    return f"{c.solver} ({c.route}, {c.policy}, {c.settings})"


def _others(steering: Steering) -> str:
    """Name the solvers that pass with three forces but not with thrusters; else those that pass."""
    before = steering.fine_with_forces
    if not before:
        fine, run = len(steering.fine), len(steering.with_thrusters)
        said = [f"{fine} of {plural(run, 'solver')} {_pass(fine)}"]
        said = said if fine else ["no solver that was run is known to pass"]
        missing, unknown = steering.missing, steering.undecided
        said += [f"not so: {_by_fault(steering, missing)}"] if missing else []
        said += [f"inconclusive: {and_list(unknown)}"] if unknown else []
        return f"{said[0].capitalize()}{'; '.join(['', *said[1:]])}."
    lost, where = steering.only_with_forces, and_list(list(steering.forces))
    head = f"Of {plural(len(before), 'solver')} that {_pass(len(before))} with "
    head += f"three forces ({where})"
    if not lost:
        return f"{head}, none fails with thrusters."
    fail = "fails" if len(lost) == 1 else "fail"
    return f"{head}, {len(lost)} {fail} with thrusters: {_by_fault(steering, lost)}."


def _pass(count: int) -> str:
    return "passes" if count == 1 else "pass"


def _by_fault(steering: Steering, solvers: Sequence[str]) -> str:
    """List solvers with their fault, those of the same fault together."""
    of_fault = grouped(solvers, lambda solver: steering.faults[solver])
    return "; ".join(f"{and_list(names)}, {fault}" for fault, names in of_fault.items())


def _after_a_loss(
    records: Records, chosen: Verdict | None, requirements: Requirements
) -> Iterator[str]:
    """State how far off the ship is after thrusters are lost, where the answers are right."""
    if chosen is None:
        return
    for run in records.select(mode="closed_loop", units="scaled"):
        lost, own = lost_late(run), run.configuration.in_common_formulation == chosen.configuration
        if own and lost and isfinite(run.r_tail_max_m) and is_right_to_the_end(run, requirements):
            yield (
                f"After the loss of {and_list(lost)} ({run.scenario}) the ship it steers stays "
                f"within {rounded_up(run.r_tail_max_m, 2)} m."
            )


def _consequence(records: Records, chosen: Verdict | None) -> Iterator[str]:
    """State the further losses that could be held, the solvers that report so, and their times."""
    analyses = consequence_analyses(records)
    if not analyses:
        return
    yield f"{', '.join(map(_end, analyses)).capitalize()}."
    own = in_all(analyses)
    right = [name for name, of_it in own.items() if all(a.all_right for a in of_it)]
    shares = {name: largest_share(own[name]) for name in right}
    timed = {name: share for name, share in shares.items() if isfinite(share)}
    said = ["nobody answers all of that rightly"]
    if timed:
        best = min(timed, key=lambda name: timed[name])
        share = of_sample_text(timed[best])
        said = [f"to know so at every sample takes {best} at most {share} of a sample"]
    label = "" if chosen is None else _of_batches(chosen, own)
    if label and label not in right:
        wrong = sum(a.asked - a.held - a.refused for a in own[label])
        asked = plural(sum(a.asked for a in own[label]), "QP")
        said.append(f"{label} leaves {wrong} of {asked} without a right answer")
    missing = sorted({a.solver for of_it in own.values() for a in of_it if a.missed})
    said += [f"alarms are missed by {and_list(missing)}"] if missing else []
    yield f"{said[0][0].upper()}{'; '.join(said)[1:]}."


def _of_batches(chosen: Verdict, names: Iterable[str]) -> str:
    """Return the name of the chosen configuration among some names; "" where it is none of them."""
    c = chosen.configuration
    level = "" if c.settings == "default" else f", {c.settings}"
    known = (
        f"{c.solver} ({c.route}, {c.policy}{level})",
        f"{c.solver} ({c.route}{level})",
        c.solver,
    )
    return next((name for name in known if name in names), "")


def _end(analysis: Analysis) -> str:
    """State how many losses could be held at the end of a consequence analysis."""
    last = analysis.spans.groupby("group", sort=False).last()
    held = int((last["state"] == HELD).sum())
    count = {0: "none", len(last): "all"}.get(held, str(held))
    where, losses = analysis.name.split("[")[0], "losses" if len(last) > 1 else "loss"
    at_s = f"{last['to_s'].max():.0f} s"
    return f"at {at_s} of {where} {count} of {len(last)} {losses} could be held"
