"""Standard streams that take whatever is printed: closed ones, pipes nobody reads, ASCII."""

from __future__ import annotations

import codecs
import io
import os
import select
import sys
import unicodedata

PIPE_CLOSED = 141
"""The exit code of a program that a closed pipe ended, as a shell gives it."""
_ERRORS = "dpbench"
"""The name of `_plain` among the handlers of encoding errors."""
_PLAIN = {
    "µ": "u",
    "≤": "<=",
    "≥": ">=",
    "≈": "~",
    "×": "x",
    "·": "*",
    "−": "-",
    "–": "-",
    "°": "deg",
    "±": "+-",
    "∞": "inf",
    "§": "section ",
    "•": "*",
}
"""What stands for a character where there are fewer; of others their letter without its accent."""


def open_streams() -> None:
    """Give this process a standard input, output and error, whatever it was started with.

    A closed one leads nowhere, before a result file gets its number. Those that cannot show a
    character show what comes nearest; a path that is no text keeps its bytes where they can.
    """
    codecs.register_error(_ERRORS, _plain)
    for number, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        if not _is_open(number):
            os.open(os.devnull, os.O_RDWR)
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115 - for good
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            unicode = codecs.lookup(stream.encoding).name.startswith("utf")
            stream.reconfigure(errors="surrogateescape" if unicode else _ERRORS)


def _is_open(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError:
        return False
    return True


def _plain(error: UnicodeError) -> tuple[str, int]:
    """Replace the characters that an encoding lacks by those it has."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    found = error.object[error.start : error.end]
    return "".join(_PLAIN.get(c) or _without_accent(c) for c in found), error.end


def _without_accent(character: str) -> str:
    bare = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode("ascii")
    return bare or "?"


def is_output_lost() -> bool:
    """Whether the reader of standard output or error went away: a closed pipe or terminal."""
    listening = select.poll()
    for number in (1, 2):
        listening.register(number, 0)
    return bool(listening.poll(0))


def flush_streams() -> None:
    """Write what is left in standard output and error, or drop it where nobody reads it.

    Python tries it once more at its end, with a traceback.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())
            os.close(nowhere)
