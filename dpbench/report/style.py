"""One restrained style for all figures, and how a figure becomes a file.

Colours are those of Okabe & Ito (2008), told apart by readers with any common colour vision.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from dpbench.errors import InputError
from dpbench.solvers.record import Family
from dpbench.solvers.table import record

BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#E69F00",
    "#CC79A7",
    "#56B4E9",
)
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
INK, GREY, PALE = "#222222", "#767676", "#DDDDDD"
CONSTRAINED, CLIPPED, LIMIT = BLUE, VERMILLION, INK

_BY_STEPS = "first order, augmented Lagrangian"
FAMILIES: dict[Family, tuple[str, str]] = {
    "active set": ("active set", BLUE),
    "interior point": ("interior point", VERMILLION),
    "first order": (_BY_STEPS, GREEN),
    "augmented Lagrangian": (_BY_STEPS, GREEN),
    "baseline law": ("baseline law", GREY),
    "harness": ("harness", GREY),
    "not stated": ("family not stated", GREY),
}
"""What a figure calls the family of a solver's record, and its colour; few colours are told apart,
so that two families share one."""

STYLE: dict[str, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9,
    "axes.edgecolor": GREY,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": PALE,
    "grid.linewidth": 0.6,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "lines.linewidth": 1.3,
    "figure.dpi": 100,
    "path.simplify": True,
    "path.simplify_threshold": 0.5,
    "svg.hashsalt": "dpbench",
}


@contextmanager
def styled() -> Iterator[None]:
    """Draw in the report's style; figures must be made *and* written inside."""
    with mpl.rc_context(cast(Any, STYLE)):  # the stub spells out every key
        yield


def family_of(solver: str) -> str:
    """What a figure calls the method family of a solver, also of one that is not known here."""
    return _family(solver)[0]


def colour_of(solver: str) -> str:
    """The colour of a solver's method family."""
    return _family(solver)[1]


def family_colours(solvers: Iterable[str]) -> dict[str, str]:
    """The families of some solvers by their names, in the order of a legend, and their colours."""
    present = {family_of(solver) for solver in solvers}
    return {name: colour for name, colour in FAMILIES.values() if name in present}


def _family(solver: str) -> tuple[str, str]:
    try:
        return FAMILIES[record(solver).family]
    except InputError:  # of a plug-in that is not installed, or fails, where the report is written
        return FAMILIES["not stated"]


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty figure without any global state."""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def one_axes(width_in: float, height_in: float) -> tuple[Figure, Axes]:
    """A figure with one pair of axes."""
    figure = new_figure(width_in, height_in)
    return figure, figure.add_subplot()


def power_label(value: float, position: int | None = None) -> str:
    """`10⁻³` for 1e-3, nothing between powers of ten; the signature is that of a tick formatter."""
    del position
    exponent = math.log10(value) if value > 0 else math.nan
    if not abs(exponent - round(exponent)) < 1e-9:
        return ""
    return "10" + str(round(exponent)).translate(_SUPERSCRIPTS)


def log_x(ax: Axes) -> None:
    """A logarithmic x axis labelled at powers of ten, in plain text (TeX costs seconds a page)."""
    ax.set_xscale("log")
    ax.xaxis.set_major_formatter(FuncFormatter(power_label))
    ax.xaxis.set_minor_formatter(NullFormatter())


def log_time(ax: Axes) -> None:
    """A logarithmic x axis of times, labelled 10, 20, 50, 100 in plain numbers."""
    ax.set_xscale("log")
    _plain_times(ax.xaxis, (1.0, 2.0, 5.0))


def log_time_y(ax: Axes) -> None:
    """A logarithmic y axis of times, labelled 1, 10, 100 in plain numbers."""
    ax.set_yscale("log")
    _plain_times(ax.yaxis, (1.0,))


def _plain_times(axis: Axis, steps: tuple[float, ...]) -> None:
    axis.set_major_locator(LogLocator(subs=steps))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.6g}".replace(",", " ")))
    axis.set_minor_formatter(NullFormatter())


def log_y(ax: Axes) -> None:
    """The same for the y axis."""
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter(FuncFormatter(power_label))
    ax.yaxis.set_minor_formatter(NullFormatter())


def save(figure: Figure, path: Path) -> None:
    """Write as SVG or PNG by the suffix; the same figure gives the same bytes."""
    metadata: dict[str, Any] | None = (
        {"Date": None, "Creator": "dpbench"} if path.suffix == ".svg" else None
    )
    figure.savefig(path, metadata=metadata, dpi=150)
