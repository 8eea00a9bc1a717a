"""The boom's equations of motion: generated code against the derivation, Newton, energy and a pendulum."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from companion.geometry import Mat, Vec
from sim_bridge.plant import boom_derivation
from sim_bridge.plant.boom_dynamics import bias_forces, direction_of, energies_of, jacobian_of, masses_of
from sim_bridge.plant.boom_motion import integrate
from sim_bridge.plant.boom_records import PARAMETERS, PRESCRIBED, STATE, Record, record

BODY = (500.0, 4.4, 250.0, 3.8, 4343.0, 46.0)
"""Masses, centres of mass and inertias, as shipped."""
M_OUTER, COM_OUTER, M_INNER, COM_INNER, J_ACROSS, J_ALONG = BODY
G = 9.80665
NO_TURN = (0.0,) * 6


def test_generated_code_is_what_the_derivation_gives() -> None:
    assert boom_derivation.source() == boom_derivation.TARGET.read_text(encoding="utf-8")


def denavit_hartenberg(rows: list[tuple[float, float, float, float]]) -> Mat:
    T = np.eye(4)
    for a, alpha, d, theta in rows:
        turn, lift = np.eye(4), np.eye(4)
        turn[:3, :3] = Rotation.from_euler("z", theta).as_matrix()
        turn[2, 3] = d
        lift[:3, :3] = Rotation.from_euler("x", alpha).as_matrix()
        lift[0, 3] = a
        T = T @ turn @ lift
    return T


def test_table_2_1_is_the_booms_motion_in_erf_axes_once_its_base_is_turned() -> None:
    h = math.pi / 2
    elevation, azimuth, length = 0.5, 0.12, 11.0
    d1, d2, d3 = 3.0, -4.0, 5.0
    rows = [
        (0.0, h, d1, 0.0), (0.0, h, d2, h), (0.0, h, d3, 0.0),
        (0.0, -h, 0.0, math.pi - elevation), (0.0, -h, 0.0, azimuth - h), (0.0, h, length, h),
    ]  # fmt: skip
    base = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
    assert np.linalg.det(base) == pytest.approx(1.0)
    tip = base @ denavit_hartenberg(rows)[:3, 3]
    ca = math.cos(azimuth)
    reach = length * np.array([-ca * math.cos(elevation), math.sin(azimuth), ca * math.sin(elevation)])
    np.testing.assert_allclose(tip, np.array([d1, d2, d3]) + reach, atol=1e-12)
    np.testing.assert_allclose(direction_of(math.pi - elevation, azimuth - h), reach / length, atol=1e-12)
    unturned = denavit_hartenberg(rows[:3])[:3, 3]
    np.testing.assert_allclose(unturned, [d3, -d2, d1], atol=1e-12)


@given(st.floats(1.6, 3.0), st.floats(-2.0, -1.2))
def test_jacobian_is_the_directions_derivative(theta4: float, theta5: float) -> None:
    h = 1e-6
    by4 = (np.array(direction_of(theta4 + h, theta5)) - np.array(direction_of(theta4 - h, theta5))) / (2 * h)
    by5 = (np.array(direction_of(theta4, theta5 + h)) - np.array(direction_of(theta4, theta5 - h))) / (2 * h)
    np.testing.assert_allclose(jacobian_of(theta4, theta5), [*by4, *by5], atol=1e-8)


def point_masses(theta4: float, theta5: float, d6: float) -> list[tuple[float, Vec]]:
    """Both tubes as points (mass, place in tanker axes) of the same mass, centre and inertia."""
    along = np.array(direction_of(theta4, theta5))
    up = np.array(jacobian_of(theta4, theta5)[:3])
    up /= np.linalg.norm(up)
    points = []
    for m, com, share in ((M_OUTER, COM_OUTER, 0.7), (M_INNER, d6 - COM_INNER, 0.3)):
        across2 = share * J_ALONG / (4.0 * m / 6.0)
        along2 = share * J_ACROSS / (2.0 * m / 6.0) - across2
        for axis, arm2 in ((along, along2), (up, across2), (np.cross(along, up), across2)):
            points += [(m / 6.0, com * along + side * math.sqrt(arm2) * axis) for side in (1.0, -1.0)]
    return points


def test_equations_are_newtons_for_point_masses_on_a_tanker_that_turns_and_accelerates() -> None:
    """D'Alembert: the sum of m (a - g) along every point's derivative by a coordinate, a by differences in ERF."""
    rng = np.random.default_rng(7)
    for _ in range(20):
        q0, q1, q2 = np.array([2.5, -1.45, 11.0]) + rng.normal(0, 0.1, 3), rng.normal(0, 0.5, 3), rng.normal(0, 1, 3)
        P1, P2, w0, w1 = rng.normal(0, 50, 3), rng.normal(0, 5, 3), rng.normal(0, 0.5, 3), rng.normal(0, 0.5, 3)
        R0 = Rotation.random(rng=rng).as_matrix()

        def attitude(t: float, R0: Mat = R0, w0: Vec = w0, w1: Vec = w1) -> Mat:
            """omega(0) = w0, d omega / dt (0) = w1, in body axes."""
            return R0 @ Rotation.from_rotvec(w0 * t + 0.5 * w1 * t * t).as_matrix()

        def places(t: float, dq: Vec, q0: Vec = q0, q1: Vec = q1, q2: Vec = q2, P1: Vec = P1, P2: Vec = P2) -> Mat:
            q = q0 + q1 * t + 0.5 * q2 * t * t + dq
            R = attitude(t)
            return np.array([P1 * t + 0.5 * P2 * t * t + R @ p for _, p in point_masses(*q)])

        masses = np.array([m for m, _ in point_masses(*q0)])
        h, none = 2e-3, np.zeros(3)
        stencil = [(-2, -1 / 12), (-1, 16 / 12), (0, -30 / 12), (1, 16 / 12), (2, -1 / 12)]
        acceleration = sum(c * places(k * h, none) for k, c in stencil) / h**2
        pull = acceleration - np.array([0.0, 0.0, G])
        wanted = []
        for e in np.eye(3) * 1e-5:
            by = (places(0.0, e) - places(0.0, -e)) / 2e-5
            wanted.append(float(np.sum(masses[:, None] * pull * by)))
        f = R0.T @ (P2 - np.array([0.0, 0.0, G]))
        left = np.array(masses_of(*q0, *BODY)) * q2 + bias_forces(*q0, *q1, *BODY, *w0, *w1, *f)
        np.testing.assert_allclose(left, wanted, rtol=2e-5, atol=0.5)


def free_boom(gravity: Vec, turn: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> tuple[Record, Record, Record]:
    """Return (parameters, prescribed, state) of a boom in vacuum without friction or stops, at rest at 40 degrees."""
    par, given_, s = record(PARAMETERS), record(PRESCRIBED), record(STATE)
    for name, value in zip(("m_outer", "com_outer", "m_inner", "com_inner", "j_across", "j_along"), BODY, strict=True):
        par[name] = value
    par["stop_e_low"], par["stop_e_high"], par["stop_a"] = -9.0, 9.0, 9.0
    par["outer_length"], par["stop_length"], par["max_lift"] = -1e3, 1e3, 1.0
    s["theta4"], s["theta5"], s["d6"] = math.pi - 0.7, -1.4, 11.0
    s["f_x"], s["f_y"], s["f_z"] = -gravity
    s["p"], s["q"], s["r"] = turn
    return par, given_, s


def coordinates(s: Record) -> tuple[float, ...]:
    return tuple(float(s[n][0]) for n in ("theta4", "theta5", "d6", "rate4", "rate5", "rate6"))


def test_energy_is_kept_in_vacuum_with_the_pivot_fixed() -> None:
    gravity = np.array([0.3, -0.2, G])
    par, given_, s = free_boom(gravity)
    s["rate4"], s["rate5"], s["rate6"] = 0.2, -0.3, 0.5

    def energy() -> float:
        return sum(energies_of(*coordinates(s), *BODY, *(0.0,) * 6, *gravity))

    start, moved = energy(), 0.0
    for _ in range(400):
        integrate(par[0], given_[0], s[0], 0.005)
        kinetic, _ = energies_of(*coordinates(s), *BODY, *(0.0,) * 6, *gravity)
        moved = max(moved, kinetic)
    assert moved > 20e3
    assert energy() == pytest.approx(start, abs=1e-6 * moved)


def test_jacobis_energy_is_kept_on_a_tanker_that_turns_evenly_and_accelerates_evenly() -> None:
    """T2 - T0 + U, with gravity less the pivot's acceleration; turning about their direction keeps it even."""
    pull = np.array([1.5, 0.0, G])
    turn = 0.4 * pull / np.linalg.norm(pull)
    par, given_, s = free_boom(pull, tuple(turn.tolist()))
    s["rate4"], s["rate5"], s["rate6"] = -0.1, 0.2, -0.5

    def energy() -> float:
        q = coordinates(s)
        t2, potential = energies_of(*q, *BODY, *(0.0,) * 6, *pull)
        t0, _ = energies_of(*q[:3], 0.0, 0.0, 0.0, *BODY, *turn, 0.0, 0.0, 0.0, *pull)
        return t2 - t0 + potential

    start = energy()
    for _ in range(300):
        integrate(par[0], given_[0], s[0], 0.005)
    assert energy() == pytest.approx(start, abs=0.05)
    at_rest, _ = energies_of(*coordinates(s), *BODY, *(0.0,) * 6, *pull)
    assert at_rest > 10e3


