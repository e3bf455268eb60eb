"""Result folder as it is sent to others, `results/community/`.

The page without scripts, runs, machine, suite, capability plots, counts and a form for the sender.
The steps stay at home: they are a hundred times as large.
"""

import datetime
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, StringConstraints

from dpbench.bench.capability.edge_qps import CAPABILITY_FILE, load_capability_plots
from dpbench.bench.record.result_folder import (
    Results,
    hash_files,
    load_results,
    read_suite_description,
)
from dpbench.embedded.table import EMBEDDED_FILE, load_counted_steps_of_folder
from dpbench.errors import InputError, ResultsError
from dpbench.files.regular_files import read_bytes, write_file_atomically, write_text_atomically
from dpbench.report.formats import join_with_and, plural
from dpbench.report.page.write import FILES
from dpbench.scenario.problem_files import read_toml_as_dict, read_toml_as_model

_UNREADABLE = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f]")
"""Control characters: an escape switches what the next bytes mean in some encodings."""
_ENCODED = re.compile(r'<meta charset="utf-8" ?/?>', re.IGNORECASE)
_PREFIX = 1024
"""Characters in which a browser looks for the encoding; without one it guesses."""
# All markup that dpbench writes. In any other, a browser may see tags where this does not.
_TAG = re.compile(
    r"<(?:!doctype html|/?(?P<name>[a-zA-Z][a-zA-Z0-9]*+)"
    r'(?P<attributes>(?:\s++[a-zA-Z][\w:-]*+(?:="[^"<]*+")?+)*+)\s*+/?)>'
)
_ATTRIBUTE = re.compile(r'([a-zA-Z][\w:-]*+)(?:="([^"]*+)")?+')
_TAGS = re.compile(
    r"a|abbr|b|body|br|button|caption|code|dd|details|dfn|div|dl|dt|em|figcaption|figure|footer|"
    r"h[1-4]|head|header|html|i|img|input|label|li|main|meta|nav|ol|option|p|pre|section|select|"
    r"small|span|strong|style|sub|summary|sup|table|tbody|td|th|thead|title|tr|ul|"
    r"circle|clippath|defs|g|line|lineargradient|path|polygon|rect|stop|svg|text|tspan"
)
_ATTRIBUTES = re.compile(
    r"(?:aria|data|clip|fill|font|pointer|stop|stroke|text)(?:-[a-z-]+)?|alt|charset|checked|class|"
    r"colspan|cx|cy|d|disabled|display|dominant-baseline|dx|dy|for|height|hidden|id|lang|max|min|"
    r"name|offset|opacity|open|points|preserveaspectratio|r|role|rowspan|rx|ry|scope|selected|"
    r"size|step|tabindex|title|transform|type|value|version|viewbox|width|x|x1|x2|xml:space|xmlns|"
    r"xmlns:xlink|y|y1|y2|gradientunits"
)
_WORDS = re.compile(r"(?:aria|data)-[\w-]+|alt|class|id|name|title|value|for")
"""Attributes with any text."""
_VALUES = {
    "href": re.compile(rf"#[\w-]*|{'|'.join(map(re.escape, FILES))}"),
    "src": re.compile(r"data:image/svg\+xml;base64,[A-Za-z0-9+/=]*"),
    # In ISO-2022-JP a browser reads quotes as parts of other characters.
    "charset": re.compile(r"utf-8", re.IGNORECASE),
    "content": re.compile(r"width=device-width, initial-scale=1"),
}
"""Allowed addresses: a section, a file of the folder, a picture without scripts."""
_LOADS = re.compile(r"url\s*\((?!#)|@import|image-set|[\\&]", re.IGNORECASE)
"""Parts of a style that load something, or hide that by an escape."""


def refuse_active_page(page: str, where: str) -> None:
    """Raise ResultsError if a browser would run or load something in a page.

    Raises ResultsError naming the line, and the tag or attribute.
    """
    for at, found in _find_active_parts(page):
        line = page.count("\n", 0, at) + 1
        allowed = "a page without scripts, written by `dpbench report --send`"
        raise ResultsError(where, f"line {line}", found[:120], allowed)


