"""Draw pictures of the guides and tutorials: `python docs/pictures/draw.py NAME [PATH ...]`.

`README.md` has the command for each picture.
"""

import io
import json
import re
import runpy
import sys
import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from xml.sax.saxutils import escape

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from dpbench import compare, open_workspace, replay, run_closed_loop
from dpbench.report.charts import style
from dpbench.report.charts.render import render_svg
from dpbench.report.charts.study import draw_effects
from dpbench.report.compare.page import draw_ratios, make_ratio_table
from dpbench.scenario.scenario import load_vessel
from dpbench.scenario.tables.vessel_file import CapabilityTable
from dpbench.ship.vessel import HullDrag, Vessel
from dpbench.ship.weather import Windage

FOLDER = Path(__file__).parent
WIDTH, PAD = 900, 12
matplotlib.rcParams.update(
    {
        "svg.fonttype": "none",
        "svg.hashsalt": "dpbench",
        "font.family": "sans-serif",
        "font.size": 11,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.color": style.GRID,
        "axes.edgecolor": style.SOFT,
    }
)


def slim(svg: str, digits: int = 1) -> str:
    """Return an SVG without labels for screen readers, empty groups and needless digits."""

    def shorten(number: re.Match[str]) -> str:
        text = f"{float(number[0]):.{digits}f}".rstrip("0").rstrip(".")
        return "0" if text in ("", "-0") else text

    svg = re.sub(
        r"<\?xml.*?\?>|<!DOCTYPE.*?>|<!--.*?-->|<metadata>.*?</metadata>", "", svg, flags=re.S
    )
    svg = re.sub(r' (aria-[a-z]+|role|class|pointer-events|stroke-miterlimit)="[^"]*"', "", svg)
    svg = re.sub(r"<[^>]*>", lambda tag: re.sub(r"-?\d+\.\d{2,}", shorten, tag[0]), svg)
    svg = re.sub(r'<path[^>]*d="M0,0h0v0h0Z"[^>]*?(/>|></path>)', "", svg)
    before = ""
    while before != svg:
        before, svg = svg, re.sub(r"<g[^>]*></g>|<g[^>]*/>", "", svg)
    svg = re.sub(r"></(path|rect|line|circle|use)>", "/>", svg)
    return re.sub(r">\s+<", "><", svg).strip()


def join(svgs: Sequence[str], gap: float = 20.0, scale: float = 0.0) -> str:
    """Return SVGs side by side on a white canvas; scaled to its width without a scale."""
    drawn = [slim(svg) for svg in svgs]
    sizes = []
    for svg in drawn:
        box = re.search(r'viewBox="([^"]+)"', svg)
        assert box, "every renderer writes a viewBox"
        sizes.append([float(value) for value in box[1].split()[2:]])
    across = sum(width for width, _ in sizes) + gap * (len(sizes) - 1)
    scale = scale or (WIDTH - 2 * PAD) / across
    height = scale * max(height for _, height in sizes) + 2 * PAD
    left, parts = 0.5 * (WIDTH - scale * across), []
    for svg, (width, own) in zip(drawn, sizes, strict=True):
        body = re.sub(r"^.*?<svg[^>]*>", "", svg, count=1, flags=re.S).rsplit("</svg>", 1)[0]
        top = 0.5 * (height - scale * own)
        parts.append(
            f'<g transform="translate({left:.1f},{top:.1f}) scale({scale:.4f})">{body}</g>'
        )
        left += scale * (width + gap)
    return _canvas(height, "".join(parts), 'xmlns:xlink="http://www.w3.org/1999/xlink"')


def _canvas(height: float, body: str, spaces: str = "") -> str:
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {spaces} width="{WIDTH}" height="{height:.0f}"'
    paper = '<rect width="100%" height="100%" fill="#fff"/>'
    return f'{head} viewBox="0 0 {WIDTH} {height:.0f}">{paper}{body}</svg>'


