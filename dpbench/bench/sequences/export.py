"""`dpbench export`: a scenario or a sequence as a file for others."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

from dpbench.bench.run.exact_loop import Part
from dpbench.bench.sequences import recording
from dpbench.bench.sequences.qpbenchmark_files import list_steps_with_optimum, save_qpbenchmark
from dpbench.bench.sequences.sequence_file import Recorded
from dpbench.bench.sequences.text_files import save_csv, save_mat, save_qps
from dpbench.errors import InputError, SituationError
from dpbench.qp.program import QPSequence
from dpbench.qp.random_mpc import is_random_mpc_sequence_name
from dpbench.qp.referee.referee import certify_all_steps
from dpbench.scenario.problem_files import is_shipped_sequence_name, list_shipped_problem_names
from dpbench.scenario.scenario import Scenario, resolve_to_scenario
from dpbench.scenario.tables.key_types import Horizons, parse_horizons

Format = Literal["npz", "qpbenchmark", "mat", "csv", "qps"]
FORMATS: tuple[Format, ...] = get_args(Format)
FILES: dict[Format, str] = {"npz": ".npz", "mat": ".mat"}  # of the formats that are one file
WRITERS = {"mat": save_mat, "csv": save_csv, "qps": save_qps}


def export_sequence(
    what: str | Path | Scenario | QPSequence,
    out: str | Path,
    *,
    format: Format = "npz",
    horizons: str | None = None,
    steps: int | None = None,
    every: int = 1,
    at: int | None = None,
    part: Part = "controller",
) -> str:
    """Write the certified QPs of a scenario or a sequence to a file; return a line on it.

    Parameters
    ----------
    what : a scenario, a sequence, or the name or path of either; a folder of qpsolvers problems; or
        a random MPC problem such as random_mpc-10-4-10 (states, inputs, horizon).
    out : the `.npz` or `.mat` file; for "qpbenchmark" the name of the Parquet file and the Python
        file; for "csv" and "qps" a folder.
    horizons : "N_p/N_c" instead of those of the tuning; of a scenario only.
    steps, every : the first so many steps, and of these each `every`-th; at : one step instead.
    part : "allocation" for the second QPs of a cascade; of a scenario only.

    Raises
    ------
    InputError : for bad input; CertificateError when the loop of a scenario cannot be certified.

    Examples
    --------
    >>> export_sequence("paper-30-5", "paper.mat", format="mat", steps=20).split(";")[0]
    'paper.mat: 20 QPs, n = 15, m = 15'
    >>> export_sequence("turn", "step-4.npz", at=4).split(";")[0]
    'step-4.npz: 1 QPs, n = 30, m = 30'
    """
    target = Path(out)
    if format not in FORMATS:
        raise InputError("`format`", "", repr(format), " | ".join(FORMATS))
    if (suffix := FILES.get(format)) and target.suffix != suffix:
        raise InputError("`out`", "", repr(target.name), f"a file name that ends in {suffix}")
    if at is not None and (steps is not None or every != 1):
        raise InputError("`at`", "", f"{at} beside `steps` or `every`", "one step, or several")
    if part not in get_args(Part):
        raise InputError("`part`", "", repr(part), " | ".join(get_args(Part)))
    recorded = _record_requested(what, _parse_horizons(horizons), steps, every, at, part)
    target.parent.mkdir(parents=True, exist_ok=True)
    if format == "npz":
        recorded.save(target)
        written = str(target)
    elif write := WRITERS.get(format):
        written = str(write(target, recorded))
    else:
        written = " and ".join(map(str, save_qpbenchmark(target, recorded)))
    left_out = len(recorded.optima or []) - len(list_steps_with_optimum(recorded))
    some = left_out and format == "qpbenchmark"
    without = f"; {left_out} without an optimum left out" if some else ""
    about = recording.describe_sequence(recorded.sequence, recorded.optima or [])
    return f"{written}: {about}{without}"


def check_export_options(options: dict[str, Any]) -> None:
    """Raise InputError unless `dpbench export` has --all alone, or what to export with --out."""
    if not options["all"]:
        if options["what"] is None or options["out"] is None:
            raise SituationError("export", "name WHAT and its file by --out, or give --all")
        return
    defaults = {"every": 1, "format": "npz", "part": "controller"}
    for key in ("what", "horizons", "steps", "every", "format", "at", "part"):
        if options[key] != defaults.get(key):
            found = f"{key} {options[key]} beside --all"
            raise InputError("export", "", found, "--all, which follows its manifest, and --out")


def _record_requested(
    what: str | Path | Scenario | QPSequence,
    horizons: tuple[int, int] | None,
    steps: int | None,
    every: int,
    at: int | None,
    part: Part,
) -> Recorded:
    """Load a stored sequence or record one from a scenario, cut to the requested steps."""
    if _is_scenario(what):
        scenario = resolve_to_scenario(what)
        record = partial(recording.record_scenario, horizons=horizons, part=part)
        if at is None:
            return record(scenario, steps=steps, every=every)
        # The loop up to there is what leads to the step; what follows is not needed.
        upto = at + 1 if 0 <= at < scenario.steps else None
        return _record_step(record(scenario, steps=upto), at)
    if part != "controller":
        allowed = "a scenario: a sequence holds the QPs it holds"
        raise InputError("`part`", "", f"{part} for a recorded sequence", allowed)
    if horizons is not None:
        found = f"{horizons[0]}/{horizons[1]} for a recorded sequence"
        raise InputError("`horizons`", "", found, "a scenario: a sequence has the horizons it has")
    stored = _load_recorded(what)
    if at is not None:
        return _record_step(stored, at)
    sequence = recording.thin_sequence(stored.sequence, steps, every)
    # The optima of a file are certified again.
    return replace(stored, sequence=sequence, optima=certify_all_steps(sequence))


def _is_scenario(what: object) -> bool:
    """Return whether something is a scenario or names one, and no sequence of QPs."""
    if not isinstance(what, str | Path):
        return not isinstance(what, QPSequence)
    path = Path(what)
    is_file = (
        path.suffix == ".npz"
        or path.is_dir()
        or is_shipped_sequence_name(what)
        or is_random_mpc_sequence_name(what)
    )
    return str(what) in list_shipped_problem_names("scenarios") or not is_file


def _load_recorded(what: str | Path | Scenario | QPSequence) -> Recorded:
    """Return a sequence with its units; of a given one, without optima."""
    if isinstance(what, QPSequence):
        return Recorded(what.scaled or what, None, what.units)
    return recording.load_named_sequence(str(what))


def _record_step(recorded: Recorded, k: int) -> Recorded:
    """Cut a recording to its step k, with the optimum of that step certified."""
    sequence = recording.select_step(recorded.sequence, k)
    return replace(recorded, sequence=sequence, optima=certify_all_steps(sequence))


def _parse_horizons(text: str | None) -> Horizons | None:
    """Return the MPC horizons in a text "N_p/N_c", None for None; InputError for other texts."""
    if text is None:
        return None
    try:
        return parse_horizons(text)
    except ValueError as error:
        raise InputError("`horizons`", "", repr(text), str(error)) from error
