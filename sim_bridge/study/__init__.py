"""Chapter 7 of the thesis again: its two pose solvers on flights of this simulator, beside its printed numbers.

Rules
-----
* Solvers run open loop over recorded sequences, with a memory of their own, as in the thesis (``solvers``).
* Axes of every table are the thesis' camera axes: x forward, y right, z down; roll, pitch, yaw as in its eq. 5.41.
* A part takes a ``Study`` and returns a ``Section``: tables, sentences and pictures. ``report`` puts them on a page.
* Chance comes from the seed alone. The figures of ``timing`` are the only ones that differ from run to run.
"""
