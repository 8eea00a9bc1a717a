"""Health of the stages: what fails is told in time, what flickers is not, and only what is used counts."""

from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest

from companion.config import FIRMWARE_CONFIGS, load_setup
from companion.geometry import SE3
from companion.health import GRACE_S, ILL_AFTER_S, STAGES, USED, WELL_AFTER_S, HealthMonitor
from companion.messages import (
    AttitudeSetpoint,
    AutopilotMode,
    AutopilotStatus,
    Detections,
    GpsStatus,
    Integrity,
    MarkerFrame,
    Phase,
    Reject,
    RelativeState,
    Sources,
    TimeStep,
    VisionOutput,
)

S, MS = 1_000_000_000, 1_000_000
DT_NS = 20 * MS
NOTHING = Detections(0, np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros(0, np.uint8))


@cache
def shipped():
    return load_setup(FIRMWARE_CONFIGS / "sitl" / "thesis.toml")


def seen(t_ns, labels=(0, 1, 2), reject=None):
    return VisionOutput(t_ns, 0, NOTHING, np.zeros((3, 2)), np.array(labels), None, reject)


def state(t_ns):
    return RelativeState(
        t_ns, t_ns, np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.eye(3), np.zeros(3), 0.0, 0.0,
        SE3.identity(), 20.0, 1.0, 9, np.eye(3),
    )


class Flight:
    """A flight step by step in which every stage does what it should, but those that are told otherwise."""

    def __init__(self, phase=Phase.HOLD, setup=None):
        self.monitor = HealthMonitor(setup or shipped())
        self.phase, self.t_ns, self.told = phase, 0, []

    def fly(self, seconds, *missing, rejects=()):
        """Return when what changed, in s since the start of this leg: [(s, {stage: detail, None when well})]."""
        start_ns, changes = self.t_ns, []
        for _ in range(round(seconds * 50)):
            self._inputs(missing, rejects)
            health = self.monitor.step(self.t_ns, self.phase, self._sources(missing))
            if health is not None:
                before = {s.name: s for s in self.told[-1].stages} if self.told else {}
                changed = [s for s in health.stages if before.get(s.name) != s]
                changes.append(((self.t_ns - start_ns) / S, {s.name: None if s.healthy else s.detail for s in changed}))
                self.told.append(health)
            self.t_ns += DT_NS
        return changes

    def _inputs(self, missing, rejects):
        t_ns, m = self.t_ns, self.monitor
        if "autopilot" not in missing and t_ns % S == 0:
            m.event(AutopilotStatus(t_ns, AutopilotMode.GUIDED, armed=True))
        if t_ns % (100 * MS) == 0 and "camera" not in missing:
            m.event(MarkerFrame(t_ns, 0, NOTHING))
            m.output(seen(t_ns, (-1, -1, -1), Reject(t_ns, "vision", "few_labels")) if "vision" in missing
                     else seen(t_ns))
        for source, reason in rejects:
            m.output(Reject(t_ns, source, reason))
        m.output(Integrity(t_ns, np.zeros(3), np.ones(3), True, ("boresight",) if "integrity" in missing else ()))
        if "fusion" not in missing:
            m.output(state(t_ns))
        if "guidance" not in missing:
            m.output(AttitudeSetpoint(t_ns, 0.0, 0.06, 0.0, 0.3))

    def _sources(self, missing):
        at = {name: None if name in missing else self.t_ns for name in ("attitude", "position", "datalink")}
        return Sources(at["attitude"], at["position"], at["datalink"], self.t_ns)

    def stage(self, name):
        return next(s for s in self.told[-1].stages if s.name == name)


def in_flight(phase=Phase.HOLD):
    """Return a flight in which all has been well for two seconds, and has been told to be."""
    flight = Flight(phase)
    flight.fly(2.0)
    assert flight.told[-1].well
    return flight


def test_at_first_nothing_is_said_until_all_is_well():
    """No complaint of what has not begun yet: who listens sends no heartbeat before the first word."""
    flight = Flight()
    assert flight.monitor.step(-DT_NS, Phase.HOLD, Sources()) is None
    changes = flight.fly(2.0)
    assert all(told.well for told in flight.told)
    assert changes[0][0] <= WELL_AFTER_S + 0.1
    assert {s.name for s in flight.told[-1].stages} == set(STAGES)


def test_what_has_not_begun_after_its_grace_is_told_as_failing():
    flight = Flight()
    [(at_s, told)] = flight.fly(2.5, "camera", "vision")
    assert at_s == pytest.approx(GRACE_S, abs=0.021)
    assert told["camera"] == "nothing yet"
    assert told["datalink"] is None
    assert not flight.told[-1].well
    lost = in_flight().fly(1.0, "attitude")  # who has been well has had its grace
    assert lost[0][0] < 0.5


@pytest.mark.parametrize(
    ("missing", "limit_s", "detail"),
    [
        ("camera", 0.35, "nothing for 0.35 s"), ("vision", 0.35, "few_labels"), ("datalink", 0.0, "nothing yet"),
        ("attitude", 0.0, "nothing yet"), ("position", 0.0, "nothing yet"), ("autopilot", 3.0, "nothing for 3 s"),
        ("fusion", 0.3, "nothing for 0.3 s"), ("integrity", 0.0, "boresight"), ("guidance", 0.1, "nothing for 0.1 s"),
    ],
)
def test_a_stage_that_fails_is_told_with_what_it_is_and_again_when_it_is_well(missing, limit_s, detail):
    flight = in_flight()
    lost = flight.fly(5.0, missing)
    at_s, what = next((s, w) for s, w in lost if missing in w)
    assert what[missing] == detail
    assert at_s <= limit_s + ILL_AFTER_S + 0.1 + 0.021
    assert not flight.told[-1].well
    back = flight.fly(2.0)
    assert [w[missing] for _, w in back if missing in w] == [None]
    assert WELL_AFTER_S <= next(s for s, w in back if missing in w) <= WELL_AFTER_S + 1.0
    assert flight.told[-1].well


