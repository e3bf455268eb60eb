"""Terms in the texts of a page, each a link to the page's glossary, and its list of scenarios."""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape

from dpbench.analysis.records.run_record import RunRecord
from dpbench.analysis.verdict.run_matrix import Experiment
from dpbench.analysis.verdict.simulated_losses import list_losses
from dpbench.report.formats import bind_units, format_share
from dpbench.report.page.data import PageData
from dpbench.report.words import term_meanings, topics

_OWN_PHRASES = (
    "accurate, active limits, certified optimum, claimed, closed loop, deadline, deployable, "
    "requirements, disturbed, reference loop, failed step, fallback, fresh, interval, "
    "native, paired ratio, qpsolvers, radial error, rate limit, maximum increment, "
    "on station, referee, region of attraction, replay, reuse, round, settings, warm, call mode, "
    "window"
)
PHRASES = {
    **{name: name for name in _OWN_PHRASES.split(", ")},
    "error of the first move": "error of the first move (error_move)",
    "single timing": "single timing",
    "exactly solved qp": "reference loop",
    "scaled up": "limiting p99",
    "limiting p99": "limiting p99",
    "speed margin": "speed margin",
    "p50": "p50, p95, p99",
    "p99": "p50, p95, p99",
}
"""Term of the glossary by phrase. Everyday words such as *step* would link every second word."""
_FOUND = re.compile(
    r"(?<![\w-])(?:" + "|".join(sorted(map(re.escape, PHRASES), key=len, reverse=True)) + r")s?\b",
    re.IGNORECASE,
)

DRAG_MISMATCH = "Cross-flow drag acts on the ship; the controller's model is linear."

_HEAD_TOPICS = (
    "Solvers and configurations",
    "Studies",
    "Commanded thrusters",
)
_OF_HEADS = {term for title in _HEAD_TOPICS for term in topics()[title]}
"""Glossary terms that may be column heads; in other topics a head may mean another thing: *error*
for a status."""


@dataclass(frozen=True)
class GlossaryEntry:
    """Entry of the page's glossary: anchor, term and meaning."""

    id: str
    term: str
    meaning: str


def find_entry(term: str) -> GlossaryEntry:
    """Return the glossary entry of a term, with its anchor on the page."""
    slug = re.sub(r"[^a-z0-9]+", "-", term.lower()).strip("-")
    return GlossaryEntry(f"word-{slug}", term, bind_units(term_meanings()[term]))


class Terms:
    """Converter of terms in the page's texts to links to its glossary, once per section.

    listed : terms of the list whether they are met or not, in its order.
    """

    def __init__(self, listed: Iterable[str]) -> None:
        self._listed = dict.fromkeys(listed)
        self._here: set[str] = set()

    def start_section(self) -> str:
        """Start a new page section, in which every term is linked once more; return ""."""
        self._here.clear()
        return ""

    def __call__(self, text: str) -> Markup:
        """Return a text as HTML: terms linked to the page's glossary, Markdown's code as code."""
        return self._mark(text.replace("**", ""), self._link_terms)

    def _link_terms(self, text: str) -> Markup:
        """Return a text without code as HTML, with its terms linked to the page's glossary."""
        parts, end = [], 0
        for found in _FOUND.finditer(text):
            phrase = found[0].lower()
            term = PHRASES.get(phrase) or PHRASES[phrase.removesuffix("s")]
            if term not in self._here:
                parts += [escape(text[end : found.start()]), self._link_term(term, found[0])]
                end = found.end()
        return Markup("").join([*parts, escape(text[end:])])

    def head(self, text: str) -> Markup:
        """Return a table head as HTML, linked to the glossary if it is a term."""
        term = re.sub(r" \[.*\]$", "", text)
        known = term in _OF_HEADS and term not in self._here
        return self._link_term(term, text) if known else escape(text)

    def _link_term(self, term: str, text: str) -> Markup:
        """Return a text as link to a term's glossary entry; record that the term was used."""
        self._here.add(term)
        self._listed[term] = None
        return self.link(find_entry(term), text)

    @staticmethod
    def link(word: GlossaryEntry, text: str) -> Markup:
        """Return an HTML link from a text to an entry of the page's glossary."""
        return Markup('<a class="term" href="#{}" title="{}">{}</a>').format(
            word.id, word.meaning.replace("`", ""), text
        )

    @staticmethod
    def mark_code(text: str) -> Markup:
        """Return a text as HTML without links, with Markdown's code as code."""
        return Terms._mark(text, escape)

    @staticmethod
    def _mark(text: str, convert: Callable[[str], Markup]) -> Markup:
        """Return a text as HTML, Markdown's code as code and the other parts converted."""
        return Markup("").join(
            Markup("<code>{}</code>").format(part) if i % 2 else convert(part)
            for i, part in enumerate(bind_units(text).split("`"))
        )

    @property
    def words(self) -> list[GlossaryEntry]:
        """Glossary entries to list: the requested terms, then those that were linked."""
        return [find_entry(term) for term in self._listed]


