"""Lagrange's equations of the boom (thesis 2.2, eq. 2.1 and 2.2, Tab. 2.1), derived symbolically and written as code.

``python -m sim_bridge.plant.boom_derivation --write`` writes ``boom_dynamics.py``; a test derives again and compares.

Rules
-----
* Coordinates are the thesis': q = [d1 d2 d3 theta4 theta5 d6]. d1 d2 d3 are the pivot P in ERF, prescribed by the
  tanker (eq. 2.2); theta4, theta5 and d6 are solved for. Convention of Denavit and Hartenberg:
  A_i = Rot_z(theta_i) Trans_z(d_i) Trans_x(a_i) Rot_x(alpha_i).
* The table holds, with one thing that it does not say. Its joints 1, 2, 3 move along z0, -y0 and x0 of its own base
  frame, so [d1 d2 d3] are P in ERF (north, east, down), as the text has it, only when the base frame is ERF turned:
  x0 down, y0 west, z0 north (``BASE``).
  Then theta4 = pi - elevation (0 points ahead, pi aft, pi / 2 down), theta5 = azimuth - pi / 2, d6 = the whole length
  from P to the nozzle; elevation turns first, about the tanker's y axis, and azimuth is measured in the plane that
  elevation has tilted. Turning the last frame by pi / 2 about the boom changes nothing in the motion.
* The table has no rotation of the tanker: its angles are relative to ERF. Those that an operator sees and stops limit
  are relative to the tanker. So the tanker's attitude, prescribed like P, is put between joints 3 and 4, and theta4
  and theta5 are relative to the tanker. With a tanker that is level and does not turn this is the thesis' chain.
* Vectors are components along the tanker's axes (FRD). p, q, r: the tanker's angular velocity in them.
"""

from __future__ import annotations

import argparse
import textwrap
from pathlib import Path

import sympy as sp

TARGET = Path(__file__).with_name("boom_dynamics.py")
BASE = sp.Matrix([[0, 0, 1], [0, -1, 0], [1, 0, 0]])
"""Axes of the table's base frame, as columns in ERF (north, east, down)."""

d1, d2, d3, theta4, theta5, d6 = sp.symbols("d1 d2 d3 theta4 theta5 d6", real=True)
rate4, rate5, rate6 = sp.symbols("rate4 rate5 rate6", real=True)
acc4, acc5, acc6 = sp.symbols("acc4 acc5 acc6", real=True)
p, q, r, p_dot, q_dot, r_dot = sp.symbols("p q r p_dot q_dot r_dot", real=True)
u, v, w, a_x, a_y, a_z, g_x, g_y, g_z = sp.symbols("u v w a_x a_y a_z g_x g_y g_z", real=True)
f_x, f_y, f_z = sp.symbols("f_x f_y f_z", real=True)
m_outer, com_outer, m_inner, com_inner = sp.symbols("m_outer com_outer m_inner com_inner", positive=True)
j_across, j_along = sp.symbols("j_across j_along", positive=True)

TABLE = (
    (0, sp.pi / 2, d1, 0),
    (0, sp.pi / 2, d2, sp.pi / 2),
    (0, sp.pi / 2, d3, 0),
    (0, -sp.pi / 2, 0, theta4),
    (0, -sp.pi / 2, 0, theta5),
    (0, sp.pi / 2, d6, sp.pi / 2),
)
"""Thesis Tab. 2.1: a, alpha, d, theta of the six joints."""
COORDINATES = (theta4, theta5, d6)
RATES = (rate4, rate5, rate6)
ACCELERATIONS = (acc4, acc5, acc6)
BODY = (m_outer, com_outer, m_inner, com_inner, j_across, j_along)
TURN = (p, q, r, p_dot, q_dot, r_dot)
SPECIFIC_FORCE = (f_x, f_y, f_z)


def link(a: sp.Expr, alpha: sp.Expr, d: sp.Expr, theta: sp.Expr) -> sp.Matrix:
    """Return A_i (4, 4) of one row of the table."""
    ct, st, ca, sa = sp.cos(theta), sp.sin(theta), sp.cos(alpha), sp.sin(alpha)
    return sp.Matrix([[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]])


def chain(first: int, last: int) -> sp.Matrix:
    """Return A_first ... A_last (4, 4), joints counted from 1 as in the table."""
    product = sp.eye(4)
    for row in TABLE[first - 1 : last]:
        product = product * link(*row)
    return product


