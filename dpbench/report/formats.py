"""Formats of the report: numbers in significant digits with units, tables of text, Markdown.

Nothing is made up: what is missing is a dash. Words of others are made harmless in Markdown.
"""

import math
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import ROUND_DOWN, ROUND_UP, Decimal
from typing import Any, Self

from dpbench.display import make_html_table

MISSING = "–"
NO_SOLUTION = "no solution"
"""Stands for an infinite error."""


def format_time(nanoseconds: float) -> str:
    """Return a duration [ns] as text in ns, µs, ms or s, in three significant digits."""
    if not math.isfinite(nanoseconds):
        return MISSING
    for factor, unit in ((1e3, "ns"), (1e6, "µs"), (1e9, "ms")):
        if abs(nanoseconds) < 0.9995 * factor:
            return f"{significant(nanoseconds / (factor / 1e3))} {unit}"
    return f"{significant(nanoseconds / 1e9)} s"


NOTED_WAIT = 0.1
"""Share of a time from which on its wait for the processor core is named beside it."""


def describe_wait(time_ns: float, wait_ns: float) -> str:
    """Return words on how much of a time [ns] was a wait for the core; "" below a tenth.

    >>> describe_wait(4.5e6, 4.2e6)
    ' (including a wait of 4.20 ms for the core)'
    """
    if not wait_ns >= NOTED_WAIT * time_ns:
        return ""
    return f" (including a wait of {format_time(wait_ns)} for the core)"


def format_microseconds(nanoseconds: float) -> str:
    """Format a duration [ns] as a number of µs without the unit, three significant digits."""
    return significant(nanoseconds / 1e3) if math.isfinite(nanoseconds) else MISSING


def significant(value: float, digits: int = 3) -> str:
    """Return a number as text in significant digits, without exponent from 1e-4 to 1e7."""
    if not math.isfinite(value):
        return MISSING
    if value == 0.0:
        return "0"
    rounded = float(f"{value:.{digits - 1}e}")
    exponent = math.floor(math.log10(abs(rounded)))
    if not -4 <= exponent < 7:
        return f"{value:.{digits - 1}e}"
    decimals = max(0, digits - 1 - exponent)
    text = f"{rounded:.{decimals}f}"
    return text if abs(rounded) < 1e3 else f"{rounded:,.0f}".replace(",", "\u202f")


def format_rounded_down(value: float, digits: int = 3) -> str:
    """Return a number as text in significant digits, rounded down: a bound that still holds."""
    return _round_significant(value, digits, ROUND_DOWN)


def floor_to_tenth(wind_mps: float) -> float:
    """Return a wind rounded down: 10.68 m/s, short of the 10.7 of number 5, is no "10.7"."""
    return math.floor(10.0 * wind_mps + 1e-6) / 10.0


def format_wind_held(wind_mps: float) -> str:
    """Return a largest wind held as text, rounded down to 0.1 m/s.

    >>> format_wind_held(8.08)
    '8.0 m/s'
    """
    return f"{floor_to_tenth(wind_mps):.1f} m/s"


def format_rounded_up(value: float, digits: int = 3) -> str:
    """Return a number as text in significant digits, rounded up: a bound that still holds."""
    return _round_significant(value, digits, ROUND_UP)


def _round_significant(value: float, digits: int, way: str) -> str:
    """Return a positive number as text in significant digits, rounded up or down."""
    if not (math.isfinite(value) and value > 0.0):
        return significant(value, digits)
    exact = Decimal(value)
    unit = Decimal(1).scaleb(exact.adjusted() - digits + 1)
    return significant(float(exact.quantize(unit, rounding=way)), digits)


def format_error(value: float) -> str:
    """Format an error: two significant digits, `no solution` when infinite."""
    if math.isnan(value):
        return MISSING
    if math.isinf(value):
        return NO_SOLUTION
    if value == 0.0:
        return "0"
    return f"{value:.1e}" if not 1e-2 <= abs(value) < 1e3 else significant(value, 2)


def format_share(share: float) -> str:
    """Format a share in percent; 100 % and 0 % are printed only when they are exact."""
    if not math.isfinite(share):
        return MISSING
    percent = 100.0 * share
    if percent in (0.0, 100.0):
        return f"{percent:.0f} %"
    return f"{min(max(percent, 0.1), 99.9):.1f} %"


def format_sample_share(share: float) -> str:
    """Format a share of a control sample in percent, two significant digits; may exceed 100 %."""
    return f"{significant(100.0 * share, 2)} %" if math.isfinite(share) else MISSING


