"""Soak the readers of files that others made with seeded mutants of real ones: `make soak`.

    python -m tests.soak.run [--share 0.01] [--only toml,hulls] [--seed 1] [--jobs 2]
    python -m tests.soak.run --again toml:1:17

A mutant is fine when its reader returns, or refuses it with one line (`InputError`), within 10 s
and 1 GB. Any other is printed with the words that read it again, and kept in `build/soak/`.
Processes forked from one that has imported everything read some hundred mutants each, so that a
crash or a hang costs one of them and is named.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

from dpbench.errors import InputError
from tests.soak.readers import KINDS, ROOT, Soaked

MUTANTS = 100_000
"""Mutants of each kind in a full run."""
BATCH = 200
"""Mutants of a process."""
LIMIT_S, LIMIT_BYTES = 10.0, 10**9
CAP_BYTES = 4 * 10**9
"""Address space a process may take beyond what it has, so that no mutant takes the machine."""
KEPT = ROOT / "build" / "soak"
FINE = ("read", "refused")


@dataclass
class Count:
    """Outcomes of the mutants of one kind."""

    kind: str
    outcomes: Counter[str] = field(default_factory=Counter)
    longest_s: float = 0.0
    largest_bytes: int = 0
    seconds: float = 0.0
    said: list[str] = field(default_factory=list)

    @property
    def bad(self) -> int:
        return self.outcomes.total() - sum(self.outcomes[name] for name in FINE)

    def add(self, outcome: str, took_s: float, took_bytes: int) -> None:
        self.outcomes[outcome] += 1
        self.longest_s = max(self.longest_s, took_s)
        self.largest_bytes = max(self.largest_bytes, took_bytes)

    def merge(self, other: Count) -> None:
        self.outcomes += other.outcomes
        self.longest_s = max(self.longest_s, other.longest_s)
        self.largest_bytes = max(self.largest_bytes, other.largest_bytes)
        self.seconds += other.seconds
        self.said += other.said

    def __str__(self) -> str:
        n = self.outcomes
        numbers = f"{n.total():8} {n['read']:8} {n['refused']:8} {self.bad:6}"
        most = f"{self.longest_s:9.2f} {self.largest_bytes / 1e6:10.0f}"
        return f"{self.kind:10} {numbers} {most} {self.seconds:9.0f}"


def _lay_out(soaked: Soaked, seed: str, folder: Path) -> tuple[str, random.Random]:
    """Write a mutant into an empty folder; the file that was changed."""
    rng = random.Random(seed)
    name = soaked.choose(rng)
    for other in soaked.files if soaked.whole else [name]:
        path = folder / other
        path.parent.mkdir(parents=True, exist_ok=True)
        data = soaked.files[other]
        path.write_bytes(soaked.mutate(other, data, rng) if other == name else data)
    return name, rng


def _read(soaked: Soaked, seed: str, folder: Path) -> tuple[str, str]:
    """Read a mutant; return its outcome and the message to show for a bad one."""
    name, rng = _lay_out(soaked, seed, folder)
    try:
        soaked.read(folder, name, rng)
    except InputError as error:
        lines = str(error).splitlines()
        return ("refused", "") if len(lines) == 1 else ("several lines", str(error))
    except BaseException:  # whatever a reader raises is what is looked for
        return "exception", traceback.format_exc()
    return "read", ""


def _peak_bytes() -> int:
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return 1024 * int(status.split("VmHWM:")[1].split()[0])


def _forget_peak() -> int:
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    return _peak_bytes()


def _serve(soaked: Soaked, seeds: Sequence[str], base: Path, answer: Connection) -> None:
    """Read mutants, in a process of its own; of each an answer before and after."""
    os.setsid()
    warnings.simplefilter("ignore")
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    has = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * 4096
    resource.setrlimit(resource.RLIMIT_AS, (has + CAP_BYTES, has + CAP_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for at, seed in enumerate(seeds):
        folder = base / str(at)
        folder.mkdir()
        before, began = _forget_peak(), _spent_s()
        outcome, said = _read(soaked, seed, folder)
        took_s, took_bytes = _spent_s() - began, _peak_bytes() - before
        if outcome in FINE and took_s > LIMIT_S:
            outcome, said = "slow", f"{took_s:.1f} s"
        if outcome in FINE and took_bytes > LIMIT_BYTES:
            outcome, said = "large", f"{took_bytes / 1e6:.0f} MB"
        shutil.rmtree(folder)
        answer.send((outcome, said, took_s, took_bytes))
    os._exit(0)


def _spent_s() -> float:
    """Processor time of this process and its ended children [s], whatever else the machine does."""
    return sum(os.times()[:4])


def _answers(
    soaked: Soaked, seeds: Sequence[str], base: Path
) -> Iterator[tuple[str, str, float, int]]:
    """The answers on as many mutants as one process reads; the last may be its death."""
    receive, send = multiprocessing.Pipe(duplex=False)
    arguments = soaked, seeds, base, send
    child = multiprocessing.get_context("fork").Process(target=_serve, args=arguments)
    child.start()
    send.close()
    try:
        for _ in seeds:
            if not receive.poll(3 * LIMIT_S):
                yield "hang", f"no end in {3 * LIMIT_S:g} s", 3 * LIMIT_S, 0
                return
            try:
                yield receive.recv()
            except EOFError:
                child.join()
                yield "crash", f"exit code {child.exitcode}", 0.0, 0
                return
    finally:
        with suppress(ProcessLookupError):
            os.killpg(child.pid or 0, signal.SIGKILL)
        child.join()


_MADE: dict[str, Soaked] = {}


def _soaked(kind: str) -> Soaked:
    if kind not in _MADE:
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            _MADE[kind] = KINDS[kind](Path(folder))
    return _MADE[kind]


def soak(kind: str, first: int, count: int, seed: int) -> Count:
    """Read mutants `first` to `first + count` of a kind, and keep those that are not fine."""
    began, soaked, total = time.monotonic(), _soaked(kind), Count(kind)
    done = 0
    while done < count:
        names = [f"{kind}:{seed}:{first + i}" for i in range(done, count)]
        with tempfile.TemporaryDirectory() as base:
            for outcome, said, took_s, took_bytes in _answers(soaked, names, Path(base)):
                total.add(outcome, took_s, took_bytes)
                if outcome not in FINE:
                    total.said.append(_keep(soaked, f"{kind}:{seed}:{first + done}", outcome, said))
                done += 1
    total.seconds = time.monotonic() - began
    return total


def _keep(soaked: Soaked, name: str, outcome: str, said: str) -> str:
    """Write the mutant and what became of it into a folder; a line or a traceback to print."""
    folder = KEPT / name.replace(":", "-")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    changed = _lay_out(soaked, name, folder)[0]
    text = f"{outcome}: {changed} of --again {name}\n{said}"
    (folder / "said.txt").write_text(text, encoding="utf-8")
    return text


def _again(name: str) -> int:
    with tempfile.TemporaryDirectory() as folder:
        outcome, said = _read(_soaked(name.partition(":")[0]), name, Path(folder))
    print(outcome, said)
    return int(outcome not in FINE)


def main() -> int:
    """Soak all kinds, print a table, and exit with 1 where a mutant is not fine."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--share", type=float, default=1.0, metavar="X", help="of 100 000 mutants")
    parser.add_argument("--only", default=",".join(KINDS), metavar="KINDS", help="a,b: these kinds")
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="of all mutants")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes at a time")
    parser.add_argument("--again", metavar="NAME", help="one mutant, kind:seed:number")
    options = parser.parse_args()
    if options.again:
        return _again(options.again)
    counts = {kind: Count(kind) for kind in options.only.split(",")}
    total = max(1, round(MUTANTS * options.share))
    with ProcessPoolExecutor(options.jobs, multiprocessing.get_context("spawn")) as pool:
        runs = [
            pool.submit(soak, kind, first, min(BATCH, total - first), options.seed)
            for kind in counts
            for first in range(0, total, BATCH)
        ]
        try:
            for done, run in enumerate(runs, 1):
                batch = run.result()
                counts[batch.kind].merge(batch)
                for said in batch.said:
                    print(said, flush=True)
                if done % 20 == 0:
                    print(f"{done} of {len(runs)} batches", file=sys.stderr, flush=True)
        except BaseException as error:
            pool.shutdown(cancel_futures=True)
            if not isinstance(error, KeyboardInterrupt):
                raise
            print("interrupted: the table is of what was read until then", file=sys.stderr)
    print(f"\n{'kind':10}  mutants     read  refused    bad   longest s    largest MB  seconds")
    print(*counts.values(), sep="\n")
    return int(any(count.bad for count in counts.values()))


if __name__ == "__main__":
    sys.exit(main())
