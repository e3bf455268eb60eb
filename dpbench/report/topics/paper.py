"""The paper: its figures 4-7 and its claims, each with what the runs show; stability.

The wording of the claims is in `paper.toml`, their criteria are in the analysis.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from dpbench.analysis.records.records import Records
from dpbench.analysis.suites.paper import (
    OF_PAPER,
    PAPER,
    State,
    assess_paper_claim,
    find_mpc_and_clipped_runs,
    is_paper_scenario,
    read_laws_in_paper_scenario,
)
from dpbench.analysis.verdict.requirements import Requirements
from dpbench.analysis.verdict.verdict import find_wrong_answers
from dpbench.bench.design import STILL, WEATHER, Bracket, Designs
from dpbench.report.charts.ship import draw_forces, draw_increments, draw_path, draw_pose_errors
from dpbench.report.formats import (
    MISSING,
    Table,
    format_rounded_down,
    format_rounded_up,
    join_with_and,
    plural,
    strip_markdown,
)
from dpbench.report.page.citations import PAPER_CITATION
from dpbench.report.page.section import Figure, Topic
from dpbench.report.verdict.findings_text import describe_findings
from dpbench.report.words import fill_template, read_words

DRAWN = (
    ("path", draw_path, "Simulated Fig. 4 shows the path of the ship and the 1 m circle."),
    ("errors", draw_pose_errors, "Simulated Fig. 5 shows the position and heading errors."),
    ("forces", draw_forces, "Simulated Fig. 6 shows the forces and their limits."),
    (
        "increments",
        draw_increments,
        "Simulated Fig. 7 shows the control moves and the maximum increments.",
    ),
)
"""Figures 4 to 7: name, function, caption."""
BASES = ("read from Fig.", "set by dpbench", "chosen by dpbench")
"""Marks in the paper's words of a claim that it does not state so."""
STILL_OFFSET = f"sway offset held, {STILL} [m]"
WEATHER_OFFSET = f"in the weather of {WEATHER} [m]"


def build_paper_topic(records: Records, designs: Designs | None = None) -> Topic | None:
    """Return the report's part on the paper's figures and claims; None without its runs."""
    laws, scenario = read_laws_in_paper_scenario(records), records.build_scenario(PAPER)
    judged = judge_claims(records)
    measured = [claim for claim in judged if claim.state != "not simulated"]
    if scenario is None or not laws or not measured:
        return None
    others = {"does not reproduce": "not reproduced", "contradicts": "contradicted"}
    wording = [describe_count_reproduced(judged)]
    for verb, state in others.items():
        names = [strip_markdown(claim.claim) for claim in measured if claim.state == state]
        claims = "the claim" if len(names) == 1 else "the claims"
        wording += [f"The simulation {verb} {claims} “{'”, “'.join(names)}”"] if names else []
    wording += _describe_inaccurate_solvers(records)
    return Topic(
        id="paper",
        title="The paper",
        lines=(". ".join(wording) + ".",),
        paste=PAPER_CITATION,
        figures=tuple(
            Figure(f"paper-{name}", draw(laws, scenario), caption) for name, draw, caption in DRAWN
        ),
        tables=(
            Table(
                ("claim", "paper states", "simulated here", "state"),
                tuple((one.claim, one.stated_in_paper, one.found, one.state) for one in judged),
                "Claims of the paper",
                _WORDS["notes"]["claims"],
                folded=True,
                labels={"paper states": "statement in the paper", "state": "result"},
            ),
            Table(
                ("not specified by the paper", "assumed here"),
                tuple(list_choices(records)),
                "Assumptions where the paper is incomplete",
                folded=True,
            ),
            *([_make_stability_table(records, designs)] if designs is not None else ()),
        ),
    )


def build_stability_topic(records: Records, designs: Designs | None) -> Topic | None:
    """Return the report's part on the stability of controllers; None if none was analysed.

    Of results with the paper's scenario, `build_paper_topic` contains the same table.
    """
    if designs is None or not designs.records:
        return None
    stable = sum(record.spectral_radius < 1.0 for record in designs.records)
    count = plural(len(designs.records), "controller")
    is_are = "is" if stable == 1 else "are"
    return Topic(
        id="stability",
        title="Stability",
        lines=(f"{stable} of {count} {is_are} stable without active limits.",),
        tables=(replace(_make_stability_table(records, designs), folded=False),),
    )


def _describe_inaccurate_solvers(records: Records) -> list[str]:
    """Return a sentence on each loop behind the claims that its solver did not solve accurately."""
    requirements = Requirements.from_suite(records.suite)
    used = (find_mpc_and_clipped_runs(records, name).constrained for name in OF_PAPER)
    runs = [run for run in used if run and is_paper_scenario(records, run.scenario)]
    return [
        f"The simulation used `{run.solver}`, which is not accurate enough: "
        f"{describe_findings(wrong)}"
        for run in runs
        if (wrong := find_wrong_answers(records, [run], requirements))
    ]


