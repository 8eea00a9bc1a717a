"""A boom between a tanker that flies straight and a receiver that is led on a string: no flight dynamics."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from companion.config import FIRMWARE_CONFIGS, BoomConfig, TankerConfig, load
from companion.geometry import Mat, Vec
from sim_bridge.plant.boom import AirAtBoom, Boom, BowWave, Carrier, Receptacle
from sim_bridge.plant.boom_dynamics import masses_of
from sim_bridge.plant.boom_forces import accelerations
from sim_bridge.plant.boom_motion import advance, authority
from sim_bridge.plant.boom_records import PRESCRIBED, SEEN, STATE, Record, parameters, record
from sim_bridge.plant.conditions import BoomConditions
from sim_bridge.plant.gusts import SIGMA_M_S
from sim_bridge.truth import BoomState

DT_S = 0.005
SPEED_M_S = 205.7
DENSITY = 0.66
PITCH_RAD = math.radians(2.5)
TANKER = load(FIRMWARE_CONFIGS / "tankers" / "kc135r.toml", TankerConfig)
BOX_M = np.array(TANKER.box_tanker_m)
RECEPTACLE_M = (2.0, 0.0, -1.0)
REST = np.zeros(3)
GRAVITY = 9.80665
STATE_NAMES = ("theta4", "theta5", "d6", "rate4", "rate5", "rate6")


def swaying(t_s: float) -> tuple[Vec, Vec]:
    """Return displacement and velocity of a docked receiver: 0.1 m in every axis, about 0.15 Hz."""
    w = 2.0 * math.pi * np.array([0.15, 0.195, 0.12])
    phase = np.array([0.0, 1.0, 2.0])
    return 0.1 * np.sin(w * t_s + phase), 0.1 * w * np.cos(w * t_s + phase)


def still(t_s: float) -> tuple[Vec, Vec]:
    """Return no motion."""
    return REST, REST * t_s


Motion = Callable[[float], tuple[Vec, Vec]]


class GustyAir:
    """First-order gusts of the Dryden form along the track, per axis of ned; the same for the same seed."""

    def __init__(self, turbulence: str, seed: int, speed_m_s: float) -> None:
        self._rng = np.random.default_rng(seed)
        self._sigma = SIGMA_M_S[turbulence]
        self._keep = math.exp(-DT_S * speed_m_s / 533.4)
        self._gust = self._sigma * self._rng.standard_normal(3)

    def next(self) -> tuple[float, float, float]:
        """Return the gust of the next step."""
        fresh = self._sigma * math.sqrt(1.0 - self._keep**2) * self._rng.standard_normal(3)
        self._gust = self._keep * self._gust + fresh
        n, e, d = self._gust.tolist()
        return n, e, d


class Bench:
    """Steps a boom; ``motion`` moves the receptacle about ``at_tanker_m`` (tanker axes in, ned displacement)."""

    def __init__(
        self, conditions: BoomConditions, motion: Motion = swaying, at_tanker_m: Vec = BOX_M, turbulence: str = "light",
        seed: int = 1, speed_m_s: float = SPEED_M_S, config: BoomConfig = TANKER.boom, bow_wave: BowWave | None = None,
        mirrored: bool = False,
    ) -> None:
        self.boom = Boom(config, conditions, DT_S, TANKER.box_tanker_m, TANKER.window)
        self.motion, self.t_s, self.speed_m_s, self.bow_wave = motion, 0.0, speed_m_s, bow_wave
        c, s = math.cos(PITCH_RAD), math.sin(PITCH_RAD)
        self.side = -1.0 if mirrored else 1.0
        self.rest_ned = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ at_tanker_m - np.array(RECEPTACLE_M)
        self.air = GustyAir(turbulence, seed, speed_m_s)
        self.tanker = Carrier((0.0, 0.0, 0.0), (speed_m_s, 0.0, 0.0), (0.0, PITCH_RAD, 0.0), *((0.0, 0.0, 0.0),) * 3)

    def step(self) -> None:
        """Advance one step."""
        self.t_s += DT_S
        moved, speed = self.motion(self.t_s)
        n, e, d = (self.rest_ned + moved).tolist()
        vn, ve, vd = speed.tolist()
        gust = self.air.next()
        receiver = Receptacle(
            (n, self.side * e, d), (self.speed_m_s + vn, self.side * ve, vd), *((0.0, 0.0, 0.0),) * 2, RECEPTACLE_M
        )
        air = AirAtBoom(DENSITY, (gust[0], self.side * gust[1], gust[2]), self.bow_wave)
        self.boom.step(self.tanker, receiver, air)

    def run(self, seconds: float) -> list[BoomState]:
        """Advance and return the states."""
        states = []
        for _ in range(round(seconds / DT_S)):
            self.step()
            states.append(self.boom.state)
        return states

    def run_until(self, done: Callable[[Boom], bool], most_s: float) -> float:
        """Advance until ``done``; returns when that was, and fails after ``most_s``."""
        while not done(self.boom):
            assert self.t_s < most_s, f"not done after {most_s} s; {self.boom.events}"
            self.step()
        return self.t_s


def given_for(elevation_rad: float, length_m: float, speed_m_s: float) -> Record:
    """Return what moves a boom that is held there, far from any receiver."""
    given = record(PRESCRIBED)
    given["t_vn"] = given["r_vn"] = speed_m_s
    given["t_pitch"], given["density"], given["r_n"] = PITCH_RAD, DENSITY, -60.0
    given["elevation"], given["length"] = elevation_rad, length_m
    return given


def settled(elevation_rad: float, length_m: float, speed_m_s: float = SPEED_M_S) -> tuple[Record, Record]:
    """Return (parameters, state) of a boom that its loops have brought to rest there."""
    par, s, seen = parameters(TANKER.boom, TANKER.box_tanker_m), record(STATE), record(SEEN)
    s["theta4"], s["theta5"], s["d6"] = math.pi - elevation_rad, -0.5 * math.pi, length_m
    given = given_for(elevation_rad, length_m, speed_m_s)
    for _ in range(6000):
        assert advance(par, given, s, seen, DT_S)
    return par, s


def linearised(par: Record, s: Record) -> tuple[Mat, Mat]:
    """Return A (6, 6) and B (6, 2) over the coordinates, their rates, and deflections up and right."""

    def rate(x: Vec, up: float, right: float) -> Vec:
        there = s.copy()
        there["right"], there["left"] = s["right"] + up - right, s["left"] + up + right
        return np.array(accelerations(par[0], there[0], *(float(v) for v in x), 0.0, 0.0, 0.0, 0.0, 0.0))

    x0 = np.array([float(s[name][0]) for name in STATE_NAMES])
    A, B, h = np.zeros((6, 6)), np.zeros((6, 2)), 1e-6
    A[:3, 3:] = np.eye(3)
    for i, e in enumerate(np.eye(6)):
        A[3:, i] = (rate(x0 + h * e, 0.0, 0.0) - rate(x0 - h * e, 0.0, 0.0)) / (2 * h)
    B[3:, 0] = (rate(x0, h, 0.0) - rate(x0, -h, 0.0)) / (2 * h)
    B[3:, 1] = (rate(x0, 0.0, h) - rate(x0, 0.0, -h)) / (2 * h)
    return A, B


def inertias(par: Record, s: Record) -> tuple[float, float]:
    """Return the diagonal of M for both angles."""
    names = ("m_outer", "com_outer", "m_inner", "com_inner", "j_across", "j_along")
    m4, m5, _ = masses_of(*(float(s[n][0]) for n in STATE_NAMES[:3]), *(float(par[n][0]) for n in names))
    return m4, m5


def moments_per_rad(par: Record, s: Record) -> Any:
    """Return what the loops take for the authority of the surfaces, up and right."""
    return authority(par[0], s[0])
