"""Corners against painted wedges whose apex is known, against OpenCV's gradients and corners, and against bad input."""

from __future__ import annotations

import cv2
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from companion.config import FIRMWARE_CONFIGS, CornerConfig, TankerConfig, load
from companion.config.rules import corner_rules, tanker_rules
from companion.geometry import Mat, Vec
from companion.vision import corners_kernel as kernels
from companion.vision.corners import detect_corners

SKY, AIRFRAME = np.array([90.0, 140.0, 220.0]), np.array([95.0, 105.0, 115.0])
FINE = 16


def wedge(apex: Vec, direction: float, opening: float, size: int = 40) -> Mat:
    """Paint a wedge of airframe before the sky (size, size, 3), each pixel by the share of it that is covered."""
    sub = (np.arange(size * FINE) + 0.5) / FINE - 0.5
    x, y = sub[None, :] - apex[0], sub[:, None] - apex[1]
    inside = np.ones((size * FINE, size * FINE), dtype=bool)
    for side in (-1.0, 1.0):
        edge = direction + side * 0.5 * opening
        inside &= side * (np.cos(edge) * y - np.sin(edge) * x) <= 0.0
    share = inside.reshape(size, FINE, size, FINE).mean(axis=(1, 3))[..., None]
    return SKY + share * (AIRFRAME - SKY)


def noisy(picture: Mat, rng: np.random.Generator, noise: float = 1.2) -> np.ndarray:
    return np.clip(np.round(picture + rng.normal(0.0, noise, picture.shape)), 0, 255).astype(np.uint8)


def speckles(seed: int, h: int = 90, w: int = 120) -> np.ndarray:
    """Return a picture with many corners of all kinds."""
    rng = np.random.default_rng(seed)
    picture = np.zeros((h, w, 3))
    for _ in range(40):
        corner, colour = rng.integers(0, [h, w]), rng.uniform(40, 220, 3)
        picture[corner[0] : corner[0] + rng.integers(4, 40), corner[1] : corner[1] + rng.integers(4, 40)] = colour
    return noisy(picture, rng)


def errors_of_wedges(opening: float, count: int = 40) -> tuple[Mat, Vec, Mat]:
    """Return our errors (n, 2) in px, our sigmas (n,), and those of OpenCV's cornerSubPix (n, 2)."""
    rng = np.random.default_rng(3)
    ours, sigmas, theirs = [], [], []
    for _ in range(count):
        apex = 19.5 + rng.uniform(-0.5, 0.5, 2)
        image = noisy(wedge(apex, rng.uniform(-np.pi, np.pi), opening), rng)
        found = detect_corners(image, np.array([apex + rng.uniform(-3, 3, 2)]))
        nearest = np.argmin(np.sum((found.uv_px - apex) ** 2, axis=1))
        ours.append(found.uv_px[nearest] - apex)
        sigmas.append(found.sigma_px[nearest])
        start = np.round(found.uv_px[nearest]).astype(np.float32).reshape(1, 1, 2)
        blue = np.ascontiguousarray(image[..., 2])
        criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 20, 0.005)
        theirs.append(cv2.cornerSubPix(blue, start, (4, 4), (-1, -1), criteria).reshape(2) - apex)
    return np.array(ours), np.array(sigmas), np.array(theirs)


@pytest.mark.parametrize(("opening_deg", "limit_px"), [(50.0, 0.26), (90.0, 0.11), (130.0, 0.07)])
def test_the_apex_of_a_wedge_is_found_better_than_by_opencv(opening_deg: float, limit_px: float) -> None:
    """The sharper the wedge, the more its blurred apex draws the point inwards; sigma covers that."""
    ours, sigmas, theirs = errors_of_wedges(np.radians(opening_deg))
    rms = np.sqrt(np.mean(ours**2))
    assert rms < limit_px
    assert rms < np.sqrt(np.mean(theirs**2))
    assert np.sqrt(np.mean((ours / sigmas[:, None]) ** 2)) < 1.0
    assert sigmas.max() < 0.6


def test_the_floor_is_added_to_the_sigma_that_noise_gives() -> None:
    image = speckles(4)
    bare, floored = (detect_corners(image, None, CornerConfig(sigma_floor_px=f)) for f in (0.0, 0.7))
    np.testing.assert_allclose(floored.sigma_px, np.hypot(bare.sigma_px, 0.7))
    assert bare.sigma_px.min() > 0.0


