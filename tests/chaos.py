"""Runs of a small suite under accidents; each must end with the rows of an undisturbed run.

`make chaos` runs all scenarios and prints a line for each: its name, what was done, what was found.
CHAOS='--quick' runs those that CI runs, CHAOS='NAME ...' the named ones. Exit 1 where one failed.

Processes are found by a variable of their environment; a row is right if all its columns but times
equal those of the undisturbed run.
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from dpbench import load_results
from tests.bench.deterministic import deterministic, suite_toml

HOSTILE = Path(__file__).parent / "bench" / "hostile_plugin.py"
SUITE = suite_toml(
    **{"solvers": ["quadprog", "daqp"], "rounds": 2, "warmup_steps": 0},
    closed_loop=[{"scenarios": ["paper", "rough"], "settings": ["default", "high"], "steps": 40}],
    replay=[{"scenario": "paper", "steps": 20}],
    random=[{"families": ["no_rows"], "sizes": [[3, 0], [4, 0]], "steps": 5}],
)
FOUND = {
    2: ("segfault", "crashed", "SIGSEGV"),
    3: ("abort", "crashed", "SIGABRT"),
    4: ("_exit", "crashed", "exit code 0"),
    5: ("C hang", "hung", "beyond the limit"),
    6: ("memory hog", "crashed", "MemoryError"),
    7: ("flood", "finished", "output was cut"),
    8: ("children", "finished", ""),
    9: ("daemons", "finished", ""),
    10: ("daemons, then _exit", "crashed", "exit code 0"),
    11: ("kills the fork server", "crashed", "the fork server was killed"),
    12: ("kills the keeper", "crashed", "the fork server was killed"),
    13: ("stops the fork server", "finished", ""),
    14: ("stops fork server and keeper", "finished", ""),
    17: ("stops itself", "hung", ""),
    16: ("daemons, kills the fork server", "crashed", "the fork server was killed"),
}
"""By variables of the random problem: what `hostile_plugin.py` does, the outcome of that cell, and
words of its detail."""
HOSTILE_SUITE = suite_toml(
    **{"solvers": ["quadprog", "hostile"], "cell_limit_s": 4.0, "cell_memory_gb": 0.3},
    **{"rounds": 1, "warmup_steps": 0},
    closed_loop=[{"scenarios": ["paper", "rough"], "steps": 20}],
    random=[{"families": ["no_rows"], "sizes": [[n, 0] for n in FOUND], "steps": 5}],
    replay=[{"scenario": "paper", "steps": 10}],
)
MARK = "DPBENCH_CHAOS"
SCRATCH = "*dpbench-scratch-*"
SKIPPED = "skipped: mounting is not permitted"
GONE_S = 10.0
"""In which all processes of a run that was killed must be gone."""
DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "cut": lambda data: data[: len(data) // 2],
    "zeros": lambda data: bytes(len(data)),
    "flipped": lambda data: data[:-40] + bytes(byte ^ 0xFF for byte in data[-40:]),
    "empty": lambda data: b"",
}


class ChaosError(Exception):
    """Failed check of a chaos run."""


def _check(right: bool, words: str) -> None:
    if not right:
        raise ChaosError(words)


@dataclass
class Place:
    """A folder of its own for one scenario, and the commands that are run there."""

    folder: Path
    wanted: Path | None = None
    took_s: float = 0.0
    text: str = SUITE
    options: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        (self.folder / "tmp").mkdir(parents=True)
        (self.folder / "suite.toml").write_text(self.text, encoding="utf-8")
        self.before = set(Path("/dev/shm").glob(SCRATCH))

    @property
    def out(self) -> Path:
        return self.folder / "out"

    @property
    def command(self) -> list[str]:
        """The command of every run, the same each time."""
        suite, out = str(self.folder / "suite.toml"), str(self.out)
        words = ["-m", "dpbench", "run", suite, "--out", out, "--quiet"]
        return [sys.executable, *words, *self.options]

    def start(self, *head: str) -> subprocess.Popen[str]:
        """Begin a run; `head` are words before its command."""
        environment = os.environ | {MARK: str(self.folder), "TMPDIR": str(self.folder / "tmp")}
        return subprocess.Popen(
            [*head, *self.command],
            env=environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def complete(self, *head: str) -> str:
        """Run to the end, which must be a good one; what it said on stderr."""
        process = self.start(*head)
        _, said = process.communicate(timeout=600)
        _check(process.returncode == 0, f"exit {process.returncode}: {said[-300:]}")
        _check("Traceback" not in said, said[-300:])
        return said

    def processes(self) -> dict[int, list[int]]:
        """The processes that bear the mark, each with its line of ancestors, nearest first."""
        found = {}
        wanted = f"{MARK}={self.folder}\0".encode()
        for entry in Path("/proc").glob("[0-9]*"):
            try:
                if wanted in (entry / "environ").read_bytes() + b"\0":
                    found[int(entry.name)] = list(_ancestors(int(entry.name)))
            except OSError:
                continue
        return found

    def nothing_left(self, *, scratch: bool = True) -> None:
        """No process is left, nor a file but the results; `scratch` if a run came to its end."""
        deadline = time.monotonic() + GONE_S
        while self.processes() and time.monotonic() < deadline:
            time.sleep(0.05)
        left = self.processes()
        _check(not left, f"{len(left)} processes left")
        if scratch:
            extra = set(Path("/dev/shm").glob(SCRATCH)) - self.before - set(_open_paths())
            _check(not extra, f"left {sorted(map(str, extra))}")
            kept = [path for path in (self.folder / "tmp").iterdir() if "leases" not in path.name]
            _check(not kept, f"left {[path.name for path in kept]}")
            names = {path.name for path in (self.out / "cells").iterdir()}
            _check(names <= {".lock"}, f"left {sorted(names)} in cells")

    def same(self, *, without: str = "") -> None:
        """Rows, each once, equal to the undisturbed; of the solver `without` they are not seen."""
        assert self.wanted is not None, "a run to compare with"
        found, wanted = load_results(self.out), load_results(self.wanted)
        _check(bool(found.runs["run_id"].is_unique), "a row is double")
        _check(list(found.runs["run_id"]) == list(wanted.runs["run_id"]), "other rows")
        others = wanted.runs.loc[wanted.runs["solver"] != without, "run_id"]
        for one, other in zip(deterministic(found), deterministic(wanted), strict=True):
            tables = [table[table["run_id"].isin(others)] for table in (one, other)]
            left, right = (table.reset_index(drop=True) for table in tables)
            try:
                pd.testing.assert_frame_equal(left, right, check_exact=True)
            except AssertionError as error:
                raise ChaosError(" ".join(str(error).split())[:200]) from error


def _ancestors(pid: int) -> Iterator[int]:
    while pid > 1:
        try:
            stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
        except OSError:
            return
        pid = int(stat.rpartition(")")[2].split()[1])
        yield pid


def _open_paths() -> list[Path]:
    """Return the paths that any process has open, among them scratch folders of other runs."""
    found = []
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        with suppress(OSError):
            found.append(Path(os.readlink(link)))
    return found


def sigkills(place: Place, times: int) -> str:
    """Kill the main program at moments spread over the run, and go on with the same command."""
    killed = runs = 0
    while killed < times:
        runs += 1
        process = place.start()
        try:
            # Multiples of the golden ratio are spread evenly, however many they are.
            process.communicate(timeout=0.3 + runs * 0.618034 % 1.0 * place.took_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            killed += 1
            place.nothing_left(scratch=False)
            continue
        _check(process.returncode == 0, f"exit {process.returncode} after {killed} kills")
        place.same()
        shutil.rmtree(place.out)
    place.complete()
    place.same()
    place.nothing_left()
    return f"{killed} kills, each gone on from; rows right, none double"


def damaged(place: Place, kinds: list[str]) -> str:
    """Damage what a killed run, then a finished one, left, before the next sitting."""
    files = 0
    for kind in kinds:
        process = place.start()
        try:
            process.communicate(timeout=0.7 * place.took_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
        place.nothing_left(scratch=False)
        files += _damage(place.out / "cells", kind)
        place.complete()
        place.same()
        files += _damage(place.out, kind)
        place.complete()
        place.same()
        shutil.rmtree(place.out)
    return f"{files} files damaged ({', '.join(kinds)}); rows right after the next sitting"


def _damage(folder: Path, kind: str) -> int:
    paths = [p for p in folder.glob("*") if p.suffix in (".cells", ".parquet", ".npz")]
    for path in paths:
        path.write_bytes(DAMAGE[kind](path.read_bytes()))
    return len(paths)


def scratch_removed(place: Place) -> str:
    """Remove the scratch folder of a run; the same command completes it."""
    process = place.start()
    removed = 0
    deadline = time.monotonic() + 120.0
    while process.poll() is None and not removed and time.monotonic() < deadline:
        for target in _open_folders(process.pid):
            shutil.rmtree(target, ignore_errors=True)
            removed += 1
        time.sleep(0.01)
    _, said = process.communicate(timeout=600)
    _check("Traceback" not in said, said[-300:])
    _check(process.returncode in (0, 1), f"exit {process.returncode}: {said[-300:]}")
    place.complete()
    place.same()
    place.nothing_left()
    return f"{removed} folder removed, exit {process.returncode}; rows right after the next sitting"


def _open_folders(pid: int) -> list[str]:
    """Scratch folders with a raw log that a process has open."""
    found = []
    for link in Path(f"/proc/{pid}/fd").glob("*"):
        try:
            target = Path(os.readlink(link))
        except OSError:
            continue
        folder = next((p for p in (target, *target.parents) if "dpbench-scratch-" in p.name), None)
        if folder is not None and any(folder.glob("*.raw")):
            found.append(str(folder))
    return found


def signalled(place: Place, number: signal.Signals, level: int) -> str:
    """Send a signal to the keeper (level 1), the fork server (2) or a worker (3) of a run."""
    process = place.start()
    sent = 0
    deadline = time.monotonic() + 120.0
    while process.poll() is None and not sent and time.monotonic() < deadline:
        if any(_open_folders(process.pid)):
            for pid, line in place.processes().items():
                if process.pid in line and line.index(process.pid) == level - 1 and not sent:
                    if level == 1 and not any(pid in other for other in place.processes().values()):
                        continue
                    os.kill(pid, number)
                    sent += 1
        time.sleep(0.01)
    _, said = process.communicate(timeout=600)
    _check("Traceback" not in said, said[-300:])
    _check(sent == 1, "nobody to send it to")
    runs = load_results(place.out).runs
    ended = runs.loc[
        runs["outcome"] != "finished", ["solver", "mode", "sequence", "outcome_detail"]
    ]
    lost = [" ".join(row) for row in ended.itertuples(index=False)]
    # A worker that somebody kills cannot be told from one that its solver kills; a cell may have
    # two rows, one for each name of its settings.
    _check(len(lost) <= 2 * (level == 3), "; ".join(lost))
    if "lost" in set(runs["outcome"]):
        place.complete()
        place.same()
    elif not lost:
        place.same()
    place.nothing_left()
    return f"exit {process.returncode}, {len(lost)} rows not finished; rows right in the end"


def disk_full(place: Place) -> str:
    """A file system of the results that is too small, then large enough."""
    place.out.mkdir()
    head = _mounted(place.out, "40k")
    if not head:
        return SKIPPED
    script = (
        'c="$*"; $c; first=$?; mount -o remount,size=64m "$OUT"; $c || exit $?; '
        'cp -r "$OUT" "$OUT.copy"; test $first -ne 0'
    )
    place.complete("env", f"OUT={place.out}", *head, "sh", "-c", script, "sh")
    place.out.rmdir()
    place.out.with_name("out.copy").rename(place.out)
    place.same()
    place.nothing_left()
    return "tmpfs of 40 kB: one line; rows right once it was larger"


def shared_memory_full(place: Place) -> str:
    """A /dev/shm of 64 kB."""
    head = _mounted(Path("/dev/shm"), "64k")
    if not head:
        return SKIPPED
    place.complete(*head)
    place.same()
    place.nothing_left()
    return "tmpfs of 64 kB: rows right in one sitting"


def _mounted(folder: Path, size: str) -> list[str]:
    """Words before a command that has a small file system at a folder; none if not permitted."""
    mount = f'mount -t tmpfs -o size={size} tmpfs "{folder}" && exec "$@"'
    head = ["unshare", "--mount", "sh", "-c", mount, "sh"]
    allowed = subprocess.run([*head, "true"], capture_output=True, check=False).returncode == 0
    return head if allowed else []


def hostile(place: Place) -> str:
    """All faults of `hostile_plugin.py`, each in a random problem of its own."""
    place.complete()
    place.same(without="hostile")
    place.nothing_left()
    runs = load_results(place.out).runs
    rows = runs[(runs["solver"] == "hostile")].set_index("sequence")
    wrong = []
    for n, (name, outcome, words) in FOUND.items():
        (row,) = (row for key, row in rows.iterrows() if f"-n{n}-" in str(key))
        if row["outcome"] != outcome or words not in row["outcome_detail"]:
            wrong.append(f"{name}: {row['outcome']} ({row['outcome_detail']})")
    others = runs[runs["scenario"] != ""]
    ended = zip(others["solver"], others["outcome"], strict=True)
    wrong += [f"{solver}: {outcome}" for solver, outcome in ended if outcome != "finished"]
    _check(not wrong, "; ".join(wrong))
    return f"{len(FOUND)} faults, each in its own row; all others right"


@dataclass(frozen=True)
class Scenario:
    """One line of the table; `quick` where CI runs it."""

    name: str
    done: str
    act: Callable[[Place], str]
    quick: bool = False
    of_plugin: bool = False


STOP, KILL = signal.SIGSTOP, signal.SIGKILL
SCENARIOS = [
    Scenario("plugin", "a hostile plug-in", hostile, True, True),
    Scenario("sigkill-3", "SIGKILL of the run, 3 times", lambda p: sigkills(p, 3), True),
    Scenario("sigkill", "SIGKILL of the run, 20 times", lambda p: sigkills(p, 20)),
    Scenario("damage", "results damaged", lambda p: damaged(p, sorted(DAMAGE))),
    Scenario("scratch", "scratch folder removed", scratch_removed),
    Scenario("kill-keeper", "keeper killed", lambda p: signalled(p, KILL, 1)),
    Scenario("kill-server", "fork server killed", lambda p: signalled(p, KILL, 2)),
    Scenario("kill-worker", "worker killed", lambda p: signalled(p, KILL, 3)),
    Scenario("stop-keeper", "keeper stopped", lambda p: signalled(p, STOP, 1)),
    Scenario("stop-server", "fork server stopped", lambda p: signalled(p, STOP, 2)),
    Scenario("stop-worker", "worker stopped", lambda p: signalled(p, STOP, 3)),
    Scenario("disk", "disk of the results full", disk_full),
    Scenario("memory", "shared memory full", shared_memory_full),
]


def _place(folder: Path, of_plugin: bool) -> Place:
    if not of_plugin:
        return Place(folder)
    options = ["--solver-module", str(HOSTILE), "--solver", "quadprog", "--solver", "hostile"]
    return Place(folder, text=HOSTILE_SUITE, options=options)


def run_scenarios(scenarios: list[Scenario], folder: Path) -> int:
    undisturbed: dict[bool, Place] = {}
    failed = 0
    for scenario in scenarios:
        began = time.monotonic()
        if scenario.of_plugin not in undisturbed:
            tame = _place(folder / f"undisturbed-{scenario.of_plugin}", scenario.of_plugin)
            tame.complete("env", "DPBENCH_TAME=1")
            tame.took_s, began = time.monotonic() - began, time.monotonic()
            undisturbed[scenario.of_plugin] = tame
        place, wanted = _place(folder / scenario.name, scenario.of_plugin), undisturbed
        place.wanted = wanted[scenario.of_plugin].out
        place.took_s = wanted[scenario.of_plugin].took_s
        try:
            found, verdict = scenario.act(place), "ok"
        except (ChaosError, subprocess.TimeoutExpired) as error:
            found, verdict = str(error), "FAIL"
            failed += 1
        finally:
            for pid in place.processes():
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
        took_s = time.monotonic() - began
        print(
            f"{verdict:4}  {scenario.name:12} {scenario.done}: {found} ({took_s:.0f} s)", flush=True
        )
    return failed


def main() -> int:
    """Run the scenarios that were asked for; 1 where one failed."""
    names = [scenario.name for scenario in SCENARIOS]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(names))
    parser.add_argument("--quick", action="store_true", help="run those that CI runs")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(names):
        parser.error(f"no scenario {', '.join(sorted(unknown))}")
    chosen = [
        scenario
        for scenario in SCENARIOS
        if (scenario.name in arguments.names or not arguments.names)
        and (scenario.quick or not arguments.quick)
    ]
    with tempfile.TemporaryDirectory(prefix="chaos-") as folder:
        return int(run_scenarios(chosen, Path(folder)) > 0)


if __name__ == "__main__":
    sys.exit(main())
