"""The reference of the Python interface: every public name, its signature and its docstring."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from enum import Enum

import dpbench
from sitegen.markup import code, docstring, prose

WIDTH = 88
INTRODUCTION = """# Python

Everything here is imported from `dpbench` itself. Vectors and matrices are NumPy arrays of float64;
`(n,)` is a shape. Wrong input raises `InputError`, whose text is one line.
"""


def pages() -> dict[str, str]:
    """Markdown by file of the documentation."""
    parts = [INTRODUCTION]
    for name in dpbench.__all__:
        parts += _entry(name, getattr(dpbench, name))
    return {"reference/python.md": "\n".join(parts)}


def _entry(name: str, thing: object) -> list[str]:
    parts = [f"## {code(name)}\n", f"{_signature(name, thing)}\n", f"{docstring(thing)}\n"]
    if inspect.isclass(thing):
        for label, member in _members(thing):
            summary = (inspect.getdoc(member) or "").split("\n\n")[0]
            parts.append(f"- {code(label)}{': ' if summary else ''}{prose(summary)}")
        parts.append("")
    return parts


def _signature(name: str, thing: object) -> str:
    if inspect.isclass(thing) and issubclass(thing, (Enum, Exception)):
        return f"```python\nclass {name}({thing.__bases__[0].__name__})\n```"
    assert callable(thing)
    text = f"{name}{inspect.signature(thing)}".replace("'", "")
    return f"```python\n{text if len(text) <= WIDTH else _broken(name, thing)}\n```"


def _broken(name: str, thing: object) -> str:
    """A long signature, a parameter a line."""
    assert callable(thing)
    signature = inspect.signature(thing)
    lines, starred = [], False
    for parameter in signature.parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and not starred:
            lines.append("    *,")
            starred = True
        lines.append(f"    {parameter},".replace("'", ""))
    returned = signature.return_annotation
    arrow = "" if returned is signature.empty else f" -> {returned}"
    return f"{name}(\n" + "\n".join(lines) + f"\n){arrow}"


def _members(cls: type) -> Iterator[tuple[str, object]]:
    """Public methods and properties with a docstring, and the members of an enumeration."""
    if issubclass(cls, Enum):
        yield from ((member.name, None) for member in cls)
        return
    for name in dir(cls):
        member = inspect.getattr_static(cls, name)
        if name.startswith("_") or not inspect.getdoc(getattr(cls, name, None)):
            continue
        if isinstance(member, property):
            yield name, member
        elif callable(function := getattr(cls, name)) and _is_ours(function):
            yield f"{name}{inspect.signature(function)}".replace("'", ""), function


def _is_ours(function: object) -> bool:
    return str(getattr(function, "__module__", "")).startswith("dpbench")