def to_svg(figure: Figure, inches: tuple[float, float] | None = None) -> str:
    """Return a Matplotlib figure as SVG, without date and program; in another size if given."""
    if inches:
        figure.set_size_inches(inches)
    text = io.StringIO()
    figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    return text.getvalue()


def save(svg: str, name: str) -> None:
    """Write an SVG, or its pixels with a palette if the SVG would be too large."""
    if len(svg.encode()) < 60_000:
        (FOLDER / f"{name}.svg").write_text(svg + "\n", encoding="utf-8")
        return
    # The libraries of the page's figures, and one that Matplotlib installs.
    import vl_convert
    from PIL import Image

    pixels = Image.open(io.BytesIO(vl_convert.svg_to_png(svg))).convert("RGB")
    pixels.quantize(48, dither=Image.Dither.NONE).save(FOLDER / f"{name}.png", optimize=True)


def draw_layout(ship: Vessel) -> str:
    """Return the hull from above, ahead is up, with its thrusters by failure group."""
    assert ship.thrusters
    half = 0.5 * ship.length_m
    beam = 0.5 * (ship.capability.breadth_m if ship.capability else 0.22 * ship.length_m)
    figure = Figure((4.4, 4.9), layout="constrained")
    axes = figure.subplots()
    axes.set_axis_off()
    hull = [(-beam, -half), (-beam, 0.45 * half), (-0.55 * beam, 0.8 * half), (0, half)]
    hull += [(-east, north) for east, north in hull[-2::-1]]
    axes.fill(*zip(*hull, strict=True), facecolor="#f3f5f7", edgecolor=style.SOFT, linewidth=1.2)
    groups = sorted({thruster.group for thruster in ship.thrusters.thrusters} - {""})
    hues = {"": style.PALETTE[3]} | dict(zip(groups, style.PALETTE[1:], strict=False))
    longest = max(thruster.thrust_N for thruster in ship.thrusters.thrusters)
    placed: dict[float, list[float]] = {1.0: [], -1.0: []}
    for thruster in sorted(ship.thrusters.thrusters, key=lambda one: -one.x_m):
        hue, reach = hues[thruster.group], 7.0 * thruster.thrust_N / longest
        east, north = thruster.y_m, thruster.x_m
        if thruster.kind == "azimuth":
            turn = np.linspace(0.0, 2.0 * np.pi, 60)
            axes.fill(
                east + reach * np.cos(turn), north + reach * np.sin(turn), color=hue, alpha=0.2
            )
            axes.plot(east, north, "o", color=hue, markersize=5)
        else:
            step = (0.0, reach) if thruster.kind == "main" else (reach, 0.0)
            look = {"arrowstyle": "<->", "color": hue, "linewidth": 2.0}
            ends = (east - step[0], north - step[1]), (east + step[0], north + step[1])
            axes.annotate("", ends[0], ends[1], arrowprops=look)
        side = 1.0 if east > 0.0 or (east == 0.0 and thruster.kind == "azimuth") else -1.0
        taken = placed[side]
        level = min([north, *(other - 0.27 * half for other in taken)])
        taken.append(level)
        group = f", {thruster.group}" if thruster.group else ""
        text = f"{thruster.name}\n{thruster.thrust_N / 1e3:.0f} kN{group}"
        look = {
            "color": hue,
            "fontsize": 11.5,
            "va": "center",
            "ha": "left" if side > 0 else "right",
        }
        axes.text(side * (beam + 4.0), level, text, **look)
    axes.set(xlim=(-beam - 38.0, beam + 38.0), ylim=(-half - 12.0, half + 4.0))
    axes.set_aspect("equal")
    return to_svg(figure)


def draw_rose_and_layout(name: str, rose: str, vessel: str) -> None:
    """Draw a capability plot and the thrusters that make it."""
    save(join([Path(rose).read_text(encoding="utf-8"), draw_layout(load_vessel(vessel))]), name)


