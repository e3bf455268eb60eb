"""The reference of the Python interface: every public name, its signature and its docstring."""

import inspect
from collections.abc import Iterator
from enum import Enum
from functools import cached_property

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
        members = [_member(label, member) for label, member in _members(thing)]
        parts += ["*Members*\n", *members, ""] if members else []
    return parts


def _member(label: str, member: object) -> str:
    summary = (inspect.getdoc(member) or "").split("\n\n")[0]
    return f"- `{label}`{': ' if summary else ''}{prose(summary)}"


def _signature(name: str, thing: object) -> str:
    if inspect.isclass(thing) and issubclass(thing, (Enum, Exception)):
        return f"```python\nclass {name}({thing.__bases__[0].__name__})\n```"
    signature = _plain(thing)
    text = f"{name}{signature}"
    return f"```python\n{text if len(text) <= WIDTH else _broken(name, signature)}\n```"


class _Annotation(str):
    """An annotation that prints without quotes."""

    __slots__ = ()
    __repr__ = str.__str__


def _plain(thing: object) -> inspect.Signature:
    """The signature as a person writes it."""
    assert callable(thing)
    signature = inspect.signature(thing)
    parameters = [
        p if p.annotation is p.empty else p.replace(annotation=_Annotation(p.annotation))
        for p in signature.parameters.values()
    ]
    returned: object = signature.return_annotation
    if inspect.isclass(thing) or returned is signature.empty:
        returned = signature.empty
    else:
        returned = _Annotation(returned)
    return signature.replace(parameters=parameters, return_annotation=returned)


def _broken(name: str, signature: inspect.Signature) -> str:
    """A long signature, a parameter a line."""
    lines, starred = [], False
    for parameter in signature.parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and not starred:
            lines.append("    *,")
            starred = True
        lines.append(f"    {parameter},")
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
        if isinstance(member, property | cached_property):
            yield name, member
        elif callable(function := getattr(cls, name)) and _is_ours(function):
            yield f"{name}{_plain(function)}", function


def _is_ours(function: object) -> bool:
    return str(getattr(function, "__module__", "")).startswith("dpbench")
