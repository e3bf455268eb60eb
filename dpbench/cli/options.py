"""The options of each command, in groups; an option is named as the parameter it is for."""

import argparse
from collections.abc import Callable
from functools import partial
from typing import Any

Command = Any  # A parser of a command, or a group of its arguments
_AGAIN = "repeatable"
_PRESETS = "default (the solver library's own), low (tolerance about 1e-3), mid (1e-6), high (1e-9)"
_RANDOM = "random_mpc-STATES-INPUTS-HORIZON (QPs of a random MPC problem)"


def _option(group: Command, name: str, value: str, meaning: str, **keywords: Any) -> None:
    """Add an option with the name of its value and its help to a command or a group of it."""
    group.add_argument(name, metavar=value, help=meaning, **keywords)


def _repeated(group: Command, name: str, value: str, meaning: str, **keywords: Any) -> None:
    """Add an option that may be given several times to a command or a group of it."""
    _option(group, name, value, f"{meaning}; {_AGAIN}", action="append", **keywords)


def _flag(group: Command, name: str, meaning: str, **keywords: Any) -> None:
    """Add an option without a value to a command or a group of it."""
    group.add_argument(name, action="store_true", help=meaning, **keywords)


def _add_module_option(group: Command) -> None:
    """Add the option that loads a plug-in with a solver."""
    _repeated(group, "--solver-module", "FILE.py", "load a plug-in that provides a solver")


def add_run_options(run: Command) -> None:
    """Add the options of `dpbench run` to its parser."""
    _add_suite_options(run)
    engine = run.add_argument_group("execution")
    _add_execution_options(engine)
    _option(
        engine,
        "--engine",
        "ENGINE",
        "where to run: local (processes on this machine; default) or dask (Dask workers)",
        default="local",
    )
    scheduler = (
        "with --engine dask: address of a Dask scheduler (default: start workers on this machine)"
    )
    _option(engine, "--scheduler", "ADDRESS", scheduler)
    tls = "PEM files for a scheduler at tls://HOST:PORT (default: Dask's configuration)"
    engine.add_argument("--tls", nargs=3, metavar=("CA", "CERT", "KEY"), help=tls)
    estimate = "print the number of cells and an estimate of the time and disk use, then exit"
    _flag(engine, "--dry-run", estimate)
    output = run.add_argument_group("output")
    folder = (
        "result folder (default: results/SUITE or results/sequence-NAME, plus -part if only some "
        "cells or steps are selected)"
    )
    _option(output, "--out", "DIR", folder)
    add_ending_options(output)


def _add_suite_options(run: Command) -> None:
    """Add the options that select the runs of a suite to a command's parser."""
    suite = "name of a suite, or a TOML file; give either SUITE or --sequence"
    run.add_argument("suite", nargs="?", metavar="SUITE", help=suite)
    choice = run.add_argument_group("selection")
    sequence = (
        "instead of running a suite, replay this sequence of recorded QPs: its name, file (.npz, "
        ".json or .mat) or folder"
    )
    _option(choice, "--sequence", "SEQUENCE", sequence)
    solver = (
        "run only this solver, such as osqp; 'osqp[rho=[0.1,1]]' runs it twice, with rho = 0.1 and "
        "with rho = 1"
    )
    _repeated(choice, "--solver", "SOLVER", solver, dest="solvers")
    scenario = "run only this scenario, given by name or TOML file; it need not be in the suite"
    _repeated(choice, "--scenario", "SCENARIO", scenario, dest="scenarios")
    settings = (
        f"use only these settings: {_PRESETS}, a tolerance such as 1e-4, or a name in the suite"
    )
    _repeated(choice, "--settings", "NAME", settings)
    route = (
        "interface through which solvers are called: native (the solver library's own), qpsolvers "
        "(the Python package) or default (qpsolvers where available, otherwise native); overrides "
        "the suite"
    )
    _repeated(choice, "--route", "ROUTE", route, dest="routes")
    policy = (
        "what a solver keeps between steps: fresh (nothing), reuse (its workspace) or warm "
        "(workspace and last solution); overrides the suite"
    )
    _repeated(choice, "--policy", "POLICY", policy, dest="policies")
    steps = (
        "stop each closed loop and each replay of a scenario after N steps; recorded sequences are "
        "replayed in full"
    )
    _option(choice, "--steps", "N", steps, type=int)
    _add_module_option(choice)


