"""Compile kernels with Numba, and keep them where this user may write.

Numba keeps them beside the sources, else in the user's cache folder, and refuses to compile where
neither can be written. Then they are kept in a folder of this process, which its child processes
inherit (NUMBA_CACHE_DIR), with links to kernels that were compiled before.
"""

import os
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numba
from numba.core import event
from numba.core.caching import UserProvidedCacheLocator
from numba.misc.appdirs import AppDirs

from dpbench.temporary_folders import process_temporary_folder

PACKAGE = Path(__file__).parent
Function = Callable[..., Any]
# Some releases have types for a part of these names, older ones have none.
_numba_njit: Any = numba.njit
_config: Any = numba.config  # type: ignore[attr-defined,unused-ignore] # as above
_app_dirs: Any = AppDirs
_locator: Any = UserProvidedCacheLocator
_Listener: Any = event.Listener
COMPILING = "compiling kernels before their first use: up to a minute"
"""Line of a session and of a campaign; other scenarios may use further kernels later."""
_OWN_PROCESSES = {"dpbench.cli", "dpbench.bench.workers.template"}
"""Modules of commands and workers, where a campaign has a line of its own."""
_NO_PLACE = "cannot cache function"
"""Beginning of Numba's error where it finds no folder to write to."""


def njit(*signature: str, **options: Any) -> Callable[[Function], Function]:
    """Return a decorator that compiles a function with Numba, cached on disk where possible."""

    def compiled(function: Function) -> Function:
        def with_options(given: dict[str, Any]) -> Function:
            kernel: Function = _numba_njit(*signature, **given)(function)
            return kernel

        try:
            return with_options(options)
        except RuntimeError as error:
            if not str(error).startswith(_NO_PLACE):
                raise
        return with_options(
            options if _use_temporary_numba_cache() else {**options, "cache": False}
        )

    return compiled


class _CompilationNotice(_Listener):  # type: ignore[misc] # Numba's class is untyped
    """Line on standard error before a session in Python waits for its first compilation."""

    is_printed = False

    def on_start(self, event: Any) -> None:
        """Print once that kernels are compiled: at the first of dpbench not in Numba's cache."""
        kernel: Function = event.data["dispatcher"].py_func
        is_due = not self.is_printed and _OWN_PROCESSES.isdisjoint(sys.modules)
        if is_due and kernel.__module__.startswith("dpbench."):
            self.is_printed = True
            print(f"dpbench: {COMPILING}", file=sys.stderr, flush=True)

    def on_end(self, event: Any) -> None:
        """Do nothing at the end of a compilation; Numba requires this method."""


_install_notice: Any = event.register
_notice = _CompilationNotice()
_install_notice("numba:compile", _notice)


def is_compilation_announced() -> bool:
    """Return whether this session in Python has printed that kernels are compiled."""
    return _notice.is_printed


def list_numba_cache_folders() -> list[Path]:
    """Return the folders below which Numba keeps compiled functions."""
    given = _config.CACHE_DIR
    return [Path(given)] if given else [PACKAGE, _numba_folder_in_user_cache()]


def _numba_folder_in_user_cache() -> Path:
    """Return Numba's folder in the user's cache."""
    return Path(_app_dirs(appname="numba", appauthor=False).user_cache_dir)


@cache
def _use_temporary_numba_cache() -> bool:
    """Make a temporary folder for compiled functions and have Numba use it; return if it worked."""
    try:
        own = process_temporary_folder() / "kernels"
        own.mkdir()
        for sources in {path.parent for path in PACKAGE.rglob("*.py")}:
            _link_compiled_kernels_into_cache(sources, own)
    except OSError:
        return False
    _config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"] = str(own)
    return True


def _link_compiled_kernels_into_cache(sources: Path, own: Path) -> None:
    """Link the compiled kernels of a folder of sources into `own`, a new Numba cache."""
    name = _locator.get_suitable_cache_subpath(str(sources / "any.py"))
    given = [Path(folder) / name for folder in filter(None, [_config.CACHE_DIR])]
    for place in (*given, sources / "__pycache__", _numba_folder_in_user_cache() / name):
        files: list[Path] = []
        with suppress(OSError):
            files = [path for path in place.iterdir() if path.suffix in (".nbi", ".nbc")]
        if files:
            (own / name).mkdir()
            for path in files:
                (own / name / path.name).symlink_to(path)
            return
