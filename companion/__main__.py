"""Command line of the companion.

Exit codes: 0 done or asked to stop (Ctrl-C, SIGTERM), 1 a command was refused, 2 bad input (one line on stderr says
what to mend), 130 interrupted before the service had begun.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from companion import __version__, app
from companion.command_line import BAD_INPUT, INTERRUPTED, OneLineParser, flight_options, with_flight_options
from companion.config import CompanionConfig, ConfigError, LinksConfig, assemble, load
from companion.config.calibration import R_IMU_FRD, camera_toml, read_calibration
from companion.io.operator import send_command
from companion.io.recorder import newest_run
from companion.io.rerun_view import open_viewer, screenshot
from companion.messages import Command

REFUSED = 1


def seconds(text: str) -> float:
    """Parse a positive time."""
    value = float(text)
    if not 0.0 < value < math.inf:
        raise ValueError(text)
    return value


def parser() -> argparse.ArgumentParser:
    """Return the command line."""
    p = OneLineParser(prog="companion", description="Brings a receiver into a tanker's refuelling window.")
    p.add_argument("--version", action="version", version=__version__)
    commands = p.add_subparsers(dest="command", required=True)

    run = commands.add_parser("run", help="run the service against an autopilot, a datalink and a camera")
    run.add_argument("config", metavar="CONFIG.toml", help="e.g. firmware_configs/sitl/docking.toml")
    run.add_argument("--mavlink", metavar="URL", help="autopilot, e.g. udpin:127.0.0.1:14540")
    run.add_argument("--datalink", metavar="DEVICE,BAUD", help="tanker's serial line, e.g. /dev/ttyUSB0,19600")
    run.add_argument("--camera", metavar="SOURCE", help="frame socket, e.g. tcp://127.0.0.1:14560")
    flight_options(run)
    run.add_argument("--out", metavar="DIR", help="folder for recordings")
    run.add_argument("--run-dir", metavar="DIR", help=argparse.SUPPRESS)
    run.add_argument("--t0-ns", type=int, help=argparse.SUPPRESS)
    run.add_argument("--stop-after-hold", type=seconds, metavar="S", help="end after so many seconds of hold")
    run.add_argument("--stop-after-breakaway", type=seconds, metavar="S", help="end so many seconds after a breakaway")
    run.add_argument("--stop-with-parent", action="store_true", help=argparse.SUPPRESS)
    run.set_defaults(action=_run)

    warm = commands.add_parser("warm-up", help="compile what a configuration needs, once after installation")
    warm.add_argument("config", metavar="CONFIG.toml", help="e.g. firmware_configs/sitl/docking.toml")
    flight_options(warm)
    warm.set_defaults(action=_warm_up)

    command = commands.add_parser("command", help="tell a running companion what the operator wants")
    command.add_argument("name", choices=[c.value for c in Command], metavar="NAME",
                         help=", ".join(c.value for c in Command))
    command.add_argument("--mavlink", metavar="URL", default="udpout:127.0.0.1:14540", help="where it listens")
    command.set_defaults(action=_command)

    camera = commands.add_parser("camera", help="print a camera TOML made of a ROS or Kalibr calibration")
    camera.add_argument("calibration", metavar="FILE.yaml", help="ROS camera_info or Kalibr camchain")
    camera.add_argument("--cam", metavar="NAME", help="which camera of a Kalibr chain, e.g. cam0")
    camera.add_argument("--imu", choices=tuple(R_IMU_FRD),
                        help="mount from T_cam_imu, of an IMU along the body axes: forward right down, or left up")
    camera.set_defaults(action=_camera)

    view = commands.add_parser("view", help="open a recording in the Rerun viewer")
    view.add_argument("run", nargs="?", metavar="RUN_DIR", help="a run folder; without it the newest of runs/")
    view.add_argument("--screenshot", metavar="PNG", help="draw the viewer to a picture instead of opening a window")
    view.set_defaults(action=_view)
    return p


def main(argv: Sequence[str] | None = None) -> int:
    """Parse and run; bad input ends in one line on stderr and exit code 2."""
    arguments = parser().parse_args(argv)
    action: Callable[[argparse.Namespace], int] = arguments.action
    try:
        return action(arguments)
    except ConfigError as error:
        print(f"companion: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        return INTERRUPTED


def _run(a: argparse.Namespace) -> int:
    path = Path(a.config)
    setup = assemble(_with_options(load(path, CompanionConfig), a), path)
    options = app.RunOptions(
        name=path.stem, run_dir=Path(a.run_dir) if a.run_dir else None, t0_ns=a.t0_ns,
        stop_after_hold_s=a.stop_after_hold, stop_after_breakaway_s=a.stop_after_breakaway,
        stop_with_parent=a.stop_with_parent,
    )
    return app.run(setup, options)


def _warm_up(a: argparse.Namespace) -> int:
    path = Path(a.config)
    app.warm_up(assemble(with_flight_options(load(path, CompanionConfig), a), path))
    return 0


def _with_options(config: CompanionConfig, a: argparse.Namespace) -> CompanionConfig:
    """Return the configuration with what the command line says in place."""
    given = {k: getattr(a, k) for k in ("mavlink", "datalink", "camera") if getattr(a, k) is not None}
    replace = msgspec.structs.replace
    config = replace(config, links=replace(config.links, **given))
    if a.out is not None:
        config = replace(config, recorder=replace(config.recorder, out=a.out))
    return with_flight_options(config, a)


def _command(a: argparse.Namespace) -> int:
    result = send_command(a.mavlink, Command(a.name), LinksConfig())
    print(f"{a.name}: {result}")
    return 0 if result == "accepted" else REFUSED


def _camera(a: argparse.Namespace) -> int:
    print(camera_toml(read_calibration(Path(a.calibration), a.cam), a.imu), end="")
    return 0


def _view(a: argparse.Namespace) -> int:
    folder = Path(a.run) if a.run else newest_run("runs")
    if not (folder / "flight.rrd").is_file():
        msg = f"{folder}: no flight.rrd in it; give a run folder such as runs/20260101T120000Z-docking"
        raise ConfigError(msg)
    if a.screenshot:
        screenshot(folder, Path(a.screenshot))
        return 0
    return open_viewer(folder)


if __name__ == "__main__":
    sys.exit(main())
