"""Libraries that come in several builds and choose one for the processor when they are imported."""

from __future__ import annotations

import sys

from dpbench.solvers.record import Build

BUILDS = {"_avx512": "AVX-512", "_avx2": "AVX2", "": "no AVX"}
"""What the end of a module's name says it was compiled for."""


def vectorised_build(module: str) -> Build:
    """The build that an imported library chose; it is never less than the processor has.

    Parameters
    ----------
    module : the name its compiled modules share, without what they were compiled for.
    """
    found = (text for end, text in BUILDS.items() if sys.modules.get(f"{module}{end}") is not None)
    return Build(next(found, ""))
