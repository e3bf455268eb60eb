"""`dpbench tune`: weights and horizons that hold a ship with margin, at little wear.

The controller found, and the scenario's own, are tried in the end in realisations of the seas that
the search never met.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from dpbench.bench.progress import Progress, Silent
from dpbench.errors import InputError, SituationError, require_integer_at_least
from dpbench.files.opening import read_bytes
from dpbench.files.writing import write_text_atomically
from dpbench.report.charts.render import save_figure
from dpbench.report.charts.study import draw_tuning_front
from dpbench.report.formats import plural, significant
from dpbench.scenario.own_ship import DP_NUMBERS
from dpbench.scenario.scenario import Scenario, load_scenario
from dpbench.scenario.writing import write_scenario_and_own_ship_files
from dpbench.solvers.contract import Options
from dpbench.solvers.own_settings import format_options_as_toml
from dpbench.tuning.controllers import (
    LoopScore,
    Realisation,
    change_controller,
    change_sea_of_scenario,
    choose_controller,
    draw_realisations,
    find_pareto_front,
    make_controller_space,
    make_unchanged_options,
    rate_controller,
)
from dpbench.tuning.search import Trial, TrialSearch

TRIALS, REALISATIONS, MARGIN = 48, 2, 0.7
NO_PROMISE = (
    "The real ship differs from this model in mass, damping and thrust.",
    "Other seas, or these seas from another direction, were not tried.",
    "A longer time in the same sea may bring a larger offset than these realisations.",
    "Stability is not proven, and only the faults of the scenario were tried.",
    "Solve time grows with the horizons and was not measured: run the scenario in a suite.",
)
"""Limits of the result, printed after it."""
_MOST_BYTES = 2**26


@dataclass(frozen=True)
class ControllerTuning:
    """Result of a search: all trials, the chosen one, and scores in fresh realisations.

    fresh, own_fresh : of the chosen controller and of the scenario's own.
    """

    trials: Sequence[Trial[LoopScore]]
    chosen: Trial[LoopScore]
    fresh: LoopScore
    own_fresh: LoopScore
    margin: float
    seas: str
    paths: Sequence[Path]

    @property
    def trial_of_own_controller(self) -> Trial[LoopScore]:
        """The trial of the scenario's own controller."""
        return self.trials[0]

    @property
    def keeps_margin(self) -> bool:
        """Return whether the best controller keeps the offset margin, in search and fresh seas."""
        return max(self.chosen.score.share, self.fresh.share) <= self.margin

    @property
    def table(self) -> pd.DataFrame:
        """Table with a row for each trial: options, share, wear_per_h, kind."""
        front = {trial.name for trial in find_pareto_front(self.trials)}
        kinds = {trial.name: "front" if trial.name in front else "tried" for trial in self.trials}
        kinds |= {self.trial_of_own_controller.name: "own"} | {self.chosen.name: "chosen"}
        rows = [{**t.options, **asdict(t.score), "kind": kinds[t.name]} for t in self.trials]
        return pd.DataFrame(rows)

    @property
    def lines(self) -> list[str]:
        """The result of a search for controller weights in words, with what it does not promise."""
        limit = f"{self.margin:.0%} of the station"
        if self.chosen.score.share > self.margin:
            verdict = f"none of {len(self.trials)} controllers stays within {limit}; the nearest"
        else:
            verdict = f"least wear of {len(self.trials)} controllers within {limit}"
        held = "within" if self.fresh.share <= self.margin else "NOT within"
        return [
            f"{verdict}: {self.chosen.name}",
            f"search, {self.seas}: {_describe_score(self.chosen.score)}; own controller "
            f"{_describe_score(self.trial_of_own_controller.score)}",
            f"fresh realisations, {held} {limit}: {_describe_score(self.fresh)}; own controller "
            f"{_describe_score(self.own_fresh)}",
            *(f"wrote {path}" for path in self.paths),
            "Limits of this result:",
            *NO_PROMISE,
        ]


def _describe_score(score: LoopScore) -> str:
    """Format the score of a controller: offset and wear of the thrusters."""
    return f"offset {score.share:.0%}, wear {significant(score.wear_per_h)} per hour"


class _KeptTrials:
    """Scores of the finished trials of one search in a JSON lines file."""

    def __init__(self, path: Path, search: str) -> None:
        self._path, self._scores = path, dict[str, LoopScore]()
        head = json.dumps({"search": search})
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text_atomically(path, f"{head}\n")
            return
        text = read_bytes(path, "the trials of a search", most_bytes=_MOST_BYTES).decode()
        # A line without an end is that of an interrupted write.
        whole = text[: text.rfind("\n") + 1]
        first, *lines = whole.splitlines() or [""]
        if first != head:
            found = f"{path} is of another search; name another folder (--out)"
            raise SituationError("--out", found)
        for number, line in enumerate(lines, 2):
            try:
                name, share, wear = json.loads(line)
                self._scores[name] = LoopScore(float(share), float(wear))
            except (ValueError, TypeError) as error:
                allowed = "a name and two numbers"
                raise InputError(str(path), f"line {number}", repr(line[:80]), allowed) from error
        if whole != text:
            write_text_atomically(path, whole)

    def find_stored_score(self, name: str) -> LoopScore | None:
        """Return the stored score of a trial by its name; None where it is not finished."""
        return self._scores.get(name)

    def store_score(self, name: str, score: LoopScore) -> None:
        """Store the score of a finished trial on disk, by the trial's name."""
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps([name, score.share, score.wear_per_h]) + "\n")