def draw_file(name: str, path: str) -> None:
    """Draw a figure of the product in the middle of the canvas."""
    save(join([Path(path).read_text(encoding="utf-8")], scale=1.3), name)


def draw_comment(name: str, path: str) -> None:
    """Draw a pull-request comment from its Markdown: a title, sentences and one table."""
    text = re.sub(r"[*`\\]", "", Path(path).read_text(encoding="utf-8"))
    top, parts, widths = 66, list[str](), ((24, 34), (300, 14), (420, 6), (480, 62))

    def put(x: float, words: str, look: str = "") -> None:
        parts.append(f'<text x="{x}" y="{top}"{look}>{escape(words)}</text>')

    for line in filter(None, text.splitlines()):
        if line.startswith("| :"):
            continue
        bold = ' font-weight="600"' if top == 66 or line.startswith("| benchmark") else ""
        if not line.startswith("|"):
            for part in textwrap.wrap(line, 125):
                put(24, part, bold)
                top += 20
            top += 8
            continue
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        start, ends = top, []
        parts.append(f'<path d="M24,{start - 18}H876" stroke="#d0d7de"/>')
        for (x, width), cell in zip(widths, cells, strict=True):
            top = start
            for part in textwrap.wrap(cell.replace("::", ":: "), width):
                put(x, part.replace(":: ", "::"), bold)
                top += 18
            ends.append(top)
        top = max(ends) + 10
    frame = (
        f'<rect x="8" y="8" width="884" height="{top - 12}" rx="8" fill="none" stroke="#d0d7de"/>'
    )
    head = '<path d="M8,40V16a8,8 0 0 1 8,-8H884a8,8 0 0 1 8,8V40z" fill="#eaf2f8"/>'
    head += '<text x="24" y="30" fill="#57606a">Comment on the pull request</text>'
    font = '<g font-family="Helvetica,Arial,sans-serif" font-size="13.5" fill="#1f2328">'
    save(_canvas(top + 4, f"{frame}{font}{head}{''.join(parts)}</g>"), name)


def draw_drag(name: str, ship_name: str = "supply_fs99") -> None:
    """Draw the force that holds a ship in a current abeam, linear and by cross flow."""
    ship = load_vessel(ship_name)
    hull = load_vessel("supply_fs99").drag or _drag_of_page(ship)
    speeds = np.linspace(0.0, 1.5, 151)
    linear = ship.D[1, 1] * speeds
    mixed = [hull.compute_drag_force(ship.D, np.array([0.0, v, 0.0]))[1] for v in speeds]
    figure = Figure((9.0, 3.8), layout="constrained")
    axes = figure.subplots()
    axes.plot(
        speeds, linear / 1e3, "--", color=style.PALETTE[1], label="linear damping D v (paper)"
    )
    axes.plot(speeds, np.array(mixed) / 1e3, color=style.PALETTE[0], label="cross-flow drag")
    axes.axvline(0.5, color=style.SOFT, linewidth=0.8)
    at = [linear[50] / 1e3, mixed[50] / 1e3]
    axes.plot([0.5, 0.5], at, "o", color=style.INK, markersize=4)
    for force in at:
        axes.annotate(f"{force:.3g} kN", (0.5, force), (6, -12), textcoords="offset points")
    axes.set(xlabel="current abeam [m/s]", ylabel="force [kN]", xlim=(0, 1.5), ylim=(0, None))
    axes.legend(frameon=False, loc="upper left")
    save(join([to_svg(figure)]), name)


def _drag_of_page(ship: Vessel) -> HullDrag:
    """Return the drag of `supply_fs99` with the breadth and draught that the page gives it."""
    table = CapabilityTable(breadth_m=18.0, draught_m=5.0)
    return HullDrag.from_hull(table.build_capability_hull(ship.length_m, Windage(1.0, 1.0)))


