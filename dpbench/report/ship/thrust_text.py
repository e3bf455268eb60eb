"""Text on the use of each thruster in the reference loop of a ship."""

from collections.abc import Iterator, Sequence

from dpbench.analysis.records.run_record import ThrusterUse
from dpbench.analysis.verdict.ship_results import ShipResult
from dpbench.bench.capability.utilisation import ThrusterReach
from dpbench.report.formats import Table, join_with_and
from dpbench.scenario.scenario import build_scenario_from_documents
from dpbench.ship.characteristics import compute_mean_weather_force

MOSTLY = 0.5
"""Share of steps from which on a thruster is named as being at a limit."""
NEARLY_ALL = 0.9
"""Share of the thrust in use at one time from which on little is left."""
NOTICED = 0.1
"""Share of steps at the rate limit from which on it is named where no other limit is."""
AT_LIMIT = "at a limit of thrust or sector"


def describe_thrust_used(use: ThrusterUse) -> str:
    """Return words on the share of the thrust left that a reference loop uses."""
    mean, most = (f"{100.0 * share:.0f} %" for share in use.thrust)
    return f"{most} of the {_name_remaining(use)}thrust at most, {mean} on average"


def _name_remaining(use: ThrusterUse) -> str:
    """Return "remaining " where the window of a use begins at a loss; "" elsewhere."""
    return "remaining " * (use.window_s[0] > 0.0)


def explain_departure(ship: ShipResult) -> str:
    """Return sentences on the thrusters' limits until a ship leaves; "" without thrusters."""
    use = ship.thruster_use
    if use is None or ship.run.scenario_documents is None:
        return ""
    begin_s, end_s = use.window_s
    used = (
        f"From {begin_s:.0f} to {end_s:.0f} s in `{ship.name}`, it uses {describe_thrust_used(use)}"
    )
    busy = [
        f"`{name}` in {100.0 * limit:.0f} % of the steps"
        for name, (_, _, limit, _) in use.thrusters.items()
        if limit >= MOSTLY
    ]
    if busy:
        return f"{used}; {AT_LIMIT}: {join_with_and(busy)}."
    rates = {name: rate for name, (*_, rate) in use.thrusters.items()}
    fastest = max(rates, key=rates.__getitem__, default="")
    at_rate = ""
    if rates and rates[fastest] >= NOTICED:
        at_rate = f", but `{fastest}` is at its rate limit in {100.0 * rates[fastest]:.0f} %"
    ramp_s = _read_ramp_s(ship)
    if begin_s == 0.0 and end_s < ramp_s:
        return f"{used}. The weather still rises then (ramp_s = {ramp_s:g}): no cause is found."
    reason = "cannot balance the mean load in all axes at once"
    if _is_mean_load_balanced(ship, use):
        is_near = use.thrust[1] >= NEARLY_ALL
        reserve = "with little thrust left for its variation"
        reason = f"balance the mean load, {reserve if is_near else 'but the loop does not settle'}"
    return (
        f"{used}. No thruster is {AT_LIMIT} in most steps{at_rate}: the {_name_remaining(use)}"
        f"thrusters {reason}."
    )


def _read_ramp_s(ship: ShipResult) -> float:
    """Return the time over which the weather of a ship's scenario rises [s]; 0 if unknown."""
    environment = ship.run.files["scenario"].get("environment") or {}
    return float(environment.get("ramp_s", 0.0))


def _is_mean_load_balanced(ship: ShipResult, use: ThrusterUse) -> bool:
    """Return whether the thrusters left, in their half turns, make the mean force of weather."""
    scenario = build_scenario_from_documents(ship.run.files)
    vessel, heading_rad = scenario.vessel, float(scenario.reference[2])
    assert vessel.thrusters is not None, "as they are used"
    names = [one.name for one in vessel.thrusters.thrusters]
    lost = [i for i, name in enumerate(names) if name not in use.thrusters]
    load = compute_mean_weather_force(vessel, scenario.environment, heading_rad)
    reach = ThrusterReach(vessel.thrusters.copy_with_convex_sectors())
    return reach.find_least_thrust_share(-load, lost) <= 1.0


def list_thruster_uses(ships: Sequence[ShipResult]) -> Iterator[str]:
    """Yield a line on each thruster's use in each scenario outside of studies."""
    for ship in ships:
        if ship.run.study or (use := ship.thruster_use) is None:
            continue
        parts = [
            f"{name} {100.0 * mean:.0f} / {100.0 * most:.0f} % ({100.0 * limit:.0f} %)"
            for name, (mean, most, limit, _) in use.thrusters.items()
        ]
        begin_s, end_s = use.window_s
        yield f"{ship.name}, {begin_s:.0f} to {end_s:.0f} s: {', '.join(parts)}"


def tabulate_thruster_use(ships: Sequence[ShipResult]) -> Table | None:
    """Return a table of each thruster's use in the reference loops; None without thrusters."""
    rows = [
        {
            "scenario": ship.name,
            "period [s]": f"{use.window_s[0]:.0f} to {use.window_s[1]:.0f}",
            "thruster": name,
            "mean thrust [%]": f"{100.0 * mean:.0f}",
            "peak thrust [%]": f"{100.0 * most:.0f}",
            "steps at a limit [%]": f"{100.0 * limit:.0f}",
            "steps at the thrust rate limit [%]": f"{100.0 * rate:.0f}",
        }
        for ship in ships
        if not ship.run.study and (use := ship.thruster_use) is not None
        for name, (mean, most, limit, rate) in use.thrusters.items()
    ]
    note = (
        "Thrust is the commanded thrust, in percent of the thruster's maximum ahead thrust. A "
        "limit is the thrust limit or, for an azimuth thruster, the limit of its sector. The "
        "period begins at the last loss of a thruster, or at the start if there is none. It ends "
        "when the ship leaves its station, or at the end of the run. Lost thrusters are left out."
    )
    title = "Use of each thruster in the reference loop"
    return Table.from_rows(rows, title, note=note, text_columns=3, folded=True) if rows else None
