"""Run one solver in this process, for a notebook or a test.

A campaign runs cells in processes of their own; here nothing protects the caller from a solver
that crashes, and no core is pinned. The assessment is the same.
"""

import math
import textwrap
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from dpbench.analysis.records.run_record import build_run_records
from dpbench.analysis.verdict.ship_results import ShipResult
from dpbench.bench.judge.answer_caching import find_caching_sign
from dpbench.bench.judge.evaluation import EvaluatedCell, evaluate_loop_log, evaluate_replay_log
from dpbench.bench.judge.rows import STATE, make_run_row, make_step_columns, make_step_rows
from dpbench.bench.judge.rules import UNCERTIFIED
from dpbench.bench.record.cell import DEFAULT_FALLBACK, FORMULATIONS, Cell, Formulation, Outcome
from dpbench.bench.record.raw_log import RawLog
from dpbench.bench.record.schema import convert_to_run_columns
from dpbench.bench.run.assemble import (
    NO_LIMIT_NS,
    build_closed_loop_setup,
    build_sequence_solver_and_log,
    clock,
)
from dpbench.bench.run.backup import FALLBACKS
from dpbench.bench.run.closed_loop import record_closed_loop
from dpbench.bench.run.exact_loop import compute_track_metrics, solve_loop_exactly
from dpbench.bench.run.formulation import Case
from dpbench.bench.run.replay import ReplayRun
from dpbench.bench.run.timed_solver import TimedSolver, list_failure_descriptions
from dpbench.bench.sequences.sequence_file import as_sequence
from dpbench.display import make_html_field_table
from dpbench.errors import InputError, require_integer_at_least, require_type, shorten_found
from dpbench.mpc.condense import UnitSystem
from dpbench.notebook.plots import RunPlots
from dpbench.qp.program import QPSequence
from dpbench.report.formats import (
    NOTED_WAIT,
    format_count,
    format_error,
    format_seconds,
    format_share,
    format_time,
    plural,
    significant,
)
from dpbench.report.ship.ship_text import (
    ShipSummary,
    describe_departure_with_solver,
    describe_ship_of_run,
    summarise_ships,
)
from dpbench.report.verdict.findings_text import describe_caching_sign
from dpbench.scenario.plants.contract import PlantMaker
from dpbench.scenario.plants.linear_mpc import LinearMPC
from dpbench.scenario.scenario import Scenario, resolve_to_scenario
from dpbench.solvers.contract import DEFAULT, Workspace
from dpbench.solvers.open import open_workspace
from dpbench.solvers.own_settings import encode_options_as_json, format_options_as_toml
from dpbench.solvers.table import Availability, find_solver_availability

MOST_LETTERS = 100  # Letters of a reason in the text form
_OF_ALL_SOLVES = " in all rounds and the warm-up"
"""Population of the failures of a replay; a failed step counts once in all rounds."""


