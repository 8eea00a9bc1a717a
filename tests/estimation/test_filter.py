"""The filter as a ``Fusion``: events in, estimates out."""

import filter_scene as fs
import numpy as np
import pytest

from companion.config import FilterConfig, FusionConfig
from companion.config.estimation import fusion_rules
from companion.estimation.aircraft import Aircraft
from companion.estimation.filter import RelativeFilter
from companion.geometry import SE3, exp_so3, log_so3
from companion.messages import (
    Detections,
    FilterState,
    FilterUpdate,
    FusedPose,
    GpsStatus,
    OwnAttitude,
    OwnPosition,
    PoseMeasurement,
    TankerState,
    TimeStep,
    VisionOutput,
)

S, MS = fs.S, fs.MS
SIGMA_PX = 0.035


class Flight:
    """A receiver that stands at ``r_m`` from the tanker, both flying straight; events every 20 and 40 ms."""

    def __init__(self, r_m=(-30.0, -3.0, 12.0), gps_bias_m=(0.0, 0.0, 0.0), seed=1, **config):
        self.r_m, self.bias_m = np.array(r_m), np.array(gps_bias_m)
        self.rng = np.random.default_rng(seed)
        self.aircraft = Aircraft(FusionConfig(), fs.T_FRD_CAM)
        fusion = FusionConfig(filter=FilterConfig(**config))
        self.filter = RelativeFilter(fusion, self.aircraft, fs.CAMERA, fs.MARKERS, self.plane)
        self.t_ns = 0
        self.boresight = np.zeros(3)
        self.off_own = self.off_tanker = self.nothing
        self.silent = str
        self.updates = []
        self.fix: bool | None = None  # what the receiver's GPS says of itself, five times a second

    @staticmethod
    def plane(uv_px):
        return (np.asarray(uv_px) - [fs.CAMERA.cx_px, fs.CAMERA.cy_px]) / fs.FOCAL_PX

    def p_tanker(self, t_ns):
        return fs.V_TANKER * t_ns * 1e-9

    def go(self, seconds, *, labels=None, positions=True, every_ms=50):
        """Fly on; ``labels``: indices of the markers seen every ``every_ms``, or a function that makes a frame."""
        end_ns = self.t_ns + round(seconds * S)
        while self.t_ns < end_ns:
            self.t_ns += 10 * MS
            if self.fix is not None and self.t_ns % (200 * MS) == 0:
                self.aircraft.gps_event(GpsStatus(self.t_ns, has_fix=self.fix))
            if self.t_ns % (20 * MS) == 0 and self.silent() != "own":
                self.own(positions)
            if self.t_ns % (40 * MS) == 0 and self.silent() != "tanker":
                fix = self.p_tanker(self.t_ns) + self.gps_noise() + self.off_tanker()
                self.aircraft.tanker_event(
                    TankerState(self.t_ns, fix, fs.V_TANKER, self.told(fs.R_TANKER), self.rates())
                )
                self.updates += self.filter.positions()
            if labels is not None and self.t_ns % (every_ms * MS) == 0:
                frame = labels(self) if callable(labels) else self.frame(labels)
                self.updates += self.filter.vision(frame)
        return self

    def own(self, positions):
        self.aircraft.own_attitude_event(OwnAttitude(self.t_ns, self.told(fs.R_OWN), self.rates()))
        if positions:
            fix = self.p_tanker(self.t_ns) + self.r_m + self.bias_m + self.gps_noise() + self.off_own()
            self.aircraft.own_position_event(OwnPosition(self.t_ns, fix, fs.V_TANKER))
            self.updates += self.filter.positions()

    def told(self, R):
        return exp_so3(1e-4 * self.rng.standard_normal(3)) @ R

    def rates(self):
        return 1e-4 * self.rng.standard_normal(3)

    @staticmethod
    def nothing():
        return np.zeros(3)

    def gps_noise(self):
        return 0.1 * self.rng.standard_normal(3)

    def frame(self, ids=range(9), *, labelled=True, pose=True, seen_from_m=None, uv_px=None):
        ids = np.array(list(ids))
        r_m = self.r_m if seen_from_m is None else np.asarray(seen_from_m)
        if uv_px is None:
            uv = fs.on_plane(r_m, np.zeros(3), self.boresight)
            uv_px = uv * fs.FOCAL_PX + [fs.CAMERA.cx_px, fs.CAMERA.cy_px]
            uv_px = uv_px + SIGMA_PX * self.rng.standard_normal((9, 2))
        n = len(ids)
        found = Detections(self.t_ns, uv_px[ids], np.full(n, 9.0), np.full(n, SIGMA_PX), np.zeros(n, dtype=np.uint8))
        labels = np.full(9, -1)
        if labelled:
            labels[ids] = np.arange(n)
        T = (SE3(fs.R_OWN, r_m) @ fs.T_FRD_CAM).inverse() @ SE3(fs.R_TANKER, np.zeros(3))
        measured = PoseMeasurement(self.t_ns, T, labels, n, 3, 0.01, 1e-4, 1e-4 * np.eye(6)) if pose else None
        return VisionOutput(self.t_ns, self.t_ns // MS, found, uv_px, labels, measured, None)

    def error_m(self):
        return self.filter.at(self.t_ns).p_ned_m - self.r_m

    def reasons(self, source):
        return [u.reason for u in self.updates if isinstance(u, FilterUpdate) and u.source == source]


def test_nothing_is_said_before_anything_is_known():
    f = Flight()
    assert f.filter.at(0) is None
    assert f.filter.prior(0) is None
    assert f.filter.sight_ns is None
    f.go(0.1)
    assert f.filter.at(f.t_ns) is None, "one difference of positions is no estimate"
    assert not f.filter.prior(f.t_ns).tracked, "but GPS is a prior for the eyes"


def test_gps_alone_gives_an_estimate_that_knows_of_its_bias():
    f = Flight(gps_bias_m=(0.5, -0.5, 0.5)).go(5.0)
    at = f.filter.at(f.t_ns)
    assert np.abs(f.error_m()).max() < 3 * np.sqrt(np.diag(at.cov)[:3]).max()
    assert np.diag(at.cov)[:3].max() > 1.0
    assert at.sight_ns is None
    assert at.vision_weight == 0.0
    assert not f.filter.prior(f.t_ns).tracked


def test_one_wild_first_position_does_not_start_it_off():
    f = Flight()
    f.bias_m = np.array([60.0, 0.0, 0.0])
    f.go(0.06)
    f.bias_m = np.zeros(3)
    f.go(2.0)
    assert np.abs(f.error_m()).max() < 1.0


def test_vision_takes_over_from_a_height_datum_that_is_ten_metres_off():
    f = Flight(gps_bias_m=(0.0, 0.0, 10.0)).go(3.0).go(3.0, labels=range(9))
    at = f.filter.at(f.t_ns)
    assert np.linalg.norm(f.error_m()) < 0.05
    assert at.cov[0, 0] < 0.05**2
    assert at.vision_weight > 0.99
    assert at.sight_ns == f.t_ns
    assert at.markers_used == 9
    states = [o for o in f.updates if isinstance(o, FilterState)]
    assert states[-1].x[11] == pytest.approx(10.0, abs=0.5), "the datum is told as a bias"
    assert states[-1].sigma[11] < 0.5


def test_every_frame_gives_a_fused_pose_and_the_state_at_its_instant():
    f = Flight().go(1.0).go(1.0, labels=range(9))
    poses = [o for o in f.updates if isinstance(o, FusedPose)]
    truth = (SE3(fs.R_OWN, f.r_m) @ fs.T_FRD_CAM).inverse() @ SE3(fs.R_TANKER, np.zeros(3))
    assert len(poses) == 20
    assert poses[-1].markers_used == 9
    assert np.linalg.norm(poses[-1].T_cam_tanker.t - truth.t) < 0.03
    assert np.linalg.norm(log_so3(poses[-1].T_cam_tanker.R @ truth.R.T)) < 0.002
    prior = f.filter.prior(f.t_ns)
    assert prior.tracked
    assert np.linalg.norm(prior.T_cam_tanker.t - truth.t) < 0.05


def test_it_flies_without_gps_for_minutes():
    f = Flight().go(2.0).go(3.0, labels=range(9))
    f.fix = False
    f.aircraft.gps_event(GpsStatus(f.t_ns, has_fix=False))
    f.bias_m = np.array([3.0, -2.0, 5.0])  # dead reckoning that has gone off, which must not count
    told = len(f.reasons("gps"))
    f.go(120.0, labels=range(9))
    assert np.linalg.norm(f.error_m()) < 0.05
    assert len(f.reasons("gps")) == told
    assert f.filter.at(f.t_ns).estimate_ns >= f.t_ns - 50 * MS
    f.fix = True
    f.go(3.0, labels=range(9))
    assert len(f.reasons("gps")) > told
    assert np.linalg.norm(f.error_m()) < 0.05


def test_a_gap_of_vision_is_coasted_with_a_covariance_that_grows():
    f = Flight().go(1.0).go(3.0, labels=range(9))
    before = f.filter.at(f.t_ns)
    f.go(2.0)
    after = f.filter.at(f.t_ns)
    assert np.linalg.norm(f.error_m()) < 0.1
    assert after.cov[0, 0] > before.cov[0, 0]
    c = FilterConfig()
    walked_m2 = 2.0 * 2.0 * c.velocity_sigma_m_s**2 * c.velocity_hold_s  # two aircraft, two seconds
    assert after.cov[1, 1] - before.cov[1, 1] > walked_m2, "across the path, where velocities are noisy"
    assert after.sight_ns == before.sight_ns
    assert after.estimate_ns >= f.t_ns - 50 * MS, "GPS carries it"


def test_without_gps_and_vision_the_estimate_grows_old():
    f = Flight().go(1.0).go(2.0, labels=range(9))
    f.aircraft.gps_event(GpsStatus(f.t_ns, has_fix=False))
    seen_ns = f.t_ns
    f.go(1.0)
    assert f.filter.at(f.t_ns).estimate_ns == seen_ns


@pytest.mark.parametrize("count", range(1, 10))
def test_any_number_of_labelled_markers_counts(count):
    f = Flight(seed=count).go(1.0).go(2.0, labels=range(9))
    f.go(3.0, labels=lambda f: f.frame(range(9 - count, 9), pose=count >= 5))
    assert set(f.reasons("pixels")[-40:]) == {""}
    assert np.linalg.norm(f.error_m()) < 0.12
    assert f.filter.at(f.t_ns).markers_used == count


def test_one_light_without_a_label_keeps_the_track():
    f = Flight().go(1.0).go(2.0, labels=range(9))
    f.fix = False
    f.go(5.0, labels=lambda f: f.frame([2], labelled=False, pose=False))
    assert f.filter.sight_ns == f.t_ns
    assert f.filter.at(f.t_ns).markers_used == 1


def test_a_light_with_a_rival_beside_it_is_not_told_apart():
    f = Flight().go(1.0).go(2.0, labels=range(9))
    seen_ns = f.t_ns

    def doubtful(f):
        frame = f.frame([2, 3], labelled=False, pose=False)
        frame.detections.uv_px[1] = frame.detections.uv_px[0] + [0.4, 0.0]
        return frame

    f.go(0.5, labels=doubtful)
    assert f.filter.sight_ns == seen_ns
    assert set(f.reasons("pixels")[-10:]) == {"no_labels"}


def test_lights_are_not_told_apart_long_after_the_last_sight():
    f = Flight(sight_lasts_s=1.0).go(1.0).go(2.0, labels=range(9)).go(1.5)
    seen_ns = f.filter.sight_ns
    f.go(0.5, labels=lambda f: f.frame([2], labelled=False, pose=False))
    assert f.filter.sight_ns == seen_ns


def test_a_wrong_marker_is_named_and_left_out():
    def wrong(f):
        frame = f.frame()
        frame.detections.uv_px[4] += [8.0, -5.0]
        return frame

    f = Flight().go(1.0).go(1.0, labels=range(9)).go(1.0, labels=wrong)
    assert f.reasons("marker 4") == ["gate"] * 20
    assert set(f.reasons("pixels")[-20:]) == {""}
    assert f.filter.at(f.t_ns).markers_used == 8
    assert np.linalg.norm(f.error_m()) < 0.05


def test_markers_are_named_by_their_ids():
    f = Flight()
    f.filter = RelativeFilter(FusionConfig(), f.aircraft, fs.CAMERA, fs.MARKERS, f.plane, tuple(range(21, 30)))

    def wrong(f):
        frame = f.frame()
        frame.detections.uv_px[4] += [8.0, -5.0]
        return frame

    f.go(1.0).go(1.0, labels=range(9)).go(1.0, labels=wrong)
    assert f.reasons("marker 25") == ["gate"] * 20


def test_single_frames_that_are_metres_off_change_nothing():
    f = Flight().go(1.0).go(2.0, labels=range(9))
    f.go(0.4, labels=lambda f: f.frame(seen_from_m=f.r_m + np.array([1.0, 1.0, -1.0])))
    assert set(f.reasons("pixels")[-8:]) == {"gate"}
    assert np.linalg.norm(f.error_m()) < 0.1


@pytest.mark.parametrize("every_ms", [10, 20, 50, 100])
def test_vision_that_insists_near_the_tanker_puts_the_position_anew_and_says_so(every_ms):
    f = Flight().go(1.0).go(2.0, labels=range(9))
    f.r_m = f.r_m + np.array([1.5, -1.0, 1.0])  # as after a stretch of wrong velocities; GPS says nothing of it
    f.bias_m = -np.array([1.5, -1.0, 1.0])
    f.go(1.5, labels=range(9), every_ms=every_ms)
    assert f.reasons("pixels").count("position_anew") == 1
    assert np.linalg.norm(f.error_m()) < 0.1
    assert f.reasons("pixels")[-1] == ""


def test_gps_that_jumps_is_refused_and_believed_with_another_bias_when_it_stays():
    f = Flight().go(1.0).go(3.0, labels=range(9))
    f.bias_m = np.array([0.0, 8.0, 0.0])
    f.go(3.0, labels=range(9))
    reasons = f.reasons("gps")
    assert "gate" in reasons
    assert reasons.count("bias_anew") == 1
    assert reasons[-1] == ""
    assert np.linalg.norm(f.error_m()) < 0.05


def test_lights_that_are_refused_without_a_pose_widen_the_filter():
    f = Flight().go(1.0).go(2.0, labels=range(9))
    f.aircraft.gps_event(GpsStatus(f.t_ns, has_fix=False))
    f.r_m = f.r_m + np.array([0.0, 0.5, 0.0])
    f.go(2.0, labels=lambda f: f.frame([0, 3, 7], pose=False))
    assert "wider" in f.reasons("pixels")
    assert np.linalg.norm(f.error_m()) < 0.5


@pytest.mark.parametrize("off_m", [0.5, 1.2])
def test_a_pose_that_was_refused_long_ago_is_not_in_the_way_of_widening(off_m):
    f = Flight().go(1.0).go(2.0, labels=range(9))
    f.aircraft.gps_event(GpsStatus(f.t_ns, has_fix=False))
    f.r_m = f.r_m + np.array([0.0, off_m, 0.0])
    f.go(0.3, labels=range(9))
    f.go(5.0, labels=lambda f: f.frame([0, 3, 7], pose=False))
    assert "wider" in f.reasons("pixels")
    assert f.reasons("pixels")[-1] == ""
    assert np.linalg.norm(f.error_m()) < 0.5


def test_gps_that_corrects_itself_minutes_after_the_last_sight_puts_the_position_anew():
    f = Flight().go(1.0).go(3.0, labels=range(9)).go(240.0)
    f.r_m = f.r_m + np.array([0.0, 8.0, 0.0])  # where velocities have taken it in minutes, and GPS says at last
    f.go(3.0)
    assert "position_anew" in f.reasons("gps")
    assert np.linalg.norm(f.error_m()) < 2.0


def test_gps_that_jumps_soon_after_the_last_sight_does_not_move_the_position():
    f = Flight().go(1.0).go(3.0, labels=range(9)).go(10.0)
    f.bias_m = np.array([0.0, 8.0, 0.0])
    f.go(3.0)
    assert "bias_anew" in f.reasons("gps")
    assert np.linalg.norm(f.error_m()) < 0.5


def test_projected_markers_do_not_make_a_position_worth_keeping():
    def projected(f):
        frame = f.frame(seen_from_m=f.r_m)
        frame.detections.sigma_px[:] = 0.0
        return frame

    f = Flight().go(3.0, labels=projected)
    f.r_m = f.r_m + np.array([0.0, 20.0, 0.0])  # as the datum that was wrong is put right
    f.go(2.0, labels=projected)
    assert "position_anew" in f.reasons("gps")
    assert np.linalg.norm(f.error_m()) < 1.0


def test_a_boresight_is_found_and_does_not_turn_the_camera_s_view_of_the_tanker():
    f = Flight()
    f.boresight = np.array([0.004, -0.003, 0.002])
    f.go(1.0).go(20.0, labels=range(9))
    at = f.filter.at(f.t_ns)
    R_cam_tanker = (fs.R_OWN @ at.T_frd_cam.R).T @ at.R_correction @ fs.R_TANKER
    truth = (fs.R_OWN @ fs.T_FRD_CAM.R @ exp_so3(f.boresight)).T @ fs.R_TANKER
    assert np.linalg.norm(log_so3(R_cam_tanker @ truth.T)) < 5e-4


def test_projected_markers_tell_nothing_but_count_as_sight():
    def projected(f):
        frame = f.frame(seen_from_m=f.r_m + np.array([0.0, 2.0, 0.0]))
        frame.detections.sigma_px[:] = 0.0
        return frame

    f = Flight().go(2.0)
    x = f.filter.at(f.t_ns).p_ned_m
    f.go(0.5, labels=projected)
    assert f.filter.sight_ns == f.t_ns
    assert np.linalg.norm(f.filter.at(f.t_ns).p_ned_m - x) < 0.2


def test_poses_alone_start_it_when_there_is_no_fix():
    f = Flight(gps_bias_m=(4.0, 0.0, 0.0))
    f.aircraft.gps_event(GpsStatus(0, has_fix=False))
    f.go(0.2)
    assert f.filter.at(f.t_ns) is None
    f.go(1.0, labels=range(9))
    assert np.linalg.norm(f.error_m()) < 0.2


def test_a_restart_forgets_everything():
    f = Flight().go(1.0).go(1.0, labels=range(9))
    f.aircraft.restart()
    f.filter.restart()
    assert f.filter.sight_ns is None
    assert f.filter.at(f.t_ns) is None
    f.go(2.0, labels=range(9))
    assert np.linalg.norm(f.error_m()) < 0.2


def test_stale_sources_give_no_estimate():
    f = Flight().go(2.0)
    assert f.filter.at(f.t_ns + 400 * MS) is None
    assert f.filter.vision(f.frame()) is not None


@pytest.mark.parametrize(("field", "value"), [
    ("gps_sigma_m", 0.0), ("boresight_initial_rad", 0.5), ("horizon_s", 5.0), ("gate_probability", 0.0),
    ("velocity_walk", -1.0), ("gps_bias_s", 0.0), ("vision_leads_m", 0.0),
])  # fmt: skip
def test_what_no_filter_can_run_on_is_told_by_its_name(field, value):
    told = [text for holds, text in fusion_rules(FusionConfig(filter=FilterConfig(**{field: value}))) if not holds]
    assert len(told) == 1
    assert field in told[0]




def test_what_was_told_of_an_instant_is_told_again_until_there_is_news():
    f = Flight().go(1.0)
    t_ns = f.t_ns + 15 * MS
    first = f.aircraft.align(t_ns)
    assert f.aircraft.align(t_ns) is first
    f.own(positions=True)  # a duplicate: nothing new, and looked at again all the same
    again = f.aircraft.align(t_ns)
    assert (again.travel_difference_m == first.travel_difference_m).all()
    f.t_ns += 10 * MS
    f.own(positions=True)
    assert (f.aircraft.align(t_ns).own.v_ned_m_s == first.own.v_ned_m_s).all(), "straight flight"
    assert (f.aircraft.align(t_ns).own_attitude.R_ned_body != first.own_attitude.R_ned_body).any(), "news"


def test_what_the_estimate_says_of_itself_grows_while_the_tanker_is_silent():
    f = Flight().go(1.0).go(2.0, labels=range(9))
    tanker_ns, sigmas = f.aircraft.tanker_ns, []
    for late_ns in (50 * MS, 250 * MS, 450 * MS):
        while f.t_ns < tanker_ns + late_ns:
            f.t_ns += 10 * MS
            f.own(positions=True)
        at = f.filter.at(f.t_ns)
        sigmas.append(np.sqrt(np.diag(at.cov)))
    young, _, old = np.array(sigmas)
    assert old[2] > np.hypot(young[2], 0.04), "0.6 m/s^2 for 0.45 s is 0.06 m"
    assert old[5] > 3 * young[5]
    assert (np.diff(np.array(sigmas)[:, :9], axis=0) > -1e-12).all()


def test_a_status_of_gps_holds_for_seconds_and_not_beyond_a_restart():
    f = Flight().go(1.0)
    f.aircraft.gps_event(GpsStatus(f.t_ns, has_fix=False))
    told = len(f.reasons("gps"))
    f.go(2.9)
    assert len(f.reasons("gps")) == told
    f.go(2.0)
    assert len(f.reasons("gps")) > told + 10, "nothing has been told for long"
    f.aircraft.gps_event(GpsStatus(f.t_ns, has_fix=False))
    f.aircraft.restart()
    f.filter.restart()
    f.go(1.0)
    assert f.filter.at(f.t_ns) is not None


@pytest.mark.parametrize("whose", ["own", "tanker"])
def test_positions_that_are_refused_and_carried_on_are_no_gps(whose):
    """A receiver of GPS that tells another place each time: the estimate must not stay young on its velocities."""
    f = Flight().go(2.0)

    def garbage():
        return 500.0 * f.rng.standard_normal(3)

    f.off_own, f.off_tanker = (garbage, f.off_tanker) if whose == "own" else (f.off_own, garbage)
    f.go(0.2)
    told, gone_ns = len(f.reasons("gps")), f.t_ns
    f.go(4.0)
    assert len(f.reasons("gps")) == told
    assert f.filter.at(f.t_ns) is not None, "velocities are still taken"
    assert f.filter.at(f.t_ns).estimate_ns <= gone_ns
    assert f.aircraft.oldest_fix_ns() <= gone_ns
    f.off_own = f.off_tanker = f.nothing
    f.go(1.5)
    assert len(f.reasons("gps")) > told
    assert f.filter.at(f.t_ns).estimate_ns >= f.t_ns - 50 * MS


@pytest.mark.parametrize("whose", ["own", "tanker"])
def test_a_gap_of_telemetry_stays_in_what_the_estimate_says_of_itself(whose):
    def variance_after(gap_ns):
        f = Flight().go(1.0).go(2.0, labels=range(9))
        end_ns, silence_ns = f.t_ns + 840 * MS, f.t_ns + gap_ns
        f.fix = False
        f.aircraft.gps_event(GpsStatus(f.t_ns, has_fix=False))
        f.silent = lambda: whose if f.t_ns < silence_ns else ""
        f.go(1e-9 * (end_ns - f.t_ns))
        return np.diag(f.filter.at(f.t_ns).cov)[:3]

    c = FilterConfig()
    more = variance_after(800 * MS) - variance_after(0)
    assert more[1] > 0.5 * 0.78**2 * c.velocity_sigma_m_s**2, "two velocities, 0.8 s apart"
    acceleration = c.own_acceleration_m_s2 if whose == "own" else c.tanker_acceleration_m_s2
    assert more[2] > (acceleration[2] * 0.78**2 / 8) ** 2


@pytest.mark.parametrize("step_ns", [3 * S, -400 * MS])
def test_a_continuous_step_of_the_clock_changes_nothing_but_stamps(step_ns):
    """Two flights alike, one on a clock that steps, just after frames that were refused: all that comes is the same."""

    def flown(step_ns):
        f = Flight().go(1.0).go(2.0, labels=range(9))
        f.go(0.4, labels=lambda f: f.frame(seen_from_m=f.r_m + np.array([1.0, 1.0, -1.0])))
        f.aircraft.time_step_event(TimeStep(f.t_ns, "mavlink", step_ns, continuous=True))
        f.filter.shift(step_ns)
        f.t_ns += step_ns
        f.p_tanker = lambda t_ns: fs.V_TANKER * (t_ns - step_ns) * 1e-9
        first = f.filter.at(f.t_ns)
        told = len(f.updates)
        f.go(0.5, labels=lambda f: f.frame(seen_from_m=f.r_m + np.array([1.0, 1.0, -1.0])))
        return f, first, f.filter.at(f.t_ns), f.updates[told:]

    (f, *states, updates), (_, *others, more) = flown(0), flown(step_ns)
    for a, b in zip(states, others, strict=True):
        assert np.allclose(a.p_ned_m, b.p_ned_m, atol=1e-9)
        assert np.allclose(a.cov, b.cov, rtol=1e-9, atol=1e-15)
        assert (b.estimate_ns - a.estimate_ns, b.sight_ns - a.sight_ns) == (step_ns, step_ns)
    assert [u.reason for u in updates if isinstance(u, FilterUpdate)] == [
        u.reason for u in more if isinstance(u, FilterUpdate)]
    assert "position_anew" in f.reasons("pixels")
