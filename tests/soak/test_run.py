"""The soak finds what it looks for: exceptions, deaths, endless loops, and memory."""

import json
import os
import random
from pathlib import Path

import pytest

from dpbench.errors import InputError
from tests.soak import run
from tests.soak.mutations import of_bytes, of_json
from tests.soak.readers import KINDS, Soaked


class Faulty(Soaked):
    """A reader with a fault of every kind, by the first byte of its file."""

    files = {"a": b"\0"}

    def mutate(self, name: str, data: bytes, rng: random.Random) -> bytes:
        return bytes([rng.randrange(6)])

    def read(self, folder: Path, name: str, rng: random.Random) -> None:
        fault = (folder / name).read_bytes()[0]
        if fault == 1:
            raise InputError("a", "", "b", "c")
        if fault == 2:
            raise KeyError("a")
        if fault == 3:
            os._exit(7)
        if fault == 4:
            while True:
                pass
        if fault == 5:
            # More than an allocator keeps at hand of what was freed.
            bytearray(2 * 10**8)


@pytest.mark.slow
def test_every_fault_is_found_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Those behind one that dies or hangs are read too; `--again` reads one of them alone."""
    for name, value in (("LIMIT_S", 1.0), ("LIMIT_BYTES", 10**8), ("KEPT", tmp_path)):
        monkeypatch.setattr(run, name, value)
    monkeypatch.setitem(KINDS, "faulty", lambda folder: Faulty())
    # Of this seed one mutant hangs, which takes three times the limit; three are read after it.
    count = run.soak("faulty", 0, 11, seed=2)
    assert count.outcomes.total() == 11
    kinds = {"read", "refused", "exception", "crash", "hang", "large"}
    assert set(count.outcomes) == kinds and count.bad == len(count.said)
    said = next(text for text in count.said if text.startswith("exception: a of --again faulty:2:"))
    name = said.splitlines()[0].rpartition(" ")[2]
    assert "KeyError" in (tmp_path / name.replace(":", "-") / "said.txt").read_text("utf-8")
    assert run._again(name) == 1 and "KeyError" in capsys.readouterr().out


def test_an_empty_file_is_mutated_too() -> None:
    """A mutation that cuts a file to nothing may be followed by another."""
    assert all(of_bytes(b"", random.Random(seed)) for seed in range(50))


@pytest.mark.parametrize("kind", ["toml", "sequences", "hulls"])
def test_a_seed_makes_the_same_mutants(kind: str, tmp_path: Path) -> None:
    """On every machine, and in whatever order they are read."""
    soaked = KINDS[kind](tmp_path)
    for i in range(20):
        made = []
        for part in ("first", "again"):
            name, _ = run._lay_out(soaked, f"{kind}:1:{i}", tmp_path / part / str(i))
            made.append((name, (tmp_path / part / str(i) / name).read_bytes()))
        assert made[0] == made[1]


def test_a_document_leaves_nothing_to_the_next() -> None:
    """Values put into one document are changed in it, and not for all that follow."""
    document = json.dumps({"a": [1, {"b": 2}], "c": "x"}).encode()
    first, again = ([of_json(document, random.Random(i)) for i in range(2000)] for _ in range(2))
    assert first == again