@dataclass(frozen=True, eq=False)
class Run:
    """One solver's run of a scenario, answers judged: table of steps, summary row and scenario.

    Parameters
    ----------
    steps : a row for each answer, with the columns of steps.parquet.
    summary : its row of runs.parquet.
    scenario : of a closed loop; None of a replay and of a `LinearMPC`, which have no ship.
    signals : of a `LinearMPC`, a row per step: t_s, outputs and inputs by name, references of the
        outputs as `<output>_reference`; None of others.

    Examples
    --------
    >>> run = run_closed_loop("paper", "daqp", steps=20)
    >>> run.label, len(run.steps), float(run.summary["fallbacks"])
    ('daqp (qpsolvers, fresh)', 20, 0.0)
    """

    steps: pd.DataFrame
    summary: "pd.Series[Any]"
    scenario: Scenario | None = None
    signals: pd.DataFrame | None = None

    @property
    def label(self) -> str:
        """Solver, interface to its library, start of each solve, and settings but "default".

        Examples
        --------
        >>> run_closed_loop("paper", open_workspace("daqp", route="native"), steps=2).label
        'daqp (native, fresh)'
        """
        row = self.summary
        words = [row["route"], row["policy"], row["settings"]]
        return f"{row['solver']} ({', '.join(word for word in words if word != DEFAULT)})"

    @property
    def remembers(self) -> bool:
        """True if a replay's times look like answers the solver has cached, not of solving.

        Examples
        --------
        >>> run_closed_loop("paper", "daqp", steps=2).remembers
        False
        """
        return bool(self._caching_text)

    @property
    def _caching_text(self) -> str:
        """Words on what of the times looks like cached answers; "" for none."""
        row = self.summary
        excess = float(row["first_visit_excess"])
        sign = find_caching_sign(float(row["first_visit_ratio"]), math.nan, excess)
        return describe_caching_sign(str(row["solver"]), sign)

    @property
    def plot(self) -> RunPlots:
        """Plots: `steps()`; of a ship `ship()`, `errors()`, `forces()`; of a plant `signals()`.

        Examples
        --------
        >>> run_closed_loop("paper", "daqp", steps=2).plot
        <figures: steps(), ship(), errors(), forces()>
        """
        return RunPlots(self)

    def __repr__(self) -> str:
        row, unverified = self.summary, self._unverified_text
        failed, (time, note) = row["failed_steps"], self._time_text
        return (
            f"<{'Inaccurate run' if self._is_inaccurate else 'Run'} of {self.label}: "
            f"{self.case_text}, {self._steps_text}, "
            f"{format_share(row['true_share'])} verified, "
            f"{f'{unverified} reported solved but not verified, ' if unverified else ''}"
            f"{f'{self._uncertified_text}, ' if self._uncertified_text else ''}"
            f"{f'{format_count(failed)} failed{self._reason_text}, ' if failed else ''}"
            f"{f'{self._late_text}, ' if self._late_text else ''}"
            f"error_move ≤ {format_error(row['error_move_max'])}, p50 {time}{note and f' ({note})'}"
            f"{f'; {self._machine_text}' if self._machine_text else ''}"
            f"{f'; {self._caching_text}' if self.remembers else ''}"
            f"{''.join(f'; {line}' for line in self._ship_lines)}>"
        )

    def _repr_html_(self) -> str:
        """Return the run's main results as an HTML table, which a notebook displays."""
        row = self.summary
        time, note = self._time_text
        fields = {
            "warning": "inaccurate" if self._is_inaccurate else self._uncertified_text,
            "ship": self._own_ship_text,
            "steps": self._steps_text,
            "answers verified": format_share(row["true_share"]),
            "reported solved but not verified": self._unverified_text or "0",
            "failed steps": format_count(row["failed_steps"]),
            "late": self._late_text,
            f"failures{'' if self._is_closed_loop else _OF_ALL_SOLVES}": row["outcome_detail"],
            "largest error of the first move": format_error(row["error_move_max"]),
            f"median step time{note and f', {note}'}": time,
        }
        # The machine first: it may be the reason for what the times look like.
        fields |= {"machine": self._machine_text} if self._machine_text else {}
        fields |= {"times": self._caching_text} if self.remembers else {}
        return make_html_field_table(
            f"{self.label}: {self.case_text}", fields | self._describe_control()
        )

    @property
    def case_text(self) -> str:
        """Mode and name of the scenario or sequence that was run.

        Examples
        --------
        >>> run_closed_loop("paper", "daqp", steps=2).case_text
        'closed loop paper'
        """
        mode = str(self.summary["mode"]).replace("_", " ")
        return f"{mode} {self.summary['scenario'] or self.summary['sequence']}"

    @property
    def _is_closed_loop(self) -> bool:
        """True for a closed loop, False for a replay."""
        return bool(self.summary["mode"] == "closed_loop")

    @property
    def _is_inaccurate(self) -> bool:
        """True if the referee finds some answer wrong."""
        return bool(self.summary["true_share"] < 1.0)

    @property
    def _unverified_text(self) -> str:
        """Number of answers that the solver reports as solved and that are wrong; "" for none."""
        row = self.summary
        count = row["claimed_not_true"]
        return (
            f"{format_count(count)} of {format_count(row['raw_samples'])} answers" if count else ""
        )

    @property
    def _uncertified_text(self) -> str:
        """Number of steps whose solutions cannot be judged, as text; "" for none."""
        # A late step has no solution to judge.
        solved = self.steps[self.steps["total_ns"].notna()]
        count = solved.loc[solved["certificate"] == UNCERTIFIED, "k"].nunique()
        return f"{plural(count, 'step')} without a certified optimum" if count else ""

    @property
    def _reason_text(self) -> str:
        """Most frequent reason of failed steps in brackets, shortened; "" for none known."""
        reason = str(self.summary["outcome_detail"]).split("; ")[0].partition(" × ")[2]
        return f" ({textwrap.shorten(reason, MOST_LETTERS, placeholder=' …')})" if reason else ""

    @property
    def _late_text(self) -> str:
        """Steps that missed their deadline, and fallbacks, as text; "" for none."""
        if not self._is_closed_loop:
            return ""
        missed, fallbacks = self.summary[["deadline_misses", "fallbacks"]].fillna(0).astype(int)
        late = [f"deadline missed in {plural(missed, 'step')}"] if missed else []
        return ", ".join([*late, plural(fallbacks, "fallback")] if fallbacks else late)

    @property
    def _time_text(self) -> tuple[str, str]:
        """Median step time, and what it is of: in a replay the minimum over rounds, as the page."""
        if self._is_closed_loop:
            return format_time(self.summary["raw_p50_ns"]), ""
        p50_ns = self.summary["algo_p50_ns"]
        return format_time(p50_ns), "minimum over rounds" if p50_ns > 0.0 else "too few steps"

    @property
    def _machine_text(self) -> str:
        """Words on what disturbed the times; "" for nothing, and without a p50."""
        row = self.summary
        if not row["raw_p50_ns" if self._is_closed_loop else "algo_p50_ns"] > 0.0:
            return ""
        # Context switches are too few in such a short time for a rate of them.
        disturbed, parts = row["disturbed_rounds"], []
        if not self._is_closed_loop and disturbed > 0:
            rounds = row["rounds"] + disturbed - row["counting_disturbed"]
            of_all = f"{format_count(disturbed)} of {plural(rounds, 'round')}"
            parts.append(f"the machine was disturbed in {of_all}")
        counting = self.steps[self.steps["counts"]]
        waited = counting["waited_ns"].sum() / max(counting["total_ns"].sum(), 1)
        if waited >= NOTED_WAIT:
            parts.append(
                f"in {format_share(waited)} of the timed span the solver waited for the processor "
                "core, which other programs had"
            )
        return "; ".join(parts)

    @property
    def _steps_text(self) -> str:
        """Number of steps done and planned in the run, as text."""
        row = self.summary
        return f"{format_count(row['steps_done'])} of {plural(row['steps_planned'], 'step')}"

    @property
    def _ship(self) -> ShipSummary:
        """Results of the controller itself: the ship of the reference closed loop."""
        return ShipSummary() if self.scenario is None else summarise_ships([self._exact_ship])

    @property
    def _exact_ship(self) -> ShipResult:
        """Ship of the reference closed loop."""
        (run,) = build_run_records(pd.DataFrame([self.summary]))
        return ShipResult(run.scenario, run)

    @property
    def _own_ship_text(self) -> str:
        """Sentence on the ship of this run, which this solver alone may lose; "" without a ship."""
        if self.scenario is None:
            return ""
        exact, state = self._exact_ship, self.steps[list(STATE)].to_numpy()
        own: dict[str, Any] = compute_track_metrics(self.scenario, state)
        ship = ShipResult(exact.name, replace(exact.run, **own))
        return describe_departure_with_solver(exact, ship) or describe_ship_of_run(ship)

    @property
    def _ship_lines(self) -> list[str]:
        """Sentences of the text form on this run's ship, and on one lost in the reference loop."""
        if self.scenario is None:
            return []
        has_arrived = self._exact_ship.state != "not arrived"
        away = self._ship.warning or ("" if has_arrived else self._ship.state)
        exact = f"reference loop: {away}" if away else ""
        return [text.removesuffix(".") for text in (self._own_ship_text, exact) if text]

    def _describe_control(self) -> dict[str, str]:
        """Return a closed loop's position errors, fallbacks and reference loop, by field name."""
        row = self.summary
        fallbacks = {"fallbacks": format_count(row["fallbacks"])} if self._is_closed_loop else {}
        if self.scenario is None:
            return fallbacks
        return {
            **fallbacks,
            "position error, largest": f"{significant(row['r_max_m'])} m",
            "position error, rms": f"{significant(row['r_rms_m'])} m",
            "position error, second half": f"≤ {significant(row['r_tail_max_m'])} m",
            "settled into 0.1 m after": format_seconds(row["settle_0p1m_s"]),
            "farthest from the reference loop": f"{significant(row['dev_position_max_m'])} m",
            "reference loop": " ".join(self._ship.lines),
        }


