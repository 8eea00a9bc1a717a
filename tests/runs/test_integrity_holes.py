"""Flights in which docking was once allowed wrongly, each by another hole: none is allowed wrongly any more.

They fly straight to the box (``procedure`` direct), which does not ask integrity: what it says of them is judged.
"""

import msgspec
import pytest

from sim_bridge.faults import parse_fault
from sim_bridge.runs.flights import near
from sim_bridge.runs.integrity import observe
from sim_bridge.runs.many import Job

HOLES = {
    (10024, "moderate", "datalink.nan@approach+4.23:1.53", 11.4): "a datalink that tells nothing, flown on for 0.7 s",
    (10028, "moderate", "datalink.velocity@hold+2.59", 11.5): "another speed of the tanker, believed by waiting",
    (10074, "docking", "position.late@hold+5.52", 11.3): "late positions: the filter refuses pictures for 0.7 s",
    (10098, "moderate", "camera.late=0.0879@approach+4.78", 10.8):
        "late pictures with a false stamp, while the receiver moves fast",
    (10127, "docking", "position.intermittent@hold+3.61", 11.9):
        "positions that come and go while the receiver manoeuvres",
    (10130, "moderate", "datalink.turned@hold+0.17", 12.5):
        "another pitch of the tanker, believed before a picture has judged it",
}


@pytest.mark.slow
@pytest.mark.parametrize("hole", HOLES, ids=lambda hole: str(hole[0]))
def test_docking_is_no_longer_allowed_wrongly(hole):
    seed, name, fault, hold_s = hole
    scenario, setup = near(name, seed, hold_s)
    outcome = observe(Job(str(seed), msgspec.structs.replace(scenario, faults=(parse_fault(fault),)), setup))
    assert outcome.began
    assert not outcome.judged.false
    assert outcome.judged.allowed_count > 100  # and it is allowed where all is well
