"""Verdicts on ratios between two runs: the noise of a run, minimum effects, equivalence, Holm.

Two runs of one suite are two draws of the machine's state: memory layout, frequency, neighbours. No
resampling of steps or rounds sees that. Its part common to all configurations of a sequence, the
machine factor, is the median over the *other* configurations, and is stated wherever it is taken
out. The spread around it is the noise between runs, estimated robustly from few configurations and
moderated by a prior, as in the moderated t-statistic (Smyth 2004, Stat. Appl. Genet. Mol. Biol.
3(1), article 3). A ratio's own error inside the runs counts as far as it exceeds the usual one.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from dpbench.analysis.statistics import Interval, adjust_p_values_by_holm
from dpbench.arrays import Floats, Ints

Verdict = Literal[
    "slower",
    "faster",
    "faster, not all verified",
    "equivalent",
    "no difference shown",
    "machine disturbed",
    "not judged",
]

MIN_OTHERS = 3
"""Least number of other configurations whose median is used: with fewer the reference kernel takes
its place."""
MAD_EFFICIENCY = 0.37
"""Efficiency of the median absolute deviation under normal noise (Rousseeuw & Croux 1993): n values
are worth so many times n degrees of freedom."""
_MAD_SMALL = (1.196, 1.495, 1.363, 1.206, 1.200, 1.140, 1.129, 1.107)
"""Corrections of the median absolute deviation for 2..9 values (Croux & Rousseeuw 1992); n/(n −
0.8) from there on."""
_MEDIAN_VARIANCE = np.pi / 2
"""Variance of a median times n, in variances of the normal noise."""


@dataclass(frozen=True)
class Prior:
    """Assumed noise of log time ratios between two runs: standard deviation, degrees of freedom."""

    sd: float
    df: float


CONFIGURATION_NOISE = Prior(sd=0.01, df=6.0)
"""Between two runs, of one configuration around all configurations."""
MACHINE_NOISE = Prior(sd=0.05, df=4.0)
"""Between two runs, of all configurations together, beyond what the reference kernel shows."""
MACHINES_NOISE = Prior(sd=0.1, df=6.0)
"""Between two machines, of a configuration's ratio to another one: caches and vector units favour
one solver or the other. Set wide, not measured; what the configurations show counts as soon as it
is wider."""


@dataclass(frozen=True)
class Assessment:
    """Verdict on one step time ratio between two runs, with interval and p-values.

    raw : ratio as measured; machine : factor taken out of it; ratio : raw / machine with an
        interval that holds for all ratios of the table together (Bonferroni).
    p_differs, p_equal : adjusted (Holm) for "beyond the margin" and "within the margin".
    """

    raw: float
    machine: float
    ratio: Interval
    p_differs: float
    p_equal: float
    verdict: Verdict


@dataclass(frozen=True)
class Evidence:
    """Log step time ratios (N,) without the machine's factor; that factor, errors and df."""

    effect: Floats
    machine: Floats
    error: Floats
    df: Floats


def remove_factor_shared_by_group(
    logs: Floats,
    own: Floats,
    groups: Sequence[str],
    prior: Prior = CONFIGURATION_NOISE,
    kernel: Floats | None = None,
    own_share: float = 1.0,
    subjects: Sequence[str] | None = None,
) -> Evidence:
    """Return log step time ratios less what all of a group share, with their standard errors.

    logs : (N,) measured; own : (N,) standard errors from inside the two runs.
    groups : (N,) which ratios share a machine factor: the sequence they were measured on.
    kernel : (N,) log ratios of a reference kernel, used where a group has too few configurations;
        NaN leaves nothing known of the configuration. None for a machine without such a factor.
    own_share : of the variance from inside the runs, what the scatter of configurations shows.
    subjects : (N,) what a change slows as a whole, such as a solver; each ratio its own if None.
        Those of an unknown one, "", are one subject, which no other is judged by.
    """
    labels = np.asarray(groups, dtype=np.str_)
    subject = np.asarray([*map(str, range(len(logs)))] if subjects is None else subjects)
    is_known = subject != ""
    # What unknown subjects share, a change or the machine, is no scatter around the known ones.
    apart = np.where(is_known, labels, np.char.add(labels, " of the unknown"))
    centre, error, df = np.zeros(len(logs)), np.empty(len(logs)), np.empty(len(logs))
    for i in range(len(logs)):
        # What a configuration is judged by must not come from its own subject: that one's slowdown
        # would count.
        keep, same = np.arange(len(logs)) != i, subject == subject[i]
        typical2 = float(np.median(own[keep] ** 2)) if keep.any() else 0.0
        places = np.where(same, np.char.add(labels, " of the subject"), apart)
        spread2, df[i] = _estimate_variance_and_freedom(
            logs[keep], places[keep], prior, own_share * typical2
        )
        # One value for each subject: of one that is measured often, a change is not the machine's.
        rest = ~same & is_known & (labels == labels[i])
        others = [np.median(logs[rest & (subject == one)]) for one in np.unique(subject[rest])]
        if len(others) >= MIN_OTHERS:
            centre[i] = np.median(others)
            unknown = spread2 * _MEDIAN_VARIANCE / len(others)
        else:
            known = 0.0 if kernel is None else float(kernel[i])
            unknown = MACHINE_NOISE.sd**2 if np.isfinite(known) else np.inf
            centre[i] = np.nan_to_num(known)
        error[i] = np.sqrt(spread2 + unknown + max(0.0, own[i] ** 2 - typical2))
    return Evidence(logs - centre, centre, error, df)