MOST_EXPERIMENTS = 60


def describe_experiments(data: PageData) -> dict[int, GlossaryEntry]:
    """Return what happens in each scenario and replay that enters verdicts, by its index."""
    first: dict[int, RunRecord] = {}
    for (_, p), run in data.runs.items():
        if p not in first or not first[p].has_steps:
            first[p] = run
    named = {
        p: _describe_scenario(data, data.experiments[p], first[p])
        for p in data.judged_experiment_indices[:MOST_EXPERIMENTS]
    }
    return {
        p: GlossaryEntry(f"experiment-{p}", data.experiments[p].label, wording)
        for p, wording in named.items()
        if wording
    }


def _describe_scenario(data: PageData, experiment: Experiment, run: RunRecord) -> str:
    """Return a plain text on the scenario of a closed loop or replay, for the page."""
    scenario = data.build_scenario_of_run(run) if run.scenario else None
    if scenario is None:
        return ""
    shows = re.split(r"(?<=\.)\s+(?=[A-Z])", scenario.shows.strip())[0]
    parts = [f"{part.strip().rstrip('.')}." for part in (scenario.title, shows) if part.strip()]
    if scenario.true_ship.drag is not None:
        parts.append(DRAG_MISMATCH)
    if experiment.mode == "replay":
        parts.append(_describe_replay(data, run))
    if experiment.units == "si":
        parts.append(
            "Here in SI units (N, N·m), unscaled; these runs do not count towards the overall "
            "verdict."
        )
    if experiment.slowdown > 0:
        parts.append(
            f"Here on a computer × {experiment.slowdown:g} slower, whose solutions come later."
        )
    return " ".join(parts).replace("`", "")


def _describe_replay(data: PageData, run: RunRecord) -> str:
    """Return as text which steps of a loop are replayed, and the share with active limits."""
    first, window, loop = run.first_step, "", "reference loop"
    loops = [one for one in data.records.runs if one.mode == "closed_loop"]
    controlled = max((o.steps_planned for o in loops if o.scenario == run.scenario), default=0)
    if "[" in run.sequence:
        window = f"steps {first} to {first + run.steps_planned - 1} of "
    if 0 < controlled <= first:
        loop = f"reference loop (the solvers' closed loops end at step {controlled - 1})"
    kept = data.thinned_runs.get(run.run_id)
    if kept is None or not kept.is_whole:  # the steps kept of a long run are its hardest
        return f"Replay of {window}its {loop}."
    share = format_share(float(np.mean(kept.steps.n_active > 0)))
    end_s = (first + run.steps_planned) * run.sample_s
    lost = ", with those of lost thrusters" * any(at_s < end_s for at_s, _ in list_losses(run))
    return (
        f"Replay of {window}its {loop}. At least one limit is active in {share} of the "
        f"replayed steps{lost}."
    )
