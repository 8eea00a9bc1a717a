"""Command line of the simulator.

Exit codes: 0 docked and held, or the report is written; 1 the simulated plant failed; 2 bad input (one line on stderr
says what to mend); 3 ended safely without docking, or something in the report is wrong; 130 interrupted.
"""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType

import msgspec

from companion import __version__
from companion.command_line import BAD_INPUT, INTERRUPTED, OneLineParser, flight_options, with_flight_options
from companion.config import CompanionConfig, ConfigError, Setup, assemble
from companion.config import load as load_toml
from companion.io.console import FlightConsole
from companion.io.result_table import result_table
from sim_bridge.faults import parse_fault
from sim_bridge.flight import Flown, fly
from sim_bridge.linearize import command as linearize
from sim_bridge.plant.fdm import PlantError
from sim_bridge.runs.options import options as run_options
from sim_bridge.scenario import Scenario, load_scenario
from sim_bridge.serve import serve
from sim_bridge.sitl import fly_sitl

DOCKED, PLANT_FAILED, NOT_DOCKED = 0, 1, 3


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    p = OneLineParser(prog="sim-bridge", description="Two aircraft, weather, sensors, camera, autopilot.")
    p.add_argument("--version", action="version", version=__version__)
    commands = p.add_subparsers(dest="command", required=True)
    f = commands.add_parser("fly", help="fly a scenario in lockstep, one process, faster than real time")
    _flight(f, _fly)
    f.add_argument("--detections", action="store_true",
                   help="the camera hands over detections instead of pictures: several times as fast")
    sitl = commands.add_parser("sitl", help="fly a scenario as two processes on the wall clock")
    _flight(sitl, _sitl)
    _stick(sitl)
    s = commands.add_parser("serve", help="simulate on the wall clock and wait for a companion of yours")
    _scenario(s)
    s.add_argument("--mavlink", metavar="URL", help="where the companion listens, e.g. udpin:127.0.0.1:14540")
    s.add_argument("--datalink", metavar="PTY_LINK", help="name of the link to the tanker's serial line")
    s.add_argument("--camera", metavar="ENDPOINT", help="where pictures go out, e.g. tcp://127.0.0.1:14560")
    _stick(s)
    s.set_defaults(action=_serve)
    study = commands.add_parser("study", help="reproduce chapter 7 of the thesis and write a report")
    study.add_argument("--seed", type=int, default=1, help="seed of the flights and of all noise (default: 1)")
    study.add_argument("--out", metavar="DIR", help="folder for the report (default: a new one in runs)")
    study.add_argument("--quick", action="store_true", help="few seeds and coarse scans")
    study.add_argument("--only", metavar="PART,...", help="some parts of it: flops, timing, delay, accuracy, noise, "
                       "swap, labeling, convergence, propagation")
    study.set_defaults(action=_study)
    m = commands.add_parser("margins", help="how much latency, delay and error each law bears; print a table")
    m.add_argument("scenario", nargs="?", default="docking", metavar="SCENARIO",
                   help="what is varied (default: docking)")
    m.add_argument("--law", choices=("attitude", "velocity", "surfaces"), help="one law only (default: all three)")
    m.add_argument("--quick", action="store_true", help="two seeds and short holds")
    m.add_argument("--out", metavar="FILE", help="write the table to a file as well")
    m.set_defaults(action=_margins)
    x = commands.add_parser("faults", help="fly the fault matrix in lockstep; print tables of what came of each")
    x.add_argument("--seed", type=int, default=1, help="seed of all flights (default: 1)")
    x.add_argument("--only", metavar="WORD", default="", help="the cells whose name has this in it, e.g. camera-")
    x.add_argument("--out", metavar="FILE", help="write the tables to a file as well")
    x.set_defaults(action=_faults)
    run_options(commands, _runs)
    lin = commands.add_parser("linearize", help="trim and linearise an aircraft; print A, B, modes")
    linearize.options(lin)
    lin.set_defaults(action=_linearize)
    aero = commands.add_parser("aero", help="run the vortex lattice; print derivatives beside the aircraft's files")
    aero.set_defaults(action=_aero)
    return p


def _fault_option(p: argparse.ArgumentParser) -> None:
    p.add_argument("--fault", metavar="FAULT", action="append", default=[],
                   help="let something fail, TARGET.KIND[=SIZE][@PHASE[+S] or @S][:S], e.g. camera.off@hold+5, or "
                   "gps.wrong=50@40:10 for 10 s; may be given again")


def _scenario(p: argparse.ArgumentParser) -> None:
    p.add_argument("scenario", nargs="?", default="docking", metavar="SCENARIO",
                   help="a scenario file or the name of a shipped one (default: docking)")
    p.add_argument("--seed", type=int, help="seed of gusts and sensors")
    _fault_option(p)


def _stick(p: argparse.ArgumentParser) -> None:
    p.add_argument("--stick", metavar="URL", help="work the boom with a joystick: MANUAL_CONTROL that comes in here, "
                   "e.g. udpin:127.0.0.1:14570")


def _flight(p: argparse.ArgumentParser, action: Callable[[argparse.Namespace], int]) -> None:
    _scenario(p)
    flight_options(p)
    p.add_argument("--out", metavar="DIR", help="folder for recordings (default: runs)")
    p.set_defaults(action=action)


