"""What is asked of a pose before it is passed on, and what it is refused for."""

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from scipy.stats import chi2 as chi_square

from companion.config import FIRMWARE_CONFIGS, CompanionConfig, VisionConfig, load
from companion.config.rules import companion_rules
from companion.geometry import SE3
from companion.vision.quality import judge_pose, pose_limits, position_sigma_m
from companion.vision.refinement import refine_pose
from companion.vision.translation import solve_translation


def see(T, points, rng=None, sigma=0.0):
    q = T.transform(points)
    uv = q[:, :2] / q[:, 2:]
    return uv if rng is None else uv + rng.normal(0.0, sigma, uv.shape)


@pytest.fixture
def limits(camera, markers):
    return pose_limits(VisionConfig(), camera, len(markers))


def seen(markers, T, limits, rng, share=1.0):
    """Return the refined pose of markers whose noise is so many times what the limits assume."""
    return refine_pose(markers, see(T, markers, rng, share * limits.sigma), T, np.full(len(markers), limits.sigma))


def test_limits_are_the_quantiles_and_the_pixels_of_the_configuration(camera, limits):
    assert limits.sigma == pytest.approx(0.3 / 457)
    assert limits.max_chi2[0] == np.inf
    dof = np.arange(1, 16)
    np.testing.assert_allclose(limits.max_chi2[1:16], chi_square.isf(1e-6, dof), rtol=1e-9)


def test_poses_of_an_approach_pass(markers, approach_pose, limits):
    rng = np.random.default_rng(50)
    assert [judge_pose(seen(markers, approach_pose(rng), limits, rng), limits) for _ in range(500)] == [None] * 500


def test_as_many_are_refused_for_their_residual_as_asked(markers, approach_pose, camera):
    """One in fifty of 4000 good poses, within three standard deviations of a binomial count."""
    rng = np.random.default_rng(51)
    limits = pose_limits(msgspec.structs.replace(VisionConfig(), residual_probability=0.02), camera, len(markers))
    verdicts = [judge_pose(seen(markers, approach_pose(rng), limits, rng), limits) for _ in range(4000)]
    refused = [v[0] for v in verdicts if v is not None]
    assert set(refused) == {"residual"}
    assert len(refused) == pytest.approx(80, abs=3 * np.sqrt(4000 * 0.02 * 0.98))


def test_two_labels_swapped_never_pass(markers, approach_pose, limits):
    """Nearly always for the residual; some swaps draw the pose to where its geometry is refused before that."""
    rng = np.random.default_rng(52)
    reasons = []
    for _ in range(200):
        T = approach_pose(rng)
        uv = see(T, markers, rng, limits.sigma)
        a, b = rng.choice(len(markers), 2, replace=False)
        uv[[a, b]] = uv[[b, a]]
        pose = refine_pose(markers, uv, T, np.full(len(markers), limits.sigma))
        verdict = judge_pose(pose, limits)
        assert verdict is not None
        reasons.append(verdict[0])
    assert reasons.count("residual") > 150


def test_few_markers_are_few_only_without_the_attitude_of_the_ins(markers, approach_pose, limits):
    rng = np.random.default_rng(53)
    T, few = approach_pose(rng), markers[[1, 3, 4, 8]]
    sigma, uv = np.full(4, limits.sigma), see(T, few, rng, limits.sigma)
    assert judge_pose(refine_pose(few, uv, T, sigma), limits) == ("few_markers", "4 of 5")
    for n in (4, 3, 2):
        pose = solve_translation(few[:n], uv[:n], T.R, sigma[:n], 1e-4 * np.eye(3))
        assert judge_pose(pose, limits) is None
    three = replace(limits, min_markers_ins=3)
    assert judge_pose(pose, three) == ("few_markers", "2 of 3")


def test_markers_behind_the_camera(markers, limits):
    T = SE3(np.eye(3), np.array([0.0, 0.0, -60.0]))
    verdict = judge_pose(refine_pose(markers, see(T, markers), T, np.full(9, limits.sigma)), limits)
    assert verdict is not None
    assert verdict[0] == "behind_camera"


def test_geometry_that_does_not_fix_the_pose_is_weak(markers, approach_pose, limits):
    """Markers bunched within a metre, all of them from too far away, or hardly off one line: about that no rotation."""
    rng = np.random.default_rng(54)
    T = approach_pose(rng)
    far = SE3(T.R, np.array([0.0, 0.0, 400.0]))
    along = np.outer(np.linspace(-8, 8, 9), [0.1, 1.0, 0.1]) + rng.normal(0, 0.02, (9, 3))
    for points, place, loose in ((markers / 24.0, T, "m"), (markers, far, "m"), (along, T, "rad")):
        pose = seen(points, place, limits, rng)
        verdict = judge_pose(pose, limits)
        assert (position_sigma_m(pose) > 1.0) == (loose == "m")
        assert verdict is not None
        assert verdict[0] == "weak_geometry"
    # The attitude of the INS mends the last.
    sigma = np.full(9, limits.sigma)
    assert judge_pose(refine_pose(along, see(T, along), T, sigma, T.R, 1e-4 * np.eye(3)), limits) is None


def test_what_is_not_finite_or_not_settled_is_refused(markers, approach_pose, limits):
    rng = np.random.default_rng(55)
    pose = seen(markers, approach_pose(rng), limits, rng)
    holes = (replace(pose, chi2=np.nan), replace(pose, chi2=np.inf), replace(pose, cov=np.full((6, 6), np.nan)))
    for hole in holes:
        assert judge_pose(hole, limits) == ("not_finite", "")
    verdict = judge_pose(replace(pose, converged=False), limits)
    assert verdict is not None
    assert verdict[0] == "not_converged"


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"sigma_px": 0.0}, "sigma_px"),
        ({"ins_sigma_rad": -0.01}, "ins_sigma_rad"),
        ({"max_sigma_m": 0.0}, "max_sigma_m"),
        ({"max_sigma_rad": 0.0}, "max_sigma_rad"),
        ({"min_markers_ins": 1}, "min_markers_ins"),
        ({"min_markers_ins": 6}, "min_markers_ins"),
        ({"residual_probability": 0.0}, "residual_probability"),
        ({"residual_probability": 0.5}, "residual_probability"),
    ],
)
def test_limits_that_make_no_sense_are_refused(change, complaint):
    config = load(FIRMWARE_CONFIGS / "sitl/docking.toml", CompanionConfig)
    changed = msgspec.structs.replace(config, vision=msgspec.structs.replace(config.vision, **change))
    assert all(holds for holds, _ in companion_rules(config))
    (said,) = [text for holds, text in companion_rules(changed) if not holds]
    assert complaint in said
