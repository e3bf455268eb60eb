"""The checks that vessels and sources of weather share; each raises one line that names the key."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dpbench.errors import InputError, ShapeError
from dpbench.ship.layout import AXES


def finite_array(
    where: str, key: str, value: ArrayLike, shape: tuple[int, ...]
) -> NDArray[np.float64]:
    """`value` as a contiguous float64 array; ShapeError or InputError unless finite of `shape`."""
    array = np.ascontiguousarray(value, dtype=np.float64)
    if array.shape != shape:
        raise ShapeError.of(where, key, array.shape, f"shape {shape}")
    if not np.isfinite(array).all():
        raise InputError(where, key, array.tolist(), "finite numbers")
    return array


def finite(where: str, **values: float) -> None:
    """InputError unless every value is a finite number."""
    for key, value in values.items():
        if not math.isfinite(value):
            raise InputError(where, key, value, "a finite number")


def positive(where: str, **values: float) -> None:
    """InputError unless every value is finite and above zero."""
    for key, value in values.items():
        if not (math.isfinite(value) and value > 0):
            raise InputError(where, key, value, "a positive number")


def not_negative(where: str, **values: float) -> None:
    """InputError unless every value is finite and zero or more."""
    for key, value in values.items():
        if not (math.isfinite(value) and value >= 0):
            raise InputError(where, key, value, "0 or more")


def store_positive_vectors(owner: object, where: str, *names: str) -> None:
    """Keep the named fields of a frozen dataclass as (3,) positive finite floats.

    Raises
    ------
    ShapeError, InputError : naming `where` and the field.
    """
    for name in names:
        array = np.ascontiguousarray(getattr(owner, name), dtype=np.float64)
        if array.shape != (AXES,):
            raise ShapeError.of(where, name, array.shape, f"shape {(AXES,)}")
        if not (np.isfinite(array) & (array > 0)).all():
            raise InputError(where, name, array.tolist(), "positive finite numbers")
        object.__setattr__(owner, name, array)
