"""After the warm-up nothing is compiled any more, whatever the camera shows: told in a process of its own."""

import subprocess
import sys

import pytest

PROGRAM = """
import sys
import numpy as np
import msgspec
from numba.core.dispatcher import Dispatcher
from companion.app import warm_up
from companion.config import FIRMWARE_CONFIGS, load_setup
from companion.geometry import SE3, exp_so3
from companion.messages import CameraFrame
from companion.vision.camera import T_frd_cam
from companion.vision.chain import VisionChain
from sim_bridge.plant.boom import nominal_boom
from sim_bridge.scene.camera_picture import CameraPicture

def compiled():
    return {(name, key): len(kernel.signatures) for name, module in list(sys.modules.items())
            if name.startswith("companion.") for key, kernel in vars(module).items() if isinstance(kernel, Dispatcher)}

solver, method, detector = sys.argv[1:]
setup = load_setup(FIRMWARE_CONFIGS / "sitl" / "thesis.toml")
vision = setup.config.vision
vision = msgspec.structs.replace(vision, solver=solver, detector=detector,
                                 labeling=msgspec.structs.replace(vision.labeling, method=method))
setup = msgspec.structs.replace(setup, config=msgspec.structs.replace(setup.config, vision=vision))
warm_up(setup)
before = compiled()
rng = np.random.default_rng(209)
picture = CameraPicture(setup.camera, setup.tanker, rng)
chain = VisionChain(setup.camera, setup.tanker, vision)
T_ned_tanker = SE3(np.eye(3), np.zeros(3))
posed = refused = 0
for k in range(120):
    place = np.array([-33.0, -1.0, 11.0]) - rng.uniform(0.0, 1.0) * np.array([17.0, 19.0, -19.0])
    T_ned_frd = SE3(exp_so3(rng.normal(0.0, 0.02, 3)), place)
    T = (T_ned_frd @ T_frd_cam(setup.camera)).inverse() @ T_ned_tanker
    image = picture.render(T_ned_tanker, T_ned_frd, nominal_boom(setup.tanker.boom))
    if k % 3 == 1:
        image[:, : rng.integers(320)] = 128
    if k % 7 == 2:
        image = rng.integers(0, 256, image.shape, dtype=np.uint8)
    prior = SE3(exp_so3(rng.normal(0.0, 0.004, 3)) @ T.R, T.t + rng.normal(0.0, [0.1, 3.0][k % 2], 3))
    out = chain.process(CameraFrame(k, k, image), prior, tracked=bool(k % 5))
    posed, refused = posed + (out.pose is not None), refused + (out.reject is not None)
print(posed, refused, {k: v for k, v in compiled().items() if v != before.get(k, 0)})
"""


@pytest.mark.parametrize(
    ("solver", "method", "detector"),
    [("lhm", "robust", "lights"), ("glsdc", "mutual_nearest", "lights"), ("lhm", "robust", "corners")],
)
def test_nothing_is_compiled_in_flight(solver, method, detector):
    call = [sys.executable, "-c", PROGRAM, solver, method, detector]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    posed, refused, late = done.stdout.strip().split(" ", 2)
    assert min(int(posed), int(refused)) >= 10
    assert late == "{}"


FLIGHT = """
import sys
import msgspec
from numba.core.dispatcher import Dispatcher
from companion.app import warm_up
from companion.messages import RelativeState
from sim_bridge.flight import Ending, LockstepCompanion, Unrecorded, run
from sim_bridge.margins import base
from sim_bridge.simulation import Simulation

def compiled():
    return {(name, key): len(kernel.signatures) for name, module in list(sys.modules.items())
            if name.startswith("companion.") for key, kernel in vars(module).items() if isinstance(kernel, Dispatcher)}

scenario, setup = base("docking", "attitude", 5.0)
warm_up(setup)
before, states = compiled(), []
companion = LockstepCompanion(setup, Unrecorded(), states.append)
run(Simulation(msgspec.structs.replace(scenario, seed=210), setup), companion, Ending(5.0, 6.0), lambda truth: None)
print(sum(isinstance(o, RelativeState) for o in states), {k: v for k, v in compiled().items() if v != before.get(k, 0)})
"""


def test_nothing_is_compiled_from_telemetry_to_setpoint():
    done = subprocess.run([sys.executable, "-c", FLIGHT], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    states, late = done.stdout.strip().split(" ", 1)
    assert int(states) > 200
    assert late == "{}"
