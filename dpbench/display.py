"""HTML tables that a notebook shows of an object, without script and style."""

from collections.abc import Iterable, Mapping, Sequence
from html import escape


def make_html_table(
    heads: Sequence[str], rows: Iterable[Sequence[object]], *, title: str = "", note: str = ""
) -> str:
    """Make an HTML table of rows below column heads, with a title above and a note below."""
    head = "".join(f"<th>{escape(text)}</th>" for text in heads)
    body = "".join(
        f"<tr>{''.join(f'<td>{escape(str(cell))}</td>' for cell in row)}</tr>" for row in rows
    )
    above = f"<caption>{escape(title)}</caption>" if title else ""
    whole = f"<thead><tr>{head}</tr></thead>" if heads else ""
    return f"<table>{above}{whole}<tbody>{body}</tbody></table>{make_html_paragraph(note)}"


def make_html_paragraph(text: str) -> str:
    """Make an HTML paragraph of plain text; "" for none."""
    return f"<p>{escape(text)}</p>" if text else ""


def make_html_field_table(title: str, fields: Mapping[str, object]) -> str:
    """Make an HTML table with one row for each field, name and value, that is not empty."""
    rows = [(name, value) for name, value in fields.items() if str(value) != ""]
    return make_html_table((), rows, title=title)


def format_numbers_with_units(numbers: Iterable[float], units: Sequence[str] = ()) -> str:
    """Format numbers to four digits, separated by commas, each with its unit."""
    texts = [f"{number:,.4g}".replace(",", "\u202f") for number in numbers]
    if units:
        texts = [f"{text} {unit}" for text, unit in zip(texts, units, strict=True)]
    return ", ".join(texts)
