"""The regulator of the surfaces in a bare loop: plant, INS and offsets as the companion sends them, nothing else.

``scan`` prints what weights do; as a program this prints it for those in force, in three kinds of weather and for each
of them halved and doubled. Tune on seeds from 1000 on.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, fields, replace

import msgspec
import numpy as np
from scipy.linalg import expm

from companion.config import Setup
from companion.geometry import Mat, Vec, rotation_from_euler
from sim_bridge.autopilot.regulator import Cures, RegulatorWeights, SurfaceRegulator, augmented, design
from sim_bridge.autopilot.setpoints import OffsetCommand
from sim_bridge.plant.actuators import ActuatorConfig, default_channels
from sim_bridge.plant.fdm import PlantError
from sim_bridge.plant.world import World
from sim_bridge.scenario import load_scenario
from sim_bridge.sensors import InertialSample, InertialSensor, Triple
from sim_bridge.truth import BodyState, Truth

DT_S = 0.005
LOST_M = 30.0


@dataclass(frozen=True)
class Conditions:
    """What the regulator meets. ``air_data``: V, alpha, beta as a probe would tell them. ``heading_of_tanker``: the
    formation's heading is where the tanker points now, as the thesis has it, and not its course; it swings by
    ``yaw_swing_rad`` beyond what the gusts do, once in 5 s.
    """

    turbulence: str = "light"
    wake: bool = True
    air_data: bool = False
    heading_of_tanker: bool = False
    yaw_swing_rad: float = 0.0
    extra_actuator_delay_s: float = 0.0
    offset_age_s: float = 0.03
    offset_every: int = 4
    fix_every: int = 10
    fix_age_s: float = 0.03
    fix_sigma_m: float = 0.01
    start_br_m: Triple = (0.0, 0.0, 0.0)


def actuators_with(extra_delay_s: float) -> ActuatorConfig:
    return ActuatorConfig(tuple(replace(c, delay_s=c.delay_s + extra_delay_s) for c in default_channels()))


class Loop:
    """One flight that starts with the receptacle in the box, or ``start_br_m`` from it."""

    def __init__(self, setup: Setup, seed: int, conditions: Conditions) -> None:
        gust, own, tanker, vision = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(4))
        self._c = conditions
        self._box, self._arm = np.array(setup.tanker.box_tanker_m), np.array(setup.airframe.receptacle_frd_m)
        start = self._box - self._arm + conditions.start_br_m
        self.world = World(
            setup.tanker, setup.airframe, start, conditions.turbulence, conditions.wake, gust,
            actuators=actuators_with(conditions.extra_actuator_delay_s),
        )  # fmt: skip
        self._own, self._tanker, self._vision = InertialSensor(own), InertialSensor(tanker), vision
        self._fixes: deque[tuple[int, Vec]] = deque()
        self._sent: deque[tuple[int, OffsetCommand]] = deque()
        self._travel, self._fix = np.zeros(3), np.zeros(3)
        self._k = 0
        self._command: OffsetCommand | None = None

    def br(self, truth: Truth) -> Vec:
        uav, tanker = truth.uav, truth.tanker
        return uav.p_ned_m + uav.R_ned_body @ self._arm - tanker.p_ned_m - tanker.R_ned_body @ self._box

    def offset(self, truth: Truth, sample: InertialSample) -> OffsetCommand | None:
        """Return what the companion would have sent last: a fix of some age, carried on by both velocities."""
        c, k = self._c, self._k
        told = self._tanker.sample(truth.tanker)
        if self._command is None or k % c.offset_every == 0:
            self._place_v = told.v_ned_m_s
        self._travel = self._travel + DT_S * (np.array(sample.v_ned_m_s) - self._place_v)
        here = self._travel + rotation_from_euler(*sample.euler_rad) @ self._arm
        if k % c.fix_every == 0:
            fix = self.br(truth) + c.fix_sigma_m * self._vision.standard_normal(3)
            self._fixes.append((k + round(c.fix_age_s / DT_S) * (k > 0), fix - here))
        while self._fixes and self._fixes[0][0] <= k:
            self._fix = self._fixes.popleft()[1]
        if k % c.offset_every == 0:
            swing = c.yaw_swing_rad * math.sin(0.4 * math.pi * truth.t_ns * 1e-9)
            heading = told.euler_rad[0] + swing if c.heading_of_tanker else 0.0
            x, y, z = (-(self._fix + here)).tolist()
            command = OffsetCommand(truth.t_ns, (x, y, z), self._place_v, heading)
            self._sent.append((k + round(c.offset_age_s / DT_S) * (k > 0), command))
        while self._sent and self._sent[0][0] <= k:
            self._command = self._sent.popleft()[1]
        self._k += 1
        return self._command

    def fly(self, regulator: SurfaceRegulator, seconds: float) -> Mat:
        """Return BR (n, 3) every step; shorter than asked for when the receiver was lost."""
        track = []
        for _ in range(round(seconds / DT_S)):
            truth = self.world.truth
            sample = self._own.sample(truth.uav)
            regulator.watch(sample, rotation_from_euler(*sample.euler_rad))
            command = self.offset(truth, sample)
            assert command is not None
            track.append(self.br(truth))
            if np.abs(track[-1]).max() > LOST_M:
                break
            if self._c.air_data:
                sample = with_air_data(sample, truth.uav)
            try:
                self.world.step(regulator.step(command, sample))
            except PlantError:
                break
        return np.array(track)


def with_air_data(sample: InertialSample, truth: BodyState) -> InertialSample:
    """Return the sample with V, alpha and beta of the motion through the air, gusts included."""
    u, v, w = truth.v_air_body_m_s.tolist()
    speed = math.sqrt(u * u + v * v + w * w)
    alpha, beta = math.atan2(w, u), math.asin(v / speed)
    return msgspec.structs.replace(sample, speed_m_s=speed, alpha_rad=alpha, beta_rad=beta)


def fly(
    setup: Setup, seed: int, seconds: float, weights: RegulatorWeights | None = None, cures: Cures | None = None,
    **conditions: object,
) -> Mat:  # fmt: skip
    """Return BR (n, 3) of one flight; ``conditions`` as in ``Conditions``."""
    regulator = SurfaceRegulator(setup.airframe, DT_S, weights, cures)
    return Loop(setup, seed, Conditions(**conditions)).fly(regulator, seconds)


def share_inside(br: Mat, half_m: Triple, seconds: float) -> float:
    """Return the share of the asked time that was flown inside +-half_m."""
    return float((np.abs(br) <= np.array(half_m)).all(axis=1).sum()) / round(seconds / DT_S)


def delay_margin_s(setup: Setup, weights: RegulatorWeights) -> float:
    """Return by how much the actuators' delay may grow before the linear loop, with lags and delay, is unstable."""
    A, B = augmented(setup.airframe)
    K, lags = design(setup.airframe, weights), np.array([c.lag_s for c in default_channels()])
    own = round(default_channels()[0].delay_s / DT_S)
    block = np.zeros((35, 35))
    block[:15, :15], block[:15, 15:25] = A, B
    block[15:25, 15:25], block[15:25, 25:] = -np.diag(1.0 / lags), np.diag(1.0 / lags)
    sampled = expm(block * DT_S)
    for steps in range(own, 60):
        size = 25 + 10 * steps
        F = np.zeros((size, size))
        F[:25, :35] = sampled[:25]
        F[25 : size - 10, 35:] = np.eye(size - 35)
        F[size - 10 :, :15] = -K
        if np.abs(np.linalg.eigvals(F)).max() > 1.0:
            return (steps - 1 - own) * DT_S
    return math.inf


