import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from companion.config import DetectionConfig
from companion.vision import blob_kernel
from companion.vision import detection_kernel as kernels
from companion.vision.detection import BlobFlag, detect_markers

SKY, FUSELAGE = (120.0, 160.0, 210.0), (150.0, 150.0, 150.0)


def canvas(background, height=40, width=48):
    picture = np.empty((height, width, 3))
    picture[:] = SKY if background == "edge" else background
    if background == "edge":
        picture[:, width // 2 :] = FUSELAGE
    return picture


def as_bytes(picture):
    return np.clip(np.round(picture), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("background", [SKY, FUSELAGE, "edge"])
@pytest.mark.parametrize("diameter_px", [2.0, 3.0, 6.0, 12.0])
def test_centroids_of_discs_are_right_to_a_thirtieth_of_a_pixel(paint, background, diameter_px):
    rng = np.random.default_rng(30)
    errors = []
    for _ in range(25):
        place = np.array([24.0, 20.0]) + rng.uniform(-1, 1, 2)
        found = detect_markers(as_bytes(paint(canvas(background), [(*place, diameter_px / 2)])))
        assert len(found.uv_px) == 1
        errors.append(found.uv_px[0] - place)
    assert np.sqrt(np.mean(np.square(errors), axis=0)).max() < 0.03
    assert np.abs(np.mean(errors, axis=0)).max() < 0.015


def test_lights_smaller_than_a_pixel_are_found(paint):
    """0.8 px across, four times full scale, spread by a lens of 0.5 px: what the 320x200 camera sees near 57 m."""
    rng = np.random.default_rng(31)
    taps = np.exp(-0.5 * (np.arange(-20, 21) / 8 / 0.5) ** 2)
    errors = []
    for _ in range(40):
        place = np.array([24.0, 20.0]) + rng.uniform(-0.5, 0.5, 2)
        fine = np.zeros((40 * 8, 48 * 8, 3))
        paint(fine, [(*(place * 8 + 3.5), 0.4 * 8)], colour=(1020.0, 30.0, 30.0), samples=4)
        for axis in (0, 1):
            fine = np.apply_along_axis(np.convolve, axis, fine[..., :], taps / taps.sum(), mode="same")
        light = fine.reshape(40, 8, 48, 8, 3).mean(axis=(1, 3))
        found = detect_markers(as_bytes(canvas(FUSELAGE) * (1 - light[..., :1] / 1020.0) + light))
        assert len(found.uv_px) == 1
        errors.append(found.uv_px[0] - place)
    assert np.sqrt(np.mean(np.square(errors))) < 0.1


@settings(deadline=None, max_examples=40)
@given(st.integers(-9, 9), st.integers(-6, 6))
def test_shifting_and_transposing_the_picture_shifts_and_transposes_the_answer(paint, du, dv):
    picture = as_bytes(paint(canvas(SKY), [(17.3, 14.6, 1.7), (28.1, 23.2, 2.4)]))
    base = detect_markers(picture)
    shifted = detect_markers(np.roll(picture, (dv, du), axis=(0, 1)))
    np.testing.assert_allclose(shifted.uv_px, base.uv_px + np.array([du, dv]), atol=1e-9)
    turned = detect_markers(np.ascontiguousarray(picture.transpose(1, 0, 2)))
    np.testing.assert_allclose(sorted(turned.uv_px[:, ::-1].tolist()), sorted(base.uv_px.tolist()), atol=1e-9)
    np.testing.assert_array_equal(np.sort(turned.area_px), np.sort(base.area_px))


def test_only_red_things_are_lights(paint):
    picture = canvas(SKY)
    paint(picture, [(12.0, 12.0, 3.0)], colour=(255.0, 255.0, 255.0))
    paint(picture, [(30.0, 12.0, 3.0)], colour=(255.0, 210.0, 60.0))
    paint(picture, [(20.0, 30.0, 3.0)])
    np.testing.assert_allclose(detect_markers(as_bytes(picture)).uv_px, [[20.0, 30.0]], atol=0.01)


@pytest.mark.parametrize(("colour", "size"), [((0, 0, 0), 40), ((255, 0, 0), 80), ((255, 255, 255), 40)])
def test_pictures_of_one_colour_hold_no_lights(colour, size):
    found = detect_markers(np.full((size, size, 3), colour, dtype=np.uint8))
    assert found.uv_px.shape == (0, 2)
    assert found.area_px.shape == (0,)


def test_a_picture_that_is_one_light_has_its_middle(paint):
    np.testing.assert_allclose(detect_markers(np.full((5, 9, 3), (255, 0, 0), dtype=np.uint8)).uv_px, [[4.0, 2.0]])


def test_lights_cut_by_the_border_stay_inside(paint):
    found = detect_markers(as_bytes(paint(canvas(SKY), [(0.2, 0.4, 2.0), (46.9, 38.6, 2.0), (24.0, 0.0, 1.5)])))
    assert len(found.uv_px) == 3
    assert ((found.uv_px >= 0) & (found.uv_px <= [47, 39])).all()


def test_areas_and_the_number_of_candidates_are_bounded(paint):
    lamps = [(6.0, 6.0, 0.8), (16.0, 6.0, 1.5), (26.0, 6.0, 2.5), (36.0, 6.0, 4.0)]
    picture = as_bytes(paint(canvas(FUSELAGE), lamps))
    found = detect_markers(picture)
    areas = found.area_px[np.argsort(found.uv_px[:, 0])]
    assert (np.diff(areas) > 0).all()
    bounded = detect_markers(picture, DetectionConfig(min_area_px=int(areas[1]), max_area_px=int(areas[2])))
    np.testing.assert_array_equal(np.sort(bounded.area_px), areas[1:3])
    largest = detect_markers(picture, DetectionConfig(max_detections=2))
    np.testing.assert_array_equal(np.sort(largest.area_px), areas[2:])


def test_opening_removes_specks_and_keeps_lights(paint):
    picture = as_bytes(paint(canvas(FUSELAGE), [(24.3, 20.1, 3.0)]))
    clean = detect_markers(picture).uv_px
    picture[5, 5], picture[33, 40] = (255, 0, 0), (255, 0, 0)
    assert len(detect_markers(picture, DetectionConfig(reject_clutter=False)).uv_px) == 3
    np.testing.assert_allclose(detect_markers(picture, DetectionConfig(morphology_px=3)).uv_px, clean, atol=0.05)


@settings(deadline=None)
@given(arrays(np.uint8, st.tuples(st.integers(1, 24), st.integers(1, 24), st.just(3))))
def test_any_picture_gives_centroids_inside_it(picture):
    found = detect_markers(picture)
    size = np.array([picture.shape[1], picture.shape[0]])
    assert ((found.uv_px >= 0) & (found.uv_px <= size - 1)).all()
    assert (found.area_px >= 1).all()


@pytest.mark.parametrize("shape", [(4, 4), (4, 4, 4), (0, 4, 3), (4, 0, 3)])
def test_what_is_no_picture_is_refused(shape):
    with pytest.raises(ValueError, match="must be"):
        detect_markers(np.zeros(shape, np.uint8))
    with pytest.raises(ValueError, match="float64"):
        detect_markers(np.zeros((4, 4, 3)))


MASKS = arrays(np.bool_, st.tuples(st.integers(1, 20), st.integers(1, 20)))


@settings(deadline=None, max_examples=200)
@given(MASKS)
def test_components_are_those_of_opencv_in_raster_order(mask):
    """Oracle: cv2.connectedComponents with 8 neighbours, which numbers them in another order."""
    runs = kernels.find_runs(mask.astype(np.uint8), 0)
    found = kernels.join_runs(runs)
    ours = np.zeros(mask.shape, np.int64)
    for row, first, last, owner in runs:
        ours[row, first : last + 1] = owner + 1
    count, theirs, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    pairs = {*zip(ours.ravel().tolist(), theirs.ravel().tolist(), strict=True)} - {(0, 0)}
    assert len(pairs) == count - 1 == len(found)
    np.testing.assert_array_equal(ours > 0, mask)
    first_pixels = [int(np.argmax(ours.ravel() == k + 1)) for k in range(len(found))]
    assert first_pixels == sorted(first_pixels)
    for k, place in enumerate(first_pixels):
        left, top, width, height, area = stats[theirs.ravel()[place]]
        np.testing.assert_array_equal(found[k], [area, left, left + width - 1, top, top + height - 1])


@settings(deadline=None, max_examples=100)
@given(arrays(np.uint8, st.tuples(st.integers(1, 16), st.integers(1, 16), st.just(3))), st.integers(0, 9), st.data())
def test_surroundings_are_the_opening_of_opencv(picture, half, data):
    size = 2 * half + 1
    left, top = (data.draw(st.integers(0, picture.shape[k] - 1)) for k in (1, 0))
    h, w = data.draw(st.integers(1, picture.shape[0] - top)), data.draw(st.integers(1, picture.shape[1] - left))
    signed = picture.astype(np.int16)
    redness = signed[..., 0] - signed[..., 1:].max(axis=2)
    opened = cv2.morphologyEx(redness, cv2.MORPH_OPEN, np.ones((size, size), np.uint8))
    ours = blob_kernel.surroundings(picture, left, top, h, w, size)
    np.testing.assert_array_equal(ours, opened[top : top + h, left : left + w])


def test_a_read_only_picture_is_as_good(paint):
    picture = as_bytes(paint(canvas(SKY), [(17.3, 14.6, 1.7)]))
    writable = detect_markers(picture)
    assert picture.flags.writeable
    picture.flags.writeable = False
    np.testing.assert_array_equal(detect_markers(picture).uv_px, writable.uv_px)
    np.testing.assert_array_equal(detect_markers(picture.transpose(1, 0, 2)).uv_px[:, ::-1], writable.uv_px)


def lens(picture):
    """Spread everything by a Gaussian of 0.5 px, as a lens does."""
    return cv2.GaussianBlur(picture, (0, 0), 0.5)


def noise_like(shape, sigma, seed=5):
    return sigma * np.random.default_rng(seed).standard_normal(shape)


@pytest.mark.parametrize("sigma", [0.5, 1.2, 4.0, 12.0])
def test_noise_is_told_from_the_picture_whatever_is_in_it(paint, sigma):
    picture = paint(canvas("edge", 200, 320), [(50.3, 60.2, 2.0), (200.0, 100.0, 9.0)])
    noisy = as_bytes(picture + noise_like(picture.shape, sigma))
    noisy.flags.writeable = False
    assert kernels.noise_of(noisy)[0] == pytest.approx(np.hypot(sigma, 0.29), rel=0.12)


@pytest.mark.parametrize("sigma", [0.0, 2.0, 8.0, 20.0])
def test_noise_alone_is_no_light(sigma):
    for background in ((0.0, 0.0, 0.0), (40.0, 40.0, 40.0), FUSELAGE):
        picture = canvas(background, 240, 320)
        assert len(detect_markers(as_bytes(picture + noise_like(picture.shape, sigma))).uv_px) == 0


@pytest.mark.parametrize("size", [(320, 200), (640, 480), (1280, 960)])
@pytest.mark.parametrize("exposure", [0.3, 1.0, 3.0])
def test_lights_of_one_and_a_half_pixels_are_found_at_any_exposure(paint, size, exposure):
    """Four full scales bright in front of a grey that a threefold exposure does not quite wash out."""
    rng = np.random.default_rng(6)
    places = np.column_stack([np.linspace(20, size[0] - 20, 9), rng.uniform(20, size[1] - 20, 9)])
    picture = np.full((size[1], size[0], 3), (70.0, 75.0, 80.0))
    paint(picture, [(*p, 0.75) for p in places], colour=(1020.0, 30.0, 30.0))
    found = detect_markers(as_bytes(lens(picture) * exposure + noise_like(picture.shape, 1.2)))
    assert len(found.uv_px) == 9
    ours = found.uv_px[np.argsort(found.uv_px[:, 0])]
    assert np.sqrt(np.mean((ours - places) ** 2)) < 0.08


def test_a_light_at_the_border_is_flagged_and_others_are_not(paint):
    found = detect_markers(as_bytes(paint(canvas(SKY), [(0.2, 14.4, 2.0), (24.0, 38.6, 2.0), (24.0, 14.0, 2.0)])))
    border = (found.flags & BlobFlag.BORDER) > 0
    cut = (found.uv_px[:, 0] < 3) | (found.uv_px[:, 1] > 36)
    np.testing.assert_array_equal(border, cut)
    assert found.sigma_px[border].min() > 5 * found.sigma_px[~border].max()


def test_hot_pixels_are_no_lights_alone_or_on_the_list(paint):
    picture = paint(canvas(FUSELAGE), [(24.3, 20.1, 1.5)])
    clean = detect_markers(as_bytes(lens(picture)))
    dirty = as_bytes(lens(picture))
    hot = [(5, 5), (40, 33), (0, 12), (47, 39), (26, 20)]  # the last one is in the light
    for u, v in hot:
        dirty[v, u] = (255, 0, 0)
    unlisted = detect_markers(dirty, DetectionConfig(reject_clutter=False))
    listed = detect_markers(dirty, DetectionConfig(hot_pixels=tuple(hot)))
    alone = [(unlisted.flags[np.all(np.abs(unlisted.uv_px - p) < 0.5, axis=1)] & BlobFlag.HOT) > 0 for p in hot[:2]]
    assert all(a.all() and len(a) == 1 for a in alone)
    assert len(listed.uv_px) == len(clean.uv_px) == 1
    np.testing.assert_allclose(listed.uv_px, clean.uv_px, atol=0.1)


def test_stripes_letters_in_a_row_and_white_cores_are_no_lights(paint):
    picture = paint(canvas(FUSELAGE, 80, 120), [(20.0, 20.0, 2.5)])
    picture[40:43, 10:60] = (200, 20, 20)
    picture[50:54, 60:64] = picture[50:54, 66:70] = picture[50:54, 71:75] = (200, 20, 20)
    picture[54, 60:75] = (200, 20, 20)
    paint(picture, [(90.0, 20.0, 4.0)], colour=(255.0, 90.0, 60.0))
    paint(picture, [(90.0, 20.0, 2.5)], colour=(255.0, 255.0, 255.0))
    everything = detect_markers(as_bytes(picture), DetectionConfig(reject_clutter=False))
    assert any(f & BlobFlag.GLINT for f in everything.flags)
    assert any(f & BlobFlag.STREAK for f in everything.flags)
    np.testing.assert_allclose(detect_markers(as_bytes(picture)).uv_px, [[20.0, 20.0]], atol=0.02)


def test_two_lights_run_together_are_misshapen(paint):
    found = detect_markers(as_bytes(paint(canvas(SKY), [(20.0, 14.0, 2.0), (22.6, 14.5, 2.0), (34.0, 30.0, 2.0)])))
    assert [bool(f & BlobFlag.MISSHAPEN) for f in found.flags] == [True, False]


def test_a_red_sky_hides_no_light_and_is_none(paint):
    picture = canvas((180.0, 110.0, 90.0), 240, 320)
    paint(picture, [(60.0, 60.0, 2.5), (200.0, 100.0, 2.5), (250.0, 200.0, 2.5)], colour=(255.0, 30.0, 30.0))
    found = detect_markers(as_bytes(lens(picture) + noise_like(picture.shape, 1.2)))
    np.testing.assert_allclose(found.uv_px, [[60.0, 60.0], [200.0, 100.0], [250.0, 200.0]], atol=0.05)


@pytest.mark.parametrize("colour", [(255, 0, 0), (200, 10, 10), (0, 0, 0), (255, 255, 255)])
@pytest.mark.parametrize("size", [(200, 320), (480, 640)])
def test_a_picture_of_one_colour_holds_nothing_at_any_size(colour, size):
    picture = np.empty((*size, 3), np.uint8)
    picture[:] = colour
    assert len(detect_markers(picture).uv_px) == 0
    assert len(detect_markers(picture, DetectionConfig(adaptive=False)).uv_px) == 0


def test_the_number_of_specks_bounds_nothing_but_the_answer():
    """Random colours: tens of thousands of components; a chessboard of red: as many as there can be."""
    rng = np.random.default_rng(7)
    board = np.zeros((480, 640, 3), np.uint8)
    board[::2, ::2, 0] = 255
    for picture in (rng.integers(0, 256, (480, 640, 3), dtype=np.uint8), board):
        for config in (DetectionConfig(), DetectionConfig(reject_clutter=False), DetectionConfig(adaptive=False)):
            found = detect_markers(picture, config)
            assert len(found.uv_px) <= config.max_detections
            assert np.isfinite(found.sigma_px).all()


@settings(deadline=None, max_examples=60)
@given(arrays(np.uint8, st.tuples(st.integers(1, 20), st.integers(1, 20), st.just(3)),
              elements=st.sampled_from([0, 1, 60, 128, 254, 255])), st.booleans(), st.booleans())
def test_whatever_is_found_is_finite_and_consistent(picture, adaptive, reject):
    found = detect_markers(picture, DetectionConfig(adaptive=adaptive, reject_clutter=reject))
    m = len(found.uv_px)
    assert found.uv_px.shape == (m, 2)
    for values in (found.area_px, found.sigma_px, found.radius_px, found.elongation, found.peak):
        assert values.shape == (m,)
        assert np.isfinite(values).all()
    assert (found.sigma_px > 0).all()
    assert (found.elongation >= 1.0).all()
    assert found.flags.dtype == np.uint8
    some = found.take(np.arange(m)[::2])
    np.testing.assert_array_equal(some.uv_px, found.uv_px[::2])
    np.testing.assert_array_equal(some.flags, found.flags[::2])


def test_sigma_is_the_spread_of_the_centroid_under_noise(paint):
    """The same light a hundred times, dark enough not to clip, in noise that outdoes what else sigma stands for."""
    clean = lens(paint(canvas(FUSELAGE), [(24.31, 20.17, 1.5)], colour=(240.0, 40.0, 40.0)))
    for sigma in (6.0, 9.0):
        found = [detect_markers(as_bytes(clean + noise_like(clean.shape, sigma, seed))) for seed in range(100)]
        spread = np.std([f.uv_px[0] for f in found], axis=0)
        said = np.mean([f.sigma_px[0] for f in found])
        assert 0.6 < np.sqrt(np.mean(spread**2)) / said < 1.6