def main(argv: Sequence[str] | None = None) -> int:
    """Parse and run; bad input ends in one line on stderr and exit code 2."""
    arguments = parser().parse_args(argv)
    action: Callable[[argparse.Namespace], int] = arguments.action
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: no companion is left behind
    try:
        return action(arguments)
    except (ConfigError, PlantError) as error:
        print(f"sim-bridge: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        return INTERRUPTED


def load(a: argparse.Namespace) -> tuple[Scenario, Setup]:
    """Load the scenario and its companion configuration with what the command line says in place."""
    replace = msgspec.structs.replace
    scenario = load_scenario(a.scenario)
    if a.seed is not None:
        if a.seed < 0:
            msg = f"--seed {a.seed}: must not be negative"
            raise ConfigError(msg)
        scenario = replace(scenario, seed=a.seed)
    if a.fault:
        scenario = replace(scenario, faults=(*scenario.faults, *map(parse_fault, a.fault)))
    if getattr(a, "detections", False):
        scenario = replace(scenario, vision_input="detections")
    if getattr(a, "stick", None) is not None:
        plant = scenario.plant
        scenario = replace(scenario, plant=replace(plant, boom=replace(plant.boom, operator="joystick")))
    path = Path(scenario.companion)
    config = load_toml(path, CompanionConfig)
    given = {k: v for k in ("mavlink", "camera") if (v := getattr(a, k, None)) is not None}
    if getattr(a, "datalink", None) is not None:
        given["datalink"] = f"{a.datalink},{scenario.datalink.rate_baud}"
    config = replace(config, links=replace(config.links, **given))
    config = with_flight_options(config, a)
    if getattr(a, "out", None) is not None:
        config = replace(config, recorder=replace(config.recorder, out=a.out))
    return scenario, assemble(config, path)


def _fly(a: argparse.Namespace) -> int:
    scenario, setup = load(a)
    with FlightConsole(setup) as console:
        flown = fly(scenario, setup, console.output)
    return _told(flown, setup)


def _sitl(a: argparse.Namespace) -> int:
    scenario, setup = load(a)
    return _told(fly_sitl(scenario, setup, a.stick), setup)


def _told(flown: Flown, setup: Setup) -> int:
    print(result_table(flown.summary, setup.tanker.window))
    print(f"recording: {flown.folder}   (look at it: make view)")
    if flown.summary["interrupted"]:
        return INTERRUPTED
    if flown.summary["plant_failure"]:
        print(f"sim-bridge: plant failed: {flown.summary['plant_failure']}", file=sys.stderr)
        return PLANT_FAILED
    return DOCKED if flown.summary["docked"] else NOT_DOCKED


def _serve(a: argparse.Namespace) -> int:
    scenario, setup = load(a)
    asked = False

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        asked = True

    signal.signal(signal.SIGINT, ask)
    signal.signal(signal.SIGTERM, ask)
    links = setup.config.links
    wires = f"calling a companion at {links.mavlink}; tanker on {links.datalink}; pictures on {links.camera}"
    served = serve(
        scenario, setup, lambda: asked, lambda truth: None,
        lambda: print(wires, flush=True), lambda: print("companion heard: flying", flush=True), a.stick,
    )
    print(f"served {served.flown_s:.1f} s, {served.late_steps} steps late"
          + (f", plant failed: {served.plant_failure}" if served.plant_failure else ""))
    return PLANT_FAILED if served.plant_failure else DOCKED


def _study(a: argparse.Namespace) -> int:
    from sim_bridge.study.command import Options, study  # noqa: PLC0415  it loads matplotlib, which flights do without

    print(f"report: {study(Options(a.seed, a.out, a.quick, a.only))}")
    return DOCKED


def _margins(a: argparse.Namespace) -> int:
    from sim_bridge.margins import LAWS, margins  # noqa: PLC0415  flights do without it

    out = None if a.out is None else writable(Path(a.out))
    table = margins(a.scenario, LAWS if a.law is None else (a.law,), quick=a.quick,
                    tell=lambda line: print(line, file=sys.stderr, flush=True))
    print(table)
    if out is not None:
        out.write_text(table + "\n", encoding="utf-8")
    return DOCKED


def _faults(a: argparse.Namespace) -> int:
    from sim_bridge.fault_cells import MATRIX, MORE  # noqa: PLC0415  flights do without it
    from sim_bridge.fault_table import report  # noqa: PLC0415

    cells = tuple(cell for cell in (*MATRIX, *MORE) if a.only in cell.name)
    if not cells or a.seed < 0:
        msg = f"--seed {a.seed}: must not be negative" if cells else f"--only {a.only}: no fault has this in its name"
        raise ConfigError(msg)
    out = None if a.out is None else writable(Path(a.out))
    text, right = report(a.seed, lambda line: print(line, file=sys.stderr, flush=True), cells)
    print(text)
    if out is not None:
        out.write_text(text + "\n", encoding="utf-8")
    return DOCKED if right else NOT_DOCKED


def _runs(a: argparse.Namespace) -> int:
    from sim_bridge.runs.command import run  # noqa: PLC0415  it loads matplotlib, which flights do without

    text, right = run(a)
    print(text)
    return DOCKED if right else NOT_DOCKED


def writable(path: Path) -> Path:
    """Return the path of a file that can be written; raises ConfigError, before the flights, not after them."""
    try:
        path.open("a", encoding="utf-8").close()
    except OSError as error:
        msg = f"--out {path}: {error.strerror}"
        raise ConfigError(msg) from None
    return path


def _linearize(a: argparse.Namespace) -> int:
    print(linearize.run(a))
    return DOCKED


def _aero(_: argparse.Namespace) -> int:
    from sim_bridge.aero.derivatives import report  # noqa: PLC0415  flights do without it

    print(report())
    return DOCKED


if __name__ == "__main__":
    sys.exit(main())
