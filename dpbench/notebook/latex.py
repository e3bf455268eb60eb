"""Tables as LaTeX: text escaped, numbers and signs as math, nothing but ASCII."""

import math
import re
from numbers import Integral, Real

import pandas as pd
from pandas.api.types import is_bool_dtype, is_numeric_dtype

from dpbench.report.formats import as_float, count_digits_of_estimate, format_rounded_down

_SPECIAL = {sign: f"\\{sign}" for sign in "&%$#_{}"} | {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "`": "",  # Markdown's mark of code
    "\u202f": r"\,",
    "–": "--",
    "“": "``",
    "”": "''",
    "…": r"\ldots{}",
}
_MATH = {
    "|": "|",
    "<": "<",
    ">": ">",
    "∞": r"\infty",
    "→": r"\to",
    "←": r"\gets",
    "↔": r"\leftrightarrow",
    "−": "-",
    "±": r"\pm",
    "×": r"\times",
    "·": r"\cdot",
    "≤": r"\le",
    "≥": r"\ge",
    "≠": r"\ne",
    "≈": r"\approx",
    "√": r"\surd",
    "½": r"\frac{1}{2}",
    "°": r"^{\circ}",
    "¹": "^{1}",
    "²": "^{2}",
    "³": "^{3}",
    "⁻": "^{-}",
    "ᵀ": r"^{\top}",
    "Δ": r"\Delta",
    "Σ": r"\Sigma",
    "η": r"\eta",
    "θ": r"\theta",
    "λ": r"\lambda",
    "µ": r"\mu",
    "μ": r"\mu",
    "ν": r"\nu",
    "τ": r"\tau",
    "ψ": r"\psi",
}
_ESCAPES = str.maketrans(_SPECIAL | {sign: f"${math}$" for sign, math in _MATH.items()})
_NUMBER = re.compile(r"(?<![\w.)])-?\d+(?:\.\d+)?e[+-]?\d+(?!\w)|(?<![\w.)])-(?=\d)")
"""A number with an exponent, or the minus of another one."""
_DIGITS = 3
_LONG_CELL = 30
"""Characters of a text above which the cells of its column have several lines."""
_LINE = 80
"""Characters of a line of the document, by which the widths of columns are estimated."""
_GAP = 3
"""Characters that the space between two columns takes."""
_COLUMN_NAME = re.compile(r"[a-z][\w.]*", re.ASCII)
_UNITS = {unit: unit for unit in ("ns", "ms", "s", "m", "cm", "N", "kN", "mps", "J")} | {
    "us": "µs",
    "deg": "°",
    "mps": "m/s",
    "percent": "%",
}
"""Units that column names end with."""
_AMOUNT = re.compile(r"_for_\d+$")
"""Words after which a unit is not the unit of the column."""
_ESTIMATE = ("effect", "ratio", "median", "low", "high")
"""Columns of an estimate and of its interval in a table with one estimate a row."""
_HEAD_NAMES = {"p_differs": "p-value", "error_move": "first-move error [max. increments]"}


def make_tabular(table: pd.DataFrame) -> str:
    r"""Return a table as a LaTeX `tabular` with the rules of `booktabs`, one line a row.

    Numbers have three digits, with trailing zeros, and stand to the right; an estimate and the ends
    of its interval have a fourth where three do not distinguish them. A column of whole numbers has
    no decimals. If one number of a column needs a power of ten, all have one, and so have the ends
    of its interval. The values of a solver's options have no trailing zeros. Speed margins are
    rounded down, as on the page. A missing value is an empty cell. Heads are column names with
    spaces and the unit in brackets. A column of long texts has a width, so that its lines break.

    Examples
    --------
    >>> print(make_tabular(pd.DataFrame({"p50_us": [5.468], "error": [2.64e-12]})))
    \begin{tabular}{rr}
    \toprule
    p50 [$\mu$s] & error \\
    \midrule
    5.47 & $2.64\cdot 10^{-12}$ \\
    \bottomrule
    \end{tabular}
    <BLANKLINE>
    """
    align = "".join(_choose_column_types(table))
    heads = (escape_latex(make_table_head(str(name))) for name in table)
    whole = [_has_only_whole_numbers(table[name]) for name in table]
    has_powers = _find_columns_in_powers(table)
    are_options = [_is_option_column(str(name)) for name in table]
    are_margins = [str(name).partition("_")[0] == "margin" for name in table]
    rows = [
        [
            format_latex_cell(
                int(value)
                if is_whole and pd.notna(value)
                else _round_margin_down(value)
                if is_margin
                else _format_option(value, in_powers)
                if is_option and isinstance(value, float) and pd.notna(value)
                else value,
                in_powers=in_powers,
                digits=digits,
            )
            for value, is_whole, is_margin, in_powers, is_option, digits in zip(
                row, whole, are_margins, has_powers, are_options, digits_of_row, strict=True
            )
        ]
        for row, digits_of_row in zip(
            table.itertuples(index=False, name=None), _count_digits(table), strict=True
        )
    ]
    head, *body = (" & ".join(cells) + r" \\" for cells in (heads, *rows))
    lines = [r"\toprule", head, r"\midrule", *body, r"\bottomrule"]
    return "\n".join((f"\\begin{{tabular}}{{{align}}}", *lines, r"\end{tabular}", ""))