def remove_reference_factor(
    logs: Floats,
    own: Floats,
    groups: Sequence[str],
    reference: Ints,
    own_share: float = 1.0,
) -> Evidence:
    """Return log step time ratios less that of their group's reference solver, with errors.

    reference : (N,) index of the reference among the ratios; −1 leaves nothing known of the ratio.
    """
    labels, rows = np.asarray(groups), np.arange(len(logs))
    centre, error, df = np.zeros(len(logs)), np.empty(len(logs)), np.empty(len(logs))
    for i, at in enumerate(reference.tolist()):
        keep = (rows != i) & (rows != at)
        typical2 = float(np.median(own[keep] ** 2)) if keep.any() else 0.0
        spread2, df[i] = _estimate_variance_and_freedom(
            logs[keep], labels[keep], MACHINES_NOISE, own_share * typical2
        )
        centre[i] = logs[at] if at >= 0 else 0.0
        # The reference has noise of its own, as large as any other's.
        both2 = [max(0.0, own[j] ** 2 - typical2) for j in (i, at)]
        error[i] = np.sqrt(2.0 * spread2 + sum(both2)) if at >= 0 else np.inf
    return Evidence(logs - centre, centre, error, df)


def _estimate_variance_and_freedom(
    logs: Floats, labels: NDArray[np.str_], prior: Prior, inside2: float
) -> tuple[float, float]:
    """Return log time ratios' variance about their group's median, and its degrees of freedom.

    Moderation never makes it smaller than it is found: too quiet a prior would make claims.
    `inside2` is the variance that errors from inside the runs lead to expect beside the prior's.
    """
    expected = prior.sd**2 + inside2
    parts = [logs[labels == label] for label in np.unique(labels)]
    parts = [part for part in parts if len(part) >= 2]
    if not parts:
        return expected, prior.df
    rest = np.concatenate([part - np.median(part) for part in parts])
    n = len(rest)
    small = _MAD_SMALL[n - 2] if n - 2 < len(_MAD_SMALL) else n / (n - 0.8)
    sd = small * float(np.median(np.abs(rest)) / stats.norm.ppf(0.75))
    df = MAD_EFFICIENCY * (n - len(parts))
    variance = (prior.df * expected + df * sd**2) / (prior.df + df)
    return max(variance, sd**2), prior.df + df


def assess_time_ratios(evidence: Evidence, margin: float, alpha: float) -> list[Assessment]:
    """Return each step time ratio with verdict (slower, faster, equivalent, none) and p-values.

    "slower" and "faster" reject a ratio within the margin (at its least favourable point),
    "equivalent" one beyond it (two one-sided tests, Schuirmann 1987); each kind is one Holm family.
    """
    bound, size = np.log1p(margin), np.abs(evidence.effect)
    tail = stats.t(evidence.df)
    beyond = tail.sf((size - bound) / evidence.error) + tail.sf((size + bound) / evidence.error)
    differs = adjust_p_values_by_holm(np.minimum(1.0, beyond))
    equal = adjust_p_values_by_holm(tail.sf((bound - size) / evidence.error))
    reach = tail.isf(alpha / 2 / max(1, len(size))) * evidence.error
    verdicts: list[Assessment] = []
    for i, effect in enumerate(evidence.effect):
        verdict: Verdict = "no difference shown"
        if differs[i] <= alpha:
            verdict = "slower" if effect > 0 else "faster"
        elif equal[i] <= alpha:
            verdict = "equivalent"
        low, value, high = np.exp([effect - reach[i], effect, effect + reach[i]]).tolist()
        machine = float(np.exp(evidence.machine[i]))
        interval = Interval(value, low, high)
        chance = (float(differs[i]), float(equal[i]))
        verdicts.append(Assessment(value * machine, machine, interval, *chance, verdict))
    return verdicts
