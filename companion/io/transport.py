"""UDP sockets that never wait, named as MAVLink people name them: ``udpin:HOST:PORT`` and ``udpout:HOST:PORT``."""

from __future__ import annotations

import errno
import re
import socket
from dataclasses import dataclass

from companion.config import ConfigError

Address = tuple[str, int]

URL = re.compile(r"(?P<kind>udpin|udpout):(?://)?(?P<host>[^:/\s]*):(?P<port>\d+)/?")
LOOPBACK = "127.0.0.1"
MAX_DATAGRAMS_PER_POLL = 256


@dataclass(frozen=True, slots=True)
class UdpUrl:
    """``listens`` True: bind there and answer; False: send there."""

    listens: bool
    host: str
    port: int


def parse_url(what: str, url: str) -> UdpUrl:
    """Parse ``udpin:H:P``, ``udpout:H:P`` or either with ``//``; raises ConfigError that calls the link ``what``.

    Without a host it is the loopback: to be reached from elsewhere has to be asked for.
    """
    match = URL.fullmatch(url.strip())
    if match is None or not 0 <= int(match["port"]) <= 65535:
        msg = f"{what} '{url}': not udpin:HOST:PORT or udpout:HOST:PORT, as in udpin:127.0.0.1:14540"
        raise ConfigError(msg)
    return UdpUrl(match["kind"] == "udpin", match["host"] or LOOPBACK, int(match["port"]))


class UdpTransport:
    """Datagrams in and out.

    ``peer`` is where datagrams go. A ``udpin`` socket has none until its owner sets one; the peer of ``udpout`` is
    fixed, and nothing is taken from anybody else.
    """

    def __init__(self, what: str, url: str) -> None:
        """Open the socket; raises ConfigError when the port is busy or the host unknown."""
        self.url = parse_url(what, url)
        self.send_errors = 0
        self._socket: socket.socket | None = None
        address = (self.url.host, self.url.port)
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            if self.url.listens:
                sock.bind(address)
            else:
                sock.connect(address)
        except OSError as error:
            sock.close()
            raise ConfigError(explain(what, url, error)) from None
        sock.setblocking(False)
        self._socket = sock
        self._peer: Address | None = None if self.url.listens else sock.getpeername()

    @property
    def local(self) -> Address | None:
        """Return the address of this end, None once closed."""
        return self._socket.getsockname() if self._socket else None

    @property
    def peer(self) -> Address | None:
        """Return where datagrams go."""
        return self._peer

    @peer.setter
    def peer(self, address: Address) -> None:
        if self.url.listens:
            self._peer = address

    def poll(self) -> list[tuple[bytes, Address]]:
        """Return the datagrams that have arrived, each with its sender, without waiting."""
        datagrams: list[tuple[bytes, Address]] = []
        while self._socket is not None and len(datagrams) < MAX_DATAGRAMS_PER_POLL:
            try:
                datagrams.append(self._socket.recvfrom(65535))
            except ConnectionRefusedError:  # told of an earlier datagram of ours: nobody is there yet
                continue
            except OSError:  # nothing there, or the network has gone
                break
        return datagrams

    def send(self, data: bytes, to: Address | None = None) -> None:
        """Send one datagram to ``to`` or else to the peer; without either, or without data, nothing happens."""
        address = to or self._peer
        if not data or address is None or self._socket is None:
            return
        try:
            if self.url.listens:
                self._socket.sendto(data, address)
            else:
                self._socket.send(data)
        except OSError:
            self.send_errors += 1

    def close(self) -> None:
        """Close the socket; safe to call twice."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def explain(what: str, url: str, error: OSError) -> str:
    """Return one line that says why a socket could not be had and what to do."""
    if isinstance(error, socket.gaierror):
        reason = "unknown host; give an address as in 127.0.0.1"
    elif error.errno == errno.EADDRINUSE:
        reason = f"the port is in use; stop the other program or choose another with --{what}"
    elif error.errno == errno.EADDRNOTAVAIL:
        reason = "this machine does not have that address; listen on 127.0.0.1 or 0.0.0.0"
    elif error.errno == errno.EACCES:
        reason = "not permitted; choose a port above 1023"
    else:
        reason = f"cannot be opened ({error.strerror})"
    return f"{what} '{url}': {reason}"