def _choose_column_types(table: pd.DataFrame) -> list[str]:
    """Return `r` for a column of numbers, `l` for short texts, `p` with a width for long ones.

    Columns of long texts divide the space that the others leave by the length of their longest
    cells, but none is narrower than its longest word. Together they are at most as wide as the
    line.
    """
    types: list[str] = []
    lengths: dict[int, int] = {}
    words: dict[int, int] = {}
    taken = _GAP * table.shape[1]
    for i, name in enumerate(table):
        head, column = make_table_head(str(name)), table.iloc[:, i]
        is_number = _has_only_numbers(column)
        texts = [] if is_number else [str(value) for value in column.dropna()]
        longest = max(map(len, texts), default=0)
        types.append("r" if is_number else "l")
        if longest > _LONG_CELL:
            lengths[i] = longest
            words[i] = max(len(word) for text in [head, *texts] for word in text.split())
        else:
            taken += max(longest, len(head))
    free, needed = max(0, _LINE - taken), sum(words.values())
    shares = {i: free * length / sum(lengths.values()) for i, length in lengths.items()}
    more = {i: max(0.0, share - words[i]) for i, share in shares.items()}
    scale = max(0, free - needed) / (sum(more.values()) or 1.0)
    line = max(_LINE, needed)
    for i in lengths:
        width = words[i] + scale * more[i]
        types[i] = f"p{{{math.floor(100 * width / line) / 100:.2f}\\linewidth}}"
    return types


def _count_digits(table: pd.DataFrame) -> list[list[int]]:
    """Return the digits of each cell, by row: more than usual where an interval is narrow."""
    names = [str(name).partition(" [")[0] for name in table]
    digits = [[_DIGITS] * len(names) for _ in range(len(table))]
    for place, name in enumerate(names):
        ends = ("low", "high") if name in ("effect", "ratio") else (f"{name}_low", f"{name}_high")
        if not {*ends} <= {*names}:
            continue
        places = [place, *map(names.index, ends)]
        for row, of_row in zip(table.itertuples(index=False, name=None), digits, strict=True):
            value, low, high = (as_float(row[i]) for i in places)
            for i in places:
                of_row[i] = count_digits_of_estimate(value, low, high, _DIGITS)
    return digits


def _round_margin_down(value: object) -> object:
    """Return a speed margin rounded down to the digits of a cell, as on the page."""
    if not isinstance(value, Real) or not math.isfinite(value):
        return value
    return float(format_rounded_down(float(value), _DIGITS).replace("\u202f", ""))


def make_table_head(name: str) -> str:
    """Return the head of a column for print: a name with words apart and its unit in brackets.

    The end of an interval precedes the unit. The unit of an amount in a name stays in the name.

    >>> [make_table_head(name) for name in ("excess_error_cm_low", "realisations_for_1_cm")]
    ['excess error, low [cm]', 'realisations for 1 cm']
    """
    if name in _HEAD_NAMES or _COLUMN_NAME.fullmatch(name) is None:
        return _HEAD_NAMES.get(name, name)
    if _is_option_column(name):
        return name.removeprefix("x_")
    name = name.removeprefix("x_")  # the key of a study
    stem, _, end = name.rpartition("_")
    if end not in ("low", "high") or stem.rpartition("_")[2] not in _UNITS:
        stem, end = name, ""
    words, _, unit = stem.rpartition("_")
    if not words or unit not in _UNITS or _AMOUNT.search(words):
        words, unit = stem, ""
    ending = (f", {end}" if end else "") + (f" [{_UNITS[unit]}]" if unit else "")
    return words.replace("_", " ") + ending