def as_float(value: object) -> float:
    """Return a table cell as a float; a missing one (None, pd.NA, NaN) is NaN."""
    try:
        return float(value)  # type: ignore[arg-type] # any cell of a table; what fails is missing
    except (TypeError, ValueError):
        return math.nan


def format_count(value: object) -> str:
    """Format a count with thin spaces between thousands; a missing one is a dash."""
    number = as_float(value)
    return f"{number:,.0f}".replace(",", "\u202f") if math.isfinite(number) else MISSING


def plural(count: float, word: str) -> str:
    """Format a count with its noun: `1 step`, `2 steps`."""
    return f"{format_count(count)} {word if count == 1 else word + 's'}"


def format_seconds(value: float) -> str:
    """Format a settling time in seconds; "never" for an infinite one."""
    if math.isnan(value):
        return MISSING
    return "never" if math.isinf(value) else f"{value:.1f} s"


def format_estimate_with_bounds(value: float, low: float, high: float) -> tuple[str, str, str]:
    """Return an estimate and the ends of its interval as text: two digits, more where ends meet it.

    Examples
    --------
    >>> format_estimate_with_bounds(0.0312, 0.0308, 0.0345)
    ('0.0312', '0.0308', '0.0345')
    """
    digits = count_digits_of_estimate(value, low, high)
    middle, least, most = (significant(number, digits) for number in (value, low, high))
    return middle, least, most


def count_digits_of_estimate(value: float, low: float, high: float, fewest: int = 2) -> int:
    """Return the digits, at most four, in which an estimate differs from the ends of its interval.

    Examples
    --------
    >>> count_digits_of_estimate(299.3, 298.9, 299.4)
    4
    """
    for digits in range(fewest, 4):
        middle, least, most = (significant(number, digits) for number in (value, low, high))
        if (middle != least or value == low) and (middle != most or value == high):
            return digits
    return 4


def format_interval(low: float, high: float) -> str:
    """Format an interval as `[low, high]`; a dash if an end is not finite."""
    if not (math.isfinite(low) and math.isfinite(high)):
        return MISSING
    return f"[{significant(low)}, {significant(high)}]"


def join_with_and(words: list[str]) -> str:
    """Return words joined to one text: `a`, `a and b`, `a, b and c`."""
    if len(words) < 2:
        return "".join(words)
    return f"{', '.join(words[:-1])} and {words[-1]}"


def drop_shared_options(labels: list[str]) -> list[str]:
    """Return labels of different runs without the solver options that all of them have."""
    options = [re.findall(r"[\w.]+=[^,)]+", label) for label in labels]
    if len(set(labels)) > 1:
        for shared in map(re.escape, set(options[0]).intersection(*options)):
            part = rf"(?<=[ ,]){shared},|, ?{shared}(?=\))"
            labels = [re.sub(part, "", label) for label in labels]
    return labels


_RANGE = re.compile(r"(.*)\[(\d+):(\d+)\]")


def describe_range_of_steps(sequence: str) -> str:
    """Return a sequence's name as code, that of a range of steps in words.

    Examples
    --------
    >>> describe_range_of_steps("rough[900:1400]")
    'steps 900 to 1399 of `rough`'
    """
    found = _RANGE.fullmatch(sequence)
    if found is None:
        return f"`{sequence}`"
    name, first, end = found.groups()
    return f"steps {first} to {int(end) - 1} of `{name}`"


def explain_range_of_steps(sequences: Iterable[str]) -> str:
    """Return a sentence on the notation of the first range of steps among sequences; or ""."""
    found = next((name for name in sequences if _RANGE.fullmatch(name)), "")
    return f"`{found}` denotes {describe_range_of_steps(found)}." if found else ""


def join_with_counts(counts: Iterable[tuple[str, int]]) -> str:
    """Return names with their counts as text, `a (3) and b (1)`, the largest count first."""
    ordered = sorted(counts, key=lambda item: -item[1])
    return join_with_and([f"{name} ({count})" for name, count in ordered])


_UNIT = re.compile(r"(?<=\d) (?=(?:%|[MG]?Hz|GiB|[nµm]?s|[kc]?m|k?N)(?![\w/]))|(?<=×) (?=\d)")


def bind_units(text: str) -> str:
    """Return a text in which no line of the page breaks between a number and its unit."""
    return _UNIT.sub("\u00a0", text)


def strip_markdown(text: str) -> str:
    """Return a text without bold and code marks of Markdown."""
    return text.replace("**", "").replace("`", "")


