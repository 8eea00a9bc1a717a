"""A serial line that does not exist: bytes paced as a UART at 8N1 would pace them, on a pty or in lockstep.

A pty knows no baud rate and keeps 10 s of old frames, so the pacing is done here and the line refuses what it cannot
carry soon.
"""

from __future__ import annotations

import os
import tty
from collections import deque
from pathlib import Path

from companion.config import ConfigError

BITS_PER_BYTE = 10
"""A start bit, eight data bits, a stop bit."""


class SerialPacer:
    """What comes out of a serial line, and when.

    ``baud`` bits per second. A frame that would have to wait behind more than ``max_waiting`` bytes (one frame) is
    dropped whole and counted in ``dropped``: a sender with a full buffer leaves a frame out, it does not grow late.
    """

    def __init__(self, baud: int, max_waiting: int = 55) -> None:
        self.dropped = 0
        self._baud = baud
        self._max_waiting = max_waiting
        self._free_ns = 0
        self._frames: deque[tuple[int, bytes]] = deque()
        self._sent = 0

    def frame_ns(self, size: int) -> int:
        """Return how long ``size`` bytes occupy the line."""
        return -(-size * BITS_PER_BYTE * 1_000_000_000 // self._baud)

    def write(self, data: bytes, now_ns: int) -> bool:
        """Hand a frame to the line at ``now_ns``; False when it had to be dropped."""
        start_ns = max(now_ns, self._free_ns)
        if start_ns - now_ns > self.frame_ns(self._max_waiting):
            self.dropped += 1
            return False
        self._frames.append((start_ns, data))
        self._free_ns = start_ns + self.frame_ns(len(data))
        return True

    def due(self, now_ns: int) -> bytes:
        """Return the bytes whose last bit has passed since the last call."""
        out = bytearray()
        while self._frames:
            start_ns, data = self._frames[0]
            passed = max(0, now_ns - start_ns) * self._baud // (BITS_PER_BYTE * 1_000_000_000)
            end = min(len(data), passed)
            out += data[self._sent : end]
            self._sent = max(self._sent, end)
            if end < len(data):
                break
            self._frames.popleft()
            self._sent = 0
        return bytes(out)


class PtyLink:
    """A paced serial line whose other end is a pty under a stable name.

    ``link_path`` becomes a symbolic link to the pty's device; an old link of that name is replaced, anything else
    there is a ConfigError. ``lost`` counts bytes that nobody has read in time.
    """

    def __init__(self, baud: int, link_path: Path | str) -> None:
        self.pacer = SerialPacer(baud)
        self.lost = 0
        self._link = Path(link_path)
        if self._link.exists() and not self._link.is_symlink():
            msg = f"datalink {self._link}: exists and is no link; remove it or choose another with --datalink"
            raise ConfigError(msg)
        try:
            self._master, self._slave = os.openpty()
        except OSError as error:
            msg = f"datalink {self._link}: no pty to be had ({error.strerror}); is /dev/pts mounted?"
            raise ConfigError(msg) from None
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.device = os.ttyname(self._slave)
        self._closed = False
        self._make_link()

    def _make_link(self) -> None:
        fresh = self._link.with_name(f"{self._link.name}.{os.getpid()}")
        try:
            fresh.symlink_to(self.device)
            fresh.replace(self._link)
        except OSError as error:
            fresh.unlink(missing_ok=True)
            self._close_pty()
            msg = f"datalink {self._link}: cannot be made ({error.strerror}); choose another with --datalink"
            raise ConfigError(msg) from None

    def write(self, data: bytes, now_ns: int) -> bool:
        """Hand a frame to the line; False when the line was too busy to take it."""
        return self.pacer.write(data, now_ns)

    def pump(self, now_ns: int) -> None:
        """Let the bytes out that are due; call this every few milliseconds."""
        data = self.pacer.due(now_ns)
        if not data:
            return
        try:
            written = os.write(self._master, data)
        except BlockingIOError:
            written = 0
        self.lost += len(data) - written

    def _close_pty(self) -> None:
        os.close(self._master)
        os.close(self._slave)

    def close(self) -> None:
        """Remove the link, if it is still ours, and close the pty; safe to call twice."""
        if self._closed:
            return
        self._closed = True
        if self._link.is_symlink() and self._link.readlink() == Path(self.device):
            self._link.unlink()
        self._close_pty()