def hinge() -> sp.Matrix:
    """Return the axes of frame 3 (columns) along the tanker's: what is left of joints 1 to 3 without translation."""
    return BASE * chain(1, 3)[:3, :3]


def nozzle() -> sp.Matrix:
    """Return P to nozzle (3,) in tanker axes."""
    return (hinge() * chain(4, 6)[:3, 3]).applyfunc(sp.simplify)


def rate_of(x: sp.Matrix) -> sp.Matrix:
    """Return the rate of change of the components of x(q)."""
    return sum((x.diff(c) * s for c, s in zip(COORDINATES, RATES, strict=True)), sp.zeros(*x.shape))


def energies() -> tuple[sp.Expr, sp.Expr]:
    """Return T and U (J) of both tubes; U without the height of P, which no coordinate changes.

    ``u v w``: the pivot's velocity relative to ERF; ``g_x g_y g_z``: gravity; both along the tanker's axes.
    """
    turn, velocity, gravity = sp.Matrix([p, q, r]), sp.Matrix([u, v, w]), sp.Matrix([g_x, g_y, g_z])
    along = nozzle() / d6
    places = ((m_outer, com_outer * along), (m_inner, (d6 - com_inner) * along))
    kinetic = potential = sp.Integer(0)
    for mass, place in places:
        speed = velocity + turn.cross(place) + rate_of(place)
        kinetic += mass * speed.dot(speed) / 2
        potential -= mass * gravity.dot(place)
    frame4 = hinge() * chain(4, 4)[:3, :3]
    frame5 = hinge() * chain(4, 5)[:3, :3]
    spin = frame5.T * (turn + rate4 * hinge()[:, 2] + rate5 * frame4[:, 2])
    kinetic += (j_across * (spin[0] ** 2 + spin[1] ** 2) + j_along * spin[2] ** 2) / 2
    return kinetic, potential


def total_rate(x: sp.Expr) -> sp.Expr:
    """Return dx/dt: coordinates, rates, the tanker's turning, and P, whose components turn with it (eq. 2.2)."""
    turn, velocity, pull = sp.Matrix([p, q, r]), sp.Matrix([u, v, w]), sp.Matrix([a_x, a_y, a_z])
    velocity_rate = pull - turn.cross(velocity)
    moving = [*COORDINATES, *RATES, p, q, r, u, v, w]
    rates = [*RATES, *ACCELERATIONS, p_dot, q_dot, r_dot, *velocity_rate]
    return sum((x.diff(c) * s for c, s in zip(moving, rates, strict=True)), sp.Integer(0))


def equations() -> tuple[sp.Matrix, sp.Matrix]:
    """Return M (3, 3), which comes out diagonal, and h (3,) of M [theta4'' theta5'' d6''] + h = F from eq. 2.1.

    The pivot's acceleration and gravity act only as their difference, the specific force f that an accelerometer at P
    feels, and its velocity not at all: both are shown here, by having them drop out, and not assumed.
    """
    kinetic, potential = energies()
    lagrangian = kinetic - potential
    rows = [
        total_rate(lagrangian.diff(rate)) - lagrangian.diff(c) for c, rate in zip(COORDINATES, RATES, strict=True)
    ]
    left = sp.Matrix(rows).subs({a_x: f_x + g_x, a_y: f_y + g_y, a_z: f_z + g_z})
    for gone in (u, v, w, g_x, g_y, g_z):
        if any(sp.trigsimp(sp.expand(row.diff(gone))) != 0 for row in left):
            msg = f"{gone} is left in the equations of motion"
            raise AssertionError(msg)
    left = left.subs(dict.fromkeys((u, v, w, g_x, g_y, g_z), 0))
    mass = left.jacobian(ACCELERATIONS).applyfunc(sp.trigsimp)
    if not mass.is_diagonal():
        msg = "the mass matrix is not diagonal"
        raise AssertionError(msg)
    return mass, left.subs(dict.fromkeys(ACCELERATIONS, 0)).applyfunc(tidy)


def tidy(row: sp.Expr) -> sp.Expr:
    """Return ``row`` as a sum over products of rates and accelerations, each with a short factor.

    Sines and cosines are handled as unknowns of polynomials with sin^2 + cos^2 = 1, which is fast.
    """
    waves = {f(angle): sp.Symbol(f"{f}_{angle}") for angle in (theta4, theta5) for f in (sp.sin, sp.cos)}
    sin4, cos4, sin5, cos5 = waves.values()
    circles = (cos4**2 + sin4**2 - 1, cos5**2 + sin5**2 - 1)
    back = {plain: wave for wave, plain in waves.items()}
    moving = (*RATES, *TURN, *SPECIFIC_FORCE)
    total = sp.Integer(0)
    for powers, factor in sp.Poly(sp.expand(row).subs(waves), *moving).terms():
        _, short = sp.reduced(factor, circles, cos4, cos5, sin4, sin5)
        total += sp.factor(short).subs(back) * sp.prod(x**n for x, n in zip(moving, powers, strict=True))
    return sp.factor_terms(total)


