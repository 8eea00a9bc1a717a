"""What the boom's kernels work on: four records of floats, filled once a step.

``PARAMETERS`` of one boom, ``PRESCRIBED`` what tanker, receiver, air and operator do, ``STATE`` of the boom, and
``SEEN``, what its operator sees. Angles of the joints as an operator speaks of them: elevation below the tanker's x
axis, azimuth in the plane tilted by it, right positive; theta4 = pi - elevation, theta5 = azimuth - pi / 2 (thesis
2.2, ``boom_derivation``).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from companion.config import BoomConfig, Vec3

Record = NDArray[np.void]
"""One element of a structured dtype whose fields are all float64."""

PARAMETERS = np.dtype([(name, np.float64) for name in (
    "m_outer", "com_outer", "m_inner", "com_inner", "j_across", "j_along",
    "outer_length", "outer_cross", "outer_skin", "inner_cross", "inner_skin",
    "area", "at", "cos_v", "sin_v", "rigged", "slope", "max_lift", "drag", "induced", "limit", "surface_rate", "lag",
    "drive_force", "friction", "hinge",
    "stop_e_low", "stop_e_high", "stop_a", "stop_length",
    "stiffness", "damping",
    "pivot_x", "pivot_y", "pivot_z", "box_x", "box_y", "box_z",
)])  # fmt: skip
PRESCRIBED_FIELDS = (
    "t_n", "t_e", "t_d", "t_vn", "t_ve", "t_vd", "t_yaw", "t_pitch", "t_roll", "t_p", "t_q", "t_r",
    "t_udot", "t_vdot", "t_wdot", "t_pdot", "t_qdot", "t_rdot",
    "r_n", "r_e", "r_d", "r_vn", "r_ve", "r_vd", "r_yaw", "r_pitch", "r_roll", "r_p", "r_q", "r_r",
    "at_x", "at_y", "at_z",
    "density", "wind_n", "wind_e", "wind_d",
    "bow_u0", "bow_v0", "bow_w0", "bow_u1", "bow_v1", "bow_w1",
    "elevation", "azimuth", "length", "elevation_rate", "azimuth_rate", "length_rate",
    "latched", "rest_x", "rest_y", "rest_z",
)  # fmt: skip
PRESCRIBED = np.dtype([(name, np.float64) for name in PRESCRIBED_FIELDS])
STATE = np.dtype([(name, np.float64) for name in (
    "theta4", "theta5", "d6", "rate4", "rate5", "rate6",
    "right", "left", "up_command", "right_command", "drive", "sum_e", "sum_a", "sum_l",
    "air_x", "air_y", "air_z", "p", "q", "r", "pd", "qd", "rd", "f_x", "f_y", "f_z", "density",
    "goal_x", "goal_y", "goal_z", "goal_vx", "goal_vy", "goal_vz",
    "bow_x0", "bow_y0", "bow_z0", "bow_x1", "bow_y1", "bow_z1",
)])  # fmt: skip
"""Coordinates and actuators of the boom, and, from ``air_x`` on, what this step's kinematics made of ``PRESCRIBED``, in
tanker axes: velocity of the pivot through the air, turning, specific force at the pivot, receptacle from the pivot."""


class Seen(NamedTuple):
    """What the operator sees at the end of a step; joint angles in rad, m, m/s, N.

    ``aim_*``: where elevation, azimuth and length would have to be for the nozzle to be in the receptacle. ``gap_*``:
    receptacle minus nozzle in tanker axes. ``br_*``: from box B to the receptacle in the psi frame. ``pull_*``: what
    the receptacle does to the nozzle, along the boom (outwards), across it up and to the right. ``force_*``: what the
    nozzle does to the receptacle, ``ned``. ``at_*``: places 0 and 1 on the telescope, in receiver body axes.
    """

    elevation: float
    azimuth: float
    length: float
    elevation_rate: float
    azimuth_rate: float
    length_rate: float
    aim_elevation: float
    aim_azimuth: float
    aim_length: float
    aim_elevation_rate: float
    aim_azimuth_rate: float
    aim_length_rate: float
    gap_x: float
    gap_y: float
    gap_z: float
    gap: float
    closing: float
    br_x: float
    br_y: float
    br_z: float
    relative_speed: float
    pull_along: float
    pull_up: float
    pull_right: float
    force_n: float
    force_e: float
    force_d: float
    right: float
    left: float
    drive: float
    airspeed: float
    alpha: float
    at_x0: float
    at_y0: float
    at_z0: float
    at_x1: float
    at_y1: float
    at_z1: float


SEEN = np.dtype([(name, np.float64) for name in Seen._fields])


def record(dtype: np.dtype[Any]) -> Record:
    """Return one record of zeros, as an array (1,)."""
    return np.zeros(1, dtype)


def flat(of: Record) -> NDArray[np.float64]:
    """Return the same memory as floats (n,)."""
    return of.view(np.float64)


def parameters(c: BoomConfig, box_tanker_m: Vec3) -> Record:
    """Return the parameters of one boom.

    Tubes as uniform rods: m l^2 / 12 across, m (d / 2)^2 along for thin walls. ``rigged``: incidence of a ruddevator
    in level flow at nominal elevation, arctan(tan(elevation) cos(dihedral)).
    """
    t, v, e = c.tubes, c.ruddevators, c.envelope
    values = {
        "m_outer": t.outer_mass_kg, "com_outer": t.outer_com_m, "m_inner": t.inner_mass_kg, "com_inner": t.inner_com_m,
        "j_across": (t.outer_mass_kg * t.outer_length_m**2 + t.inner_mass_kg * t.inner_length_m**2) / 12.0,
        "j_along": (t.outer_mass_kg * t.outer_diameter_m**2 + t.inner_mass_kg * t.inner_diameter_m**2) / 4.0,
        "outer_length": t.outer_length_m,
        "outer_cross": t.cross_drag * t.outer_diameter_m, "outer_skin": t.skin_friction * math.pi * t.outer_diameter_m,
        "inner_cross": t.cross_drag * t.inner_diameter_m, "inner_skin": t.skin_friction * math.pi * t.inner_diameter_m,
        "area": v.area_m2, "at": v.at_m, "cos_v": math.cos(v.dihedral_rad), "sin_v": math.sin(v.dihedral_rad),
        "rigged": math.atan(math.tan(c.elevation_rad) * math.cos(v.dihedral_rad)),
        "slope": v.lift_slope, "max_lift": v.max_lift, "drag": v.drag, "induced": v.induced_drag,
        "limit": v.limit_rad, "surface_rate": v.rate_rad_s, "lag": v.lag_s,
        "drive_force": c.drive.force_n, "friction": c.drive.friction_n, "hinge": c.drive.hinge_n_m_s,
        "stop_e_low": e.stop_elevation_rad[0], "stop_e_high": e.stop_elevation_rad[1], "stop_a": e.stop_azimuth_rad,
        "stop_length": t.outer_length_m + e.stop_extension_m,
        "stiffness": c.nozzle.stiffness_n_m, "damping": c.nozzle.damping_n_s_m,
        "pivot_x": c.pivot_tanker_m[0], "pivot_y": c.pivot_tanker_m[1], "pivot_z": c.pivot_tanker_m[2],
        "box_x": box_tanker_m[0], "box_y": box_tanker_m[1], "box_z": box_tanker_m[2],
    }  # fmt: skip
    return np.array([tuple(values[name] for name in PARAMETERS.names or ())], PARAMETERS)
