"""Text on the thrust that a closed loop uses after a loss, as a share of what is left."""

import numpy as np

from dpbench.analysis.records.records import Records
from dpbench.analysis.records.run_record import RunRecord
from dpbench.mpc.thruster_rows import RAMP_DOWN_SHARE
from dpbench.report.ship.ship_text import list_losses

TAIL_S = 60.0
"""End of a run over which the used thrust is averaged [s]."""


def describe_thrust_after_loss(records: Records, run: RunRecord) -> str:
    """Return words on the share of the remaining thrust that a closed loop uses after its losses.

    The sum of all forces over the largest ones of the thrusters that are left, from when the lost
    ones give no force. "" for a run without commanded thrusters, losses or recorded steps.
    """
    end_s = run.steps_done * run.sample_s
    losses = [(at_s, names) for at_s, names in list_losses(run) if at_s < end_s]
    scenario = records.build_scenario(run.scenario)
    control = None if scenario is None else scenario.controller.commanded_thrusters
    if not losses or scenario is None or control is None or not run.has_steps:
        return ""
    thrusters, most_N = control.thrusters, control.thrusters.largest_thrusts_N
    lost = set[int]().union(
        *(
            thrusters.find_indices_of_thrusters_or_groups(names, scenario.name, "faults.lost")
            for _, names in losses
        )
    )
    faults = scenario.files["scenario"]["faults"]
    is_ramped = any(fault.get("loss", "ramp_down") != "trip" for fault in faults)
    rise_s = max((thrusters.thrusters[i].rise_s for i in lost), default=0.0)
    begin_s = max(at_s for at_s, _ in losses) + is_ramped * rise_s / RAMP_DOWN_SHARE
    left = [i for i in range(len(most_N)) if i not in lost]
    steps = records.read_counting_step_table(run, ("k", "thrust_share"))
    t_s = steps["k"].to_numpy() * run.sample_s
    share = steps["thrust_share"].to_numpy()[t_s >= begin_s]
    if not left or not len(share) or not np.isfinite(share).all():
        return ""
    share = share * most_N.sum() / most_N[left].sum()
    tail = share[-max(1, round(TAIL_S / run.sample_s)) :]
    return (
        f"{100.0 * share.max():.0f} % of the remaining thrust at most, {100.0 * tail.mean():.0f} % "
        f"on average in the last {len(tail) * run.sample_s:.0f} s"
    )