HEAD = '''"""Written by ``python -m sim_bridge.plant.boom_derivation --write``; change the derivation and not this file.

Equations of motion of the boom, M [theta4'' theta5'' d6''] + h = F (thesis 2.2): see the derivation for the coordinates
and what is prescribed. Units: m, rad, s, kg, kg m2, J.
"""

from __future__ import annotations

from math import cos, sin

from numba import njit

'''


def function(name: str, doc: str, arguments: tuple[sp.Symbol, ...], results: list[sp.Expr]) -> str:
    """Return the text of one compiled function of floats that returns the ``results`` as a tuple."""
    symbols = (sp.Symbol(f"s{k}") for k in range(10_000))
    shared, reduced = sp.cse(results, symbols=symbols, optimizations="basic")
    lines = [(str(name), code_of(value)) for name, value in shared]
    lines += [(f"out{k}", code_of(value)) for k, value in enumerate(reduced)]
    signature = ", ".join(f"{a}:~float" for a in arguments)
    returned = ", ".join(f"out{k}" for k in range(len(reduced)))
    kind = "float, " * (len(reduced) - 1) + "float"
    head = wrapped(f"def {name}(", signature, f") -> tuple[{kind}]:", "")
    body = "".join(assignment(*line) for line in lines)
    return f'@njit(cache=True, nogil=True)\n{head}    """{doc}"""\n{body}    return {returned}\n'


def code_of(value: sp.Expr) -> str:
    """Return the text of a float."""
    return "0.0" if value == 0 else sp.pycode(value, fully_qualified_modules=False)


def assignment(name: str, value: str) -> str:
    """Return ``name = value`` as one line, or in brackets over several."""
    line = f"    {name} = {value}\n"
    return line if len(line) <= 121 else wrapped(f"    {name} = (", value, ")", "    ")


def wrapped(before: str, text: str, after: str, indent: str) -> str:
    """Return ``text`` over several lines, further in than ``indent``; ``~`` in it is a space that does not break."""
    inner = textwrap.fill(text, 116, initial_indent=indent + "    ", subsequent_indent=indent + "    ",
                          break_long_words=False, break_on_hyphens=False)
    return f"{before}\n{inner}\n{indent}{after}\n".replace("~", " ")


def source() -> str:
    """Return the text of ``boom_dynamics.py``."""
    mass, bias = equations()
    kinetic, potential = energies()
    along = nozzle() / d6
    parts = [
        function("direction_of", "Return the unit vector from P to the nozzle, in tanker axes.",
                 (theta4, theta5), list(along)),
        function("jacobian_of", "Return d(direction)/d(theta4) and d(direction)/d(theta5), in tanker axes.",
                 (theta4, theta5), [*along.diff(theta4), *along.diff(theta5)]),
        function("masses_of", "Return the diagonal of M, which has nothing else.", (theta4, theta5, d6, *BODY),
                 list(mass.diagonal())),
        function("bias_forces", "Return h4, h5, h6; f: specific force at P, p q r: the tanker's turning.",
                 (*COORDINATES, *RATES, *BODY, *TURN, *SPECIFIC_FORCE), list(bias)),
        function("energies_of", "Return T and U, U from the height of P; u v w: velocity of P, g: gravity.",
                 (*COORDINATES, *RATES, *BODY, p, q, r, u, v, w, g_x, g_y, g_z), [kinetic, potential]),
    ]
    return HEAD + "\n" + "\n\n".join(parts)


def main() -> None:
    """Write the code, or say whether it is what the derivation gives."""
    parser = argparse.ArgumentParser(description="Derive the boom's equations of motion.")
    parser.add_argument("--write", action="store_true", help="write boom_dynamics.py")
    text = source()
    if parser.parse_args().write:
        TARGET.write_text(text, encoding="utf-8")
    elif text != TARGET.read_text(encoding="utf-8"):
        parser.exit(1, f"{TARGET.name} is not what the derivation gives; run with --write\n")


if __name__ == "__main__":
    main()
