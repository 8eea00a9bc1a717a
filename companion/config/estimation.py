"""Configuration of fusion and integrity, and what has to hold of it."""

from __future__ import annotations

from typing import Literal

from companion.config.base import Rules, Struct


class FilterConfig(Struct, frozen=True, kw_only=True):
    """The filter of relative position, velocity and attitude: noise of what comes in, spread of what it estimates.

    GPS and velocity sigmas are of one aircraft, per axis; ``attitude_sigma_rad`` of one INS' noise, per axis.
    """

    gps_sigma_m: float = 0.1
    velocity_sigma_m_s: float = 0.041
    attitude_sigma_rad: float = 1.4e-4
    gate_probability: float = 1e-5


class FusionConfig(Struct, frozen=True, kw_only=True):
    """Fusion of GPS and vision: ``filter``, or the thesis' ``blend`` (eq. 3.9).

    The blend is all GPS beyond ``d1_m``, all vision within ``d2_m``; a pose counts in it from ``min_markers`` markers:
    five in the thesis; here the vision itself says when it has a pose. An estimate rests on vision for
    ``vision_stale_s`` after the last pose; ``own_stale_s`` and ``tanker_stale_s``: how old the newest sample of either
    aircraft may be.
    """

    method: Literal["filter", "blend"] = "blend"
    d1_m: float = 55.0
    d2_m: float = 40.0
    min_markers: int = 2
    vision_stale_s: float = 0.3
    own_stale_s: float = 0.3
    tanker_stale_s: float = 1.0
    filter: FilterConfig = FilterConfig()


class IntegrityConfig(Struct, frozen=True, kw_only=True):
    """What is asked of the estimate before the receiver may close in.

    ``risk``: probability per axis that an error beyond the protection level stays unseen.
    """

    risk: float = 1e-7


def fusion_rules(fusion: FusionConfig) -> Rules:
    """Return what has to hold of the fusion."""
    return [
        (fusion.d1_m > fusion.d2_m > 0, "fusion: d1_m must be larger than d2_m, both in metres"),
        (fusion.min_markers >= 2, "fusion.min_markers must be at least 2"),
        (min(fusion.vision_stale_s, fusion.own_stale_s, fusion.tanker_stale_s) > 0,
         "fusion: vision_stale_s, own_stale_s and tanker_stale_s must be positive seconds"),
    ]


def integrity_rules(c: IntegrityConfig) -> Rules:
    """Return what has to hold of the integrity."""
    return [(0 < c.risk < 0.1, "integrity.risk must be in 0..0.1")]
