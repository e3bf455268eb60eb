"""`dpbench tune`: weights and horizons that hold a ship with margin, at little wear.

The controller found, and the scenario's own, are tried in the end in realisations of the seas that
the search never met. Only ratios of weights count, so the weight of the position stays. Every
controller meets the same seas: common random numbers.
"""

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, field, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from dpbench.bench.judge.control_metrics import compute_force_travel
from dpbench.bench.progress import Progress, Silent
from dpbench.bench.record.cell import Cell
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.run.assemble import NO_LIMIT_NS, build_closed_loop_setup
from dpbench.bench.run.closed_loop import record_closed_loop
from dpbench.bench.run.exact_loop import compute_largest_offset_share
from dpbench.errors import InputError, SituationError, require_integer_at_least
from dpbench.files.regular_files import read_bytes, write_text_atomically
from dpbench.report.charts.render import save_figure
from dpbench.report.charts.study import draw_tuning_front
from dpbench.report.formats import join_with_and, plural, significant
from dpbench.report.words import render_document
from dpbench.scenario.own_ship import DP_NUMBERS, FROM_DEG, make_environment_of_dp_number
from dpbench.scenario.problem_files import read_toml_as_dict
from dpbench.scenario.scenario import Scenario, load_scenario
from dpbench.scenario.variation import (
    copy_scenario_with_values,
    write_scenario_and_own_ship_files,
)
from dpbench.ship.environment import WeatherDraw
from dpbench.ship.plant import SUBSTEPS
from dpbench.solvers.contract import Options
from dpbench.solvers.open import open_workspace
from dpbench.solvers.own_settings import format_options_as_toml
from dpbench.tuning.search import OptionRange, SearchSpace, Trial, TrialSearch

SOLVER = "paper_active_set"
"""Exact and fast: its loop is that of the controller."""
HEADING_WEIGHTS, INCREMENT_WEIGHTS = (0.01, 100.0), (0.01, 10_000.0)
"""Ranges of weights, in multiples of the scenario's own."""


@dataclass(frozen=True)
class LoopScore:
    """Result of a controller in some seas.

    share : largest offset, in multiples of the station's limits.
    wear_per_h : mean travel of the forces in an hour, in multiples of the largest forces.
    largest_in : scenario and sea of the largest offset; "" where there is only one of each.
    """

    share: float
    wear_per_h: float
    largest_in: str = ""


@dataclass(frozen=True, eq=False)
class Realisation:
    """One sea of a DP capability number (None: the scenario's weather) by its seed, drawn once.

    label : scenario and number, as far as the realisations of a search differ in them.
    """

    scenario: Scenario
    number: int | None
    seed: int
    steps: int
    label: str
    drawn: WeatherDraw = field(default_factory=dict, repr=False)


