"""What the arrival of a frame on a serial line says about its stamp.

A frame of n bytes takes n x 10 bits / baud (8N1; 55 bytes at 19600 bit/s: 28.06 ms), so its content was true before its
first bit: stamp <= arrival - transmission. It was not there at the read before: arrival is later than that. So

    lag = arrival - transmission - stamp

is the age of the content when it was sent, plus what it waited, plus what the sender's clock is behind. It cannot be
negative, but for what our own reading of GPS time errs; over a few seconds its minimum is what cannot be explained by
waiting: age and clock alone. When ``AHEAD_FRAMES`` of these seconds were there before they could be, the sender's clock
is ahead, and no stamp of it is believed: at 206 m/s, 20 ms are four metres.
"""

from __future__ import annotations

from collections import deque

BITS_PER_BYTE = 10
"""A start bit, eight data bits, a stop bit."""
MAX_LAG_NS = 250_000_000
"""A link that is always later, or a clock that is further behind, is none to fly on: 50 m of flight."""
MAX_AHEAD_NS = 100_000_000
AHEAD_NS = 5_000_000
"""What a lag may be below nothing by rounding and by clocks that drift, beside the uncertainty of our own time."""
AHEAD_FRAMES = 3
WINDOW_NS = 5_000_000_000


class ArrivalBounds:
    """Holds the stamps of one line against when its frames arrive.

    ``lag_ns`` is the smallest lag of the last seconds: offset of the sender's clock (behind ours positive) and constant
    delay, which arrivals alone cannot tell apart. None before the first frame.
    """

    def __init__(self, baud: int) -> None:
        self._baud = baud
        self._read_ns: int | None = None
        self._ahead: deque[int] = deque(maxlen=AHEAD_FRAMES)  # arrivals of the newest frames with an impossible lag
        self._lags: deque[tuple[int, int]] = deque()  # rising in lag: the first is the smallest in the window

    @property
    def lag_ns(self) -> int | None:
        """Return the smallest lag of the last ``WINDOW_NS``."""
        return self._lags[0][1] if self._lags else None

    def transmission_ns(self, size: int) -> int:
        """Return how long ``size`` bytes are on the line."""
        return size * BITS_PER_BYTE * 1_000_000_000 // self._baud

    def read(self, now_ns: int) -> int:
        """Note that the line has been read now; return the read before: all that has come, came since."""
        before_ns, self._read_ns = self._read_ns, now_ns
        return now_ns if before_ns is None else before_ns

    def fault(
        self, stamp_ns: int, size: int, since_ns: int, now_ns: int, uncertain_ns: int | None = None
    ) -> str:
        """Say what is wrong with a stamp: ``future_stamp``, ``stale_stamp`` or nothing; the frame counts for the lag.

        The last of the frame's ``size`` bytes came between ``since_ns`` and ``now_ns``; ``uncertain_ns``: how wrong our
        time may be on the clock of the stamps, None when that is not known.
        """
        on_line_ns = self.transmission_ns(size)
        latest_ns = now_ns - on_line_ns - stamp_ns
        if latest_ns < -MAX_AHEAD_NS:
            return "future_stamp"
        while self._lags and now_ns - self._lags[0][0] > WINDOW_NS:
            self._lags.popleft()
        while self._lags and self._lags[-1][1] >= latest_ns:
            self._lags.pop()
        self._lags.append((now_ns, latest_ns))
        if self._is_ahead(latest_ns, now_ns, uncertain_ns):
            return "future_stamp"
        waited_ns = now_ns - since_ns
        return "stale_stamp" if latest_ns - waited_ns > MAX_LAG_NS else ""

    def _is_ahead(self, lag_ns: int, now_ns: int, uncertain_ns: int | None) -> bool:
        """Tell whether the frame, or several of the last ones, came before it could."""
        impossible = uncertain_ns is not None and lag_ns < -(uncertain_ns + AHEAD_NS)
        if impossible:
            self._ahead.append(now_ns)
        several = len(self._ahead) == AHEAD_FRAMES and now_ns - self._ahead[0] <= WINDOW_NS
        return impossible or several