def test_everything_but_the_heartbeat_is_told_within_a_little_over_half_a_second():
    for missing in set(STAGES) - {"autopilot"}:
        lost = in_flight().fly(2.0, missing)
        assert next(s for s, w in lost if missing in w) <= 0.6


@pytest.mark.parametrize(("source", "stage", "reason"), [
    ("camera", "camera", "frozen"), ("datalink", "datalink", "checksum"), ("mavlink", "attitude", "not_finite"),
    ("attitude", "attitude", "jump"), ("position", "position", "frozen"),
])
def test_the_reject_that_goes_with_it_says_why(source, stage, reason):
    flight = in_flight()
    flight.fly(2.0, stage, rejects=[(source, reason)])
    assert flight.stage(stage).detail == reason


def test_a_picture_that_vision_could_not_use_is_still_a_picture():
    """No prior: vision says why nothing is seen, and the camera is well."""
    flight = in_flight()
    flight.fly(2.0, "camera", rejects=[("vision", "no_prior")])
    assert flight.stage("camera").healthy
    assert (flight.stage("vision").healthy, flight.stage("vision").detail) == (False, "no_prior")


def test_what_comes_and_goes_does_not_flicker():
    """0.16 s without setpoints out of every 0.5 s for ten seconds: never told; nor a second without use of a stage."""
    flight, changes = in_flight(), []
    for _ in range(20):
        changes += flight.fly(0.16, "integrity") + flight.fly(0.34)
    assert changes == []


def test_a_stage_that_is_mostly_ill_stays_ill():
    """Well for 0.3 s out of every 0.8 s: it is told once, not twenty times."""
    flight, changes = in_flight(), []
    for _ in range(10):
        changes += flight.fly(0.5, "integrity") + flight.fly(0.3)
    assert [w for _, w in changes] == [{"integrity": "boresight"}]


def test_what_is_not_used_harms_nobody():
    flight = Flight(Phase.STANDBY)
    flight.fly(2.0, "datalink", "vision", "fusion", "guidance", "integrity")
    assert flight.told[-1].well
    assert not flight.stage("datalink").healthy
    assert not flight.stage("datalink").enabled


def test_a_stage_that_comes_into_use_gets_its_chance():
    """Guidance sends nothing in standby; when the join begins it is not called ill before it had the time to send."""
    flight = Flight(Phase.STANDBY)
    flight.fly(2.0, "guidance")
    flight.phase = Phase.JOIN
    changes = flight.fly(1.0)
    assert all(h.well for h in flight.told[-len(changes):])
    dead = Flight(Phase.STANDBY)
    dead.fly(2.0, "guidance")
    dead.phase = Phase.JOIN
    assert {"guidance": "nothing yet"} in [w for _, w in dead.fly(1.0, "guidance")]


def test_a_gps_without_a_fix_is_no_loss_while_vision_carries_the_position():
    for phase, well in ((Phase.HOLD, True), (Phase.JOIN, False)):
        flight = in_flight(phase)
        flight.monitor.event(GpsStatus(flight.t_ns, has_fix=False))
        flight.fly(1.0)
        assert flight.stage("position").healthy is well
    flight.monitor.event(GpsStatus(flight.t_ns, has_fix=True))
    flight.fly(1.0)
    assert flight.stage("position").healthy
    blind = in_flight()
    blind.monitor.event(GpsStatus(blind.t_ns, has_fix=False))
    blind.fly(2.0, "vision")
    assert blind.stage("position").detail == "no GPS fix"


def test_a_step_of_time_is_no_illness():
    """Everything begins anew with the clock: what comes after the step is judged, not what came before."""
    flight = in_flight()
    flight.monitor.event(TimeStep(flight.t_ns, "autopilot", 3600 * S))
    flight.t_ns = (flight.t_ns // S + 1) * S
    changes = flight.fly(2.0)
    assert [w for _, w in changes if any(w.values())] == []
    assert flight.told[-1].well


def test_what_is_not_configured_is_not_there_until_it_comes():
    config = shipped().config
    links = msgspec.structs.replace(config.links, camera="", datalink="")
    setup = msgspec.structs.replace(shipped(), config=msgspec.structs.replace(config, links=links))
    monitor = HealthMonitor(setup)
    monitor.step(0, Phase.HOLD, Sources())
    health = monitor.step(round(GRACE_S * S), Phase.HOLD, Sources())
    absent = {s.name: s.detail for s in health.stages if not s.present}
    assert absent == dict.fromkeys(("camera", "vision", "datalink", "integrity"), "not there")
    flight = Flight(setup=setup)
    flight.fly(2.0)
    assert {s.name for s in flight.told[-1].stages if not s.present} == set()


def test_every_phase_has_its_stages_and_none_that_is_unknown():
    assert set(USED) == set(Phase)
    assert all(used <= set(STAGES) for used in USED.values())


def test_stages_that_are_told_never_say_well_and_why_not():
    flight = in_flight()
    flight.fly(3.0, "camera", "datalink")
    for health in flight.told:
        assert all((stage.detail == "") == stage.healthy for stage in health.stages)
        assert replace(health, stages=()).well
