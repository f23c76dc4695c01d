"""Decide who may see a page or a stream: no page of another site, by whatever name."""

import socket
import threading
from contextlib import suppress
from email.message import Message
from http.client import HTTPException, parse_headers
from ipaddress import ip_address
from socket import gethostname
from socketserver import StreamRequestHandler, ThreadingTCPServer
from urllib.parse import urlsplit

# Viewers of Foxglove that browsers load from there.
_VIEWERS = ".foxglove.dev"
_BLOCK_BYTES = 1 << 16
_FORBIDDEN = b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


def _host_name(address: str) -> str:
    """Return the host of "HOST:PORT" without brackets, empty if there is none."""
    with suppress(ValueError):
        return urlsplit(f"//{address}").hostname or ""
    return ""


def names_this_machine(host: str) -> bool:
    """Tell whether a Host header is an IP address, localhost or this machine's name.

    Any other name may belong to a site that rebinds it to this address.

    Args:
        host: The header, which may have a port.
    """
    name = _host_name(host)
    try:
        ip_address(name)
    except ValueError:
        return name in ("localhost", gethostname())
    return True


def accepts_viewer(headers: Message) -> bool:
    """Tell by Host and Origin whether a request is allowed: from no foreign web page.

    Browsers send the page's Origin, and let any page open a WebSocket to any address.

    Args:
        headers: Headers of the request.
    """
    host = headers.get("Host", "")
    origin = headers.get("Origin")
    if not names_this_machine(host):
        return False
    # Programs send none, and Foxglove's own app that of a file.
    if origin is None or origin.startswith("file:"):
        return True
    name = _host_name(origin.partition("//")[2])
    return name in ("localhost", _host_name(host)) or name.endswith(_VIEWERS)


class Gate(ThreadingTCPServer):
    """Passes viewers on to a server on this machine that does not check the Origin."""

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, address: tuple[str, int], inner: tuple[str, int]) -> None:
        """Start a thread that listens at `address` and passes viewers on to `inner`.

        Args:
            address: Where viewers connect.
            inner: Where the server listens.

        Raises:
            OSError: The address is not available.
        """
        self.inner = inner
        super().__init__(address, _Passage)
        threading.Thread(target=self.serve_forever, daemon=True).start()

    def close(self) -> None:
        """Stop listening; open connections end when the inner server does."""
        self.shutdown()
        self.server_close()


class _Passage(StreamRequestHandler):
    """Reads the request of a connection, and passes on what it may."""

    server: Gate
    timeout = 10.0

    def handle(self) -> None:
        """Refuse a connection with 403, or copy data both ways until one side ends."""
        # A viewer may leave, or send what is no request.
        with suppress(OSError, HTTPException):
            request = self.rfile.readline(_BLOCK_BYTES)
            headers = parse_headers(self.rfile)
            if not accepts_viewer(headers):
                self.wfile.write(_FORBIDDEN)
                return
            self.connection.settimeout(None)
            with socket.create_connection(self.server.inner) as inner:
                lines = [f"{name}: {value}\r\n" for name, value in headers.items()]
                head = "".join([*lines, "\r\n"]).encode("iso-8859-1")
                inner.sendall(request + head)
                threading.Thread(target=self._answer, args=[inner], daemon=True).start()
                while data := self.rfile.read1(_BLOCK_BYTES):
                    inner.sendall(data)

    def _answer(self, inner: socket.socket) -> None:
        """Copy what the server sends, then end the connection."""
        with suppress(OSError):
            while data := inner.recv(_BLOCK_BYTES):
                self.connection.sendall(data)
            self.connection.shutdown(socket.SHUT_RDWR)