def make_controller_space(scenario: Scenario) -> SearchSpace:
    """Return the ranges in which a controller's weights and horizons are searched."""
    table = scenario.files["scenario"]["controller"]
    N_p, N_c = table["prediction_horizon"], table["control_horizon"]
    return SearchSpace(
        (
            OptionRange("heading_weight", *HEADING_WEIGHTS),
            OptionRange("increment_weight", *INCREMENT_WEIGHTS),
            OptionRange("prediction_horizon", max(2, N_p // 3), min(max(3, 3 * N_p), 1000)),
            OptionRange("control_horizon", max(1, N_c // 2), min(2 * N_c, 1000)),
        )
    )


def make_unchanged_options(scenario: Scenario) -> Options:
    """Return the options that leave the scenario's controller as it is."""
    table = scenario.files["scenario"]["controller"]
    horizons = {key: table[key] for key in ("prediction_horizon", "control_horizon")}
    return {"heading_weight": 1.0, "increment_weight": 1.0} | horizons


def change_controller(scenario: Scenario, options: Options) -> Scenario:
    """Return the scenario with other weights and horizons of its controller."""
    heading, increment, N_p, N_c = (
        _convert_to_number(options[key]) for key in make_unchanged_options(scenario)
    )
    table = scenario.files["scenario"]["controller"]
    *position, turn = table["output_weight"]
    values: dict[str, Any] = {
        "controller.output_weight": [*position, _scale_weight(turn, heading)],
        "controller.prediction_horizon": int(N_p),
        "controller.control_horizon": int(min(N_c, N_p)),
    }
    for key in ("move_weight", "move_weight_relative"):
        if table[key] is not None:
            values[f"controller.{key}"] = [
                _scale_weight(weight, increment) for weight in table[key]
            ]
    if table.get("kind") == "thrusters":
        key, own = "move_weight_relative", table["thrusters"]["move_weight_relative"]
        values[f"controller.thrusters.{key}"] = _scale_weight(own, increment)
    return copy_scenario_with_values(scenario, values, f"scenario {scenario.name}")


def _convert_to_number(value: object) -> float:
    """Return the value of a controller's option as a number, which its range ensures that it is."""
    assert isinstance(value, int | float), "of a range"
    return value


def _scale_weight(weight: float, factor: float) -> float:
    """Return a controller's weight times a factor, rounded to four digits."""
    return float(f"{weight * factor:.4g}")


def draw_realisations(
    scenarios: Sequence[Scenario], seas: Sequence[int], first: int, count: int, steps: int
) -> list[Realisation]:
    """Return `count` realisations of each scenario and sea, from the `first` after its own on.

    steps : of each, at most those of its scenario; 0 for all of them.
    """
    found = []
    numbers: Sequence[int | None] = seas or [None]
    for scenario, number in product(scenarios, numbers):
        seed = scenario.files["scenario"]["environment"]["seed"] + first
        own = min(steps or scenario.steps, scenario.steps)
        parts = [scenario.name] * (len(scenarios) > 1)
        parts += [f"DP number {number}"] * (len(numbers) > 1)
        for at in range(seed, seed + count):
            sea = Realisation(scenario, number, at, own, ", ".join(parts))
            env = change_sea_of_scenario(scenario, sea).environment
            drawn = env.draw_wind_and_waves_at_stages(own, scenario.sample_s, SUBSTEPS)
            found.append(replace(sea, drawn=drawn))
    return found


def change_sea_of_scenario(scenario: Scenario, sea: Realisation) -> Scenario:
    """Return a scenario changed to one sea; direction, wave motion and noise are its own."""
    weather = scenario.files["scenario"]["environment"]
    if sea.number is not None:
        own, waves = weather, weather["waves"] or {}
        from_deg = (own["wind"] or waves).get("from_deg", FROM_DEG)
        weather = make_environment_of_dp_number(sea.number, from_deg).model_dump()
        weather["waves"]["motion"] = waves.get("motion")
        weather["noise"] = own["noise"]
    values = {"environment": weather | {"seed": sea.seed}}
    return copy_scenario_with_values(scenario, values, f"scenario {scenario.name}")


def rate_controller(options: Options, seas: Sequence[Realisation]) -> LoopScore:
    """Run a closed loop with other weights and horizons in each sea; return the score."""
    shares, wear = [], []
    for sea in seas:
        changed = change_controller(sea.scenario, options)
        loop = change_sea_of_scenario(changed, sea).truncate(sea.steps)
        share, travel = _run_loop_in_sea(loop, sea.drawn)
        shares.append(share)
        wear.append(travel * 3600.0 / (loop.steps * loop.sample_s))
    # A ship whose state is no number is off station.
    known = np.nan_to_num(shares, nan=np.inf, posinf=np.inf)
    mean = np.nan_to_num(np.mean(wear), nan=np.inf, posinf=np.inf)
    return LoopScore(float(np.max(known)), float(mean), seas[int(np.argmax(known))].label)


def _run_loop_in_sea(scenario: Scenario, drawn: WeatherDraw) -> tuple[float, float]:
    """Run a closed loop with `SOLVER`; return largest share of the station and force travel."""
    workspace = open_workspace(SOLVER)
    cell = Cell(
        mode="closed_loop",
        scenario=scenario.files,
        solver=SOLVER,
        route=workspace.route,
        policy=workspace.policy,
        settings="",
        steps=scenario.steps,
    )
    setup = build_closed_loop_setup(cell, scenario, workspace, RawLog.in_memory, NO_LIMIT_NS)
    setup.drawn = drawn
    record_closed_loop(setup)
    return compute_largest_offset_share(scenario, setup.log.state), compute_force_travel(
        scenario, setup.log.tau
    )


def find_pareto_front(trials: Sequence[Trial[LoopScore]]) -> list[Trial[LoopScore]]:
    """Return the trials that no other beats in offset and wear, by growing offset."""
    front: list[Trial[LoopScore]] = []
    for trial in sorted(trials, key=lambda t: (t.score.share, t.score.wear_per_h)):
        if not front or trial.score.wear_per_h < front[-1].score.wear_per_h:
            front.append(trial)
    return front


def choose_controller(trials: Sequence[Trial[LoopScore]], margin: float) -> Trial[LoopScore]:
    """Return the trial of least wear among those within the margin, else that of least offset."""
    within = [trial for trial in trials if trial.score.share <= margin]
    if within:
        return min(within, key=lambda trial: trial.score.wear_per_h)
    return min(trials, key=lambda trial: trial.score.share)


TRIALS, REALISATIONS, MARGIN = 48, 2, 0.7
SCORES = (
    "offset: largest position or heading error, in percent of its limit",
    "wear: travel of the forces in an hour, in multiples of the largest forces",
)
NO_PROMISE = (
    "The real ship differs from this model in mass, damping and thrust.",
    "Other seas, or these seas from another direction, were not tried.",
    "A longer time in the same sea may bring a larger offset than these realisations.",
    "A swing that does not decay is not detected: look at the result of the next run, and repeat "
    "this command with a smaller --margin if the ship swings.",
    "Stability is not proven, and only the faults of the scenario were tried.",
    "Azimuths turn at any rate unless the scenario has `azimuth_turning = true`.",
    "Solve time grows with the horizons and was not measured: run the scenario in a suite.",
)
"""Limits of the result, printed after it."""
UNCHANGED = "unchanged: no trial has a better score than the scenario's own controller"
WORSE_IN_TEST = (
    "in the test, the original controller is no worse in offset and wear: keep it, or increase "
    "--trials and --realisations"
)
_MOST_BYTES = 2**26


@dataclass(frozen=True)
class ControllerTuning:
    """Result of a search: all trials, the chosen one, and scores in fresh realisations.

    fresh, own_fresh : of the chosen controller and of the scenario's own.
    suite : runs the tuned scenarios; None before it is written.
    shortened : the limit that `steps` sets on the result; "" where it shortens no scenario.
    """

    trials: Sequence[Trial[LoopScore]]
    chosen: Trial[LoopScore]
    fresh: LoopScore
    own_fresh: LoopScore
    margin: float
    seas: str
    paths: Sequence[Path]
    suite: Path | None = None
    shortened: str = ""

    @property
    def trial_of_own_controller(self) -> Trial[LoopScore]:
        """The trial of the scenario's own controller."""
        return self.trials[0]

    @property
    def is_unchanged(self) -> bool:
        """Return whether no trial was better than the scenario's own controller."""
        return self.chosen.options == self.trial_of_own_controller.options

    @property
    def keeps_margin(self) -> bool:
        """Return whether the best controller keeps the offset margin, in search and fresh seas."""
        return max(self.chosen.score.share, self.fresh.share) <= self.margin

    @property
    def is_worse_in_test(self) -> bool:
        """Return whether the scenario's own controller is as good in fresh seas, in both scores."""
        own, chosen = self.own_fresh, self.fresh
        is_no_worse = own.share <= chosen.share and own.wear_per_h <= chosen.wear_per_h
        return not self.is_unchanged and is_no_worse

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
        held = "within" if self.fresh.share <= self.margin else "NOT within"
        describe = partial(_describe_score, margin=self.margin)
        return [
            *([UNCHANGED] if self.is_unchanged else []),
            f"{self._describe_choice()}: {self.chosen.name}",
            f"search ({self.seas}): {describe(self.chosen.score)} (original controller: "
            f"{describe(self.trial_of_own_controller.score)})",
            f"test in other realisations, {held} the margin: {describe(self.fresh)} "
            f"(original controller: {describe(self.own_fresh)})",
            *([WORSE_IN_TEST] if self.is_worse_in_test else []),
            *SCORES,
            *(f"wrote {path}" for path in self.paths),
            "Limits of this result:",
            *NO_PROMISE,
            *([self.shortened] if self.shortened else []),
            *([f"next: dpbench run {self.suite} --solver {SOLVER}"] if self.suite else []),
        ]

    def _describe_choice(self) -> str:
        """Return why the controller was chosen."""
        limit = f"{100.0 * self.margin:g} % of the limits of 5 m and 5°"
        if self.chosen.score.share > self.margin:
            return f"none of {len(self.trials)} controllers stays within {limit}; the nearest"
        found = "own controller, with" if self.is_unchanged else "controller of least wear with"
        return f"{found} offsets within {limit} ({len(self.trials)} tried)"


def _describe_shortening(bases: Sequence[Scenario], steps: int) -> str:
    """Return the limit that `steps` sets on the result; "" where it shortens no scenario."""
    lengths = dict.fromkeys(
        f"{significant(steps * base.sample_s)} of {significant(base.steps * base.sample_s)} s"
        for base in bases
        if 0 < steps < base.steps
    )
    if not lengths:
        return ""
    return (
        f"`--steps` stopped loops before the end of the scenario ({join_with_and([*lengths])}): "
        "what happens later was not tried."
    )


def _describe_score(score: LoopScore, margin: float) -> str:
    """Format the score of a controller: offset and wear of the thrusters.

    The offset has the digits that show on which side of the margin it is.
    """
    offset, limit = 100.0 * score.share, round(100.0 * margin, 9)
    is_within = score.share <= margin
    digits = next((d for d in range(9) if (round(offset, d) <= limit) == is_within), 9)
    where = f" ({score.largest_in})" if score.largest_in else ""
    return f"offset {offset:.{digits}f} %{where}, wear {significant(score.wear_per_h)} per hour"


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
            found = f"{path} belongs to another search; name another folder"
            raise SituationError("--out", found)
        for number, line in enumerate(lines, 2):
            try:
                name, share, wear, largest_in = json.loads(line)
                self._scores[name] = LoopScore(float(share), float(wear), str(largest_in))
            except (ValueError, TypeError) as error:
                allowed = "a name, two numbers and a text"
                raise InputError(str(path), f"line {number}", repr(line[:80]), allowed) from error
        if whole != text:
            write_text_atomically(path, whole)

    def find_stored_score(self, name: str) -> LoopScore | None:
        """Return the stored score of a trial by its name; None where it is not finished."""
        return self._scores.get(name)

    def store_score(self, name: str, score: LoopScore) -> None:
        """Store the score of a finished trial on disk, by the trial's name."""
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps([name, *astuple(score)]) + "\n")


def tune_controller(
    scenarios: str | Path | Sequence[str | Path],
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

    In several scenarios the largest offset of all counts, and the mean wear. Finished trials are
    kept: the same call goes on after an interruption.

    Parameters
    ----------
    scenarios : by name or a TOML file, one or several with one ship and controller; of a vessel
        file NAME.toml, its NAME_weather.toml.
    seas : DP capability numbers such as "4,5"; "" for each scenario's own weather.
    trials : controllers to try; realisations : of each sea.
    margin : largest offset wanted, as a share of the station's limits.
    steps : of each loop, 0 for all of the scenario; seed : of the search.
    out : folder; by default `results/tune-SCENARIO`.

    Raises
    ------
    InputError : for bad input, or a folder with the trials of another search.
    """
    names = [scenarios] if isinstance(scenarios, str | Path) else scenarios
    bases = [load_scenario(_find_scenario_of_ship(name)) for name in names]
    _refuse_other_controllers(bases)
    numbers = _parse_seas(seas)
    _refuse_bad_numbers(trials, realisations, margin, steps, seed)
    base = bases[0]
    name = base.name.replace("@", "_")
    folder = Path("results") / f"tune-{name}" if out is None else Path(out)
    searched = draw_realisations(bases, numbers, 0, realisations, steps)
    other = draw_realisations(bases, numbers, realisations, realisations, steps)
    kept = _KeptTrials(
        folder / "trials.jsonl", _compute_search_digest(bases, numbers, realisations, steps)
    )
    bar = progress or Silent()
    total = sum(sea.steps for sea in searched)
    bar.start((trials + 3) * total)

    def rate(options: Options, at: Sequence[Realisation], role: str) -> LoopScore:
        name = f"{role}{format_options_as_toml(options)}"
        score = kept.find_stored_score(name)
        if score is None:
            score = rate_controller(options, at)
            kept.store_score(name, score)
        bar.advance(total, f"{role}{_describe_score(score, margin)}")
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
    weather = "the scenario's weather" if len(bases) == 1 else "the weather of each scenario"
    if numbers:
        weather = f"DP capability number{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))}"
    seas_text = f"{weather}, {plural(realisations, 'realisation')} each"
    if len(bases) > 1:
        seas_text = f"{len(bases)} scenarios, {seas_text}"
    shortened = _describe_shortening(bases, steps)
    tuning = ControllerTuning(
        found, chosen, fresh, own_fresh, margin, seas_text, (), shortened=shortened
    )
    hardest = max(numbers, default=None)
    written = {sea.scenario.name: sea for sea in reversed(other) if sea.number == hardest}
    return _write_tuning(tuning, bases, written, folder)


def _write_tuning(
    tuning: ControllerTuning,
    bases: Sequence[Scenario],
    seas: Mapping[str, Realisation],
    folder: Path,
) -> ControllerTuning:
    """Write tuned scenarios, table of trials and figure; return the result with their paths.

    seas : the first test realisation of the hardest sea, by the names of the scenarios.
    """
    head, mark = "Controller found by `dpbench tune`.", "tuned"
    if tuning.is_unchanged:
        head, mark = "`dpbench tune` kept the scenario's own controller.", UNCHANGED
    if tuning.fresh.share > tuning.margin:  # page and statement show the title
        mark += f", NOT within the margin of {100.0 * tuning.margin:g} %"
    comment = "\n".join((head, *tuning.lines))
    paths: dict[Path, None] = {}
    files: list[Path] = []
    for base in bases:
        tuned = change_controller(base, tuning.chosen.options)
        changed = change_sea_of_scenario(tuned, seas[base.name]).files
        if number := seas[base.name].number:
            changed["scenario"] |= _describe_sea(changed["scenario"], number)
        changed["scenario"]["title"] += f", {mark}"
        files.append(folder / f"{base.name.replace('@', '_')}_tuned.toml")
        paths |= dict.fromkeys(write_scenario_and_own_ship_files(changed, files[-1], comment))
    suite = folder / "tuned_suite.toml"
    ship = next((path.name for path in paths if path not in files), bases[0].files["vessel_name"])
    names = [file.name for file in files]
    write_text_atomically(suite, _render_suite(bases, names, ship, mark))
    paths[suite] = None
    table = tuning.table
    write_text_atomically(folder / "tune.csv", table.to_csv(index=False))
    drawn = table[["share", "wear_per_h", "kind"]].copy()
    drawn["options"] = [trial.name for trial in tuning.trials]
    # A logarithmic axis has no zero, and a ship that is lost no place on it.
    drawn[["share", "wear_per_h"]] = drawn[["share", "wear_per_h"]].clip(1e-3, 1e4)
    chart = draw_tuning_front(
        drawn, f"{join_with_and([base.name for base in bases])}: offset and wear", tuning.margin
    )
    figure = save_figure(chart, folder / "front.svg")
    fields: dict[str, Any] = vars(tuning) | {
        "paths": [*paths, folder / "tune.csv", figure],
        "suite": suite,
    }
    return ControllerTuning(**fields)


def _describe_sea(scenario: Mapping[str, Any], number: int) -> dict[str, str]:
    """Return title and description of a scenario changed to the sea of a DP capability number."""
    sea = f"DP capability number {number}"
    title, found = re.subn(r"DP capability number \d+", sea, scenario["title"])
    wind, current, waves = (scenario["environment"][key] for key in ("wind", "current", "waves"))
    shows = (
        f"{sea}: gusty wind of {wind['speed_mps']:g} m/s, a current of "
        f"{current['speed_mps']:g} m/s and waves (Hs {waves['hs_m']:g} m, Tp {waves['tp_s']:g} s) "
        f"from {wind['from_deg']:g}°."
    )
    return {"title": title if found else f"{title}, in the sea of {sea}", "shows": shows}


def _render_suite(bases: Sequence[Scenario], names: Sequence[str], ship: str, mark: str) -> str:
    """Return a suite of the tuned scenarios at `names` with the settings of `dpbench init`.

    Closed loops and a replay of the first. For a ship with thrusters also its capability plot, and
    with commanded thrusters a consequence analysis in the 100 steps before the loss.
    """
    first, vessel = bases[0], bases[0].files["vessel"]
    is_steered = first.files["scenario"]["controller"].get("kind") in ("thrusters", "cascade")
    lossy = [(base, name) for base, name in zip(bases, names, strict=True) if _find_loss(base)]
    return render_document(
        "own_suite.toml",
        quoted=partial(json.dumps, ensure_ascii=False),
        title=f"{join_with_and([base.name for base in bases])}, {mark}",
        weather=[] if is_steered else names,
        steered=names if is_steered else [],
        variables=None,
        apart={},
        first=0,
        steps=first.steps,
        lost_from=_find_loss(lossy[0][0]) if lossy and is_steered else 0,
        analysed=lossy[0][1] if lossy else "",
        vessel=ship if vessel.get("thrusters") and vessel.get("capability") else "",
        step_s=first.sample_s,
    )


def _find_loss(scenario: Scenario) -> int:
    """Return the step at which a scenario first loses thrusters; 0 if it never does."""
    faults = scenario.files["scenario"].get("faults") or ()
    lost_s = [fault["at_s"] for fault in faults if fault.get("lost")]
    return round(min(lost_s, default=0.0) / scenario.sample_s)


def _find_scenario_of_ship(scenario: str | Path) -> str | Path:
    """Return the scenario that `init` wrote for a vessel file; any other name as it is."""
    path = Path(scenario)
    if path.suffix != ".toml" or not path.is_file():
        return scenario
    if not {"limits", "thrusters"} & read_toml_as_dict(path).keys():
        return scenario
    weather = path.with_name(f"{path.stem}_weather.toml")
    if not weather.is_file():
        sentence = f"this is a vessel, and {weather.name} is not in its folder; name a scenario"
        raise SituationError(str(path), sentence)
    return weather


def _refuse_other_controllers(bases: Sequence[Scenario]) -> None:
    """Raise InputError for scenarios of several ships or controllers, or with one name."""
    first, names = bases[0], {base.name for base in bases}
    if len(names) < len(bases):
        found = join_with_and([base.name for base in bases])
        raise InputError("SCENARIO", "", found, "scenarios with different names")
    for base in bases:
        for part, own, known in (
            ("vessel", base.files["vessel"], first.files["vessel"]),
            *(
                (key, base.files["scenario"][key], first.files["scenario"][key])
                for key in ("controller", "sample_s")
            ),
        ):
            if own != known:
                found = f"a {part} other than that of {first.name}"
                allowed = "scenarios with the same vessel, controller and sample_s"
                raise InputError("SCENARIO", base.name, found, allowed)


def _parse_seas(text: str) -> list[int]:
    """Return the DP capability numbers in a text such as "4,5"; InputError for another text."""
    words = [word.strip() for word in text.split(",")] if text else []
    if len(set(words)) < len(words) or any(word not in map(str, DP_NUMBERS) for word in words):
        allowed = f"DP capability numbers from 1 to {max(DP_NUMBERS)}, each once, such as 4,5"
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
    bases: Sequence[Scenario], seas: Sequence[int], realisations: int, steps: int
) -> str:
    """Return a digest of everything that the score of a trial depends on."""
    files = [base.files for base in bases]
    content = json.dumps([files, list(seas), realisations, steps], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()