def _is_option_column(name: str) -> bool:
    """Return whether a column has the values of a solver's option, as `x_eps_abs`."""
    return name.startswith("x_") and "." not in name


def _has_only_numbers(column: pd.Series) -> bool:
    """Return whether the cells of a column are numbers."""
    return is_numeric_dtype(column) and not is_bool_dtype(column)


def _has_only_whole_numbers(column: pd.Series) -> bool:
    """Return whether the known values of a column are finite whole numbers below 1e7."""
    if not _has_only_numbers(column):
        return False
    known = column.dropna().astype(float)
    return bool(len(known)) and bool(((known % 1.0 == 0.0) & (known.abs() < 1e7)).all())


def _find_columns_in_powers(table: pd.DataFrame) -> list[bool]:
    """Return of each column whether it, or a column of the same estimate, needs powers of ten."""
    estimates = [_name_estimate(str(name)) for name in table]
    in_powers = {
        estimate
        for estimate, name in zip(estimates, table, strict=True)
        if _has_powers_of_ten(table[name])
    }
    return [estimate in in_powers for estimate in estimates]


def _has_powers_of_ten(column: pd.Series) -> bool:
    """Return whether a number of a column is written as a power of ten."""
    if not _has_only_numbers(column):
        return False
    known = column.dropna().astype(float).abs()
    return any(r"\cdot" in _format_number(value) for value in known)


def _name_estimate(name: str) -> str:
    """Return a name that the columns of an estimate and of the ends of its interval share."""
    is_of_row = name.partition(" [")[0] in _ESTIMATE
    return _ESTIMATE[0] if is_of_row else name.removesuffix("_low").removesuffix("_high")


def _format_option(value: float, in_powers: bool) -> str:
    """Return the value of a solver's option as text without trailing zeros."""
    mantissa, exponent = f"{value:e}".split("e")
    return f"{float(mantissa):g}e{exponent}" if in_powers else f"{value:g}"


def format_latex_cell(value: object, *, in_powers: bool = False, digits: int = _DIGITS) -> str:
    """Format a value as a cell of LaTeX: a float to so many digits, anything else as text."""
    if value is None or value is pd.NA or value != value:  # NaN alone differs from itself
        return ""
    if isinstance(value, Real) and not isinstance(value, Integral):
        return _format_number(float(value), in_powers=in_powers, digits=digits)
    return escape_latex(str(value))


def escape_latex(text: str) -> str:
    """Escape a text for LaTeX; its signs and the exponents of its numbers become math."""
    parts, end = [], 0
    for found in _NUMBER.finditer(text):
        number = "$-$" if found[0] == "-" else _format_power_of_ten(found[0])
        parts += [text[end : found.start()].translate(_ESCAPES), number]
        end = found.end()
    return "".join((*parts, text[end:].translate(_ESCAPES)))


def _format_number(value: float, *, in_powers: bool = False, digits: int = _DIGITS) -> str:
    """Return a number as LaTeX of so many digits; 0 as it is.

    It has no exponent from 1e-4 to 1e7, unless it stands `in_powers` of ten.
    """
    if abs(value) == float("inf"):
        return r"$\infty$" if value > 0.0 else r"$-\infty$"
    if value == 0.0:
        return "0"
    rounded = float(f"{value:.{digits}g}")
    if in_powers or not 1e-4 <= abs(rounded) < 1e7:
        return _format_power_of_ten(f"{value:.{digits - 1}e}")
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(rounded))))
    text = f"{rounded:.{decimals}f}"
    return f"${text}$" if rounded < 0.0 else text


def _format_power_of_ten(text: str) -> str:
    """Return a number such as 1.2e-12 as a power of ten in math."""
    mantissa, exponent = text.split("e")
    factor = {"1": "", "-1": "-"}.get(mantissa, f"{mantissa}\\cdot ")
    return f"${factor}10^{{{int(exponent)}}}$"