def _add_execution_options(group: Command) -> None:
    """Add the options on parallel runs, resumption and waiting to a group of a command."""
    jobs = (
        "number of cells to run in parallel (default: one per core); replays that measure solve "
        "times always run one at a time; a cell is one run: a solver with its settings, route and "
        "policy in one scenario or on one sequence"
    )
    _option(group, "--jobs", "N", jobs, type=int)
    _flag(group, "--fresh", "run finished cells again; not related to --policy fresh")
    _add_wait_options(group)


def _add_wait_options(group: Command) -> None:
    """Add the options on how long to wait for another campaign to a command or a group of it."""
    wait = group.add_mutually_exclusive_group()
    longest = "longest wait while another dpbench command is using this machine (default: no limit)"
    _option(wait, "--wait", "SECONDS", longest, type=float, dest="wait_s")
    never = "exit with 2 if another dpbench command is using this machine"
    wait.add_argument("--no-wait", action="store_const", const=0.0, dest="wait_s", help=never)


def add_cells_options(cells: Command) -> None:
    """Add the options of `dpbench cells`, which runs one shard, to its parser."""
    _add_suite_options(cells)
    engine = cells.add_argument_group("execution")
    _option(engine, "--shard", "I/N", "shard to run, such as 2/8 (default: 1/1)", default="1/1")
    _add_execution_options(engine)
    output = cells.add_argument_group("output")
    _option(output, "--out", "DIR", "folder for this shard only", required=True)


def add_gather_options(gather: Command) -> None:
    """Add the options of `dpbench gather`, which joins shards, to its parser."""
    gather.add_argument("folders", metavar="DIR", nargs="+", help="folders of all shards")
    _option(gather, "--suite", "FILE", "path of the suite file, if it has moved")
    _repeated(gather, "--solver-module", "FILE.py", "plug-in that the shards were run with")
    output = gather.add_argument_group("output")
    _option(output, "--out", "DIR", "result folder", required=True)
    add_ending_options(output)


def add_ending_options(group: Command) -> None:
    """Add the options on what a command prints at its end, and exits with, to a group of it."""
    _flag(group, "--open", "open the report in a browser")
    _flag(group, "--json", "print the result as JSON")
    _flag(group, "--quiet", "print only the path of the report")
    strict = (
        "exit with 1 if a ship does not stay on station (5 m, 5°) in a closed loop although its "
        "QPs are solved exactly"
    )
    _flag(group, "--strict", strict)


def add_report_options(report: Command) -> None:
    """Add the options of `dpbench report` to its parser."""
    folder = "result folder of `dpbench run` or `dpbench gather`"
    report.add_argument("dir", metavar="DIR", help=folder)
    baseline = (
        "compare the recommended solver with this one (default: the baseline of the suite; if the "
        "suite has none, a faster passing solver that is not available as compiled code; if there "
        "is none, the next-fastest passing solver)"
    )
    _option(report, "--baseline", "SOLVER", baseline)
    more = report.add_argument_group("further documents")
    formats = "also write the figures as svg, pdf or png"
    _repeated(more, "--figures", "FORMAT", formats, default=[])
    statement = (
        "write a statement for a classification society on the recommended solver (.pdf or .svg)"
    )
    _option(more, "--statement", "FILE", statement)
    comment = (
        "write SOLVER.md in the result folder: a pull-request comment that compares this solver "
        "(all settings) with others and lists its worst steps in error, time and iterations"
    )
    _option(more, "--for", "SOLVER", comment, dest="solver")
    against = "with --for: compare with this solver (default: osqp and daqp)"
    _repeated(more, "--against", "SOLVER", against, default=[])
    sent = (
        "write a folder to submit to results/community of the dpbench repository (nothing is sent)"
    )
    _option(more, "--send", "DIR", sent)
    tables = "list the folder's tables and what each contains; do not rewrite the report"
    _flag(more, "--tables", tables)
    latex = (
        "print this table, named as in --tables, as a LaTeX tabular (booktabs); do not rewrite the "
        "report"
    )
    _option(more, "--latex", "TABLE", latex)
    _option(more, "--columns", "A,B,C", "with --latex: only these columns, in this order")
    add_ending_options(report.add_argument_group("output"))