def draw_forces(name: str, exported: str, vessel: str) -> None:
    """Draw each thruster's planned force over time, from QPs of `dpbench export`."""
    thrusters = load_vessel(vessel).thrusters
    assert thrusters
    with np.load(exported, allow_pickle=False) as stored:
        sample_s = float(json.loads(str(stored["meta"]))["sample_s"])
        block = int(stored["block"])
        forces = np.cumsum((stored["z"] * stored["unit_z"])[:, :block], axis=0)
    figure = Figure((9.0, 4.0), layout="constrained")
    axes, at, time = figure.subplots(), 0, np.arange(len(forces)) * sample_s
    for i, thruster in enumerate(thrusters.thrusters):
        count = 2 if thruster.kind == "azimuth" else 1
        share = np.linalg.norm(forces[:, at : at + count], axis=1) / thruster.thrust_N
        at += count
        label = f"{thruster.name}{', ' + thruster.group if thruster.group else ''}"
        dash = "--" if thruster.group == "board A" else "-"
        axes.plot(time, 100.0 * share, dash, color=style.PALETTE[i], label=label, linewidth=1.6)
    axes.set(xlabel="time [s]", ylabel="force [% of the largest]", ylim=(0, 105))
    axes.set(xlim=(0, time[-1]))
    figure.legend(loc="outside lower center", ncols=5, frameon=False, fontsize=9.5)
    save(join([to_svg(figure)]), name)


def draw_active_limits(name: str, *files: str) -> None:
    """Draw which limits are active at each QP of stored sequences."""
    figure = Figure((9.0, 3.9), layout="constrained")
    for axes, file in zip(figure.subplots(1, len(files)), map(Path, files), strict=True):
        with np.load(file, allow_pickle=False) as stored:
            meta, active, rows = json.loads(str(stored["meta"])), stored["active"], len(stored["A"])
        step_s = meta["sample_s"] * meta["every"]
        for sign, hue, side in ((1, style.PALETTE[1], "upper"), (-1, style.PALETTE[0], "lower")):
            step, limit = np.nonzero(active == sign)
            look = {"color": hue, "markersize": 3.0, "label": f"{side} limit active"}
            axes.plot(step_s * step, limit + 1, "s", **look)
        axes.axhline(rows + 0.5, color=style.SOFT, linewidth=0.8)
        limits = f"limit: {rows} rows, then {active.shape[1] - rows} bounds"
        axes.set(title=file.stem, xlabel="time in the recorded loop [s]", ylabel=limits)
        axes.set(xlim=(0, step_s * len(active)), ylim=(active.shape[1] + 1, 0))
    entries = axes.get_legend_handles_labels()
    figure.legend(*entries, loc="outside lower center", ncols=2, frameon=False)
    save(join([to_svg(figure)]), name)


def draw_loop(name: str, scenario: str) -> None:
    """Draw errors and forces of a ship in a closed loop with DAQP."""
    run = run_closed_loop(scenario, "daqp")
    parts = [run.plot.errors(backend="matplotlib"), run.plot.forces(backend="matplotlib")]
    save(join([to_svg(part, (4.2, 3.6)) for part in parts], gap=10.0), name)


def draw_replays(name: str, sequence: str, *solvers: str) -> None:
    """Draw steps of replays together; a solver is `NAME:POLICY:PRESET`, or a plug-in's file."""
    runs = []
    for solver in solvers:
        known, policy, preset, *_ = [*solver.split(":"), "", ""]
        if known.endswith(".py"):
            workspace = runpy.run_path(known)["open"](policy or "fresh", {})
        else:
            workspace = open_workspace(
                known, policy=policy or "fresh", settings=preset or "default"
            )
        runs.append(replay(sequence, workspace, repeats=3))
    figure = runs[0].plot.steps(*runs[1:], backend="matplotlib")
    save(join([to_svg(figure, (6.0, 3.6))]), name)


