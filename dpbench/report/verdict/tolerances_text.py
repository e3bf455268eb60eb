"""Tolerances that custom settings leave at a library's defaults, in plain words."""

from dpbench.analysis.verdict.verdict import Verdict, find_solver_record_or_none
from dpbench.report.formats import join_with_and
from dpbench.solvers.own_settings import decode_options_from_json
from dpbench.solvers.settings import (
    find_default_tolerance,
    list_tolerance_options,
    list_tolerances_left_at_default,
)


def describe_tolerances_left(verdict: Verdict) -> str:
    """Return a clause on tolerances that settings with too large an error do not set; or ""."""
    solver = verdict.configuration.solver
    is_inaccurate = any(finding.kind == "inaccurate" for finding in verdict.causes)
    options = decode_options_from_json(verdict.configuration.options)
    if not is_inaccurate or not options or find_solver_record_or_none(solver) is None:
        return ""
    left = list_tolerances_left_at_default(solver, options)
    if not left:
        return ""
    defaults = {name: find_default_tolerance(solver, name) for name in left}
    own = {name: options[name] for name in list_tolerance_options(solver) if name in options}
    largest = max((v for v in own.values() if isinstance(v, (int, float))), default=0.0)
    is_looser = any(v is not None and v > largest for v in defaults.values())
    names = join_with_and([f"`{name}`" for name in left])
    values = join_with_and([f"{v:g}" for v in defaults.values() if v is not None])
    are, default = ("is", "default") if len(left) == 1 else ("are", "defaults")
    text = f"{names} {are} left at {solver}'s {default} {values}".rstrip()
    set_names = join_with_and([f"`{name}`" for name in own])
    return f"{text}, so a solve can end before it reaches {set_names}" if is_looser else text
