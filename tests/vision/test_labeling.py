import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from companion.vision.labeling import label_mutual_nearest

PLACES = st.integers(-6, 6).map(float)  # few values, so that ties are common


def sets(most: int) -> st.SearchStrategy[np.ndarray]:
    return st.integers(0, most).flatmap(lambda n: arrays(np.float64, (n, 2), elements=PLACES))


def by_the_listing(predicted, detected, limit=np.inf):
    """Thesis 10.3.3, loop by loop."""
    n, m = len(predicted), len(detected)
    min_row, min_column, index = [np.inf] * n, [np.inf] * m, [-1] * m
    for i in range(n):
        for j in range(m):
            distance = (detected[j][0] - predicted[i][0]) ** 2 + (detected[j][1] - predicted[i][1]) ** 2
            if not distance <= limit:
                continue
            min_row[i] = min(min_row[i], distance)
            if distance < min_column[j]:
                min_column[j], index[j] = distance, i
    labels = [-1] * n
    for j in range(m):
        if index[j] >= 0 and min_column[j] == min_row[index[j]]:
            labels[index[j]] = j
    return labels


@given(sets(9), sets(12), st.one_of(st.none(), st.floats(0.5, 9.0)))
def test_same_answer_as_the_listing_ties_and_all(predicted, detected, limit):
    labels = label_mutual_nearest(predicted, detected, limit)
    assert labels.dtype == np.int64
    assert labels.tolist() == by_the_listing(predicted, detected, np.inf if limit is None else limit**2)


@given(sets(9), sets(12))
def test_no_detection_is_used_twice(predicted, detected):
    used = label_mutual_nearest(predicted, detected)
    used = used[used >= 0]
    assert len(set(used.tolist())) == len(used)


@given(st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_small_shifts_are_followed_whatever_the_order(n, seed):
    rng = np.random.default_rng(seed)
    predicted = np.column_stack([np.arange(n) * 10.0, rng.uniform(-50, 50, n)])
    order = rng.permutation(n)
    detected = (predicted + rng.uniform(-2, 2, (n, 2)))[order]
    np.testing.assert_array_equal(order[label_mutual_nearest(predicted, detected)], np.arange(n))


def test_thesis_figure_4_8_a_split_marker_does_not_spill_over():
    a, b = [0.0, 0.0], [4.0, 0.0]
    p, q = [0.3, 0.0], [1.5, 0.0]  # one light, seen twice; nothing near b
    np.testing.assert_array_equal(label_mutual_nearest(np.array([a, b]), np.array([p, q])), [0, -1])


def test_what_is_not_predicted_and_what_is_nan_does_not_match():
    predicted = np.array([[np.nan, np.nan], [1.0, 1.0], [5.0, 5.0]])
    detected = np.array([[np.nan, 1.0], [1.1, 1.0], [4.0, 5.0]])
    np.testing.assert_array_equal(label_mutual_nearest(predicted, detected), [-1, 1, 2])
    np.testing.assert_array_equal(label_mutual_nearest(predicted, detected, 0.5), [-1, 1, -1])
    np.testing.assert_array_equal(label_mutual_nearest(predicted, np.empty((0, 2))), [-1, -1, -1])
    assert label_mutual_nearest(np.empty((0, 2)), detected).shape == (0,)