def run_closed_loop(
    scenario: Case | str | Path,
    workspace: Workspace | str,
    *,
    units: UnitSystem = "scaled",
    formulation: Formulation = "condensed_box",
    fallback: str = DEFAULT_FALLBACK,
    backup: str = "",
    slowdown: float = 0.0,
    deadline_s: float = 0.0,
    steps: int | None = None,
    plant: PlantMaker | None = None,
) -> Run:
    """Simulate plant and MPC in closed loop with `workspace` as QP solver; judge every answer.

    Parameters
    ----------
    scenario : an object, a name or a TOML file; `Scenario.with_horizons` sets other horizons. Or a
        `LinearMPC`, for a plant that is no ship.
    workspace : an object of `open_workspace`, or the name of a solver.
    units : "scaled" or "si". formulation : "condensed_box", "condensed_stacked" or "sparse";
        "none" for a control law. fallback : "shifted_plan", "hold" or "clip".
    steps : only the first so many; by default, and above its number of steps, the whole scenario.
    backup : name of a second solver, called before the fallback acts; "" for none.
    slowdown : how much slower than this machine the ship's computer is (≥ 1), so that answers
        arrive late; 0 for a ship that waits for each. Time is simulated, not waited for.
    deadline_s : what a step may take of its time [s], at most the sample; 0 for the sample.
    plant : class or function that makes a custom `Plant`, called for this loop and for the
        reference loop; it replaces the scenario's ship, and is needed for a `LinearMPC`.

    Raises
    ------
    InputError : for an unknown formulation, fallback or backup, "sparse" for a scenario that has
        none, a slowdown, deadline or number of steps that cannot be, or weather that would push a
        custom plant.
    PlantError : for a plant that fails, or whose state or measurement has another shape or NaN.
    TypeError : for a scenario, workspace, backup, number of steps, slowdown or deadline of another
        type.

    Examples
    --------
    >>> run = run_closed_loop("paper", "daqp", steps=20)
    >>> bool(run.summary["error_move_max"] < 1e-9)
    True
    """
    function = "run_closed_loop"
    require_type("backup", backup, str, "the name of a solver")
    _refuse_unknown_choice(function, "fallback", fallback, FALLBACKS)
    _refuse_unknown_choice(function, "formulation", formulation, FORMULATIONS)
    mpc = scenario if isinstance(scenario, LinearMPC) else None
    case: Case = mpc or resolve_to_scenario(scenario)
    workspace = _open_workspace_if_named(workspace)
    if steps is not None:
        case = case.truncate(steps)
    cell = _make_cell(
        workspace,
        mode="closed_loop",
        scenario=case.files,
        steps=case.steps,
        formulation=formulation,
        units=units,
        fallback=fallback,
        backup=backup,
        slowdown=slowdown,
        deadline_s=deadline_s,
    )
    setup = build_closed_loop_setup(
        cell, case, workspace, RawLog.in_memory, NO_LIMIT_NS, plant=plant
    )
    record_closed_loop(setup)
    exact = solve_loop_exactly(case, plant=plant)
    if isinstance(case, LinearMPC):
        evaluated = evaluate_loop_log(cell, setup.log, exact, case)
        run = _make_run(cell, workspace, setup.solver, evaluated)
        return replace(run, signals=_tabulate_signals(case, setup.log))
    return _make_run(cell, workspace, setup.solver, evaluate_loop_log(cell, setup.log, exact), case)