def _find_active_parts(page: str) -> Iterator[tuple[int, str]]:
    """Yield position and text of what a browser would run or load in a page."""
    if control := _UNREADABLE.search(page):
        yield control.start(), f"the control character {ord(control[0]):#04x}"
    if _ENCODED.search(page, 0, _PREFIX) is None:
        yield 0, f'no <meta charset="utf-8"> in the first {_PREFIX} characters'
    at = 0
    while (start := page.find("<", at)) >= 0:
        tag = _TAG.match(page, start)
        if tag is None:
            yield start, page[start : start + 40].partition("\n")[0]
            return
        name, at = (tag["name"] or "html").lower(), tag.end()
        if _TAGS.fullmatch(name) is None:
            yield start, f"<{name}>"
        for attribute, value in _ATTRIBUTE.findall(tag["attributes"] or ""):
            if not _is_passive_attribute(attribute.lower(), value):
                yield start, f'{attribute}="{value}" in <{name}>'
        if name == "style" and not tag[0].startswith("</"):
            end = page.find("<", at)
            if loads := _LOADS.search(page, at, end if end >= 0 else len(page)):
                yield loads.start(), f"{loads[0]} in <style>"


def _is_passive_attribute(attribute: str, value: str) -> bool:
    """Return whether an attribute of a sent SVG can neither load nor run anything."""
    if attribute in _VALUES:
        return _VALUES[attribute].fullmatch(value) is not None
    if _ATTRIBUTES.fullmatch(attribute) is None:
        return False
    return _WORDS.fullmatch(attribute) is not None or _LOADS.search(value) is None


COPIED = ("runs.parquet", "machine.json", "suite.json")
WHERE_THERE = (CAPABILITY_FILE, EMBEDDED_FILE)
"""Copied if present."""
PAGE, SENDER = "report.html", "sender.toml"
SENT = (PAGE, *COPIED, SENDER)
MOST_BYTES = 4_000_000
"""Twice a run of the suite `standard`; every clone of the repository has every folder."""
_MADE_BY = "one written by `dpbench report --send`"
_Words = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]
_BLANK = """\
# Who ran this, when, and how. `dpbench check` lists what is missing.
who = ""      # a name, and a contact if you like
when = {when}
command = ""  # the command line, such as "dpbench run standard"
remarks = ""  # what a reader should know: power plan, other load, own build of a solver
"""


class Sender(BaseModel):
    """Form that goes with results sent to others: name, date and method."""

    model_config = ConfigDict(extra="forbid")

    who: _Words
    when: datetime.date
    command: _Words
    remarks: str = ""


def prepare_sent_folder(folder: Path, target: Path) -> None:
    """Copy the files to send into a folder of their own, with a form for the sender.

    An existing `sender.toml` is kept.

    Raises InputError when `target` is the result folder itself or holds other things.
    """
    allowed = "a folder of its own, such as results/community/2026-11-22-name"
    if target.resolve() == folder.resolve():
        raise InputError("--send", "", str(target), allowed)
    strangers = _list_unknown_files(target) if target.is_dir() else []
    if strangers:
        raise InputError("--send", "", f"{target}, which contains {strangers[0]}", allowed)
    target.mkdir(parents=True, exist_ok=True)
    for name in WHERE_THERE:
        (target / name).unlink(missing_ok=True)
    for name in _list_files_to_send(folder):
        with write_file_atomically(target / name) as part:
            shutil.copyfile(folder / name, part)
    started = str(read_suite_description(folder).get("started_utc", ""))[:10]
    if not (target / SENDER).is_file():
        when = started or datetime.datetime.now(datetime.UTC).date().isoformat()
        write_text_atomically(target / SENDER, _BLANK.format(when=when))


