"""Laws that any flight has to obey: mirror images, energy, momentum. Of JSBSim with our data, without autopilots."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.geometry import GRAVITY_M_S2
from sim_bridge.linearize import LATERAL, linearize
from sim_bridge.plant.fdm import Fdm, InitialCondition
from sim_bridge.plant.tanker import INPUTS as TANKER_INPUTS
from sim_bridge.plant.world import ALTITUDE_M, CALM_WAKE, UAV_INPUTS
from sim_bridge.truth import BodyState

DT = 0.005
Values = tuple[float, ...]
RECEIVER = Fdm("ice101", UAV_INPUTS, DT, ALTITUDE_M)
TANKER = Fdm("kc135r", TANKER_INPUTS, DT, ALTITUDE_M)

small = st.floats(-0.2, 0.2)
state = st.tuples(st.floats(170.0, 240.0), *(small,) * 8)
"""u (m/s), v / u, w / u, yaw, pitch, roll (rad), p, q, r (rad/s)."""


def accelerations(fdm: Fdm, x: Values, u: Values, gust: Values) -> np.ndarray:
    """Return u', v', w', p', q', r'; ``gust`` is three velocities (ned, m/s) and three rates (rad/s)."""
    speed, side, down, *rest = x
    fdm.set_inputs(u)
    fdm.set_gust(*gust[:3])
    fdm.set_rotary_gust(*gust[3:])
    v_body = (speed, side * speed, down * speed)
    fdm.reset(InitialCondition((0.0, 0.0, 0.0), v_body, tuple(rest[:3]), tuple(rest[3:])))  # type: ignore[arg-type]  # 3 each
    return np.concatenate(fdm.accelerations())


def mirrored_state(x: Values) -> Values:
    u, v, w, yaw, pitch, roll, p, q, r = x
    return (u, -v, w, -yaw, pitch, -roll, -p, q, -r)


def mirrored_gust(g: Values) -> Values:
    n, e, d, p, q, r = g
    return (n, -e, d, -p, q, -r)


MIRROR = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
gusts = st.tuples(*(st.floats(-5.0, 5.0),) * 3, *(small,) * 3)


@settings(max_examples=60)
@given(
    x=state,
    u=st.tuples(st.floats(0.0, 1.0), *(st.floats(-0.5, 0.5),) * 9),
    wake=st.tuples(*(st.floats(-0.05, 0.05),) * 6),
    gust=gusts,
)
def test_receiver_mirrors(x: Values, u: Values, wake: Values, gust: Values) -> None:
    throttle, amt_r, amt_l, tef_r, tef_l, lef_r, lef_l, pf, ssd_r, ssd_l = u
    swapped = (throttle, amt_l, amt_r, tef_l, tef_r, lef_l, lef_r, pf, ssd_l, ssd_r)
    drag, lift, pitch, roll, yaw, side = wake
    here = accelerations(RECEIVER, x, (*u, *wake), gust)
    there = accelerations(
        RECEIVER, mirrored_state(x), (*swapped, drag, lift, pitch, -roll, -yaw, -side), mirrored_gust(gust)
    )
    np.testing.assert_allclose(there, MIRROR * here, rtol=1e-9, atol=1e-9)


@settings(max_examples=60)
@given(x=state, u=st.tuples(st.floats(0.0, 4e4), *(st.floats(-0.3, 0.3),) * 3), gust=gusts)
def test_tanker_mirrors(x: Values, u: Values, gust: Values) -> None:
    thrust, elevator, aileron, rudder = u
    here = accelerations(TANKER, x, u, gust)
    there = accelerations(TANKER, mirrored_state(x), (thrust, elevator, -aileron, -rudder), mirrored_gust(gust))
    np.testing.assert_allclose(there, MIRROR * here, rtol=1e-9, atol=1e-9)


@pytest.fixture(scope="module")
def flight() -> list[BodyState]:
    """Two seconds of the bare receiver from a bank, flaps moved at a quarter of them; thrust stays."""
    trim = linearize().airframe.trim
    fdm = Fdm("ice101", UAV_INPUTS, DT, ALTITUDE_M)
    u = np.array(trim.effectors)
    fdm.set_inputs((*u.tolist(), *CALM_WAKE))
    v_body = (trim.airspeed_m_s * math.cos(trim.alpha_rad), 0.0, trim.airspeed_m_s * math.sin(trim.alpha_rad))
    fdm.reset(InitialCondition((0.0, 0.0, 0.0), v_body, (0.3, trim.alpha_rad, 0.2)))
    track = []
    for k in range(400):
        track.append(fdm.state(k))
        if k == 100:
            u[[3, 7]] += (0.02, -0.03)
            fdm.set_inputs((*u.tolist(), *CALM_WAKE))
        fdm.step()
    return track


def test_energy_changes_by_the_power_of_air_and_engine(flight: list[BodyState]) -> None:
    energy = np.array([0.5 * s.v_ned_m_s @ s.v_ned_m_s - GRAVITY_M_S2 * s.p_ned_m[2] for s in flight])
    power = np.array([s.R_ned_body @ s.specific_force_body_m_s2 @ s.v_ned_m_s for s in flight])
    work = np.concatenate(([0.0], np.cumsum(0.5 * (power[1:] + power[:-1]) * DT)))
    assert np.ptp(energy) > 30.0  # J/kg: it did change
    np.testing.assert_allclose(energy - energy[0], work, atol=2e-4 * np.ptp(energy))


def test_momentum_changes_by_force_and_weight(flight: list[BodyState]) -> None:
    v = np.array([s.v_ned_m_s for s in flight])
    force = np.array([s.R_ned_body @ s.specific_force_body_m_s2 for s in flight])
    force[:, 2] += GRAVITY_M_S2
    found = (v[2:] - v[:-2]) / (2.0 * DT)
    smooth = np.abs(np.arange(1, 399) - 101) > 3  # not across the step of the flaps
    assert np.abs(force).max() > 2.0
    np.testing.assert_allclose(found[smooth], force[1:-1][smooth], atol=2e-3)


def test_position_is_the_integral_of_velocity(flight: list[BodyState]) -> None:
    v = np.array([s.v_ned_m_s for s in flight])
    p = np.array([s.p_ned_m for s in flight])
    np.testing.assert_allclose(p[1:] - p[:-1], 0.5 * (v[1:] + v[:-1]) * DT, atol=1e-9)


@pytest.mark.parametrize("which", [-1, -2], ids=["faster", "slower"])
def test_bare_receiver_diverges_as_its_unstable_modes_say(which: int) -> None:
    # Thesis 3.8: two unstable real modes. A flight that starts along one of them goes with exp(lambda t), alone.
    airframe = linearize().airframe
    values, vectors = np.linalg.eig(np.array(airframe.A)[np.ix_(LATERAL, LATERAL)])
    order = np.argsort(values.real)
    growth, shape = float(values.real[order[which]]), vectors.real[:, order[which]]
    beta, p, r, roll = 0.002 * shape / np.abs(shape).max()
    V, alpha = airframe.trim.airspeed_m_s, airframe.trim.alpha_rad
    fdm = Fdm("ice101", UAV_INPUTS, DT, ALTITUDE_M)
    fdm.set_inputs((*airframe.trim.effectors, *CALM_WAKE))
    v_body = (V * math.cos(alpha) * math.cos(beta), V * math.sin(beta), V * math.sin(alpha) * math.cos(beta))
    fdm.reset(InitialCondition((0.0, 0.0, 0.0), v_body, (0.0, alpha, float(roll)), (float(p), 0.0, float(r))))
    for _ in range(round(2.0 / DT)):
        fdm.step()
    assert growth > 0.05
    assert fdm.roll == pytest.approx(roll * math.exp(2.0 * growth), rel=0.03)