def test_what_the_tanker_does_to_the_boom_is_the_power_that_it_gains() -> None:
    """dE/dt = sum over points of m (a - g) . (velocity of the tanker's frame there), for F = 0."""
    rng = np.random.default_rng(3)
    q, rates = np.array([2.6, -1.5, 10.5]), np.array([0.2, -0.1, 0.4])
    turn, turn_rate = rng.normal(0, 0.3, 3), rng.normal(0, 0.3, 3)
    speed, pull = rng.normal(0, 9, 3), rng.normal(0, 3, 3)
    gravity = np.array([0.5, 0.8, 9.7])
    f = pull - gravity
    acc = -np.array(bias_forces(*q, *rates, *BODY, *turn, *turn_rate, *f)) / np.array(masses_of(*q, *BODY))

    def at(t: float) -> tuple[Vec, Vec, Vec, Vec, Vec]:
        """Coordinates, rates, turning, pivot's speed and gravity along the tanker's axes, near t = 0."""
        speed_rate = pull - np.cross(turn, speed)
        return (q + rates * t + 0.5 * acc * t * t, rates + acc * t, turn + turn_rate * t, speed + speed_rate * t,
                gravity - np.cross(turn, gravity) * t)

    def energy(t: float) -> float:
        x, v, w, u, g = at(t)
        return sum(energies_of(*x, *v, *BODY, *w, *u, *g))

    h = 1e-4
    gained = (energy(h) - energy(-h)) / (2 * h)

    def momentum(t: float) -> tuple[Vec, Vec]:
        """Impulse and moment of momentum about the pivot, along the tanker's axes."""
        x, v, w, u, _ = at(t)
        e = 1e-6
        total, about = np.zeros(3), np.zeros(3)
        ahead, behind = point_masses(*(x + e * v)), point_masses(*(x - e * v))
        for (m, p), (_, a), (_, b) in zip(point_masses(*x), ahead, behind, strict=True):
            momentum_ = m * (u + np.cross(w, p) + (a - b) / (2 * e))
            total, about = total + momentum_, about + np.cross(p, momentum_)
        return total, about

    (L1, H1), (L0, H0), (L, H) = momentum(h), momentum(-h), momentum(0.0)
    masses = M_OUTER + M_INNER
    first = sum((m * p for m, p in point_masses(*q)), np.zeros(3))
    force = (L1 - L0) / (2 * h) + np.cross(turn, L) - masses * gravity
    moment = (H1 - H0) / (2 * h) + np.cross(turn, H) + np.cross(speed, L) - np.cross(first, gravity)
    # The potential is counted from the pivot's height, so the pivot's own fall is no loss.
    power = force @ speed + moment @ turn + masses * gravity @ speed
    assert gained == pytest.approx(power, rel=1e-5)


