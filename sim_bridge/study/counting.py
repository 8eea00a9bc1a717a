"""Numbers that count: what takes floats is run on them, and the arithmetic that it does is on a tally.

Rules
-----
* One addition, subtraction, multiplication, division, square root, sine, cosine or angle is one operation. A change of
  sign, an absolute value, a comparison and a copy are none. ``x ** k`` is k - 1 multiplications.
* A compiled kernel is run by its own Python source: ``source_of`` hands it numbers that count in the place of floats.
* LAPACK cannot be run on such numbers; its parts are on the tally by their textbook figures (``Textbook``).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from types import FunctionType
from typing import Any

import numpy as np
from numpy.typing import NDArray

Tally = Counter[str]


class Counted:
    """A float whose arithmetic is counted."""

    __slots__ = ("tally", "value")

    def __init__(self, value: float, tally: Tally) -> None:
        self.value, self.tally = value, tally

    def _do(self, kind: str, value: float) -> Counted:
        self.tally[kind] += 1
        return Counted(value, self.tally)

    def __add__(self, other: object) -> Counted:
        return self._do("add", self.value + _float(other))

    __radd__ = __add__

    def __sub__(self, other: object) -> Counted:
        return self._do("add", self.value - _float(other))

    def __rsub__(self, other: object) -> Counted:
        return self._do("add", _float(other) - self.value)

    def __mul__(self, other: object) -> Counted:
        return self._do("multiply", self.value * _float(other))

    __rmul__ = __mul__

    def __truediv__(self, other: object) -> Counted:
        return self._do("divide", self.value / _float(other))

    def __rtruediv__(self, other: object) -> Counted:
        return self._do("divide", _float(other) / self.value)

    def __pow__(self, exponent: int) -> Counted:
        self.tally["multiply"] += exponent - 1
        return Counted(self.value**exponent, self.tally)

    def __neg__(self) -> Counted:
        return Counted(-self.value, self.tally)

    def __abs__(self) -> Counted:
        return Counted(abs(self.value), self.tally)

    def __float__(self) -> float:
        return float(self.value)

    def __lt__(self, other: object) -> bool:
        return self.value < _float(other)

    def __le__(self, other: object) -> bool:
        return self.value <= _float(other)

    def __gt__(self, other: object) -> bool:
        return self.value > _float(other)

    def __ge__(self, other: object) -> bool:
        return self.value >= _float(other)

    def sqrt(self) -> Counted:
        """Take the root: what ``np.sqrt`` calls."""
        return self._do("root", float(np.sqrt(self.value)))

    def sin(self) -> Counted:
        """Take the sine: what ``np.sin`` calls."""
        return self._do("trigonometric", float(np.sin(self.value)))

    def cos(self) -> Counted:
        """Take the cosine: what ``np.cos`` calls."""
        return self._do("trigonometric", float(np.cos(self.value)))

    def arcsin(self) -> Counted:
        """Take the angle: what ``np.arcsin`` calls."""
        return self._do("trigonometric", float(np.arcsin(self.value)))

    def arctan2(self, x: object) -> Counted:
        """Take the angle: what ``np.arctan2`` calls."""
        return self._do("trigonometric", float(np.arctan2(self.value, _float(x))))


def _float(x: object) -> float:
    return x.value if isinstance(x, Counted) else float(x)  # type: ignore[arg-type]  # ints and numpy's scalars


def counted(values: Any, tally: Tally) -> NDArray[Any]:
    """Return an array of numbers that count, of the shape of ``values``."""
    array = np.asarray(values, dtype=np.float64)
    out = np.empty(array.shape, dtype=object)
    for index, value in np.ndenumerate(array):
        out[index] = Counted(float(value), tally)
    return out


def plain(values: NDArray[Any]) -> NDArray[np.float64]:
    """Return the floats of an array of numbers that count."""
    return np.vectorize(float, otypes=[np.float64])(values)


class CountingNumpy:
    """What stands for numpy in a kernel's source: new arrays are of numbers that count, the rest is numpy's."""

    def __init__(self, tally: Tally) -> None:
        self._tally = tally

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)

    def zeros(self, shape: Any) -> NDArray[Any]:
        """Return zeros that count."""
        return counted(np.zeros(shape), self._tally)

    def empty(self, shape: Any) -> NDArray[Any]:
        """Return numbers that count."""
        return counted(np.zeros(shape), self._tally)

    def array(self, values: Any) -> NDArray[Any]:
        """Return values in an array, counting or not as they come."""
        return np.array(values, dtype=object)

    def isfinite(self, x: Any) -> bool:
        """Test one number; that is no arithmetic."""
        return bool(np.isfinite(float(x)))


def source_of(kernel: Any, tally: Tally) -> Callable[..., Any]:
    """Return the Python source of a numba kernel, and of all kernels that it calls, with numpy that counts."""
    function = kernel.py_func
    names = dict(function.__globals__)
    for name in function.__code__.co_names:
        value = names.get(name)
        if value is np:
            names[name] = CountingNumpy(tally)
        elif hasattr(value, "py_func"):
            names[name] = source_of(value, tally)
    return FunctionType(function.__code__, names, function.__name__, function.__defaults__)


class Lapack:
    """The decompositions that the thesis' listings call, on floats."""

    def svd(self, M: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return U and V of M = U S V^T."""
        U, _, Vt = np.linalg.svd(M)
        return U, Vt.T

    def inv(self, M: NDArray[Any]) -> NDArray[Any]:
        """Return the inverse."""
        return np.linalg.inv(M)

    def pinv(self, M: NDArray[Any]) -> NDArray[Any]:
        """Return the pseudo-inverse, by singular values."""
        return np.linalg.pinv(M)


class Textbook(Lapack):
    """The same for numbers that count: floats inside, and on the tally what Golub and Van Loan give for n by n.

    U, S and V: 4 m^2 n + 8 m n^2 + 9 n^3 = 21 n^3 (Matrix Computations, 5.4.5); inverse: 2 n^3; pseudo-inverse: the
    singular values, n reciprocals, n^2 products for the scaling and 2 n^3 for the product of the factors.
    """

    def __init__(self, tally: Tally) -> None:
        self._tally = tally

    def svd(self, M: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """See ``Lapack``."""
        self._tally["LAPACK"] += 21 * len(M) ** 3
        U, V = super().svd(plain(M))
        return counted(U, self._tally), counted(V, self._tally)

    def inv(self, M: NDArray[Any]) -> NDArray[Any]:
        """See ``Lapack``."""
        self._tally["LAPACK"] += 2 * len(M) ** 3
        return counted(super().inv(plain(M)), self._tally)

    def pinv(self, M: NDArray[Any]) -> NDArray[Any]:
        """See ``Lapack``."""
        n = len(M)
        self._tally["LAPACK"] += 23 * n**3 + n**2 + n
        return counted(super().pinv(plain(M)), self._tally)
