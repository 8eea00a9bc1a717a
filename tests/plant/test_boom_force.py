"""What a force at the receptacle does to the receiver: F/m, and J^-1 (r x F)."""

import numpy as np
import pytest

from sim_bridge.plant.aircraft_data import read_aircraft
from sim_bridge.plant.fdm import Fdm, InitialCondition
from sim_bridge.plant.world import ALTITUDE_M, UAV_INPUTS

LEVEL = InitialCondition((0.0, 0.0, 0.0), (205.0, 0.0, 15.8), (0.3, 0.08, 0.05))


def accelerations(fdm, force_n):
    """Return the rates of change of u v w (3,) and of p q r (3,) at once under ``force_n``."""
    fdm.set_boom_force(force_n)
    fdm.reset(LEVEL)
    return tuple(np.array(rates) for rates in fdm.accelerations())


@pytest.mark.parametrize("at_frd_m", [(2.0, 0.0, -1.0), (-3.0, 1.5, 0.5)])
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_kilonewton_at_the_receptacle_pushes_and_turns(at_frd_m, axis, sign):
    data = read_aircraft("ice101")
    ixx, iyy, izz, ixz = data.inertia_kg_m2
    J = np.array([[ixx, 0.0, -ixz], [0.0, iyy, 0.0], [-ixz, 0.0, izz]])
    force_n = sign * 1000.0 * np.eye(3)[axis]
    fdm = Fdm("ice101", UAV_INPUTS, 0.005, ALTITUDE_M)
    fdm.set_receptacle(at_frd_m)
    free, pushed = accelerations(fdm, (0.0, 0.0, 0.0)), accelerations(fdm, tuple(force_n.tolist()))
    np.testing.assert_allclose(pushed[0] - free[0], force_n / data.mass_kg, atol=1e-6)
    np.testing.assert_allclose(pushed[1] - free[1], np.linalg.solve(J, np.cross(at_frd_m, force_n)), atol=1e-7)


def test_forces_add_up_and_end():
    fdm = Fdm("ice101", UAV_INPUTS, 0.005, ALTITUDE_M)
    fdm.set_receptacle((2.0, 0.0, -1.0))
    free = accelerations(fdm, (0.0, 0.0, 0.0))
    parts = [accelerations(fdm, f) for f in ((900.0, 0.0, 0.0), (0.0, -400.0, 0.0), (0.0, 0.0, 700.0))]
    whole = accelerations(fdm, (900.0, -400.0, 700.0))
    for k in range(2):
        np.testing.assert_allclose(whole[k] - free[k], sum(p[k] - free[k] for p in parts), atol=1e-9)
    again = accelerations(fdm, (0.0, 0.0, 0.0))
    np.testing.assert_allclose(again, free, atol=1e-12)
