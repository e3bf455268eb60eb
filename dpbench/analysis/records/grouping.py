"""Records put together by what they share."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

import numpy as np
import pandas as pd

Item = TypeVar("Item")
Key = TypeVar("Key")


def grouped(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, list[Item]]:
    """The items of each key; keys and items in the order in which they come."""
    groups: dict[Key, list[Item]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return groups


def firsts(items: Iterable[Item], key: Callable[[Item], Key]) -> dict[Key, Item]:
    """The first item of each key."""
    first: dict[Key, Item] = {}
    for item in items:
        first.setdefault(key(item), item)
    return first


def spans_of(labels: pd.Series[str] | np.ndarray) -> dict[str, tuple[int, int]]:
    """Of labels (N,) that are ordered: the first place of each, and the one after its last."""
    codes, names = pd.factorize(labels)
    ends = np.append(np.flatnonzero(np.diff(codes)) + 1, len(codes)).tolist() if len(codes) else []
    return dict(zip(map(str, names), zip([0, *ends], ends, strict=False), strict=True))
