"""What the configuration of the phases may not say: one line that names field and unit."""

import msgspec
import pytest

from companion.config import FIRMWARE_CONFIGS, ConfigError, GuidanceConfig, load_setup
from companion.config.guidance import GuardConfig, guidance_rules, thrust_rule


def broken(**changed):
    return [text for holds, text in guidance_rules(msgspec.structs.replace(GuidanceConfig(), **changed)) if not holds]


def test_the_defaults_hold():
    assert broken() == []


@pytest.mark.parametrize(("changed", "words"), [
    ({"pre_contact_m": (15.0, 0.0, 5.0)}, "pre_contact_m must be aft of the box"),
    ({"pre_contact_m": (-15.0, 0.0, -5.0)}, "pre_contact_m must be aft of the box"),
    ({"pre_contact_m": (-2.0, 0.0, 1.0)}, "more than contact_near_m away"),
    ({"observation_s": -1.0}, "observation_s"),
    ({"may_dock_s": float("nan")}, "may_dock_s"),
    ({"contact_timeout_s": 1.0}, "contact_timeout_s"),
    ({"closure_m_s2": 0.0}, "closure_m_s2"),
    ({"transit_m_s2": -0.1}, "transit_m_s2"),
    ({"contact_closure_m_s": 0.9}, "in rising order"),
    ({"max_closure_m_s": 0.4}, "in rising order"),
    ({"contact_closure_m_s": 0.0}, "must be positive"),
    ({"approach_closure_m_s": 1.0}, "below guard.closure_m_s"),
    ({"guard": GuardConfig(closure_m_s=0.5)}, "below guard.closure_m_s"),
    ({"breakaway_descent_rad": 0.0}, "breakaway_descent_rad"),
    ({"breakaway_descent_rad": -0.05}, "breakaway_descent_rad"),
    ({"breakaway_descent_rad": 2.9}, "breakaway_descent_rad"),
    ({"max_pitch_offset_rad": 0.04}, "at most max_pitch_offset_rad"),
    ({"breakaway_separation_m": 5.0}, "breakaway_separation_m"),
    ({"breakaway_separation_m": float("inf")}, "breakaway_separation_m"),
    ({"breakaway_level_s": 1e6}, "breakaway_level_s"),
    ({"stabilise_tolerance_m": 50.0}, "stabilise_tolerance_m"),
    ({"join_tolerance_m": -1.0}, "join_tolerance_m"),
    ({"join_range_m": 1e9}, "join_range_m"),
    ({"rate_hz": 16.0}, "guidance.guard.sight_lost_s must be in 0..0.438 seconds"),
    *(({"guard": GuardConfig(**{name: 0.49})}, name) for name in (
        "sight_lost_s", "datalink_stale_s", "attitude_stale_s", "position_stale_s", "estimate_lost_s",
        "integrity_failed_s", "lasting_s")),
    ({"guard": GuardConfig(off_path_m=1e4)}, "off_path"),
    ({"guard": GuardConfig(protection_range_m=1e4)}, "protection_range_m"),
    ({"guard": GuardConfig(braking_m_s2=float("inf"))}, "braking_m_s2"),
])
def test_each_rule_is_told(changed, words):
    [text] = broken(**changed)
    assert text.startswith("guidance")
    assert words in text


def test_a_breakaway_has_to_slow_the_receiver_of_this_airframe_down(tmp_path):
    file = FIRMWARE_CONFIGS / "sitl" / "docking.toml"
    throttle = load_setup(file).airframe.trim.throttle
    assert thrust_rule(GuidanceConfig(breakaway_thrust=0.79 * throttle), throttle)[0]
    lines = file.read_text(encoding="utf-8").replace('"../', f'"{FIRMWARE_CONFIGS}/')
    wrong = tmp_path / "companion.toml"
    wrong.write_text(lines.replace("[guidance]", f"[guidance]\nbreakaway_thrust = {throttle:.3f}"), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"breakaway_thrust must be at most 0[.]8 of"):
        load_setup(wrong)
