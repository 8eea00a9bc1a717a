"""What was found about an aircraft, as text for people."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from sim_bridge.linearize.model import STATES, Condition, Mode, coupling
from sim_bridge.linearize.published import PUBLISHED
from sim_bridge.linearize.receiver import Linearization
from sim_bridge.linearize.tanker import INPUTS, TankerModel
from sim_bridge.truth import EFFECTORS


def report(result: Linearization) -> str:
    """Return trim, modes beside the thesis' structure, decoupling, closed loops, A and B of the receiver."""
    a = result.airframe
    surfaces = zip(EFFECTORS[1:], a.trim.effectors[1:], strict=True)
    lines = [
        *headline(a.name, a.trim.airspeed_m_s, a.mass_kg, result.condition),
        f"trim: alpha {math.degrees(a.trim.alpha_rad):.3f} deg, throttle {a.trim.throttle:.3f}, "
        f"residual {result.residual:.1e}",
        "      " + ", ".join(f"{name} {math.degrees(v):.2f}" for name, v in surfaces) + " deg",
        *mode_table(result.modes),
        *structure_table(result.modes),
        *coupling_line(a.A),
    ]
    r = a.response
    if result.condition.designed:
        lines += [
            "",
            f"closed attitude loops: roll {r.roll_rad_s:.2f} rad/s damping {r.roll_damping:.2f}, "
            f"pitch {r.pitch_rad_s:.2f} rad/s damping {r.pitch_damping:.2f}, "
            f"thrust lag {r.thrust_lag_s:.2f} s, delay {r.delay_s * 1e3:.0f} ms",
        ]
    lines += matrix("A (columns: states)", STATES, STATES, a.A)
    lines += matrix("B (columns: throttle 0..1, surfaces rad)", STATES, EFFECTORS, a.B)
    return "\n".join(lines)


def tanker_report(result: TankerModel) -> str:
    """Return trim, modes beside published aircraft's, decoupling, A and B of the tanker."""
    x, u = result.trim.x, result.trim.u
    lines = [
        *headline("kc135r", float(x[0]), result.mass_kg, result.condition),
        f"trim: alpha {math.degrees(x[1]):.3f} deg, elevator {math.degrees(u[1]):.3f} deg, "
        f"thrust {u[0] * 100.0:.1f} kN, residual {result.trim.residual:.1e}",
        *mode_table(result.modes),
        "",
        "beside it, by the textbook's equations from published derivatives:",
    ]
    for aircraft in (result.textbook, *PUBLISHED):
        lines += [*mode_table(aircraft.modes(), aircraft.name), f"  ({aircraft.source})"]
    lines += coupling_line(result.A.tolist())
    lines += matrix("A (columns: states)", STATES, STATES, result.A.tolist())
    lines += matrix("B (columns: thrust 100 kN, surfaces rad)", STATES, INPUTS, result.B.tolist())
    return "\n".join(lines)


def headline(name: str, speed_m_s: float, mass_kg: float, condition: Condition) -> list[str]:
    """Return what was linearised, where, and with which coefficients changed."""
    changed = [f"{key} x {factor:g}" for key, factor in condition.factors.items()]
    first = f"{name} at {speed_m_s:.2f} m/s (Mach {condition.mach:g}), {condition.altitude_m:.0f} m, {mass_kg:.0f} kg"
    return [first, *([f"with {', '.join(changed)}"] if changed else [])]


def mode_table(modes: Iterable[Mode], title: str = "mode") -> list[str]:
    """Return a line for each mode."""
    lines = ["", f"{title:36} {'eigenvalue (1/s)':>22} {'frequency':>10} {'damping':>8}"]
    for mode in modes:
        v = mode.eigenvalue
        text = f"{v.real:+.4f}" + (f" +- {v.imag:.4f}j" if v.imag else "")
        lines.append(f"{mode.name:36} {text:>22} {abs(v):10.4f} {-v.real / abs(v):8.3f}")
    return lines


def structure(modes: Sequence[Mode]) -> list[tuple[str, str, bool]]:
    """Return what the thesis says of the modes, what is found, and whether it holds (3.7, 3.8)."""
    found = {m.name: m.eigenvalue for m in modes}
    rows = []
    for name in ("short period", "phugoid"):
        v = found.get(name)
        text = "none" if v is None else f"{v.real:+.3f} +- {v.imag:.3f}j"
        rows.append((f"3.7 {name}: complex pair", text, v is not None))
    lateral = sorted(m.eigenvalue.real for m in modes if m.name == "lateral" and not m.eigenvalue.imag)
    signs = ("3.8 lambda_4 < 0", "3.8 lambda_5 < 0", "3.8 lambda_3 > 0", "3.8 lambda_6 > 0")
    for k, text in enumerate(signs):
        holds = len(lateral) == 4 and (lateral[k] < 0.0) == (k < 2)
        rows.append((text, f"{lateral[k]:+.3f}" if len(lateral) == 4 else f"{len(lateral)} real", holds))
    return rows


def structure_table(modes: Sequence[Mode]) -> list[str]:
    """Return the thesis' structure of modes beside what is found."""
    lines = ["", f"{'thesis':36} {'found':>22}"]
    for text, found, holds in structure(modes):
        lines.append(f"{text:36} {found:>22}   {'holds' if holds else 'FAILS'}")
    return lines


def coupling_line(A: Sequence[Sequence[float]]) -> list[str]:
    """Return how far the planes are decoupled."""
    worst, name = coupling(np.array(A))
    where = f" ({name})" if worst else ""
    return ["", f"largest entry that couples longitudinal and lateral motion: {worst:.1e} of its row's largest{where}"]


def matrix(title: str, rows: Sequence[str], columns: Sequence[str], values: Sequence[Sequence[float]]) -> list[str]:
    """Return the lines of a table of ``values`` (rows, columns)."""
    head = " " * 7 + "".join(f"{name:>10}" for name in columns)
    body = [f"{name:7}" + "".join(f"{v:10.4f}" for v in row) for name, row in zip(rows, values, strict=True)]
    return ["", title, head, *body]