def draw_signals(name: str, script: str) -> None:
    """Draw the signals of the loops that a tutorial's script runs."""
    loops = runpy.run_path(script)["loops"]
    figure = loops[0].plot.signals(*loops[1:], backend="matplotlib")
    save(join([to_svg(figure, (6.0, 3.4))]), name)


def draw_comparison(name: str, a: str, b: str, sequence: str) -> None:
    """Draw the ratios of step times of two result folders, of default settings on a sequence."""
    found = compare(a, b)
    table = make_ratio_table(found.compared)
    label = table["name"].str.removesuffix(f", {sequence}")
    kept = (table["sequence"] == sequence) & ~label.str.contains(r"high|low|mid|fresh|reuse")
    table = table.assign(name=label)[kept]
    save(join([render_svg(draw_ratios(table, found.margin), titled=False)]), name)


def draw_study(name: str, folder: str) -> None:
    """Draw the effect of each factor on the radial error, and the excess error of solvers."""
    effects = pd.read_csv(Path(folder, "tables", "study_effects.csv"))
    effects = effects[effects["measure"] == "95 % radial error"]
    keys = effects["factor"].str.replace(r"[a-z]+\.(?:[a-z]+\.)*", "", regex=True)
    rows = pd.DataFrame(
        {
            "measure": "change of the 95 % radial error [" + effects["unit"] + "]",
            "effect": keys + ": " + effects["levels"],
            "configuration": effects["configuration"],
            "value": effects["effect"],
            "low": effects["low"],
            "high": effects["high"],
        }
    )
    names = ["daqp", "osqp (1e-1)"]
    chart = draw_effects(rows[rows["configuration"].isin(names)], "Effect of each factor", names)
    excess = Path(folder, "figures", f"study-excess-{effects['study'].iloc[0]}.svg")
    save(join([render_svg(chart), excess.read_text(encoding="utf-8")]), name)


def draw_fmu(name: str, folder: str) -> None:
    """Draw the loop of `paper` with its ship, and with an FMU of it that is built in a folder."""
    from tests.scenario.plants.fmus import build_ship_fmu, write_scenario

    Path(folder).mkdir(parents=True, exist_ok=True)
    fmu = build_ship_fmu(Path(folder).resolve(), 2)
    cases = {
        "dpbench's ship": "paper",
        "the same ship as an FMU": write_scenario(fmu.parent, str(fmu)),
    }
    figure = Figure((7.5, 3.3), layout="constrained")
    panels = figure.subplots(1, 2)
    looks = ({"linewidth": 4.0, "alpha": 0.35}, {"linewidth": 1.2, "linestyle": "--"})
    for (label, case), look in zip(cases.items(), looks, strict=True):
        steps = run_closed_loop(case, "daqp", steps=300).steps
        panels[0].plot(steps["e_m"], steps["n_m"], label=label, **look)
        panels[1].plot(steps["t_s"], steps["tau_y_N"] / 1e3, **look)
    panels[0].set(xlabel="east [m]", ylabel="north [m]", aspect="equal")
    panels[1].set(xlabel="time [s]", ylabel="sway force [kN]")
    figure.legend(loc="outside lower center", ncols=2, frameon=False)
    save(join([to_svg(figure)]), name)


DRAWERS: dict[str, Callable[..., None]] = {
    "add-a-solver": draw_replays,
    "capability": draw_rose_and_layout,
    "ci": draw_comment,
    "compare": draw_comparison,
    "drag": draw_drag,
    "fmu": draw_fmu,
    "own-plant": draw_signals,
    "own-ship": draw_loop,
    "own-thrusters": draw_rose_and_layout,
    "python": draw_replays,
    "sequences": draw_active_limits,
    "studies": draw_study,
    "test-your-solver": draw_replays,
    "thrusters": draw_forces,
    "your-ship": draw_loop,
}

if __name__ == "__main__":
    DRAWERS.get(sys.argv[1], draw_file)(*sys.argv[1:])