def format_as_toml(value: Any) -> str:
    """Format a number, or the rows of an array, as TOML text with six significant digits."""
    if isinstance(value, Iterable):
        return f"[{', '.join(map(format_as_toml, value))}]"
    text = f"{float(value):.6g}"
    return text if any(sign in text for sign in ".en") else f"{text}.0"


_TAG = re.compile(r"<(?=[A-Za-z/!?])")
_LINK = re.compile(r"\](?=[(\[:])")
_PIPE = re.compile(r"(\\*)\|")
_BLOCK = re.compile(r"^(?=#{1,6}(\s|$)|>|```|~~~|[-+*]\s|[-_*=]{3})")
_NOT_SHOWN = {"Cc", "Cf", "Cs", "Zl", "Zp"}
"""Categories of characters that end a line, turn its direction or cannot be written."""


def one_line(text: str) -> str:
    """Return a text with spaces for line breaks and other characters that are not shown."""
    return "".join(" " if unicodedata.category(c) in _NOT_SHOWN else c for c in text)


def escape_markdown(text: str) -> str:
    """Return a text escaped for a line of Markdown: no HTML, link or picture; marks like ` stay."""
    return _LINK.sub(r"]\\", _TAG.sub("&lt;", one_line(text)))


def escape_markdown_paragraph(text: str) -> str:
    """Return Markdown escaped so that its paragraph is no heading, list or block of code."""
    return _BLOCK.sub(r"\\", escape_markdown(text).lstrip())


def escape_markdown_cell(text: str) -> str:
    """Return a text escaped for a cell of a Markdown table."""
    return _PIPE.sub(r"\1\1\\|", escape_markdown(text))


def mark_solver(name: str) -> str:
    """Return the name of a configuration, `solver` or `solver (settings)`, the solver as code."""
    solver, *settings = name.split(" ", 1)
    return " ".join([f"`{solver}`", *settings])


@dataclass(frozen=True)
class Table:
    """Table of text with heads, a title and a note, for page, file and Markdown.

    heads : with units; text_columns : so many leading ones are left-aligned.
    shown : rows on the page, by default all, with 0 no table; folded : opens there with a click.
    labels : text of a head on the page and in Markdown, where the name in the file is shorter.
    """

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    title: str = ""
    note: str = ""
    text_columns: int = 1
    shown: int | None = None
    folded: bool = False
    labels: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def from_rows(cls, rows: Sequence[Mapping[str, str]], title: str = "", **more: Any) -> Self:
        """Return a table of rows that map column heads to text cells."""
        return cls(tuple(rows[0]), tuple(tuple(row.values()) for row in rows), title, **more)

    @property
    def printed_heads(self) -> list[str]:
        """Heads of the table on the page and in Markdown."""
        return [self.labels.get(head, head) for head in self.heads]

    @property
    def page_rows(self) -> list[list[str]]:
        """Rows of the table that the page shows, without Markdown marks."""
        return [
            [bind_units(strip_markdown(cell)) for cell in row] for row in self.rows[: self.shown]
        ]

    @property
    def cut(self) -> int:
        """Number of the table's rows that the page leaves out."""
        return len(self.rows[self.shown :]) if self.shown is not None else 0


def make_markdown_table(
    heads: Sequence[str], rows: Sequence[Sequence[str]], text_columns: int = 1
) -> str:
    """Return a Markdown table; columns after the first `text_columns` are right-aligned."""
    align = [":--" if i < text_columns else "--:" for i in range(len(heads))]
    lines = (" | ".join(map(escape_markdown_cell, cells)) for cells in [heads, align, *rows])
    return "\n".join(f"| {line} |" for line in lines)


def make_markdown_document(title: str, lines: Sequence[str], tables: Sequence[Table]) -> str:
    """Return a Markdown document: the lines as a list, then the tables with titles and notes."""
    parts = [
        f"# {escape_markdown(title)}",
        "\n".join(f"- {escape_markdown(line)}" for line in lines),
    ]
    parts += [
        f"## {escape_markdown(t.title)}\n\n{escape_markdown_paragraph(t.note)}\n\n"
        f"{make_markdown_table(t.heads, t.rows, t.text_columns)}"
        for t in tables
    ]
    return "\n\n".join(parts) + "\n"


def format_table_as_html(table: Table) -> str:
    """Return the table as plain HTML, which a notebook displays."""
    return make_html_table(table.printed_heads, table.rows, title=table.title, note=table.note)
