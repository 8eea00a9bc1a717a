"""A joystick on a real socket works the boom of a served simulation."""

import socket

import msgspec

from companion.io.mavlink_codec import MavlinkCodec, dialect
from companion.io.transport import UdpTransport
from sim_bridge.plant.conditions import BoomConditions, PlantConditions
from sim_bridge.scenario import load_scenario
from sim_bridge.serve import Wires, _exchange
from sim_bridge.simulation import Simulation
from sim_bridge.stick import StickPort

STEPS = 500


def test_pulling_back_raises_the_boom_and_pushing_lowers_it():
    plant = PlantConditions(boom=BoomConditions(operator="joystick"))
    scenario = msgspec.structs.replace(load_scenario("docking"), plant=plant, vision_input="detections", seed=241)
    elevation = {x: fly_with_stick(scenario, x) for x in (-400, 0, 400)}
    assert elevation[-400] < elevation[0] - 0.02  # elevation is down from the tanker's x axis
    assert elevation[400] > elevation[0] + 0.02


def fly_with_stick(scenario, x):
    """Return the boom's elevation after 2.5 s with the stick held at ``x``."""
    simulation = Simulation(scenario, scenario.setup())
    transport, stick = UdpTransport("mavlink", "udpin:127.0.0.1:0"), StickPort("udpin:127.0.0.1:0")
    codec = MavlinkCodec(255, 190)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            for k in range(STEPS):
                if k % 20 == 0:
                    sock.sendto(codec.pack(dialect.MAVLink_manual_control_message(1, x, 0, 500, 0, 0)), stick.local)
                _exchange(simulation, Wires(transport, None, stick))  # nothing is photographed: detections
    finally:
        transport.close()
        stick.close()
    return simulation.truth.boom.elevation_rad
