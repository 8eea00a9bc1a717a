"""Lifting surfaces of both aircraft for the vortex lattice, seen from their centres of mass (``frd``, metres).

The ICE-101 here is flat: 65 degrees of leading-edge sweep, the span of the reports, and a root chord of 1.5 times their
mean chord (recalled: 37.5 ft, 28.75 ft, so 43.1 ft). Its trailing edge is a W with edges of 25 degrees, whose notch and
point are placed so that the tip closes and the area is that of the reports, 75.1 m2 (recalled, 808.6 ft2).

What each effector covers is estimated: the thesis (Fig. 3.3) shows where they are, not how large. The pitch flap is
short and at the very tail, the trailing-edge flaps have long chords at the notch, so that the lattice finds the lift of
the latter 0.1 chord ahead of the former's: deflected against each other they give lift without moment.

Where the centre of mass lies is not published. Here it is ``ICE_CG_BEHIND_NOSE_M``, for a static margin of 2.8 % of the
mean chord, which the XML takes for the short period ([modes]).

The KC-135R: span, area and 35 degrees of sweep from the fact sheets; taper, tailplane and fin estimated from its
proportions. There is no body, so the lattice lacks what the fuselage takes off Cm and Cn.
"""

from __future__ import annotations

import math

from sim_bridge.aero.vortex_lattice import Control, Reference, Trapezoid

SWEEP = math.tan(math.radians(65.0))
SAW = math.tan(math.radians(25.0))
ICE_CG_BEHIND_NOSE_M = 7.344
ICE = Reference(area_m2=75.1, span_m=11.43, chord_m=8.76)
KC135R = Reference(area_m2=226.0, span_m=39.88, chord_m=6.10)
NOTCH_M, POINT_M, TIP_M = 2.13, 4.25, 5.715
"""The trailing edge's notch and point; half the span (m from the middle)."""
TAIL_M = 13.145
"""Length of the root chord, nose to tail."""
PF_END_M, TEF_END_M = 1.60, 3.60
"""Pitch flap: from the middle to here. Trailing-edge flap: from there to here. The tip turns from ``POINT_M`` on."""
PF_DEPTH_M, TEF_DEPTH_M, LEF_SHARE = 0.80, 2.00, 0.15
ICE_ALPHA_RAD, KC135R_ALPHA_RAD = 0.077, 0.077
"""Where derivatives are taken: incidence of the trim at Mach 0.65, 6000 m; of the tanker's, that of its wing."""


def ice101() -> tuple[Trapezoid, ...]:
    """Return the wing with its effectors pf, tef, lef and amt; spoilers work by separation, which is no lattice's."""
    stations = (0.0, PF_END_M, NOTCH_M, TEF_END_M, POINT_M, TIP_M)
    right = tuple(
        Trapezoid(
            (ICE_CG_BEHIND_NOSE_M - a * SWEEP, a, 0.0), (ICE_CG_BEHIND_NOSE_M - b * SWEEP, b, 0.0),
            chord(a), chord(b), strips, 20, controls=_effectors(a, b),
        )
        for a, b, strips in zip(stations, stations[1:], (4, 2, 4, 2, 4), strict=False)
    )
    return (*right, *(s.mirrored() for s in right))


def _effectors(a: float, b: float) -> tuple[Control, ...]:
    """Return the controls between ``a`` and ``b`` m from the middle, on the right side."""
    if b <= PF_END_M:
        return (_rear("pf", PF_DEPTH_M, a, b),)
    if a >= POINT_M:
        return (Control("amt_r", (0.0, 0.0)),)
    front = Control("lef_r", (0.0, 0.0), (LEF_SHARE, LEF_SHARE), gain=-1.0)
    return (_rear("tef_r", TEF_DEPTH_M, a, b), front) if b <= TEF_END_M else (front,)


def _rear(name: str, depth_m: float, a: float, b: float) -> Control:
    return Control(name, (1.0 - depth_m / chord(a), 1.0 - depth_m / chord(b)))


def chord(y_m: float) -> float:
    """Return the chord of the ICE-101 at ``y_m`` from the middle."""
    aft = TAIL_M - SAW * min(y_m, NOTCH_M)
    aft += SAW * min(max(y_m - NOTCH_M, 0.0), POINT_M - NOTCH_M) - SAW * max(y_m - POINT_M, 0.0)
    return aft - SWEEP * y_m


def kc135r() -> tuple[Trapezoid, ...]:
    """Return wing, tailplane (with elevator) and fin (with rudder)."""
    wing = _swept_half(span_m=39.88, area_m2=226.0, taper=0.35, dihedral_rad=math.radians(7.0), quarter_m=(0.0, 0.6))
    tail = _swept_half(span_m=12.3, area_m2=46.5, taper=0.40, dihedral_rad=math.radians(7.0), quarter_m=(-18.6, -0.9))
    elevator = (Control("elevator", (0.70, 0.70)),)
    tail = Trapezoid(
        tail.left_frd_m, tail.right_frd_m, tail.left_chord_m, tail.right_chord_m, 5, 6, controls=elevator
    )
    rudder = Control("rudder", (0.70, 0.70), gain=-1.0)  # trailing edge left, as in CR-2144
    fin = Trapezoid((-13.6, 0.0, -2.0), (-18.4, 0.0, -9.1), 6.4, 2.6, 6, 6, controls=(rudder,))
    return wing, wing.mirrored(), tail, tail.mirrored(), fin


def _swept_half(
    span_m: float, area_m2: float, taper: float, dihedral_rad: float, quarter_m: tuple[float, float]
) -> Trapezoid:
    """Return the right half; the quarter of its mean chord is at x, and its root at z, of ``quarter_m`` (frd)."""
    root = 2.0 * area_m2 / (span_m * (1.0 + taper))
    half = 0.5 * span_m
    mean_at = half * (1.0 + 2.0 * taper) / (3.0 * (1.0 + taper))
    slope = math.tan(math.radians(35.0))
    nose = quarter_m[0] + slope * mean_at + 0.25 * root
    tip = quarter_m[0] - slope * (half - mean_at) + 0.25 * taper * root
    return Trapezoid(
        (nose, 0.0, quarter_m[1]), (tip, half, quarter_m[1] - half * math.tan(dihedral_rad)), root, taper * root, 12, 5
    )
