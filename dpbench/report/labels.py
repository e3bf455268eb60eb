"""Place text beside points so that the words do not lie on each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

Box = tuple[float, float, float, float]

_CHARACTER_PT = 5.0
_LINE_PT = 9.5
_DIRECTIONS = 16
LINE_PT, OFFSET_PT = 9.0, 18.0
"""Height of a name at the end of a line, and how far right of it the name stands."""


def label_points(
    ax: Axes, points: Sequence[tuple[float, float]], texts: Sequence[str], colours: Sequence[str]
) -> None:
    """Write each text beside its point, greedily where it overlaps least.

    The limits and scales of `ax` must be final, and its layout drawn once.
    """
    scale = 72.0 / ax.get_figure(root=True).dpi  # type: ignore[union-attr] # axes of a figure have one
    spots = ax.transData.transform(np.asarray(points, dtype=np.float64).reshape(-1, 2)) * scale
    frame = ax.get_window_extent()
    inside = (frame.x0 * scale, frame.y0 * scale, frame.x1 * scale, frame.y1 * scale)
    taken: list[Box] = [(x - 4, y - 4, x + 4, y + 4) for x, y in spots]
    for point, spot, text, colour in zip(points, spots, texts, colours, strict=True):
        width = _CHARACTER_PT * len(text)
        dx, dy, box = min(_candidates(spot, width), key=lambda found: _cost(found, taken, inside))
        taken.append(box)
        far = np.hypot(dx, dy) > 14
        ax.annotate(
            text,
            point,
            xytext=(dx, dy),
            textcoords="offset points",
            ha="left",
            va="center",
            fontsize=7.5,
            color=colour,
            path_effects=[withStroke(linewidth=2.0, foreground="white")],
            arrowprops={"arrowstyle": "-", "color": colour, "lw": 0.5, "shrinkB": 3}
            if far
            else None,
        )


def _candidates(spot: NDArray[np.float64], width: float) -> list[tuple[float, float, Box]]:
    found = []
    for radius in (8.0, 16.0, 26.0, 38.0, 52.0):
        for angle in np.arange(_DIRECTIONS) * 2 * np.pi / _DIRECTIONS:
            dx, dy = radius * np.cos(angle), radius * np.sin(angle)
            # A label to the left ends at the point, one to the right starts there.
            left = dx - width * (1 - np.cos(angle)) / 2
            x, y = spot[0] + left, spot[1] + dy
            found.append((left, dy, (x, y - _LINE_PT / 2, x + width, y + _LINE_PT / 2)))
    return found


def _cost(
    found: tuple[float, float, Box], taken: Sequence[Box], inside: Box
) -> tuple[float, float]:
    dx, dy, box = found
    overlap = sum(_overlap(box, other) for other in taken)
    outside = _area(box) - _overlap(box, inside)
    return round(overlap + 3 * outside, 3), float(np.hypot(dx, dy))


def _area(box: Box) -> float:
    return (box[2] - box[0]) * (box[3] - box[1])


def _overlap(a: Box, b: Box) -> float:
    wide = min(a[2], b[2]) - max(a[0], b[0])
    high = min(a[3], b[3]) - max(a[1], b[1])
    return max(0.0, wide) * max(0.0, high)


def name_ends(ax: Axes, ends: Sequence[tuple[float, float, str, str]]) -> None:
    """Names right of the ends of lines, those of one column kept apart.

    The limits and scales of `ax` must be final, and its layout drawn once.

    Parameters
    ----------
    ends : x, y, name and colour of each.
    """
    columns: dict[float, list[tuple[float, str, str]]] = {}
    for x, y, name, colour in ends:
        columns.setdefault(x, []).append((y, name, colour))
    scale = 72.0 / ax.get_figure(root=True).dpi  # type: ignore[union-attr] # axes of a figure have one
    for x, column in columns.items():
        column.sort()
        heights = ax.transData.transform([(x, y) for y, _, _ in column])[:, 1] * scale
        shifts = kept_apart(heights, LINE_PT) - heights
        for (y, name, colour), shift in zip(column, shifts, strict=True):
            ax.annotate(
                name,
                (x, y),
                xytext=(OFFSET_PT, shift),
                textcoords="offset points",
                va="center",
                fontsize=7.5,
                color=colour,
                bbox={"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.7},
                arrowprops={
                    "arrowstyle": "-",
                    "color": colour,
                    "lw": 0.5,
                    "relpos": (0.0, 0.5),
                    "shrinkA": 0,
                    "shrinkB": 3,
                },
            )


def kept_apart(places: NDArray[np.float64], gap: float) -> NDArray[np.float64]:
    """The places nearest to these ascending ones (least squares) that are `gap` apart at least."""
    steps = gap * np.arange(len(places))
    found: NDArray[np.float64] = isotonic_regression(places - steps).x + steps
    return found
