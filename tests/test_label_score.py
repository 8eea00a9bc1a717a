import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_bridge.label_score import LabelScore


def test_one_frame_of_everything():
    """Four markers: one right, one on another's light, one on a false point, one missed; a false point is left over."""
    score = LabelScore(4)
    truth = [0, 2, -1, 3, -1]
    wrong = score.add([0, 1, 2, -1], truth)
    np.testing.assert_array_equal(wrong, [1, 2])
    np.testing.assert_array_equal(
        score.confusion,
        [[1, 0, 0, 0, 0], [0, 0, 1, 0, 0], [0, 0, 0, 0, 1], [0, 0, 0, 0, 0], [0, 0, 0, 1, 1]],
    )
    assert (score.right, score.swapped, score.spurious_taken, score.wrong, score.missed) == (1, 1, 1, 2, 1)
    assert (score.absent, score.frames, score.frames_labelled, score.frames_wrong) == (0, 1, 1, 1)


def test_pieces_of_a_light_are_that_light():
    score = LabelScore(2)
    score.add([1, -1], [0, 0], [False, False])
    assert (score.right, score.impure, score.wrong, score.missed, score.absent) == (1, 1, 0, 0, 1)
    score.add([-1, -1], [0, 0], [False, False])
    assert (score.missed, score.absent, score.frames_labelled) == (1, 2, 1)


@given(st.integers(1, 6), st.lists(st.integers(-1, 5), max_size=8), st.randoms(use_true_random=False))
def test_everything_is_counted_once(n, truth, random):
    truth = np.array([t if t < n else -1 for t in truth], dtype=np.int64)
    free = list(range(len(truth)))
    random.shuffle(free)
    labels = np.array([free.pop() if free and random.random() < 0.6 else -1 for _ in range(n)])
    score = LabelScore(n)
    wrong = score.add(labels, truth)
    assert score.right + score.wrong == np.count_nonzero(labels >= 0)
    assert score.wrong == len(wrong)
    assert score.confusion[:, -1].sum() == np.count_nonzero(truth < 0)
    assert score.absent == sum(i not in truth and labels[i] < 0 for i in range(n))


def test_the_table_can_be_read():
    score = LabelScore(2)
    score.add([0, -1], [0, -1])
    table = score.table([7, 9])
    assert table.splitlines()[0].split() == ["7", "9", "spurious"]
    assert table.splitlines()[1].split() == ["7", "1", "0", "0"]
    assert "right 1" in table
    assert "wrong 0" in table


@pytest.mark.parametrize(
    ("labels", "truth"), [([0], [0]), ([0, 5], [0, 1]), ([0, 0], [0, 1]), ([0, 1], [0, 2]), ([0, 1], [[0, 1]])]
)
def test_what_does_not_fit_is_told(labels, truth):
    with pytest.raises(ValueError, match="labels"):
        LabelScore(2).add(labels, truth)