def add_compare_options(compare: Command) -> None:
    """Add the options of `dpbench compare` to its parser."""
    folders = (
        "two result folders, from before and after a change; with --solver, one folder; with "
        "--releases, two or more"
    )
    compare.add_argument("folders", metavar="DIR", nargs="+", help=folders)
    chosen = "configuration to compare within one folder, such as osqp or 'osqp[rho=1.6]'"
    _repeated(compare, "--solver", "SOLVER", chosen, default=[], dest="choices")
    releases = "compare each solver's releases across the folders"
    _flag(compare, "--releases", releases)
    reference = (
        "divide step times by those of this solver (default: do not divide if all folders come "
        "from one machine; otherwise, paper_active_set or, if it was not timed, daqp)"
    )
    _option(compare, "--reference", "SOLVER", reference)
    _flag(compare, "--any-machine", argparse.SUPPRESS)
    margin = (
        "relative difference in a step time (solve time of one step), error or control metric up "
        "to which two runs are equivalent (default: 0.05)"
    )
    _option(compare, "--margin", "SHARE", margin, type=float, default=0.05)
    alpha = "family-wise error rate (default: 0.05)"
    _option(compare, "--alpha", "SHARE", alpha, type=float, default=0.05)
    disturbed = (
        "exit code if a step time could not be judged (usually because of other load on the "
        "machine) and nothing regressed (default: 0)"
    )
    codes: dict[str, Any] = {"type": int, "choices": range(256), "default": 0}
    _option(compare, "--disturbed-exit", "CODE", disturbed, **codes)
    output = compare.add_argument_group("output")
    _option(
        output,
        "--markdown",
        "FILE",
        "write the comparison as Markdown to this file, or print it if FILE is '-'",
    )
    _option(output, "--html", "FILE", "write an HTML page with figures; not with --solver")


def add_export_options(export: Command) -> None:
    """Add the options of `dpbench export` to its parser."""
    problems = f"scenario, sequence (name or .npz file), folder of QPs, or {_RANDOM}"
    export.add_argument("what", metavar="WHAT", nargs="?", help=problems)
    _flag(export, "--all", "write all sequences of `dpbench list sequences` instead of WHAT")
    choice = export.add_argument_group("selection")
    horizons = (
        "use these prediction and control horizons [samples], such as 30/5, instead of the "
        "scenario's"
    )
    _option(choice, "--horizons", "N_p/N_c", horizons)
    _option(choice, "--steps", "N", "write only the first N steps", type=int)
    _option(choice, "--every", "K", "write every K-th step (default: 1)", type=int, default=1)
    _option(choice, "--at", "K", "write only step K (the first step is 0)", type=int)
    part = (
        "QPs to write if forces are planned first and then allocated to thrusters: controller "
        "(those of the plan; default) or allocation (those of the thruster allocation)"
    )
    _option(choice, "--part", "PART", part, default="controller")
    output = export.add_argument_group("output")
    formats = "file format: npz (default), qpbenchmark, mat, csv or qps"
    _option(output, "--format", "FORMAT", formats, default="npz")
    path = (
        "file or folder to write (required without --all; with --all, default: results/sequences)"
    )
    _option(output, "--out", "PATH", path)


def add_worst_case_options(worst_case: Command) -> None:
    """Add the options of `dpbench worst-case` to its parser."""
    solver = "solver to examine, such as osqp or 'osqp[rho=1.6]'"
    worst_case.add_argument("solver", metavar="SOLVER", help=solver)
    _add_call_options(worst_case.add_argument_group("solver"), has_settings=True)
    search = worst_case.add_argument_group("search")
    goal = (
        "quantity to maximise: iterations (default) or error (of the planned control moves, as a "
        "multiple of the maximum increment of the control force)"
    )
    _option(search, "--goal", "GOAL", goal, default="iterations")
    start = "scenario whose initial state and disturbances are varied (default: paper)"
    _option(search, "--scenario", "SCENARIO", start, default="paper")
    _option(search, "--budget", "N", "number of cases to try (default: 300)", type=int, default=300)
    _option(search, "--steps", "N", "steps per case (default: 60)", type=int, default=60)
    _option(search, "--seed", "N", "seed of the search (default: 1)", type=int, default=1)
    output = worst_case.add_argument_group("output")
    _option(output, "--out", "FILE.npz", "file to write (default: worst-cases/SOLVER-GOAL.npz)")


