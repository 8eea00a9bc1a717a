"""What the configuration of the phases may not say: one line that names field and unit."""

import msgspec
import pytest

from companion.config import GuidanceConfig
from companion.config.guidance import guidance_rules


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
    ({"approach_closure_m_s": 3.0}, "in rising order"),
    ({"contact_closure_m_s": 0.0}, "must be positive"),
])
def test_each_rule_is_told(changed, words):
    [text] = broken(**changed)
    assert text.startswith("guidance")
    assert words in text