def test_tensors_are_opencvs_scharr_summed_over_colours() -> None:
    image = speckles(1)
    image.flags.writeable = False
    field = kernels.tensors(image, -3, -3, 96, 126)[:, 3:-3, 3:-3]
    gx, gy = (cv2.Scharr(image.astype(np.float64), cv2.CV_64F, *order) / 32.0 for order in ((1, 0), (0, 1)))
    for of, expected in zip(field, (gx * gx, gx * gy, gy * gy), strict=True):
        np.testing.assert_allclose(of[1:-1, 1:-1], expected.sum(axis=2)[1:-1, 1:-1], rtol=1e-5, atol=1e-3)


def test_strength_is_the_least_eigenvalue_of_the_mean_tensor() -> None:
    image = speckles(2)
    image.flags.writeable = False
    field = kernels.tensors(image, 0, 0, 90, 120)
    strength = kernels.least_eigenvalues(field)
    a, b, c = (cv2.blur(f.astype(np.float64), (5, 5)) for f in field)
    matrices = np.stack([np.stack([a, b], axis=-1), np.stack([b, c], axis=-1)], axis=-1)
    expected = np.linalg.eigvalsh(matrices)[..., 0]
    np.testing.assert_allclose(strength[2:-2, 2:-2], expected[2:-2, 2:-2], rtol=1e-3, atol=0.05)


@given(seed=st.integers(0, 999), du=st.integers(-6, 6), dv=st.integers(-6, 6))
def test_a_picture_moved_by_whole_pixels_moves_its_corners(seed: int, du: int, dv: int) -> None:
    image = speckles(seed)
    frame = np.zeros((130, 160, 3), np.uint8)
    moved = frame.copy()
    frame[20:110, 20:140] = image
    moved[20 + dv : 110 + dv, 20 + du : 140 + du] = image
    at, there = detect_corners(frame), detect_corners(moved)
    np.testing.assert_allclose(there.uv_px, at.uv_px + np.array([du, dv]), atol=1e-9)
    np.testing.assert_allclose(there.sigma_px, at.sigma_px, atol=1e-9)


@given(seed=st.integers(0, 999))
def test_transposed_or_recoloured_pictures_have_the_same_corners(seed: int) -> None:
    image = speckles(seed)
    config = CornerConfig(max_detections=400)
    here = detect_corners(image, None, config)
    turned = detect_corners(image.transpose(1, 0, 2), None, config)
    recoloured = detect_corners(255 - image[..., ::-1], None, config)
    np.testing.assert_allclose(recoloured.uv_px, here.uv_px, atol=1e-9)
    # Sums in another order settle two like corners differently now and then: nearly all, not all.
    away = np.sqrt(np.sum((here.uv_px[:, None] - turned.uv_px[None, :, ::-1]) ** 2, axis=2)).min(axis=1)
    assert np.mean(away < 1e-3) > 0.9


@given(seed=st.integers(0, 999), gate=st.floats(1.0, 40.0), most=st.integers(1, 5), total=st.integers(5, 30))
def test_corners_keep_to_windows_counts_and_distance(seed: int, gate: float, most: int, total: int) -> None:
    config = CornerConfig(gate_px=gate, max_per_window=most, max_detections=total)
    places = np.random.default_rng(seed).uniform([-20, -20], [140, 110], (6, 2))
    found = detect_corners(speckles(seed), places, config)
    uv = found.uv_px
    assert len(uv) <= min(6 * most, total)
    if len(uv) == 0:
        return
    reach = np.abs(uv[:, None] - places[None]).max(axis=2).min(axis=1)
    assert reach.max() <= gate + config.radius_px  # the point estimate may lie that far from its candidate
    apart = np.sqrt(np.sum((uv[:, None] - uv[None]) ** 2, axis=2)) + 1e3 * np.eye(len(uv))
    assert apart.min() >= config.apart_px - 1e-9
    assert np.all(np.diff(found.strength) <= 0)
    assert np.all(found.strength >= config.min_gradient**2)
    assert np.all(found.sigma_px >= config.sigma_floor_px)
    assert found.area_px.shape == found.sigma_px.shape == (len(uv),)