def _add_call_options(group: Command, *, has_settings: bool = False) -> None:
    """Add the options on how a solver is called to a group of a command."""
    routes = (
        "interface through which the solver is called: native (the solver library's own) or "
        "qpsolvers (the Python package); default: native where available, otherwise qpsolvers"
    )
    _option(group, "--route", "ROUTE", routes)
    policies = (
        "what the solver keeps between steps: fresh (nothing, default), reuse (its workspace) or "
        "warm (workspace and last solution)"
    )
    _option(group, "--policy", "POLICY", policies, default="fresh")
    if has_settings:
        levels = f"settings: {_PRESETS} or a tolerance such as 1e-4; if not given: default"
        _option(group, "--settings", "NAME", levels, default="default")
    _add_module_option(group)


def add_iteration_bound_options(bound: Command) -> None:
    """Add the options of `dpbench iteration-bound` to its parser."""
    bound.add_argument("axes", metavar="AXES", help="axes of the controller: surge or sway-yaw")
    controller = "scenario whose controller is analysed (default: paper)"
    _option(bound, "--scenario", "SCENARIO", controller, default="paper")
    box = "scale the box of parameters by this factor (default: 1)"
    _option(bound, "--box", "FACTOR", box, type=float, dest="factor", default=1.0)
    limit = "stop the proof after this time (default: 600 s)"
    _option(bound, "--limit", "SECONDS", limit, type=float, dest="limit_s", default=600.0)


def add_active_sets_options(visited: Command) -> None:
    """Add the arguments of `dpbench active-sets` to its parser."""
    visited.add_argument("names", nargs="+", metavar="NAME", help="scenario, sequence or .npz file")
    counted = (
        "store the control law of each active set and count the instructions per step that this "
        "saves on a Cortex-M7, compared with paper_active_set (requires pip install "
        "'dpbench[embedded]')"
    )
    visited.add_argument("--instructions", action="store_true", help=counted)


def add_check_options(check: Command) -> None:
    """Add the options of `dpbench check` to its parser."""
    file = (
        "name or TOML file of a vessel, scenario or suite; SCENARIO@VESSEL (a scenario with "
        "another vessel); file or folder of QPs (their optima are certified again); or a folder in "
        "results/community"
    )
    check.add_argument("file", metavar="FILE", help=file)
    quick = "skip the simulations from initial offsets"
    _flag(check, "--quick", quick)


def add_init_options(init: Command) -> None:
    """Add the options of `dpbench init` to its parser."""
    init.add_argument("name", metavar="NAME", help="name of the ship: letters, digits, _ and -")
    ship = init.add_argument_group("ship")
    _option(ship, "--length", "M", "length between perpendiculars [m]")
    _option(ship, "--breadth", "M", "breadth [m]")
    _option(ship, "--draught", "M", "draught [m]")
    _option(ship, "--displacement", "T", "displacement [t]")
    like = "library vessel from which the ship is scaled (default: the nearest in size)"
    _option(ship, "--like", "VESSEL", like)
    _option(ship, "--from-mss", "FILE.mat", "read the hull from a vessel of the MSS toolbox")
    _option(ship, "--from-csv", "FILE.csv", "read the hull from rows of coefficient,value")
    thrust = init.add_argument_group("thrust")
    _option(thrust, "--thrust", "KN", "largest force ahead [kN]")
    _option(
        thrust, "--sway-thrust", "KN", "largest force abeam [kN] (default: 0.34 times --thrust)"
    )
    moment = "largest yaw moment [kN·m] (default: 0.57 times --sway-thrust times --length)"
    _option(thrust, "--yaw-moment", "KNM", moment)
    rows = (
        "read the thrusters from this file, one per row, in place of the three options above; '-' "
        "prompts for the thrusters"
    )
    _option(thrust, "--thrusters", "FILE.csv", rows)
    _option(
        init.add_argument_group("weather"),
        "--sea",
        "N",
        "DP capability number of the sea, 1 to 9 (default: the highest in which the ship holds "
        "station; with --thrusters, after the loss in NAME_thrusters.toml)",
    )
    output = init.add_argument_group("output")
    _option(output, "--out", "DIR", "folder to write to (default: current folder)", default=".")
    _flag(output, "--force", "overwrite existing files")