def _tabulate_signals(mpc: LinearMPC, log: RawLog) -> pd.DataFrame:
    """Return time, outputs, references and inputs of a linear MPC's loop, a row per step."""
    done, theta = int(log.done[0]), mpc.problem.model.theta
    rows = log.theta[:done]
    columns = {"t_s": mpc.sample_s * np.arange(done)}
    outputs = rows[:, theta.x][:, mpc.model.n_x :]
    for name, values, wanted in zip(mpc.outputs, outputs.T, rows[:, theta.y_ref].T, strict=True):
        columns |= {name: values, f"{name}_reference": wanted}
    return pd.DataFrame(columns | dict(zip(mpc.inputs, log.tau[:done].T, strict=True)))


def replay(
    sequence: QPSequence | str | Path,
    workspace: Workspace | str,
    *,
    repeats: int = 5,
    warmup_steps: int = 50,
    formulation: Formulation = "condensed_box",
) -> Run:
    """Solve recorded QPs with a solver: a warm-up, then `repeats` rounds; judge every answer.

    Parameters
    ----------
    sequence : an object, a name or a `.npz` file.
    workspace : an object of `open_workspace`, or the name of a solver, on its default route.

    Raises
    ------
    InputError : for an unknown formulation, or "sparse" for QPs without a scenario behind them.
    TypeError : for a sequence, workspace or number of another type.

    Examples
    --------
    >>> workspace = open_workspace("daqp", route="native", policy="warm")
    >>> run = replay("paper-30-5", workspace, repeats=2)
    >>> run.label
    'daqp (native, warm)'
    >>> len(run.steps.query("counts"))  # the warm-up does not count
    150
    """
    _refuse_unknown_choice("replay", "formulation", formulation, FORMULATIONS)
    sequence, workspace = as_sequence(sequence), _open_workspace_if_named(workspace)
    repeats = require_integer_at_least("repeats", repeats, 1)
    warmup_steps = require_integer_at_least("warmup_steps", warmup_steps, 0)
    warmup_steps = min(warmup_steps, len(sequence))
    steps, solver, log = build_sequence_solver_and_log(
        sequence, workspace, formulation, repeats, RawLog.in_memory
    )
    replaying = ReplayRun(
        steps, solver, log, warmup_steps=warmup_steps, limit_ns=NO_LIMIT_NS, clock=clock
    )
    replaying.run_all_rounds()
    cell = _make_cell(
        workspace,
        mode="replay",
        scenario={"name": sequence.name},
        steps=len(sequence),
        formulation=formulation,
        units="scaled" if sequence.scaled is None else "si",
        rounds=repeats,
        warmup_steps=warmup_steps,
    )
    sample_s = float(sequence.meta.get("sample_s", float("nan")))
    return _make_run(cell, workspace, solver, evaluate_replay_log(log, sequence, sample_s))


