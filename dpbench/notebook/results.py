"""A result folder in memory, with the tables of the report as data frames."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from dpbench.analysis.records.records import Records
from dpbench.analysis.times.chosen_pairs import compare_chosen
from dpbench.analysis.times.paired_times import RATIO_COLUMNS
from dpbench.analysis.verdict.ship_results import find_ship_results
from dpbench.analysis.verdict.verdict import list_best_verdict_of_each_solver
from dpbench.bench.capability.edge_qps import load_capability_plots
from dpbench.bench.design import load_stability_records
from dpbench.bench.record import result_folder
from dpbench.bench.record.recorded_steps import STEPS_NEEDED
from dpbench.display import make_html_paragraph, make_html_table
from dpbench.embedded.table import load_counted_steps_of_folder
from dpbench.errors import (
    InputError,
    ResultsError,
    format_allowed_names,
    require_lists_of_names,
    require_type,
)
from dpbench.files.regular_files import make_folder_if_missing
from dpbench.notebook.captions import (
    NO_RATIO_NOTE,
    RATIO_NOTE,
    describe_table_with_runs,
    yield_notes_on_columns,
)
from dpbench.notebook.latex import escape_latex, make_tabular
from dpbench.notebook.plots import ResultPlots
from dpbench.report.commands_text import describe_disturbed_times
from dpbench.report.formats import plural, strip_markdown
from dpbench.report.ship.ship_text import summarise_ships

if TYPE_CHECKING:
    from dpbench.report.report import Report

_NAME = "table"
"""Key of a data frame's `attrs`: the name of the table."""
_OF_UNIT = ("effect", "low", "high", "median")
"""Columns of a table whose unit is in its column `unit`."""
VERDICT_COLUMNS = (
    *("solver", "route", "policy", "settings", "verdict"),
    *("error_move", "p50_us", "limiting_p99_us"),
)
"""The columns of the verdicts in LaTeX."""


class RatioTable(pd.DataFrame):
    """Data frame of step time ratios that displays the meaning and reach of their intervals."""

    def __repr__(self) -> str:
        return f"{super().__repr__()}\n{self._note}"

    def _repr_html_(self) -> str | None:
        """Return the table as HTML with the note below it, which a notebook displays."""
        table = super()._repr_html_()  # type: ignore[misc] # the stubs of pandas lack it
        return None if table is None else f"{table}{make_html_paragraph(self._note)}"

    @property
    def _note(self) -> str:
        """Note below the table: what a ratio is, or why there is none."""
        return NO_RATIO_NOTE if self.empty else RATIO_NOTE