def add_capability_options(capability: Command) -> None:
    """Add the options of `dpbench capability` to its parser."""
    vessel = "name of a vessel with thrusters, or a TOML file"
    capability.add_argument("vessel", metavar="VESSEL", help=vessel)
    sides = (
        "model the thrust range of each azimuth thruster as a polygon with N sides, not as a circle"
    )
    _option(capability, "--sides", "N", sides, type=int)
    planned = (
        "also show the highest wind speed with each azimuth thruster restricted to the 180° "
        "sector (half turn) in which the controllers plan its direction"
    )
    _flag(capability, "--planned", planned)
    solver = (
        "check this solver's solutions of thrust allocation QPs near the highest wind speed; "
        "'all' checks every installed solver"
    )
    _repeated(capability, "--solver", "SOLVER", solver)
    output = capability.add_argument_group("output")
    _option(
        output,
        "--out",
        "DIR",
        "folder for the results of --solver (default: results/capability-VESSEL)",
    )
    _option(output, "--figure", "FILE", "write the plot: .svg, .html, .png or .pdf")
    _flag(output, "--json", "print the result as JSON")


def add_codegen_options(codegen: Command) -> None:
    """Add the options of `dpbench codegen` to its parser."""
    codegen.add_argument("scenario", metavar="SCENARIO", help="name of a scenario, or a TOML file")
    solver = (
        "solver to include: paper_active_set (default), daqp or osqp, also with options, as in "
        "'osqp[rho=1.6]'"
    )
    _option(codegen, "--solver", "SOLVER", solver, default="paper_active_set")
    levels = (
        f"settings: {_PRESETS} or a tolerance such as 1e-4; if not given: mid with rho = 0.25 for "
        "osqp, else default"
    )
    _option(codegen, "--settings", "NAME", levels)
    steps = "steps of the recorded trajectory (default: 1000)"
    _option(codegen, "--steps", "N", steps, type=int, default=1000)
    output = codegen.add_argument_group("output")
    _option(output, "--out", "DIR", "folder to write to", required=True)
    fmu = "also write a functional mock-up unit (requires pip install 'dpbench[embedded]')"
    _option(output, "--fmu", "FILE.fmu", fmu)
    _option(output, "--fmi", "N", "FMI version of the unit: 2 (default) or 3", type=int, default=2)


def add_embedded_options(embedded: Command) -> None:
    """Add the options of `dpbench embedded` to its parser."""
    sequences = (
        f"name, file (.npz, .json or .mat) or folder of a sequence, or {_RANDOM}; default: "
        "paper-30-5"
    )
    embedded.add_argument("sequences", metavar="SEQUENCE", nargs="*", help=sequences)
    repeated: Callable[..., None] = partial(_repeated, default=[])
    solver = embedded.add_argument_group("solvers")
    only = "measure only this solver (default: all with a build recipe)"
    repeated(solver, "--solver", "SOLVER", only)
    recipe = "folder with your own build recipe for a solver's C code (recipe.toml and shim.c)"
    repeated(solver, "--recipe", "DIR", recipe)
    repeated(solver, "--source", "SOLVER=DIR", "folder with the sources of a solver, such as hpipm")
    repeated(
        solver,
        "--settings",
        "SOLVER.KEY=N",
        "solver option (not a tolerance preset), such as osqp.rho=0.1",
    )
    _flag(solver, "--float", "compile in single precision (default: double)", dest="single")
    core = embedded.add_argument_group("core")
    repeated(
        core,
        "--target",
        "CORE",
        "core to emulate: m7 (Cortex-M7, default), a53 (Cortex-A53), riscv or x86",
    )
    fit = (
        "find the largest control horizon with which the solver fits in N kB of memory; each "
        "SEQUENCE is then a scenario (default: paper)"
    )
    repeated(core, "--fit", "N", fit)
    opinion = "compare the counts with those of Valgrind (x86) or QEMU (a53, m7), if installed"
    _flag(core, "--second-opinion", opinion)
    _option(
        core,
        "--steps",
        "N",
        "run at most N steps of each sequence (default: all; with --fit: 5; with "
        "--second-opinion: 3)",
        type=int,
        default=0,
    )
    output = embedded.add_argument_group("output")
    folder = "folder for embedded.parquet (default: results/embedded)"
    _option(output, "--out", "DIR", folder, default="results/embedded")
    _flag(output, "--json", "print a summary as JSON")