def describe_sent_folder(target: Path) -> str:
    """Return what `prepare_sent_folder` wrote, and what the sender has to do next, as text."""
    files = join_with_and([name for name in (*SENT, *WHERE_THERE) if (target / name).is_file()])
    missing = _list_missing_keys(target / SENDER)
    fill_in = (
        f"Fill in {join_with_and(missing)} in {target / SENDER}, then check" if missing else "Check"
    )
    return f"{target}: {files}. {fill_in} the folder: dpbench check {target}"


def _list_missing_keys(form: Path) -> list[str]:
    """Return the required keys that a sender's form leaves empty; all of a form without TOML."""
    try:
        filled = read_toml_as_dict(form)
    except InputError:
        filled = {}
    required = [name for name, field in Sender.model_fields.items() if field.is_required()]
    return [name for name in required if not str(filled.get(name, "")).strip()]


def check_sent_folder(folder: Path) -> str:
    """Check a result folder that others sent; return a line that describes its contents.

    Raises ResultsError naming the first file at fault: missing, damaged, too large, of another
    machine, or a page of other runs; InputError for the contents of `sender.toml`.
    """
    where = str(folder)
    size = sum(path.lstat().st_size for path in folder.glob("*"))
    if size > MOST_BYTES:
        raise ResultsError(where, "", f"{size} bytes", f"at most {MOST_BYTES} in all")
    results = load_results(folder, without_steps=True)
    strangers = _list_unknown_files(folder)
    if strangers:
        sent = f"{join_with_and([*SENT, *WHERE_THERE])}, as in a folder of `dpbench report --send`"
        raise ResultsError(f"{where}/{strangers[0]}", "", "an unexpected file", f"only {sent}")
    sender = read_toml_as_model(folder / SENDER, Sender)
    load_capability_plots(folder)
    load_counted_steps_of_folder(folder)
    _check_runs(folder, results)
    _check_page(folder)
    solvers = plural(results.runs["solver"].nunique(), "solver")
    cpu = results.machine.get("cpu_model", "an unnamed CPU")
    return (
        f"{folder}: suite {results.suite.get('name', '')}, {plural(len(results.runs), 'run')} of "
        f"{solvers} on {cpu}; submitted by {sender.who} on {sender.when}"
    )


def _list_unknown_files(folder: Path) -> list[str]:
    """Return the names of files in a sent folder that do not belong there."""
    allowed = (*SENT, *WHERE_THERE)
    return sorted(path.name for path in folder.iterdir() if path.name not in allowed)


def _list_files_to_send(folder: Path) -> list[str]:
    """Return the names of the result files to send, without report page and sender's form."""
    return [*COPIED, *(name for name in WHERE_THERE if (folder / name).exists())]


def _check_runs(folder: Path, results: Results) -> None:
    """Raise ResultsError unless the runs sent are of one machine and none was lost."""
    path, runs = str(folder / "runs.parquet"), results.runs
    if not len(runs):
        raise ResultsError(path, "", "no run", "at least one")
    machines = sorted(set(runs["machine_id"]) - {results.machine["id"]})
    if machines:
        allowed = f"only {results.machine['id']!r}, as in machine.json"
        raise ResultsError(path, "machine_id", repr(machines[0]), allowed)
    lost = int((runs["outcome"] == "lost").sum())
    if lost:
        found = f"{plural(lost, 'run')} with a harness error (lost)"
        raise ResultsError(path, "outcome", found, "none; run the same `dpbench run` again")


def _check_page(folder: Path) -> None:
    """Raise ResultsError unless the report page sent belongs to the files and has no script."""
    path = folder / PAGE
    data = read_bytes(path, _MADE_BY, most_bytes=MOST_BYTES, error=ResultsError)
    page = data.decode("utf-8", errors="replace")
    for name, sha in hash_files(folder, _list_files_to_send(folder)).items():
        if sha not in page:
            allowed = "the page of these files, written by `dpbench report --send`"
            raise ResultsError(str(path), "", f"a page of another {name}", allowed)
    refuse_active_page(page, str(path))