@dataclass(frozen=True, eq=False, repr=False)
class Results(result_folder.Results):
    """A benchmark's results in memory: runs, steps, machine, suite, and tables of the report.

    The report's are made at first use, and are what `dpbench report` writes into `tables/`. In a
    folder without `steps.parquet`, such as `results/reference`, they are read from there; what
    needs the steps raises ResultsError. A notebook shows the recommendation, and what disturbed the
    times.

    Examples
    --------
    >>> results = load_results("results/smoke")
    >>> len(results.runs), results.runs["solver"].nunique()
    (16, 4)
    >>> list(results.verdict().columns)[:3]
    ['solver', 'route', 'policy']
    """

    folder: Path

    @property
    def answer(self) -> str:
        """Sentence that names the recommended solver and settings, or the question of the suite.

        Where the controller does not hold the ship, whatever the solver, it begins with that. Where
        other load disturbed the times, it ends with that.

        Examples
        --------
        >>> load_results("results/smoke").answer  # doctest: +ELLIPSIS
        'Use paper_active_set (native ...'
        """
        state = f"The machine was {self._disturbed}." if self._disturbed else ""
        return " ".join(filter(None, (self._warning, self._recommendation, state)))

    def ships(self) -> pd.DataFrame:
        """Return what the controller itself does to each scenario's ship: a row per scenario.

        From the reference loop, with offsets [m], times [s] and the share of steps with active
        limits; `ship` is "on station", "leaves", "leaves and returns", "not arrived" (at its
        setpoint) or "not run".

        Examples
        --------
        >>> load_results("results/smoke").ships()[["scenario", "ship"]].values.tolist()
        [['paper', 'on station']]
        """
        return self.tables["ships"]

    @property
    def plot(self) -> ResultPlots:
        """Plots of the results: `times()` against the deadline, and `accuracy()` over time.

        Examples
        --------
        >>> load_results("results/smoke").plot
        <figures: times(), accuracy()>
        """
        return ResultPlots(self._full_report.data)

    @cached_property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """All tables of the benchmark's report as data frames, by name.

        Examples
        --------
        >>> load_results("results/smoke").tables["ships"]["scenario"].tolist()
        ['paper']
        """
        if self.recorded.is_missing:
            return _StoredTables(self.folder / "tables")
        return _Tables(self._full_report.tables.items())

    @cached_property
    def steps(self) -> pd.DataFrame:
        """All steps as a data frame, some 500 bytes each; use `recorded` for large folders.

        Examples
        --------
        >>> results = load_results("results/smoke")
        >>> {"k", "status", "error_move", "n_active"} <= set(results.steps)
        True
        """
        self.recorded.require_file()
        return self.recorded.read_all_steps()

    def verdict(self) -> pd.DataFrame:
        """Return a table of verdicts: a row per solver and settings, with reason and main numbers.

        Times in µs; error_move and failed_steps over all its runs except those in SI units.

        Examples
        --------
        >>> table = load_results("results/smoke").verdict()
        >>> table.query("solver == 'daqp' and policy == 'fresh'")["failed_steps"].tolist()
        [0]
        """
        return self.tables["verdicts"]

    def hard_steps(self) -> pd.DataFrame:
        """Return the five hardest steps of each solver's run by time [µs], iterations and error.

        Examples
        --------
        >>> sorted(load_results("results/smoke").hard_steps()["by"].unique())
        ['error', 'iterations', 'time']
        """
        return self.tables["hard_steps"]

    def ladder(self) -> pd.DataFrame:
        """Return step times [µs] of each timed solver's best and your own settings, as a table.

        The best is the fastest of the best verdict by p99, or by p50 without a p99. If all fail,
        it is the one with the fewest failed steps, then the smallest error.
        `share` is what calling a library that does nothing takes of its median.

        Examples
        --------
        >>> list(load_results("results/smoke").ladder().columns)[:4]
        ['solver', 'label', 'verdict', 'p50_us']
        """
        return self.tables["ladder"]

    def paired_ratios(self, *choices: str) -> pd.DataFrame:
        """Return step time ratios of two configurations on the same steps, as a table.

        Each solver's best and up to 12 of your settings against the fastest, and its settings, in
        one call mode, against `default` or the first of them. One row for each number of
        `variables`. `low` and `high` bound the mean ratio, second over first, within this run.
        `finding` is "slower" or "faster" (the second), "tied" where they include 1, "unstable"
        where another measure disagrees, "machine disturbed" where other load can explain the
        difference, "one run" of settings without effect, or "too few steps" for an interval; these
        two have 0 to inf. Two that were not interleaved have no ratio, and `finding` has the
        reason.

        choices : instead, of each two of these: solvers, `osqp[rho=1.6]`, `osqp high` or labels.

        Raises
        ------
        InputError : for a choice that was not timed, or one alone.

        Examples
        --------
        >>> results = load_results("results/smoke")
        >>> results.paired_ratios("daqp", "quadprog")["second"].tolist()
        ['quadprog (qpsolvers fresh)']
        """
        for choice in choices:
            allowed = "names of configurations, each an argument: 'daqp', 'osqp high'"
            require_type("choices", choice, str, allowed)
        if choices:
            self.recorded.require_file()
            rows = [one.table_row for one in compare_chosen(Records(self), choices)]
            return RatioTable(rows, columns=list(RATIO_COLUMNS))
        return RatioTable(self.tables["paired_ratios"])

    def to_latex(
        self,
        table: str | pd.DataFrame = "verdicts",
        columns: Sequence[str] | None = None,
        *,
        solvers: Sequence[str] | None = None,
        only_run: bool = False,
    ) -> str:
        """Return a table of the report as a LaTeX `tabular`, numbers to three digits.

        An estimate and its interval have a fourth digit where three do not distinguish them. The
        document needs the package `booktabs`. A ratio of one run to itself is an empty cell. If
        all rows have one `unit`, it is in the heads of the values. For a table of the report, or
        rows of one, the last line is a comment with a caption: contents, and rounds and steps of
        the replays. It defines step time ratios, their intervals and that of the limiting p99.

        table : a name in `tables`, or a data frame, such as some rows of one. columns : some of its
        columns, by default all; of "verdicts" those that identify a configuration, its verdict,
        error and times, without empty ones. solvers : only their rows. only_run : without rows of
        verdict "not run". InputError for a table, column or solver that is not there.

        Examples
        --------
        >>> results = load_results("results/smoke")
        >>> latex = results.to_latex(columns=["solver", "route"], solvers=["daqp"])
        >>> "daqp & qpsolvers" in latex
        True
        """
        require_type("table", table, str | pd.DataFrame, "the name of a table, or a data frame")
        require_lists_of_names({}, columns=columns, solvers=solvers)
        if isinstance(table, str):
            if table not in self.tables:
                with_rows = [name for name, rows in self.tables.items() if len(rows)]
                listing = "results.tables` or `dpbench report DIR --tables"
                _refuse_unknown_name("table", table, with_rows, listing)
            frame, source = self.tables[table], table
        else:
            frame, source = table, str(table.attrs.get(_NAME, ""))
        if solvers is not None:
            _refuse_unknown_name("solvers", "solver", frame.columns)
            for name in solvers:
                _refuse_unknown_name("solvers", name, frame["solver"].unique())
            frame = frame[frame["solver"].isin(solvers)]
        if only_run and "verdict" in frame:
            frame = frame[frame["verdict"] != "not run"]
        for name in columns or ():
            _refuse_unknown_name("columns", name, frame.columns)
        if "finding" in frame:
            values = frame.columns.intersection(["ratio", "low", "high"])
            frame = frame.copy()
            of_one_run = frame["finding"] == "one run"
            frame.loc[of_one_run, values] = math.nan
        are_verdicts = isinstance(table, str) and table == "verdicts"
        usual = [
            name
            for name in frame
            if not are_verdicts or (name in VERDICT_COLUMNS and not frame[name].isna().all())
        ]
        chosen: list[Any] = list(columns or usual)
        parts = []
        if source in self.tables:
            parts.append(describe_table_with_runs(self, source, self.tables[source]))
        parts += yield_notes_on_columns(frame, chosen, are_verdicts=source == "verdicts")
        caption = " ".join(parts)
        frame = frame[chosen].rename(columns=_find_heads_with_unit(frame))
        return make_tabular(frame) + (f"% Caption: {escape_latex(caption)}\n" if caption else "")

    def to_csv(self, folder: str | Path) -> None:
        """Write all tables of the report that have rows as CSV files into a folder.

        The file `.<folder>.json` beside it lists them, so that the next call removes old ones. Of
        results without steps the stored files are copied.

        Examples
        --------
        >>> from pathlib import Path
        >>> load_results("results/smoke").to_csv("tables")
        >>> Path("tables/verdicts.csv").is_file()
        True
        """
        # The report draws, and Altair takes its time.
        from dpbench.report.report import copy_tables, write_tables

        require_type("folder", folder, str | PathLike, "the path of a folder")
        target = make_folder_if_missing(Path(folder))
        if self.recorded.is_missing:
            copy_tables(self.folder / "tables", target)
        else:
            write_tables(target, self.tables)

    def __repr__(self) -> str:
        runs = plural(len(self.runs), "run")
        solvers = plural(self.runs["solver"].nunique(), "solver")
        outcomes = self.runs["outcome"].value_counts().drop("finished", errors="ignore")
        others = "".join(f", {count} {outcome}" for outcome, count in outcomes.items())
        state = f"; the machine was {self._disturbed}" if self._disturbed else ""
        name = self.suite.get("name", self.folder.name)
        warning = f"; {self._warning}" if self._warning else ""
        return f"<Results {name}: {runs} of {solvers}{others}{state}{warning}>"

    def _repr_html_(self) -> str:
        """Return the recommendation and each solver's best settings as HTML.

        The warning of a lost ship comes before the table. Without steps it has the number of runs,
        and why there is no recommendation.
        """
        if self.recorded.is_missing:
            missing = f"No recommendation, as {self.folder} has no steps.parquet. Required:"
            return make_html_paragraph(repr(self)) + make_html_paragraph(
                f"{missing} {STEPS_NEEDED}."
            )
        from dpbench.report.documents.markdown import HEAD, make_solver_rows

        rows = make_solver_rows(
            self._full_report.data,
            list_best_verdict_of_each_solver(self._full_report.data.verdicts),
        )
        title = str(self.suite.get("name", self.folder.name))
        state = f" The machine was {self._disturbed}." if self._disturbed else ""
        note = f"{self._recommendation}{state}"
        table = make_html_table(HEAD, rows, title=title, note=note)
        return f"{make_html_paragraph(self._warning)}{table}"

    @cached_property
    def _warning(self) -> str:
        """Warning where the controller does not hold a ship, whatever the solver; "" elsewhere."""
        return strip_markdown(summarise_ships(find_ship_results(Records(self))).warning)

    @property
    def _recommendation(self) -> str:
        """Sentence of `answer` without the warning of a lost ship."""
        return dict(self._full_report.summary_rows()).get("answer", "")

    @cached_property
    def _disturbed(self) -> str:
        """Disturbance of the timed replays, as in `report.md`; "" on a quiet machine."""
        return describe_disturbed_times(Records(self))

    @cached_property
    def _full_report(self) -> Report:
        """Report of these results, the same as `dpbench report` writes, built at first use."""
        self.recorded.require_file()
        from dpbench.report.report import Report

        capability, counted = (
            load_capability_plots(self.folder),
            load_counted_steps_of_folder(self.folder),
        )
        return Report.from_results(
            self, load_stability_records(self.folder), capability=capability, counted=counted
        )


