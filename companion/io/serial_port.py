"""Serial devices by pyserial: names, opening, and what to tell people when it fails."""

from __future__ import annotations

import errno
import termios
from typing import TypeAlias

import serial

from companion.config import ConfigError

Port: TypeAlias = "serial.Serial"


def parse_spec(what: str, spec: str) -> tuple[str, int]:
    """Return device and baud rate of ``DEVICE,BAUD``; raises ConfigError that calls the link ``what``."""
    device, _, baud = spec.rpartition(",")
    if not device or not baud.strip().isdecimal() or not 50 <= int(baud) <= 4_000_000:
        msg = f"{what} '{spec}': not DEVICE,BAUD (50 to 4000000 bits per second), as in /dev/ttyUSB0,19600"
        raise ConfigError(msg)
    return device, int(baud)


def open_port(device: str, baud: int) -> Port:
    """Open a serial device for us alone, reading without waiting, and drop what it has kept; raises OSError.

    A pty or an adapter holds up to 10 s of old bytes, hence the flush.
    """
    try:
        port = serial.Serial(device, baud, exclusive=True, timeout=0)
        port.reset_input_buffer()
    except (ValueError, termios.error) as error:  # a rate that the driver does not have; a device gone at once
        raise OSError(str(error)) from error
    return port


def explain_port(device: str, error: OSError) -> str:
    """Return one line that says what is wrong with a serial device and what to do."""
    remedies = {
        errno.ENOENT: "no such device; plug it in, start the simulator first or name another as DEVICE,BAUD",
        errno.EACCES: "permission denied; add the user to the device's group (often 'dialout')",
        errno.EAGAIN: "in use by another program; stop that one or name another as DEVICE,BAUD",
    }
    unusable = f"not a usable serial device ({error}); name another as DEVICE,BAUD"
    return f"{device}: {remedies.get(error.errno or 0, unusable)}"
