"""Views, states and guards for the tests of the guard: all well unless told otherwise."""

from dataclasses import replace
from functools import cache

import numpy as np

from companion.config import FIRMWARE_CONFIGS, load_setup
from companion.geometry import SE3, rotation_from_euler
from companion.guidance.guard import Guard, View, envelope_of
from companion.messages import Integrity, Phase, RelativeState, Sources

S = 1_000_000_000
MS = 1_000_000
DT_NS = 20 * MS


@cache
def shipped():
    return load_setup(FIRMWARE_CONFIGS / "sitl" / "thesis.toml")


def config():
    return shipped().config.guidance.guard


def envelope():
    return envelope_of(shipped().config.guidance, shipped().airframe)


def new_guard():
    return Guard(config(), envelope(), shipped().tanker.window)


def state_at(t_ns, p_m=(0.1, 0.0, 0.1), v_m_s=(0.0, 0.0, 0.0), *, age_ns=0, euler=None, heading=0.0, turn=0.0,
             v_box=(205.7, 0.0, 0.0)):
    yaw, pitch, roll = euler or (0.1, shipped().airframe.trim.alpha_rad, 0.02)
    return RelativeState(
        t_ns, t_ns - age_ns, np.array(p_m, float), np.array(v_m_s, float), np.array(v_box, float), np.zeros(3),
        rotation_from_euler(yaw, pitch, roll), np.zeros(3), heading, turn, SE3.identity(), 20.0, 1.0, 9, np.eye(3),
    )


def sources_at(t_ns, **ages_ns):
    ages = {"attitude": 0, "position": 0, "tanker": 0, "sight": 0, **ages_ns}
    return Sources(**{f"{name}_ns": None if age is None else t_ns - age for name, age in ages.items()})


def integrity_at(t_ns, *faults, protection_m=(0.5, 0.5, 0.5), alert_m=(1.0, 1.0, 1.0)):
    return Integrity(t_ns, np.array(protection_m, float), np.array(alert_m, float), not faults, faults)


def view_at(t_ns, phase=Phase.HOLD, **changed):
    """Return a view in which all is well, with what is told changed."""
    well = View(t_ns, phase, state_at(t_ns), sources_at(t_ns), t_ns, integrity_at(t_ns), asked=False, error_m=0.1)
    return replace(well, **changed)
