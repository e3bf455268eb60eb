"""Check that a page from others is passive: no script in it, and nothing that is loaded.

The page cannot be compared with one written anew, as verdicts need the steps, which are not sent.
So its markup is held against what pages without scripts are made of, in this and earlier releases.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from dpbench.errors import ResultsError
from dpbench.report.page.write import FILES

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
"""Attributes that are read by people or by name, whatever is in them."""
_VALUES = {
    "href": re.compile(rf"#[\w-]*|{'|'.join(map(re.escape, FILES))}"),
    "src": re.compile(r"data:image/svg\+xml;base64,[A-Za-z0-9+/=]*"),
    # In ISO-2022-JP a browser reads quotes as parts of other characters.
    "charset": re.compile(r"utf-8", re.IGNORECASE),
    "content": re.compile(r"width=device-width, initial-scale=1"),
}
"""What addresses may be: a section, a file of the folder, a picture, in which nothing runs."""
_LOADS = re.compile(r"url\s*\((?!#)|@import|image-set|[\\&]", re.IGNORECASE)
"""What a style can load something with, or hide that by an escape."""


def check_passive(page: str, where: str) -> None:
    """Refuse a page in which a browser would run or load something.

    Raises
    ------
    ResultsError : naming the line, and the tag or attribute.
    """
    for at, found in _active(page):
        line = page.count("\n", 0, at) + 1
        allowed = "a page without scripts: `dpbench report DIR --send FOLDER`"
        raise ResultsError(where, f"line {line}", found[:120], allowed)


def _active(page: str) -> Iterator[tuple[int, str]]:
    """Yield what is not passive, and where."""
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
            if not _is_passive(attribute.lower(), value):
                yield start, f'{attribute}="{value}" in <{name}>'
        if name == "style" and not tag[0].startswith("</"):
            end = page.find("<", at)
            if loads := _LOADS.search(page, at, end if end >= 0 else len(page)):
                yield loads.start(), f"{loads[0]} in <style>"


def _is_passive(attribute: str, value: str) -> bool:
    if attribute in _VALUES:
        return _VALUES[attribute].fullmatch(value) is not None
    if _ATTRIBUTES.fullmatch(attribute) is None:
        return False
    return _WORDS.fullmatch(attribute) is not None or _LOADS.search(value) is None
