"""Result folder as it is sent to others, `results/community/`.

The page without scripts, runs, machine, suite, capability plots and a form for the sender. The
steps stay at home: they are a hundred times as large.
"""

from __future__ import annotations

import datetime
import shutil
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, StringConstraints

from dpbench.bench.capability.table import CAPABILITY_FILE, load_capability
from dpbench.bench.record.result_folder import Results, hashes, load_results, read_suite
from dpbench.errors import InputError, ResultsError
from dpbench.files.opening import read_bytes
from dpbench.files.writing import replaced, write_text
from dpbench.report.documents.passive_page import check_passive
from dpbench.report.formats import and_list, plural
from dpbench.scenario.problem_files import read_model

COPIED = ("runs.parquet", "machine.json", "suite.json")
WHERE_THERE = (CAPABILITY_FILE,)
"""Copied of the suites that have it."""
PAGE, SENDER = "report.html", "sender.toml"
SENT = (PAGE, *COPIED, SENDER)
"""The files of every folder that is sent."""
MOST_BYTES = 1_000_000
"""Everybody who clones the repository gets every folder."""
_MADE_BY = "one made by `dpbench report DIR --send FOLDER`"
_Words = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1)]
_BLANK = """\
# Who ran this, when, and how. `dpbench check` says what is missing.
who = ""      # a name, and where to ask if you like
when = {when}
command = ""  # what was typed: "dpbench run standard"
remarks = ""  # what a reader should know: power plan, other load, own build of a solver
"""


class Sender(BaseModel):
    """What `sender.toml` says; versions and machine are in `machine.json` and `runs.parquet`."""

    model_config = ConfigDict(extra="forbid")

    who: _Words
    """Who ran it."""
    when: datetime.date
    """When it was run."""
    command: _Words
    """What was typed."""
    remarks: str = ""
    """What a reader should know beside it."""


def prepare(folder: Path, target: Path) -> None:
    """Copy the files to send into a folder of their own, with a form for the sender.

    An existing `sender.toml` is kept.

    Raises
    ------
    InputError : when `target` is the result folder itself or holds other things.
    """
    allowed = "a folder of its own, as results/community/2026-11-22-name"
    if target.resolve() == folder.resolve():
        raise InputError("--send", "", str(target), allowed)
    strangers = _strangers(target) if target.is_dir() else []
    if strangers:
        raise InputError("--send", "", f"{target} with {strangers[0]}", allowed)
    target.mkdir(parents=True, exist_ok=True)
    for name in WHERE_THERE:
        (target / name).unlink(missing_ok=True)
    for name in _copied(folder):
        with replaced(target / name) as part:
            shutil.copyfile(folder / name, part)
    started = str(read_suite(folder).get("started_utc", ""))[:10]
    if not (target / SENDER).is_file():
        when = started or datetime.datetime.now(datetime.UTC).date().isoformat()
        write_text(target / SENDER, _BLANK.format(when=when))


def check_sent(folder: Path) -> str:
    """Check that a folder that was sent is complete and readable; return its description.

    Raises
    ------
    ResultsError : naming the first file at fault: missing, damaged, too much, of another machine,
        or a page of other runs. InputError : for the contents of `sender.toml`.
    """
    where = str(folder)
    size = sum(path.lstat().st_size for path in folder.glob("*"))
    if size > MOST_BYTES:
        raise ResultsError(where, "", f"{size} bytes", f"at most {MOST_BYTES} in all")
    results = load_results(folder, without_steps=True)
    strangers = _strangers(folder)
    if strangers:
        raise ResultsError(
            f"{where}/{strangers[0]}", "", "a file", f"only {and_list([*SENT, *WHERE_THERE])}"
        )
    sender = read_model(folder / SENDER, Sender)
    load_capability(folder)
    _check_runs(folder, results)
    _check_page(folder)
    solvers = plural(results.runs["solver"].nunique(), "solver")
    cpu = results.machine.get("cpu_model", "an unnamed CPU")
    return (
        f"{folder}: {plural(len(results.runs), 'run')} of {solvers}, suite "
        f"{results.suite.get('name', '')}, on {cpu}, by {sender.who}, {sender.when}"
    )


def _strangers(folder: Path) -> list[str]:
    allowed = (*SENT, *WHERE_THERE)
    return sorted(path.name for path in folder.iterdir() if path.name not in allowed)


def _copied(folder: Path) -> list[str]:
    return [*COPIED, *(name for name in WHERE_THERE if (folder / name).exists())]


def _check_runs(folder: Path, results: Results) -> None:
    path, runs = str(folder / "runs.parquet"), results.runs
    if not len(runs):
        raise ResultsError(path, "", "no run", "at least one")
    machines = sorted(set(runs["machine_id"]) - {results.machine["id"]})
    if machines:
        allowed = f"{results.machine['id']!r} of machine.json alone"
        raise ResultsError(path, "machine_id", repr(machines[0]), allowed)
    lost = int((runs["outcome"] == "lost").sum())
    if lost:
        raise ResultsError(path, "outcome", f"{lost} lost", "none; run the same command again")


def _check_page(folder: Path) -> None:
    """Check that the page names the files beside it by their hashes, and has no script."""
    path = folder / PAGE
    data = read_bytes(path, _MADE_BY, most_bytes=MOST_BYTES, error=ResultsError)
    page = data.decode("utf-8", errors="replace")
    for name, sha in hashes(folder, _copied(folder)).items():
        if sha not in page:
            allowed = "the page of these files: `dpbench report DIR --send FOLDER`"
            raise ResultsError(str(path), "", f"a page of another {name}", allowed)
    check_passive(page, str(path))
