"""Records put together by what they share."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

Item = TypeVar("Item")
Key = TypeVar("Key")


def grouped(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """Group items by key, keys and items in the order in which they come."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def firsts(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, Item]:
    """Return the first item of each key."""
    first: dict[Key, Item] = {}
    for item in items:
        first.setdefault(key(item), item)
    return first