def describe_count_reproduced(judged: "Sequence[Claim]") -> str:
    """Return a sentence: how many claims of the paper are reproduced, how many not simulated."""
    states = [claim.state for claim in judged]
    held, missing = states.count("reproduced"), states.count("not simulated")
    why = "as no complete runs of both control laws were made"
    if any(claim.found == _WORDS["found"]["no clipped law"] for claim in judged):
        why += " (add `--solver unconstrained_clipped` to run the baseline law)"
    open_ones = f", and {missing} not simulated, {why}" if missing else ""
    return (
        f"{held} of {len(states)} claims of Xia, Liu, Pang & Xue are reproduced"
        f"{_describe_basis(judged)}{open_ones}"
    )


def _describe_basis(judged: "Sequence[Claim]") -> str:
    """Return how many reproduced claims rest on a figure or a choice of dpbench, as a clause."""
    held = [claim.stated_in_paper for claim in judged if claim.state == "reproduced"]
    marked = sum(any(mark in stated for mark in BASES) for stated in held)
    are = "are" if marked > 1 else "is"
    why = f"{are} read from a figure, or tested with a limit or weights chosen by dpbench"
    return f"; {marked} of these {len(held)} {why}" * bool(marked)


def _make_stability_table(records: Records, designs: Designs) -> Table:
    """Return a table of each controller's closed-loop spectral radius and sway offset it holds."""
    is_run = any(run.scenario == WEATHER for run in records.all_runs)
    absent = "" if is_run else " (not in this suite)"
    untested = [record.controller for record in designs.records if not record.held]
    remedy = "".join(
        f" A dash (–) is a range that was not computed: `dpbench check {name}` computes that in "
        f"{STILL}, and a suite with a table `[design]` computes both."
        for name in untested[:1]
    )
    return Table(
        (
            "controller",
            "largest |λ| (eq. 35)",
            STILL_OFFSET,
            WEATHER_OFFSET,
        ),
        tuple(
            (
                f"{record.tuning} {record.N_p}/{record.N_c}, ship {record.vessel}",
                f"{record.spectral_radius:.4f}",
                *(_format_bracket(record.held.get(weather)) for weather in (STILL, WEATHER)),
            )
            for record in designs.records
        ),
        "Stability of the controller",
        "A controller is stable if all eigenvalues λ of its closed loop without active limits have "
        "|λ| < 1. A name such as `paper 30/5` gives the tuning, the "
        "prediction horizon and the control horizon (both in steps). "
        f"{_name_scenarios_of_controllers(designs)} The columns of sway offsets bracket the "
        "largest offset from which the ship returns: it returned from the first value, but not "
        "from the second; ≥ means that it returned from every offset tested. The last column is "
        f"for the weather of scenario `{WEATHER}`{absent}, whose moderate forces build up over "
        f"the first minute.{remedy}",
        folded=True,
        labels={
            STILL_OFFSET: f"recoverable sway offset, {STILL} [m]",
            WEATHER_OFFSET: f"recoverable sway offset, weather of scenario {WEATHER} [m]",
        },
    )


def _name_scenarios_of_controllers(designs: Designs) -> str:
    """Return a sentence on the scenarios whose controllers the table analyses."""
    used = {f"{one.tuning} {one.N_p}/{one.N_c}": one.controller for one in designs.records}
    named = [f"`{name}` is the controller of scenario `{where}`" for name, where in used.items()]
    return f"{join_with_and(named)}."


def _format_bracket(bracket: Bracket | None) -> str:
    """Return as text the largest sway offset a controller holds and the least it does not [m]."""
    if bracket is None:
        return MISSING
    if bracket.fails_m is None:
        return f"≥ {bracket.holds_m:.3g}"
    if bracket.holds_m == 0.0:
        return f"< {format_rounded_up(bracket.fails_m)}"
    return f"{format_rounded_down(bracket.holds_m)} – {format_rounded_up(bracket.fails_m)}"


_WORDS = read_words(__file__)


@dataclass(frozen=True)
class Claim:
    """Claim of the paper: text, the paper's own words, what was simulated, if it is reproduced."""

    claim: str
    stated_in_paper: str
    found: str
    state: State


def judge_claims(records: Records) -> list[Claim]:
    """Return the findings on all claims of the paper by a folder's runs, in the paper's order."""
    requested = [
        (text, stated, assess_paper_claim(records, where, by))
        for text, where, by, stated in _WORDS["claims"]
    ]
    wording = _WORDS["found"]
    return [
        Claim(text, stated, fill_template(wording[of.by], **of.values), of.state)
        for text, stated, of in requested
    ]


def list_choices(records: Records) -> list[tuple[str, str]]:
    """Return what the paper leaves open, and the choice of the recorded scenario `paper`."""
    scenario = records.build_scenario(PAPER)
    if scenario is None or not is_paper_scenario(records, PAPER):
        return []
    chosen = {
        "vessel": scenario.vessel,
        "Q": scenario.problem.Q,
        "R": scenario.problem.R,
        "sea": scenario.files["scenario"]["environment"],
        "duration_s": scenario.steps * scenario.sample_s,
    }
    return [(name, fill_template(words, **chosen)) for name, words in _WORDS["choices"].items()]
