"""Compile kernels with Numba, and keep them where this user may write.

Numba keeps what it compiled beside the sources, else in the user's cache folder, and refuses to
compile where neither can be written: in a container, or in an installation of another user without
a home. There the kernels are kept in a folder of this process, whose name the processes that it
starts inherit (NUMBA_CACHE_DIR), with links to those that were compiled before.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import UserProvidedCacheLocator
from numba.misc.appdirs import AppDirs

from dpbench.own_folders import process_folder

PACKAGE = Path(__file__).parent
_NO_PLACE = "cannot cache function"
"""How Numba's complaint begins where it finds no folder to write to."""


def njit(*signature: str, **options: Any) -> Callable[[Any], Any]:
    """`numba.njit` with these arguments, whatever can be written; without a cache at the last."""

    def compiled(function: Any) -> Any:
        try:
            return numba.njit(*signature, **options)(function)
        except RuntimeError as error:
            if not str(error).startswith(_NO_PLACE):
                raise
        in_memory = {**options, "cache": False}
        return numba.njit(*signature, **(options if _has_own_cache() else in_memory))(function)

    return compiled


def cache_folders() -> list[Path]:
    """The folders below which Numba keeps compiled kernels."""
    given = numba.config.CACHE_DIR
    return [Path(given)] if given else [PACKAGE, _of_user()]


def _of_user() -> Path:
    """Numba's cache folder in the user's home."""
    return Path(AppDirs(appname="numba", appauthor=False).user_cache_dir)


@cache
def _has_own_cache() -> bool:
    """Make the cache of this process, with links to all that was compiled before; whether there is
    a place for it."""
    try:
        own = process_folder() / "kernels"
        own.mkdir()
        for sources in {path.parent for path in PACKAGE.rglob("*.py")}:
            _link(sources, own)
    except OSError:
        return False
    numba.config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"] = str(own)
    return True


def _link(sources: Path, own: Path) -> None:
    """Link what was compiled of one folder of sources into the cache, as Numba names it there."""
    name = UserProvidedCacheLocator.get_suitable_cache_subpath(str(sources / "any.py"))
    given = [Path(folder) / name for folder in filter(None, [numba.config.CACHE_DIR])]
    for place in (*given, sources / "__pycache__", _of_user() / name):
        files: list[Path] = []
        with suppress(OSError):
            files = [path for path in place.iterdir() if path.suffix in (".nbi", ".nbc")]
        if files:
            (own / name).mkdir()
            for path in files:
                (own / name / path.name).symlink_to(path)
            return