def tune_controller(
    scenario: str | Path,
    *,
    seas: str = "",
    trials: int = TRIALS,
    realisations: int = REALISATIONS,
    margin: float = MARGIN,
    steps: int = 0,
    seed: int = 1,
    out: str | Path | None = None,
    progress: Progress | None = None,
) -> ControllerTuning:
    """Search a controller's weights and horizons; write the best, return it with all trials.

    Finished trials are kept: the same call goes on after an interruption.

    Parameters
    ----------
    scenario : by name or a TOML file.
    seas : DP numbers such as "4,5"; "" for the scenario's own weather.
    trials : controllers to try; realisations : of each sea.
    margin : largest offset wanted, as a share of the station's limits.
    steps : of each loop, 0 for all of the scenario; seed : of the search.
    out : folder; by default `results/tune-SCENARIO`.

    Raises
    ------
    InputError : for bad input, or a folder with the trials of another search.
    """
    base = load_scenario(scenario)
    numbers = _parse_seas(seas)
    _refuse_bad_numbers(trials, realisations, margin, steps, seed)
    steps = min(steps or base.steps, base.steps)
    name = base.name.replace("@", "_")
    folder = Path("results") / f"tune-{name}" if out is None else Path(out)
    for number in numbers:
        change_sea_of_scenario(base, Realisation(number, 0))
    kept = _KeptTrials(
        folder / "trials.jsonl", _compute_search_digest(base, numbers, realisations, steps)
    )
    bar = progress or Silent()
    searched = draw_realisations(base, numbers, 0, realisations, steps)
    other = draw_realisations(base, numbers, realisations, realisations, steps)
    bar.start((trials + 3) * len(searched) * steps)

    def rate(options: Options, at: Sequence[Realisation], role: str) -> LoopScore:
        name = f"{role}{format_options_as_toml(options)}"
        score = kept.find_stored_score(name)
        if score is None:
            score = rate_controller(base, options, at, steps)
            kept.store_score(name, score)
        bar.advance(len(at) * steps, f"{role}{_describe_score(score)}")
        return score

    own = make_unchanged_options(base)
    first = Trial(own, np.empty(0), rate(own, searched, ""))
    search = TrialSearch[LoopScore](
        make_controller_space(base),
        lambda settings: [rate(options, searched, "") for options in settings],
        find_pareto_front,
        seed,
    )
    search.run(trials)
    found = [first, *search.trials]
    chosen = choose_controller(found, margin)
    fresh, own_fresh = (rate(options, other, "fresh: ") for options in (chosen.options, own))
    seas_text = f"DP {', '.join(map(str, numbers))}" if numbers else "its own weather"
    seas_text += f", {plural(realisations, 'realisation')} each"
    tuning = ControllerTuning(found, chosen, fresh, own_fresh, margin, seas_text, ())
    return _write_tuning(tuning, base, folder, name)


def _write_tuning(
    tuning: ControllerTuning, base: Scenario, folder: Path, name: str
) -> ControllerTuning:
    """Write a tuned scenario, table of trials and figure; return the result with their paths."""
    changed = change_controller(base, tuning.chosen.options)
    comment = "\n".join(("Controller found by `dpbench tune`.", *tuning.lines))
    paths = write_scenario_and_own_ship_files(changed.files, folder / f"{name}_tuned.toml", comment)
    table = tuning.table
    write_text_atomically(folder / "tune.csv", table.to_csv(index=False))
    drawn = table[["share", "wear_per_h", "kind"]].copy()
    drawn["options"] = [trial.name for trial in tuning.trials]
    # A logarithmic axis has no zero, and a ship that is lost no place on it.
    drawn[["share", "wear_per_h"]] = drawn[["share", "wear_per_h"]].clip(1e-3, 1e4)
    chart = draw_tuning_front(drawn, f"{base.name}: offset and wear", tuning.margin)
    figure = save_figure(chart, folder / "front.svg")
    fields: dict[str, Any] = vars(tuning) | {"paths": [*paths, folder / "tune.csv", figure]}
    return ControllerTuning(**fields)


def _parse_seas(text: str) -> list[int]:
    """Return the DP numbers in a text such as "4,5"; InputError for another text."""
    words = [word.strip() for word in text.split(",")] if text else []
    if len(set(words)) < len(words) or any(word not in map(str, DP_NUMBERS) for word in words):
        allowed = f"DP numbers from 1 to {max(DP_NUMBERS)}, each once, as 4,5"
        raise InputError("--seas", "", repr(text)[:80], allowed)
    return [int(word) for word in words]


def _refuse_bad_numbers(
    trials: int, realisations: int, margin: float, steps: int, seed: int
) -> None:
    """Raise InputError for an impossible number of trials or realisations, margin or seed."""
    require_integer_at_least("--trials", trials, 1)
    require_integer_at_least("--realisations", realisations, 1)
    require_integer_at_least("--steps", steps, 0)
    require_integer_at_least("--seed", seed, 0)
    if not 0.0 < margin <= 1.0:
        raise InputError("--margin", "", margin, "a number above 0, at most 1")


def _compute_search_digest(
    base: Scenario, seas: Sequence[int], realisations: int, steps: int
) -> str:
    """Return a digest of everything that the score of a trial depends on."""
    content = json.dumps([base.files, list(seas), realisations, steps], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()
