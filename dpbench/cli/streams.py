"""Standard streams that accept any text, also when closed, in a closed pipe or in ASCII."""

import codecs
import io
import os
import select
import sys
import unicodedata

PIPE_CLOSED = 141  # The exit code of a program that a closed pipe ended, as a shell gives it
_ERRORS = "dpbench"  # The name of `_plain` among the handlers of encoding errors
# fmt: off
_PLAIN = {
    "µ": "u", "≤": "<=", "≥": ">=", "≈": "~", "×": "x", "·": "*", "−": "-", "–": "-",
    "°": "deg", "±": "+-", "∞": "inf", "§": "section ", "•": "*",
}
# fmt: on
"""Replacements of characters that an encoding lacks; others lose their accent."""


def open_streams() -> None:
    """Reopen closed standard streams; make all accept characters that their encoding lacks.

    A closed one leads nowhere, before a result file gets its number. A character that an encoding
    lacks is replaced by the nearest; a path that is no text keeps its bytes where that is possible.
    """
    codecs.register_error(_ERRORS, _replace_unencodable)
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
    """Return whether a file descriptor, given by number, is open."""
    try:
        os.fstat(number)
    except OSError:
        return False
    return True


def _replace_unencodable(error: UnicodeError) -> tuple[str, int]:
    """Return plain characters for those a stream cannot encode: an error handler of codecs."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    found = error.object[error.start : error.end]
    bare = (unicodedata.normalize("NFKD", c).encode("ascii", "ignore").decode() for c in found)
    return "".join(_PLAIN.get(c) or b or "?" for c, b in zip(found, bare, strict=True)), error.end


def is_output_lost() -> bool:
    """Return whether standard output or error is a closed pipe or terminal."""
    streams = select.poll()
    for number in (1, 2):
        streams.register(number, 0)
    return bool(streams.poll(0))


def flush_streams() -> None:
    """Flush standard output and error; discard their content if they are closed."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())
            os.close(nowhere)