def _refuse_unknown_choice(function: str, key: str, value: str, allowed: Collection[str]) -> None:
    """Raise InputError, named after a function, unless a value is one of those allowed."""
    if value not in tuple(allowed):  # A list has no hash to look for
        raise InputError(function, key, repr(value), f"one of {', '.join(allowed)}")


def _open_workspace_if_named(given: object) -> Workspace:
    """Return a workspace that is given as an object or by the name of its solver."""
    if isinstance(given, str):
        return open_workspace(given)
    if isinstance(given, Workspace):
        return given
    allowed = (
        "a Workspace of open_workspace, or the name of a solver; for your own function, use "
        "`opener(name, function)('fresh', {})`"
    )
    raise TypeError(f"workspace: found {shorten_found(given)}; allowed: {allowed}")


def _make_cell(workspace: Workspace, **fields: Any) -> Cell:
    """Describe a solver's run in this process: its scenario or QPs, policy and settings."""
    settings, options = workspace.requested_settings, ""
    if not isinstance(settings, str):
        options = encode_options_as_json(settings)
        settings = format_options_as_toml(settings) or DEFAULT
    fields |= {"settings": settings, "options": options}
    route, policy = workspace.route, workspace.policy
    return Cell(solver=workspace.solver, route=route, policy=policy, **fields)


def _make_run(
    cell: Cell,
    workspace: Workspace,
    timed_solver: TimedSolver,
    evaluated: EvaluatedCell,
    scenario: Scenario | None = None,
) -> Run:
    """Make a run with its table of steps and its summary row from judged answers."""
    steps = make_step_columns(cell, evaluated)
    detail = "; ".join(list_failure_descriptions(timed_solver.details))
    outcome = Outcome("finished", detail, workspace.form, *timed_solver.size)
    # A workspace of somebody's own class has no library that could be asked.
    known = workspace.reopen is not None
    library = find_solver_availability(cell.solver) if known else Availability(True)
    row = make_run_row("in-process", cell, outcome, library, "", evaluated, steps)
    return Run(
        make_step_rows("in-process", steps),
        convert_to_run_columns(pd.DataFrame([row])).iloc[0],
        scenario,
    )
