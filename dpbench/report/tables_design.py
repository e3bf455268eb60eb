"""Tables on the design of controllers: figures of the loop, regions, gains, all trials."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from dpbench.bench.design.bracket import Trial
from dpbench.bench.design.design_file import DesignRecord
from dpbench.bench.design.region_of_attraction import RegionOfAttraction
from dpbench.report.formats import MISSING, and_list, plural, rounded_down, rounded_up, significant
from dpbench.report.table import Cell, Table, row_of

AXES = ("surge", "sway", "yaw")
STATES = ("Δu", "Δv", "Δr", "Δn", "Δe", "Δψ", "n", "e", "ψ")
"""Of x = [Δν; Δη; y], in that order."""


def names_of(records: Iterable[DesignRecord]) -> dict[str, str]:
    """Each controller in a few words; its scenario is named where the words fit another too."""
    words: dict[str, str] = {}
    for record in records:
        end = "" if record.terminal == "none" else f", terminal {record.terminal}"
        words[record.controller] = f"{record.tuning} {record.N_p}/{record.N_c}{end}"
    twice = [name for name in words.values() if list(words.values()).count(name) > 1]
    return {c: f"{name} of {c}" if name in twice else name for c, name in words.items()}


def full_time(record: DesignRecord) -> float:
    """What makes a time of the record's ship one at full size (Froude's law)."""
    return math.sqrt(record.model_scale)


def weathers(records: Sequence[DesignRecord]) -> list[str]:
    """The weathers of the regions."""
    return list(dict.fromkeys(b.weather for record in records for b in record.regions))


def region_in(record: DesignRecord, weather: str) -> RegionOfAttraction | None:
    """The region of a record in some weather."""
    return next((b for b in record.regions if b.weather == weather), None)


def region_text(record: DesignRecord, region: RegionOfAttraction) -> str:
    """The bracket in m at full size, rounded outwards."""
    found, scale = region.bracket, record.model_scale
    if found.fails_m is None:
        return f"≥ {scale * found.holds_m:.3g}"
    high = rounded_up(scale * found.fails_m)
    if found.holds_m == 0.0:
        return f"< {high}"
    note = ", undecided" if found.edge is not None and found.edge.verdict == "undecided" else ""
    return f"{rounded_down(scale * found.holds_m)} – {high}{note}"


def design_table(records: Sequence[DesignRecord]) -> Table:
    """A row for every vessel and controller."""
    seas, names = weathers(records), names_of(records)
    heads = (
        "vessel",
        "controller",
        "spectral radius",
        "smallest |λ|",
        "slowest mode [s]",
        "controllable",
        "cond P, scaled",
        "cond P, SI",
        *(f"region, {weather_text(sea)} [m]" for sea in seas),
    )
    scaled = [f"`{r.vessel}` (1 : {r.model_scale:g})" for r in records if r.model_scale != 1.0]
    model = and_list(list(dict.fromkeys(scaled)))
    return Table(
        title="Loop, conditioning and region",
        note=(
            f"{plural(len(records), 'design')}. λ are the roots of paper eq. 35; the slowest mode "
            "is the time in which the largest of them decays by 1/e. P in units of z = ΔU/Δu_max "
            "(scaled) and in N, N·m (SI). RegionOfAttraction: the largest sway offset held – the "
            "smallest not "
            f"held; ≥ where everything tried was held.{f' Of {model}:' if model else ''}"
            f"{' times and offsets at full size.' if model else ''}"
        ),
        heads=heads,
        rows=tuple(_design_row(record, names[record.controller], seas) for record in records),
        text_columns=2,
    )


def weather_text(weather: str) -> str:
    """A weather in a sentence: in words, or by the name of its scenario."""
    return weather if " " in weather else f"`{weather}`"


def _design_row(record: DesignRecord, name: str, seas: Sequence[str]) -> tuple[Cell, ...]:
    radius = record.spectral_radius
    stable, whole = radius < 1.0, record.controllable == record.states
    slowest = -full_time(record) * record.sample_s / math.log(radius) if stable else math.inf
    regions = [region_in(record, sea) for sea in seas]
    return row_of(
        f"`{record.vessel}`",
        name,
        Cell(f"{radius:.4f}", "" if stable else "bad"),
        f"{min(math.hypot(*root) for root in record.eigenvalues):.4f}",
        significant(slowest),
        Cell(f"{record.controllable} of {record.states}", "" if whole else "bad"),
        significant(record.condition_scaled),
        significant(record.condition_si),
        *(MISSING if b is None else region_text(record, b) for b in regions),
    )


def gains_table(records: Sequence[DesignRecord]) -> Table:
    """K_mpc of every design."""
    names = names_of(records)
    return Table(
        title="Gains K_mpc",
        note=(
            f"{plural(len(records), 'design')}; Δu = K_y y_d − K_mpc x while no limit is active "
            "(paper eq. 33), in N and N·m per m/s, rad/s, m and rad, on the ship's own scale. The "
            "last three columns are K_y as well: y is part of x."
        ),
        heads=("vessel", "controller", "axis", *STATES),
        rows=tuple(
            row_of(
                f"`{record.vessel}`",
                names[record.controller],
                axis,
                *(significant(value) for value in gains),
            )
            for record in records
            for axis, gains in zip(AXES, record.K_mpc, strict=True)
        ),
        text_columns=3,
        folded=True,
    )


def trials_table(records: Sequence[DesignRecord]) -> Table:
    """Every offset that was tried."""
    names = names_of(records)
    tried = sum(len(b.bracket.tried) for record in records for b in record.regions)
    return Table(
        title="All offsets that were tried",
        note=(
            f"{plural(tried, 'offset')} in m at full size. In brackets the side the ship did not "
            "come back from; port was tried only where starboard held."
        ),
        heads=("vessel", "controller", "weather", "held", "not held"),
        rows=tuple(
            row_of(
                f"`{record.vessel}`",
                names[record.controller],
                weather_text(b.weather),
                ", ".join(_tried(record, t) for t in b.bracket.tried if t.verdict == "holds"),
                ", ".join(_tried(record, t) for t in b.bracket.tried if t.verdict != "holds"),
            )
            for record in records
            for b in record.regions
        ),
        text_columns=5,
        folded=True,
    )


def _tried(record: DesignRecord, trial: Trial) -> str:
    offset = f"{record.model_scale * trial.offset_m:.4g}"
    if trial.verdict == "holds":
        return offset
    return f"{offset} ({'undecided, ' if trial.verdict == 'undecided' else ''}{trial.side})"


def condition_text(records: Sequence[DesignRecord]) -> str:
    """What scaling does to the conditioning of the QPs."""
    scaled = [record.condition_scaled for record in records]
    si = [record.condition_si for record in records]
    names = names_of(records)
    better = [
        f"`{record.vessel}` with {names[record.controller]}"
        for record in records
        if record.condition_si < record.condition_scaled
    ]
    text = (
        f"Scaled by the rate limits P has a condition number of "
        f"{significant(min(scaled))} to {significant(max(scaled))}, in SI units one of "
        f"{significant(min(si))} to {significant(max(si))}."
    )
    return f"{text} SI is the better one for {and_list(better)}." if better else text


def _span(values: Sequence[float]) -> str:
    low, high = f"{min(values):.3g}", f"{max(values):.3g}"
    return low if low == high else f"{low} to {high}"


def horizon_text(records: Sequence[DesignRecord]) -> str:
    """How far a controller looks ahead, against the time its thrusters take."""
    ahead = [r.N_p * r.sample_s * full_time(r) for r in records]
    ramp = [r.ramp_s * full_time(r) for r in records]
    against = "against"
    if all(a < b for a, b in zip(ahead, ramp, strict=True)):
        against = "less than"
    elif all(a > b for a, b in zip(ahead, ramp, strict=True)):
        against = "more than"
    return (
        f"looks {_span(ahead)} s ahead, {against} the {_span(ramp)} s in which the force goes "
        "from zero to full"
    )


def held_text(records: Sequence[DesignRecord], weather: str) -> str:
    """What a controller holds in some weather, in its worst vessel and in its best."""
    found = [(r, b) for r in records if (b := region_in(r, weather)) is not None]
    if not found:
        return ""
    found.sort(key=lambda pair: pair[0].model_scale * pair[1].bracket.holds_m)
    sea = f"In {weather_text(weather)} it holds"
    if all(b.bracket.fails_m is None for _, b in found):
        largest = min(r.model_scale * b.bracket.largest_m for r, b in found)
        vessels = "every vessel" if len(found) > 1 else f"`{found[0][0].vessel}`"
        return f"{sea} all that was tried, up to {largest:.3g} m, in {vessels}."
    worst, best = (f"`{r.vessel}`, {region_text(r, b)} m" for r, b in (found[0], found[-1]))
    most = f", and most in {best}" if len(found) > 1 else ""
    return f"{sea} least in {worst}{most}."


def count_of(records: Sequence[DesignRecord], verdict: str) -> int:
    """How many trials had this verdict."""
    return sum(t.verdict == verdict for r in records for b in r.regions for t in b.bracket.tried)
