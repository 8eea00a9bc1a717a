import math

from hypothesis import given
from hypothesis import strategies as st

from companion.guidance.guard import Envelope, guard
from companion.messages import AttitudeSetpoint, Reject

ENVELOPE = Envelope(max_roll_rad=0.35, pitch_trim_rad=0.064, max_pitch_offset_rad=0.12, estimate_stale_s=0.3)
anything = st.floats(allow_nan=True, allow_infinity=True)


@given(anything, anything, anything, anything, st.one_of(st.none(), anything))
def test_whatever_goes_in_no_setpoint_outside_the_envelope_comes_out(roll, pitch, yaw, thrust, age_s):
    out = guard(AttitudeSetpoint(0, roll, pitch, yaw, thrust), age_s, ENVELOPE)
    if isinstance(out, AttitudeSetpoint):
        assert age_s is not None
        assert age_s <= 0.3
        assert all(map(math.isfinite, (roll, pitch, yaw, thrust)))
        assert abs(out.roll_rad) <= 0.35
        assert abs(out.pitch_rad - 0.064) <= 0.12 + 1e-12
        assert abs(out.yaw_rad) <= math.pi
        assert 0.0 <= out.thrust <= 1.0
    else:
        assert isinstance(out, Reject)
        assert out.source == "guard"


@given(st.floats(-0.35, 0.35), st.floats(-0.05, 0.18), st.floats(-3.1, 3.1), st.floats(0, 1), st.floats(0, 0.3))
def test_what_is_inside_passes_unchanged(roll, pitch, yaw, thrust, age_s):
    s = AttitudeSetpoint(7, roll, pitch, yaw, thrust)
    assert guard(s, age_s, ENVELOPE) == s
