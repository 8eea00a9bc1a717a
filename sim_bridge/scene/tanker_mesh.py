"""Mesh of a KC-135R-like tanker; its boom is in ``boom_mesh``.

Rules
-----
* Body axes, forward right down in m, origin at the centre of mass (estimated at a quarter of the mean chord).
* Length 41.53 m, span 39.88 m and height 12.70 m are the USAF fact sheet's; sweep 35 degrees and dihedral 7 degrees at
  the quarter chord, fuselage 3.66 m wide, are shared figures of the type; the rest is estimated from proportions.
* Nothing is painted red: red is what the markers are found by.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from companion.geometry import Mat
from sim_bridge.scene.meshing import Mesh, aerofoil, loft, merge, revolution, ring
from sim_bridge.scene.paints import BLACK, DARK, GREEN, GREY, LIGHT, METAL, YELLOW

FUSELAGE = np.array(
    # x      top    bottom half-width
    [
        [19.50, 0.52, 0.60, 0.03],
        [19.30, 0.20, 0.95, 0.34],
        [18.80, -0.22, 1.27, 0.68],
        [18.00, -0.66, 1.55, 1.02],
        [17.00, -1.12, 1.76, 1.33],
        [16.30, -1.52, 1.87, 1.49],
        [15.60, -1.84, 1.95, 1.61],
        [14.60, -2.02, 2.03, 1.73],
        [13.30, -2.09, 2.09, 1.81],
        [12.00, -2.10, 2.10, 1.83],
        [8.00, -2.10, 2.10, 1.83],
        [4.00, -2.10, 2.10, 1.83],
        [0.00, -2.10, 2.10, 1.83],
        [-4.00, -2.10, 2.10, 1.83],
        [-7.00, -2.10, 2.10, 1.83],
        [-9.00, -2.10, 2.00, 1.82],
        [-11.0, -2.09, 1.76, 1.77],
        [-13.0, -2.07, 1.38, 1.65],
        [-15.0, -2.03, 0.92, 1.43],
        [-17.0, -1.96, 0.40, 1.13],
        [-18.5, -1.86, -0.02, 0.85],
        [-19.7, -1.72, -0.42, 0.56],
        [-20.5, -1.55, -0.75, 0.32],
        [-20.9, -1.35, -1.00, 0.12],
    ]
)
"""Fuselage stations: x, top, bottom and half-width in m."""

WING_Y = np.array([0.0, 1.83, 6.5, 10.0, 13.5, 17.0, 19.2, 19.94])
WING_SWEEP_LE = np.tan(np.radians(37.2))
WING_DIHEDRAL = np.tan(np.radians(7.0))


def wing_station(y: float) -> tuple[float, float, float]:
    """Return (leading edge x, trailing edge x, z) of the chord line at span station y >= 0, in m."""
    lead = 7.6 - WING_SWEEP_LE * y
    kink = 6.5
    trail = -3.6 - 0.05 * y if y < kink else -3.93 - (y - kink) * (10.35 - 3.93) / (19.94 - kink)
    return lead, trail, 1.35 - WING_DIHEDRAL * max(y - 1.83, 0.0)


def fuselage() -> Mesh:
    """Return the fuselage."""
    rings = [ring(np.array([x, 0.0, 0.5 * (t + b)]), w, 0.5 * (b - t), 0.5 * (b - t), 32) for x, t, b, w in FUSELAGE]

    def paint(p: Mat) -> Mat:
        return np.where(p[:, :1] > 19.2, np.array(METAL), np.array(GREY))

    return loft(np.stack(rings), paint)


def skin_station(x: float) -> tuple[float, float, float]:
    """Return top, bottom and half-width of the fuselage at station x."""
    top, bottom, width = (float(np.interp(-x, -FUSELAGE[:, 0], FUSELAGE[:, n])) for n in (1, 2, 3))
    return top, bottom, width


def windscreen(low: float, high: float) -> Mesh:
    """Return dark panes on the skin of the nose between two angles from its top, in rad."""
    angles = np.linspace(low, high, 7)
    sections = []
    for x in (17.25, 17.0, 16.65, 16.3, 16.05):
        top, bottom, width = skin_station(x)
        middle, half = 0.5 * (top + bottom), 0.5 * (bottom - top)
        arcs = [
            np.column_stack([np.full(7, x), (width + d) * np.sin(a), middle - (half + d) * np.cos(a)])
            for a, d in ((angles, 0.02), (angles[::-1], -0.10))
        ]
        sections.append(np.concatenate(arcs))
    return loft(np.stack(sections), BLACK)


def spindle(x: list[float], half_y: list[float], top: float, bottom: list[float], paint: tuple[float, float, float],
            power: float = 2.4) -> Mesh:
    """Return a fairing under the fuselage: stations x with half-widths and lower edges, flat top at z = ``top``."""
    rings = [
        ring(np.array([a, 0.0, top]), w, 0.05, b - top, 20, power) for a, w, b in zip(x, half_y, bottom, strict=True)
    ]
    return loft(np.stack(rings), paint)


def wing(side: float) -> Mesh:
    """Return one wing; ``side`` +1 right, -1 left. Leading edge is bare metal, the rest grey."""
    sections = []
    for y in WING_Y:
        lead, trail, z = wing_station(float(y))
        chord = lead - trail
        if y > 19.5:
            lead, chord = lead - 0.6, chord - 0.9
        sections.append(aerofoil(np.array([lead, y, z]), chord, 0.125 - 0.0017 * y, 0.012))

    def paint(p: Mat) -> Mat:
        lead = 7.6 - WING_SWEEP_LE * p[:, 1]
        colours = np.tile(np.array(GREY), (len(p), 1))
        colours[p[:, 0] > lead - 0.03 * 8.0] = METAL
        return colours

    right = loft(np.stack(sections), paint)
    return right if side > 0 else right.mirrored()


def flap_track(y: float) -> Mesh:
    """Return one flap track fairing under the wing at station y > 0."""
    _, trail, z = wing_station(y)
    x = np.array([1.9, 1.2, 0.3, -0.5, -0.9]) + trail
    return revolution(list(x), [0.03, 0.17, 0.20, 0.11, 0.02], (y, z + 0.28), 10, LIGHT)


def nacelle(y: float) -> Mesh:
    """Return engine and pylon at span station y > 0: fan cowl with dark intake, core and plug behind."""
    lead, _, z_wing = wing_station(y)
    z = z_wing + 1.66
    front = lead + 3.2
    cowl = revolution(
        list(front - np.array([0.6, 0.35, 0.0, 0.1, 0.6, 1.6, 2.6, 3.15, 3.1])),
        [0.02, 0.80, 0.92, 1.02, 1.14, 1.19, 1.10, 0.94, 0.60],
        (y, z),
        24,
        lambda p: np.where((p[:, 0] > front - 0.7) & (np.hypot(p[:, 1] - y, p[:, 2] - z) < 0.85), 0.0, 1.0)[:, None]
        * (np.array(LIGHT) - BLACK)
        + BLACK,
    )
    lip = revolution([front - 0.12, front + 0.02, front - 0.12], [0.90, 0.97, 1.035], (y, z), 24, METAL)
    core = revolution(
        [front - 2.9, front - 3.5, front - 4.3, front - 4.25], [0.72, 0.68, 0.50, 0.36], (y, z), 20, METAL
    )
    plug = revolution([front - 4.1, front - 4.5, front - 5.0], [0.34, 0.24, 0.02], (y, z), 14, DARK)
    return merge([cowl, lip, core, plug, pylon(y, front, z, z_wing)])


def pylon(y: float, front: float, z_engine: float, z_wing: float) -> Mesh:
    """Return the strut between engine and wing: a thin vertical section swept back."""
    across = np.array([0.0, 1.0, 0.0])
    sections = [
        aerofoil(np.array([front - 0.7, y, z_engine - 1.00]), 4.2, 0.085, across=across),
        aerofoil(np.array([front - 1.6, y, z_engine - 1.25]), 4.6, 0.080, across=across),
        aerofoil(np.array([front - 3.0, y, z_wing + 0.05]), 4.2, 0.080, across=across),
    ]
    return loft(np.stack(sections), GREY)


def tailplane() -> Mesh:
    """Return the right half of the tailplane: span 12.27 m, 35 degrees of sweep."""
    sections = [
        aerofoil(np.array([-15.1, 0.0, -0.95]), 4.5, 0.10),
        aerofoil(np.array([-15.9, 1.1, -1.02]), 4.1, 0.10),
        aerofoil(np.array([-19.3, 5.9, -1.62]), 2.1, 0.09),
        aerofoil(np.array([-19.7, 6.13, -1.65]), 1.5, 0.06),
    ]
    return loft(np.stack(sections), GREY)


def fin() -> Mesh:
    """Return the fin with its dorsal fillet; the tip is 8.7 m above the centre of mass."""
    across = np.array([0.0, 1.0, 0.0])
    sections = [
        aerofoil(np.array([-9.8, 0.0, -1.70]), 10.2, 0.04, across=across),
        aerofoil(np.array([-12.6, 0.0, -2.60]), 7.5, 0.08, across=across),
        aerofoil(np.array([-13.5, 0.0, -3.60]), 6.8, 0.10, across=across),
        aerofoil(np.array([-17.3, 0.0, -8.35]), 4.3, 0.10, across=across),
        aerofoil(np.array([-17.9, 0.0, -8.70]), 3.4, 0.05, across=across),
    ]
    return loft(np.stack(sections), GREY)


def belly_strip(x0: float, x1: float, y: float, half: float, paint: tuple[float, float, float]) -> Mesh:
    """Return a thin strip on the underside of the fuselage from x0 down to x1 at lateral offset y."""
    sections = []
    for x in np.linspace(x0, x1, max(2, int((x0 - x1) / 1.0) + 1)):
        top, bottom, width = skin_station(float(x))
        z = 0.5 * (top + bottom) + 0.5 * (bottom - top) * np.sqrt(max(0.0, 1.0 - (y / width) ** 2))
        edge = np.array([[-half, -0.05], [half, -0.05], [half, 0.03], [-half, 0.03]])
        tilt = -np.sign(y) * np.arcsin(min(1.0, abs(y) / width))
        c, s = np.cos(tilt), np.sin(tilt)
        turned = np.column_stack([c * edge[:, 0] - s * edge[:, 1], s * edge[:, 0] + c * edge[:, 1]])
        sections.append(np.column_stack([np.full(4, x), y + turned[:, 0], z + turned[:, 1]]))
    return loft(np.stack(sections), paint)


def markings() -> list[Mesh]:
    """Return the yellow centre line and the two rows of director lights under the forward fuselage (dark here)."""
    parts = [belly_strip(12.6, 7.6, 0.0, 0.11, YELLOW)]
    for y in (-0.40, 0.40):
        parts.append(belly_strip(12.6, 7.4, y, 0.14, DARK))
        parts.extend(belly_strip(x, x - 0.45, y, 0.165, c) for x, c in ((11.6, YELLOW), (10.2, GREEN), (8.8, YELLOW)))
    return parts


@lru_cache(maxsize=1)
def tanker_mesh() -> Mesh:
    """Return the KC-135R-like tanker without its boom, in tanker axes."""
    halves = [wing(1.0), nacelle(8.3), nacelle(14.1), tailplane(), flap_track(4.2), flap_track(6.2), flap_track(11.2)]
    keel = spindle(
        [7.9, 7.0, 5.0, 1.0, -3.0, -5.5, -7.0, -7.9], [0.3, 1.2, 1.85, 2.05, 2.05, 1.8, 1.2, 0.3], 1.2,
        [1.4, 1.95, 2.25, 2.40, 2.40, 2.22, 1.95, 1.4], GREY, 2.6,
    )
    pod = spindle(
        [-10.8, -11.6, -13.0, -14.5, -15.8, -16.8, -17.4], [0.15, 0.45, 0.66, 0.70, 0.60, 0.38, 0.10], 0.6,
        [1.75, 1.92, 2.02, 1.98, 1.78, 1.40, 0.9], GREY,
    )
    window = spindle([-15.4, -15.7, -16.2, -16.5], [0.20, 0.34, 0.32, 0.18], 1.0, [1.75, 1.86, 1.74, 1.5], DARK)
    fork = revolution([-15.9, -16.3, -16.75, -16.95], [0.10, 0.34, 0.30, 0.05], (0.0, 1.92), 16, METAL)
    panes = [windscreen(a, b) for a, b in ((-1.25, -0.78), (-0.72, -0.05), (0.05, 0.72), (0.78, 1.25))]
    return merge(
        [fuselage(), *panes, keel, pod, window, fork, fin(), *markings(), *halves, *(h.mirrored() for h in halves)]
    )
