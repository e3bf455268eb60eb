"""The commands of pages, in the working folder; one that pages repeat runs once a session."""

import hashlib
import shlex
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from dpbench.cli.main import main
from tests.docs.markdown_blocks import DOCS, Block, blocks_of

REGRESSION_SHOWN = 1
REPEATABLE = ("check", "doctor", "init", "run")
"""Commands that read files named on their line and beside those, no result of another command."""
READ = {".toml", ".py", ".csv", ".npz"}


def _without_out(words: Sequence[str]) -> tuple[tuple[str, ...], str]:
    """Words of a command without the place that it writes to, and that; "" where none is named."""
    at = words.index("--out") if "--out" in words else len(words)
    return (*words[: at + 1], *words[at + 2 :]), "".join(words[at + 1 : at + 2])


class PageCommands:
    """Runs commands of pages; of a repeated one copies what it wrote for the same files before."""

    def __init__(self, store: Path, pages: Sequence[Path]) -> None:
        self._store = store
        blocks: list[Block] = [block for page in pages for block in blocks_of(page)]
        lines = [line for one in blocks if one.language == "sh" for line in one.tested]
        self._times = Counter(
            _without_out(shlex.split(line, comments=True)[1:])[0] for line in lines
        )

    def run(self, command: str) -> None:
        """Run a command, which must succeed."""
        program, *words = shlex.split(command, comments=True)
        if program != "dpbench":
            assert program == "python", command
            subprocess.run([sys.executable, *words], check=True, cwd=DOCS.parent)
        elif words[0] in REPEATABLE and self._times[_without_out(words)[0]] > 1:
            self._run_once(command, words)
        else:
            # Two runs of the same code may differ; that a comparison says so is no fault of a page.
            allowed = (0, REGRESSION_SHOWN) if words[0] == "compare" else (0,)
            assert main(words) in allowed, command

    def _run_once(self, command: str, words: Sequence[str]) -> None:
        asked, out = _without_out(words)
        read = [
            (path.name, path.read_bytes())
            for path in sorted(Path().iterdir())
            if path.suffix in READ
        ]
        stored = self._store / hashlib.sha256(repr((asked, read)).encode()).hexdigest()
        if not stored.exists():
            before = {*Path().rglob("*")}
            assert main(words) == 0, command
            made = {*Path().rglob("*")} - before
            written = [p for p in made if p.is_file() and "__pycache__" not in p.parts]
            for path in written:
                target = stored / path.relative_to(out) if out else stored / path
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(path, target)
            stored.mkdir(exist_ok=True)
        else:
            shutil.copytree(stored, out or ".", dirs_exist_ok=True)
