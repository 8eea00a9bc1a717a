"""Flights in which docking was once allowed wrongly, each by another hole: none is allowed wrongly any more."""

import pytest

from sim_bridge.runs.integrity import draw, observe

HOLES = {
    10024: "a datalink that tells nothing, flown on for 0.7 s",
    10028: "another speed of the tanker, believed by waiting",
    10074: "late positions: the filter refuses pictures for 0.7 s",
    10098: "late pictures with a false stamp, while the receiver moves fast",
    10127: "positions that come and go while the receiver manoeuvres",
    10130: "another pitch of the tanker, believed before a picture has judged it",
}


@pytest.mark.slow
@pytest.mark.parametrize("seed", HOLES, ids=str)
def test_docking_is_no_longer_allowed_wrongly(seed):
    outcome = observe(draw(seed))
    assert outcome.began
    assert not outcome.judged.false
    assert outcome.judged.allowed_count > 100  # and it is allowed where all is well
