import pytest

from companion.io.clock import MonotonicClock, SimulatedClock


def test_the_machines_clock_goes_forward():
    clock = MonotonicClock()
    first = clock.now_ns()
    assert clock.now_ns() >= first > 0


def test_a_simulated_clock_stands_until_it_is_set_and_never_goes_back():
    clock = SimulatedClock(5)
    assert clock.now_ns() == clock.now_ns() == 5
    clock.set_ns(7)
    assert clock.now_ns() == 7
    with pytest.raises(ValueError, match="go back"):
        clock.set_ns(6)