class _Tables(dict[str, pd.DataFrame]):
    """Tables by name, which their rows keep; KeyError with the nearest names for an absent one."""

    def __init__(self, tables: Iterable[tuple[str, pd.DataFrame]]) -> None:
        super().__init__(tables)
        for name, frame in self.items():
            frame.attrs[_NAME] = name

    def __missing__(self, name: str) -> pd.DataFrame:
        """Raise KeyError that names the nearest tables."""
        raise KeyError(f"no table {name!r}; allowed: {format_allowed_names(str(name), list(self))}")


class _StoredTables(_Tables):
    """Tables that an earlier report wrote into a folder; ResultsError for one that is absent."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        from dpbench.report.report import read_tables

        super().__init__(read_tables(folder))

    def __missing__(self, name: str) -> pd.DataFrame:
        """Raise ResultsError that names the table and those that are there."""
        path, stored = self._folder / f"{name}.csv", ", ".join(self) or "steps.parquet to make it"
        raise ResultsError(str(path), "", "no such file, and no steps.parquet", stored)


def _find_heads_with_unit(frame: pd.DataFrame) -> dict[str, str]:
    """Return heads with the unit of a table whose rows all have the same; none for several."""
    units: list[str] = [*frame["unit"].unique()] if "unit" in frame else []
    if len(units) != 1:
        return {}
    return {name: f"{name} [{units[0]}]" for name in _OF_UNIT if name in frame}


def _refuse_unknown_name(argument: str, name: str, known: Iterable[str], listing: str = "") -> None:
    """Raise InputError unless a table, column or solver is known, with the nearest that are."""
    if name not in (names := list(known)):
        allowed = format_allowed_names(name, names, listing=listing)
        if argument == "columns":  # their names differ from the heads on the page: none is near
            allowed = f"one or more of {', '.join(names)}"
        if not names:
            allowed = f"none, as there are no {argument.removesuffix('s')}s"
        raise InputError(f"`{argument}`", "", repr(name), allowed)


def load_results(out: str | Path) -> Results:
    """Read a benchmark's result folder into memory.

    Parameters
    ----------
    out : a folder written by `run_campaign` or `dpbench run`, or one without the steps.

    Raises
    ------
    ResultsError : naming the file, when one is missing, damaged or of another schema.

    Examples
    --------
    >>> load_results("results/smoke").runs["mode"].unique().tolist()
    ['closed_loop', 'replay']
    """
    stored = result_folder.load_results(out, without_steps=True)
    return Results(stored.runs, stored.recorded, stored.machine, stored.suite, Path(out))
