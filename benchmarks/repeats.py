"""Count how often `dpbench compare` is wrong on repeated runs, with and without a change.

    python benchmarks/repeats.py OUT [--runs 10] [--slowed-by 0.15]

makes N + 1 runs of `repeats.toml` as they are and N with `slowed_daqp` slowed, in turn, each in a
process of its own, then compares every run as it is with the next one, and with the slowed run
between the two. It prints each claim and the counts; exit 1 when more than 1 of 10 tables without a
change holds a claim, or a slowed configuration is not found. An interrupted call goes on where it
stopped.
"""

import argparse
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

from rich.progress import track

from dpbench import Comparison, compare, load_results
from dpbench.errors import DpbenchError

HERE = Path(__file__).parent
PLANTED = "slowed_daqp"
RUN = (
    "import sys; from dpbench import run_campaign; "
    "run_campaign(sys.argv[1], sys.argv[2], solver_module=sys.argv[3])"
)


def main() -> int:
    """Run, compare, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--runs", type=int, default=10, help="repeats of either kind (10)")
    parser.add_argument("--slowed-by", type=float, default=0.15, help="planted share (0.15)")
    asked = parser.parse_args()
    runs = [("plain", r, 0.0) for r in range(asked.runs + 1)]
    runs += [("slowed", r, asked.slowed_by) for r in range(asked.runs)]
    runs.sort(key=lambda run: (run[1], run[0]))
    for kind, r, share in track(runs, description="runs"):
        _run(asked.out / f"{kind}-{r}", share)
    plain = [asked.out / f"plain-{r}" for r in range(asked.runs + 1)]
    print("without a change")
    false = sum(_claims(compare(*pair)) > 0 for pair in pairwise(plain))
    print(f"with {PLANTED} slowed by {asked.slowed_by:g}")
    planted = [compare(plain[r], asked.out / f"slowed-{r}") for r in range(asked.runs)]
    beside = sum(_claims(found, but=PLANTED) > 0 for found in planted)
    configurations = [f["verdict"] for found in planted for _, f in _planted(found).iterrows()]
    hit = sum((_planted(found)["verdict"] == "slower").any() for found in planted)
    print(f"tables without a change that hold a claim: {false} of {asked.runs}")
    print(f"tables with the change: found in {hit} of {asked.runs}, ", end="")
    print(
        f"{configurations.count('slower')} of its {len(configurations)} configurations; a claim "
        f"beside it in {beside}"
    )
    return int(false > 0.1 * asked.runs or hit < asked.runs)


def _run(out: Path, share: float) -> None:
    """One run in a process of its own, unless it is there."""
    try:
        load_results(out)
    except DpbenchError:
        arguments = (str(HERE / "repeats.toml"), str(out), str(HERE / f"{PLANTED}.py"))
        environment = os.environ | {"DPBENCH_SLOWED_BY": str(share)}
        subprocess.run([sys.executable, "-c", RUN, *arguments], env=environment, check=True)


def _planted(found: Comparison):  # type: ignore[no-untyped-def] # a DataFrame, outside mypy's files
    return found.times[found.times["solver"] == PLANTED]


def _claims(found: Comparison, but: str = "") -> int:
    """Print the claims of a table on step times and count those on other solvers than `but`."""
    times = found.times
    claims = times[times["verdict"].isin(["slower", "faster"])]
    for _, row in claims.iterrows():
        interval = f"[{row['low']:.3f}, {row['high']:.3f}]"
        print(f"  {row['solver']} {row['policy']}: {row['verdict']} {row['ratio']:.3f} {interval}")
    together = [s.assessment.verdict for s in found.shared if s.assessment is not None]
    for shared in found.shared:
        print(f"  all configurations {shared.factor:.3f}, reference kernel {shared.kernel:.3f}")
    shared_claims = sum(verdict in ("slower", "faster") for verdict in together)
    return int((claims["solver"] != but).sum()) + shared_claims


if __name__ == "__main__":
    raise SystemExit(main())