def add_tune_solver_options(tune: Command) -> None:
    """Add the options of `dpbench tune-solver` to its parser."""
    start = "solver to tune, such as osqp or, with settings to start from, 'osqp[rho=1.6]'"
    tune.add_argument("solver", metavar="SOLVER", help=start)
    _add_call_options(tune.add_argument_group("solver"))
    repeated: Callable[..., None] = partial(_repeated, default=[])
    data = tune.add_argument_group("sequences")
    training = "sequence or scenario to search on (default: paper, rough, turn)"
    repeated(data, "--train", "SEQUENCE", training, dest="training")
    test = "sequence or scenario to measure on (default: move, extreme, weather)"
    repeated(data, "--test", "SEQUENCE", test)
    steps = "use at most N steps of each sequence (default: all)"
    _option(data, "--steps", "N", steps, type=int, default=0)
    search = tune.add_argument_group("search")
    ranges = (
        "search this solver option in this range, such as 'rho=[1e-3,10]', in place of all "
        "predefined options and ranges"
    )
    repeated(search, "--range", "RANGE", ranges, dest="ranges")
    widened = (
        "also search this solver option, in this range (form as in --range); the other options "
        "keep their predefined ranges"
    )
    repeated(search, "--widen", "RANGE", widened, dest="widened")
    error = (
        "largest allowed error of the first control move, as a share of the maximum increment of "
        "the control force (default: 0.01)"
    )
    _option(search, "--error", "X", error, type=float, default=0.01, dest="error_move")
    trials = "number of sets of settings to try (default: 48); more trials may find better settings"
    _option(search, "--trials", "N", trials, type=int, default=48)
    _option(search, "--seed", "N", "seed of the search (default: 1)", type=int, default=1)
    _flag(search, "--dry-run", "estimate the time, then exit")
    _add_wait_options(search)
    output = tune.add_argument_group("output")
    _option(
        output, "--name", "NAME", "name of the settings found (default: tuned)", default="tuned"
    )
    _option(output, "--out", "DIR", "folder to write to (default: results/tune-SOLVER)")


def add_tune_options(tune: Command) -> None:
    """Add the options of `dpbench tune` to its parser."""
    scenarios = (
        "name of a scenario, or a TOML file; all scenarios must have the same vessel, controller "
        "and sample time"
    )
    tune.add_argument("scenarios", nargs="+", metavar="SCENARIO", help=scenarios)
    seas = (
        "seas in which to try the controllers, as DP capability numbers, such as 4 or 4,5 "
        "(default: the scenario's own weather)"
    )
    _option(tune, "--seas", "N,N", seas, default="")
    search = tune.add_argument_group("search")
    trials = "number of controllers to try (default: 48)"
    _option(search, "--trials", "N", trials, type=int, default=48)
    count = "realisations of each sea in the search, and as many others in the test (default: 2)"
    _option(search, "--realisations", "N", count, type=int, default=2)
    margin = "largest offset allowed, as a share of the limits of 5 m and 5° (default: 0.7)"
    _option(search, "--margin", "SHARE", margin, type=float, default=0.7)
    steps = "run at most N steps of each scenario (default: all)"
    _option(search, "--steps", "N", steps, type=int, default=0)
    _option(search, "--seed", "N", "seed of the search (default: 1)", type=int, default=1)
    output = tune.add_argument_group("output")
    _option(
        output,
        "--out",
        "DIR",
        "folder to write to (default: results/tune-SCENARIO, with the name of the first scenario)",
    )


def add_paper_options(paper: Command) -> None:
    """Add the options of `dpbench paper` to its parser."""
    _option(paper, "--out", "DIR", "folder to write to (default: results/paper)")


def add_doctor_options(doctor: Command) -> None:
    """Add the options of `dpbench doctor` to its parser."""
    _flag(doctor, "--offline", "do not look for newer releases of solvers")


def add_completion_options(completion: Command) -> None:
    """Add the arguments of `dpbench completion` to its parser."""
    shell = "your shell: bash, zsh or fish"
    completion.add_argument("shell", metavar="SHELL", choices=("bash", "zsh", "fish"), help=shell)