def test_windows_find_what_the_whole_picture_has() -> None:
    image, config = speckles(5), CornerConfig(max_detections=400, max_per_window=50)
    whole = detect_corners(image, None, config).uv_px
    about = detect_corners(image, whole, config).uv_px
    away = np.sqrt(np.sum((whole[:, None] - about[None]) ** 2, axis=2)).min(axis=1)
    assert len(whole) > 20
    assert np.mean(away < 1e-6) > 0.95


def test_red_lights_are_candidates_too_and_edges_are_not() -> None:
    image = np.full((60, 60, 3), 110, np.uint8)
    image[:, 30:] = 200
    assert len(detect_corners(image).uv_px) == 0
    image[28:32, 10:14] = (255, 30, 30)
    assert len(detect_corners(image).uv_px) >= 1


@pytest.mark.parametrize("image", [np.zeros((48, 64, 3), np.uint8), np.full((48, 64, 3), 255, np.uint8),
                                   np.full((1, 1, 3), 9, np.uint8), np.full((2, 300, 3), 9, np.uint8)])
def test_blank_and_tiny_pictures_have_none(image: np.ndarray) -> None:
    for places in (None, np.array([[0.0, 0.0], [30.0, 20.0]])):
        assert detect_corners(image, places).uv_px.shape == (0, 2)


@pytest.mark.parametrize("places", [np.empty((0, 2)), np.full((3, 2), np.nan),
                                    np.array([[np.inf, 3.0], [3.0, -np.inf]]),
                                    np.array([[-500.0, 20.0], [1e300, 1e300], [30.0, 500.0]])])
def test_nothing_predicted_in_the_picture_finds_nothing(places: Mat) -> None:
    found = detect_corners(speckles(1), places)
    assert found.uv_px.shape == (0, 2)
    assert found.sigma_px.shape == found.area_px.shape == found.strength.shape == (0,)


@given(hnp.arrays(np.float64, st.tuples(st.integers(0, 8), st.just(2)), elements=st.floats(width=64)),
       hnp.arrays(np.uint8, st.tuples(st.integers(1, 24), st.integers(1, 24), st.just(3))))
def test_any_places_in_any_picture_give_finite_corners(places: Mat, image: np.ndarray) -> None:
    found = detect_corners(image, places)
    assert np.isfinite(found.uv_px).all()
    assert np.isfinite(found.sigma_px).all()


@pytest.mark.parametrize("image", [None, "picture", [1, 2], np.zeros((4, 5), np.uint8), np.zeros((4, 5, 3)),
                                   np.zeros((4, 5, 4), np.uint8), np.zeros((0, 5, 3), np.uint8)])
def test_what_is_no_picture_is_refused(image: object) -> None:
    with pytest.raises(ValueError, match=r"image must be \(h, w, 3\) uint8"):
        detect_corners(image)  # type: ignore[arg-type]  # the point of the test


@pytest.mark.parametrize("places", [np.zeros(2), np.zeros((4, 3)), np.zeros((2, 2, 2))])
def test_places_of_another_shape_are_refused(places: Mat) -> None:
    with pytest.raises(ValueError, match=r"predicted_uv_px must be \(n, 2\)"):
        detect_corners(np.zeros((40, 40, 3), np.uint8), places)


def test_rules_name_what_is_wrong() -> None:
    assert all(holds for holds, _ in corner_rules(CornerConfig()))
    for name, value in (("gate_px", 0.0), ("gate_px", float("nan")), ("min_gradient", 0.0), ("apart_px", 0),
                        ("radius_px", 1), ("max_per_window", 0), ("max_detections", 4), ("sigma_floor_px", -0.1)):
        broken = [text for holds, text in corner_rules(CornerConfig(**{name: value})) if not holds]
        assert len(broken) == 1
        assert name in broken[0]


def test_a_wrong_map_is_named() -> None:
    tanker = load(FIRMWARE_CONFIGS / "tankers" / "kc135r.toml", TankerConfig)
    first = tanker.corners[0]
    far = msgspec.structs.replace(first, id=99, p_tanker_m=(12820.0, 0.0, 0.0))
    for corners, says in ((tanker.corners[:4], "at least 5"), ((*tanker.corners, first), "same id"),
                          ((*tanker.corners, far), "metres, not millimetres")):
        broken = [text for holds, text in tanker_rules(msgspec.structs.replace(tanker, corners=corners)) if not holds]
        assert len(broken) == 1
        assert "corners" in broken[0]
        assert says in broken[0]
    assert all(holds for holds, _ in tanker_rules(msgspec.structs.replace(tanker, corners=())))