def test_small_swings_of_a_locked_boom_have_the_period_of_a_compound_pendulum() -> None:
    d6 = 12.0
    inertia = J_ACROSS + M_OUTER * COM_OUTER**2 + M_INNER * (d6 - COM_INNER) ** 2
    moment = M_OUTER * COM_OUTER + M_INNER * (d6 - COM_INNER)
    wanted = moment * G / inertia
    h = 1e-5
    for i in (0, 1):
        def acceleration(off: float, i: int = i) -> float:
            q = [0.5 * math.pi, -0.5 * math.pi, d6]
            q[i] += off
            bias = bias_forces(*q, 0.0, 0.0, 0.0, *BODY, *NO_TURN, 0.0, 0.0, -G)
            return -bias[i] / masses_of(*q, *BODY)[i]

        assert -(acceleration(h) - acceleration(-h)) / (2 * h) == pytest.approx(wanted, rel=1e-6)


@settings(max_examples=50)
@given(st.floats(0.1, 1.5), st.floats(-0.3, 0.3), st.floats(9.0, 14.0))
def test_telescope_falls_freely_along_the_boom_and_flies_out_when_spun(e: float, a: float, d6: float) -> None:
    q = (math.pi - e, a - 0.5 * math.pi, d6)
    down = direction_of(*q[:2])[2]
    h6 = bias_forces(*q, 0.0, 0.0, 0.0, *BODY, *NO_TURN, 0.0, 0.0, -G)[2]
    assert -h6 / masses_of(*q, *BODY)[2] == pytest.approx(G * down, rel=1e-9)
    h6 = bias_forces(*q, 0.0, 0.7, 0.0, *BODY, *NO_TURN, 0.0, 0.0, 0.0)[2]
    assert -h6 / M_INNER == pytest.approx(0.49 * (d6 - COM_INNER), rel=1e-9)
    assert bias_forces(*q, 0.3, 0.2, 0.1, *BODY, *NO_TURN, 0.0, 0.0, 0.0)[2] < 0.0
