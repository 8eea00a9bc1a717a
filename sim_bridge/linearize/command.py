"""``sim-bridge linearize``: options in, text out."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from companion.config import ConfigError
from sim_bridge.linearize.model import ALTITUDE_RANGE_M, MACH_RANGE, Condition
from sim_bridge.linearize.receiver import AIRFRAME_FILE, linearize, write_airframe
from sim_bridge.linearize.tables import report, tanker_report
from sim_bridge.linearize.tanker import linearize_tanker
from sim_bridge.plant.aircraft_data import AIRCRAFT
from sim_bridge.plant.world import ALTITUDE_M, MACH


def options(p: argparse.ArgumentParser) -> None:
    """Add the options."""
    p.add_argument("--aircraft", choices=AIRCRAFT, default=AIRCRAFT[0], help="receiver (default) or tanker")
    p.add_argument("--mach", type=float, default=MACH,
                   help=f"trim elsewhere, {MACH_RANGE[0]} to {MACH_RANGE[1]} (default: {MACH})")
    p.add_argument("--altitude", type=float, default=ALTITUDE_M, metavar="M",
                   help=f"{ALTITUDE_RANGE_M[0]:.0f} to {ALTITUDE_RANGE_M[1]:.0f} m (default: {ALTITUDE_M:.0f})")
    p.add_argument("--scale", action="append", default=[], metavar="NAME=FACTOR",
                   help="multiply a coefficient of the aircraft's XML, e.g. Cnb=0.5; may be repeated")
    p.add_argument("--write", nargs="?", const=str(AIRFRAME_FILE), metavar="FILE",
                   help="write the airframe data that the companion uses")


def run(a: argparse.Namespace) -> str:
    """Return what is found; raises ConfigError for options that do not fit, PlantError when there is no trim."""
    condition = Condition(a.mach, a.altitude, dict(factor(text) for text in a.scale))
    if a.write and (a.aircraft != AIRCRAFT[0] or not condition.designed):
        msg = f"--write: the companion's airframe is the receiver at Mach {MACH}, {ALTITUDE_M:.0f} m, nothing scaled"
        raise ConfigError(msg)
    if a.aircraft != AIRCRAFT[0]:
        return tanker_report(linearize_tanker(condition))
    if a.write:
        return f"{report(write_airframe(Path(a.write)))}\nwritten: {a.write}"
    return report(linearize(condition))


def factor(text: str) -> tuple[str, float]:
    """Return name and factor of ``NAME=FACTOR``; raises ConfigError when it is not that."""
    name, _, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not name or not math.isfinite(number):
        msg = f"--scale {text}: must be NAME=FACTOR, e.g. Cnb=0.5"
        raise ConfigError(msg)
    return name, number
