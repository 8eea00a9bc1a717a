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


def minima(n, m, work, index):
    """The listing's second double loop: least of each row and column, and the column's row."""
    min_r, min_c = n * m, n * m + n
    for i in range(n):
        for j in range(m):
            work[min_r + i] = min(work[min_r + i], work[j * n + i])
            if work[j * n + i] < work[min_c + j]:
                work[min_c + j] = work[j * n + i]
                index[j] = i + 1
            if work[min_c + j] == 1000.0:
                index[j] = 0


def thesis_memory(predicted, detected, limit):
    """Listing 10.3.3, statement by statement: its one block of memory, its 1000 and its overflow value 100."""
    n, m, y1, up2 = len(predicted), len(detected), predicted.ravel().tolist(), detected.ravel().tolist()
    work, index = [0.0] * (n * m + n + m), [0] * m
    min_r, min_c = n * m, n * m + n
    for i in range(n):
        work[min_r + i] = 1000.0
        for j in range(m):
            work[j * n + i] = 1000.0
            work[min_c + j] = 1000.0
    for i in range(n):
        for j in range(m):
            if limit[0] <= up2[2 * j] <= limit[1] and limit[2] <= up2[2 * j + 1] <= limit[3]:
                work[j * n + i] = (up2[2 * j] - y1[2 * i]) ** 2 + (up2[2 * j + 1] - y1[2 * i + 1]) ** 2
    minima(n, m, work, index)
    y2 = [100.0] * (2 * n)
    for j in range(m):
        if index[j] > 0 and work[min_c + j] == work[min_r + index[j] - 1]:
            y2[2 * (index[j] - 1)] = up2[2 * j]
            y2[2 * (index[j] - 1) + 1] = up2[2 * j + 1]
    return np.array(y2).reshape(n, 2)


EDGES = st.tuples(st.integers(-7, 0), st.integers(0, 7), st.integers(-7, 0), st.integers(0, 7))


@given(sets(9), sets(12), EDGES, st.sampled_from([1.0, 8.0]))
def test_same_output_vector_as_the_listing_in_its_own_memory(predicted, detected, edges, scale):
    """At scale 8 many squared distances lie beyond the listing's 1000, and a few at it."""
    predicted, detected, screen = predicted * scale, detected * scale, tuple(scale * e for e in edges)
    labels = label_mutual_nearest(predicted, detected, np.sqrt(999.5), screen)  # squared distances are integers here
    ours = np.full((len(predicted), 2), 100.0)
    ours[labels >= 0] = detected[labels[labels >= 0]]
    np.testing.assert_array_equal(ours, thesis_memory(predicted, detected, screen))


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