def scan(
    setup: Setup, variants: dict[str, RegulatorWeights], seeds: tuple[int, ...], seconds: float = 60.0,
    skip_s: float = 10.0, **conditions: object,
) -> None:  # fmt: skip
    """Print sigma, largest mean and largest BR per axis after ``skip_s``, least share in the window, delay margin."""
    window = setup.tanker.window.desired_m
    for name, weights in variants.items():
        tracks = [fly(setup, seed, seconds, weights, **conditions) for seed in seeds]
        flown = [t[min(round(skip_s / DT_S), len(t) // 2) :] for t in tracks]
        sigma = np.mean([t.std(axis=0) for t in flown], axis=0)
        mean = np.max([np.abs(t.mean(axis=0)) for t in flown], axis=0)
        largest = np.max([np.abs(t).max(axis=0) for t in flown], axis=0)
        share = min(share_inside(t, window, seconds) for t in tracks)
        cells = "  ".join(" ".join(f"{v:6.3f}" for v in row) for row in (sigma, mean, largest))
        margin_ms = 1e3 * delay_margin_s(setup, weights)
        flown_s = min(len(t) for t in tracks) * DT_S
        print(f"{name:24} {cells}  {share:6.3f}  {flown_s:5.1f} s  {margin_ms:4.0f} ms", flush=True)


def neighbours(weights: RegulatorWeights) -> dict[str, RegulatorWeights]:
    """Return the weights with every one of them halved and doubled, axis by axis."""
    out = {"in force": weights}
    for field in fields(weights):
        value = getattr(weights, field.name)
        for factor in (0.5, 2.0):
            if isinstance(value, tuple):
                for k, axis in enumerate("xyz"):
                    changed = tuple(v * factor if i == k else v for i, v in enumerate(value))
                    out[f"{field.name} {axis} x{factor}"] = replace(weights, **{field.name: changed})
            else:
                out[f"{field.name} x{factor}"] = replace(weights, **{field.name: value * factor})
    return out


def main() -> None:
    setup = load_scenario("docking").setup()
    print(f"{'':24} {'sigma x y z':20}  {'|mean|':20}  {'largest':20}  in the window   flown  delay")
    for turbulence in ("light", "moderate", "severe"):
        scan(setup, {turbulence: RegulatorWeights()}, (1001, 1002, 1003), turbulence=turbulence)
    scan(setup, neighbours(RegulatorWeights()), (1001, 1002))


if __name__ == "__main__":
    main()
