"""How well a labeling did, against the simulator's truth: a confusion matrix over frames.

Rules
-----
* The truth of a frame is, for each detection, the marker (its place in the map, from 0) whose light it is, or -1 for a
  false detection. A light detected in two pieces gives two detections with the same marker; one that has run together
  with something else is still that marker's, though its centroid is off.
* A label is wrong when its detection is not that marker's light, whatever the distance between them.
* A marker is missed when one of the frame's detections is its light and it got no label; a marker with no detection
  that got none is as it should be.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Ints = NDArray[np.int64]


class LabelScore:
    """Counts over frames. ``confusion`` (n + 1, n + 1): rows the marker that was labelled, the last row "none";
    columns whose light the detection was, the last column "spurious".

    A row's label goes to the column of its detection's truth. Detections that got no label are in the row "none", where
    the pieces of one light count once and not at all when one of them is labelled. ``absent`` counts markers without a
    detection that rightly got no label; ``impure`` labels on a piece of the right light, or one not alone in its blob.
    """

    def __init__(self, markers: int) -> None:
        self.confusion: Ints = np.zeros((markers + 1, markers + 1), dtype=np.int64)
        self.absent = 0
        self.impure = 0
        self.frames = 0
        self.frames_labelled = 0
        self.frames_wrong = 0

    def add(self, labels: ArrayLike, truth: ArrayLike, pure: ArrayLike | None = None) -> Ints:
        """Count one frame: labels (n,) index into the detections or -1, truth (m,). Return the wrong markers.

        ``pure`` (m,) bool says which detections are one light, whole and alone; without it all are.

        Raises ValueError when the numbers of markers or detections do not fit, or a detection has two labels.
        """
        given, true = np.asarray(labels, dtype=np.int64), np.asarray(truth, dtype=np.int64)
        n = len(self.confusion) - 1
        self._check(given, true, n)
        used = np.flatnonzero(given >= 0)
        owner = true[given[used]]
        np.add.at(self.confusion, (used, owner), 1)  # -1, spurious, is the last column
        labelled = np.zeros(len(true), dtype=bool)
        labelled[given[used]] = True
        seen = np.zeros(n, dtype=bool)
        seen[true[true >= 0]] = True
        reached = np.zeros(n, dtype=bool)  # lights of which some piece has a label, right or wrong
        reached[owner[owner >= 0]] = True
        self.confusion[n, :n] += seen & ~reached
        self.confusion[n, n] += np.count_nonzero((true < 0) & ~labelled)
        self.absent += int(np.count_nonzero(~seen & (given < 0)))
        if pure is not None:
            self.impure += int(np.count_nonzero(~np.asarray(pure, dtype=bool)[given[used[owner == used]]]))
        self.frames += 1
        self.frames_labelled += len(used) > 0
        self.frames_wrong += bool(np.any(owner != used))
        return used[owner != used]

    @staticmethod
    def _check(given: Ints, true: Ints, n: int) -> None:
        used = given[given >= 0]
        if given.shape != (n,) or true.ndim != 1 or np.any(true >= n):
            msg = f"labels must be ({n},) and truth (m,) of markers below {n}, not {given.shape} and {true.shape}"
            raise ValueError(msg)
        if np.any(used >= len(true)) or len(set(used.tolist())) != len(used):
            msg = f"labels must point at {len(true)} detections, each once: {given.tolist()}"
            raise ValueError(msg)

    @property
    def right(self) -> int:
        """Labels on a detection that is that marker's light."""
        return int(np.trace(self.confusion[:-1, :-1]))

    @property
    def swapped(self) -> int:
        """Labels on the light of another marker."""
        return int(self.confusion[:-1, :-1].sum()) - self.right

    @property
    def spurious_taken(self) -> int:
        """Labels on a detection that is no marker's light."""
        return int(self.confusion[:-1, -1].sum())

    @property
    def wrong(self) -> int:
        """Labels on a detection that is not that marker's light: swapped and spurious."""
        return self.swapped + self.spurious_taken

    @property
    def missed(self) -> int:
        """Lights that were detected and got no label."""
        return int(self.confusion[-1, :-1].sum())

    def table(self, ids: Sequence[int] | None = None) -> str:
        """Return the matrix and its totals as text; ``ids`` are the markers' names in the map."""
        n = len(self.confusion) - 1
        names = [str(i) for i in (ids if ids is not None else range(1, n + 1))]
        width = max(9, len(str(self.confusion.max())) + 2)
        lines = [" " * 10 + "".join(f"{name:>{width}}" for name in [*names, "spurious"])]
        lines += [f"{name:>10}" + "".join(f"{count:>{width}}" for count in row)
                  for name, row in zip([*names, "none"], self.confusion, strict=True)]
        lines.append(f"right {self.right} (of these on split or merged lights {self.impure}), wrong {self.wrong} "
                     f"(swapped {self.swapped}, spurious taken {self.spurious_taken}), missed {self.missed}, "
                     f"absent {self.absent}")
        lines.append(f"frames {self.frames}, with labels {self.frames_labelled}, with a wrong one {self.frames_wrong}")
        return "\n".join(lines)
