"""Serves the live view: GET /, /model and /events, to this machine's own pages only.

A page from elsewhere that a browser on this machine shows can send requests here. It must not read the answers:

- `Host` must name the address served, so that a name that was made to point here (DNS rebinding) is refused;
- `Origin` and `Sec-Fetch-Site`, where a browser sends them, must be this page's own;
- answers say that they may not be read, framed or guessed at by other origins.
"""

from __future__ import annotations

import errno
import ipaddress
import json
import socket
import sys
import threading
from dataclasses import dataclass, replace
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

from pipeline.view.live.feed import Feed

DEFAULT_ADDRESS = "127.0.0.1:8080"
PORTS_TRIED = 20  # from the wanted one on, where others are taken
WAIT_S = 10.0  # of a request for a newer model; then the page asks again
EVENT_S = 0.5  # between events
HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
}


@dataclass(frozen=True)
class Address:
    host: str
    port: int  # 0: any

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    @property
    def is_local(self) -> bool:
        """Whether only this machine reaches it."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"


def address_of(text: str, where: str) -> Address:
    """From HOST:PORT. ValueError, naming `where`, for anything else."""
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not host or not port.isascii() or not port.isdigit() or int(port) > 65535:
        raise ValueError(f"{where}: expected HOST:PORT such as {DEFAULT_ADDRESS}, found {text}")
    return Address(host, int(port))


class LiveServer:
    """A context manager; serves in threads of its own while it is open."""

    def __init__(self, address: Address, page: str, feed: Feed) -> None:
        """The wanted port or one of the next PORTS_TRIED that is free. OSError, one line, where none is."""
        self._page, self.feed = page.encode(), feed
        self._server = _listening(address, self._handler())
        self.address = replace(address, port=self._server.server_address[1])
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)

    @property
    def url(self) -> str:
        return f"http://{self.address}/"

    def __enter__(self) -> LiveServer:
        self._thread.start()
        return self

    def __exit__(self, *exception: Any) -> None:
        self.feed.end()
        self._server.shutdown()
        self._server.server_close()

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        live = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:  # noqa: N802 (http.server calls it by that name)
                try:
                    live.answer(self)
                except (BrokenPipeError, ConnectionResetError):
                    self.close_connection = True  # the page was closed

            def log_message(self, *_: Any) -> None:
                """Nothing: the terminal is the training's."""

        return Handler

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        if refused := self._refusal(request):
            _send(request, HTTPStatus.FORBIDDEN, "text/plain; charset=utf-8", refused.encode())
            return
        url = urlsplit(request.path)
        if url.path == "/":
            _send(request, HTTPStatus.OK, "text/html; charset=utf-8", self._page)
        elif url.path == "/model":
            model = self.feed.model_after(_after(url.query), WAIT_S)
            if model is None:
                _send(request, HTTPStatus.NO_CONTENT, None, b"")
            else:
                _send(request, HTTPStatus.OK, "application/octet-stream", model)
        elif url.path == "/events":
            self._events(request)
        else:
            _send(request, HTTPStatus.NOT_FOUND, "text/plain; charset=utf-8", b"expected /, /model or /events")

    def _refusal(self, request: BaseHTTPRequestHandler) -> str | None:
        """Why the request is refused, or None."""
        host, origin = request.headers.get("Host", ""), request.headers.get("Origin")
        if self.address.is_local:
            names = ("127.0.0.1", "localhost", "[::1]")
            hosts = {str(self.address), *(f"{name}:{self.address.port}" for name in names)}
            if self.address.port == 80:  # which browsers leave out
                hosts |= {*names, self.address.host}
            if host not in hosts:
                return f"Host: expected {self.address}, found {host}"
        if origin is not None and origin != f"http://{host}":
            return f"Origin: expected http://{host}, found {origin}"
        site, mode = request.headers.get("Sec-Fetch-Site"), request.headers.get("Sec-Fetch-Mode")
        if site not in (None, "same-origin", "none") and mode != "navigate":
            return f"Sec-Fetch-Site: expected same-origin, found {site}"
        return None

    def _events(self, request: BaseHTTPRequestHandler) -> None:
        """Server-Sent Events: `progress` as it comes, at most one in EVENT_S; `end` once training has ended."""
        _start(request, HTTPStatus.OK, "text/event-stream", None)
        request.close_connection = True
        reached, pause = -1, threading.Event()
        while True:
            progress = self.feed.progress_after(reached, WAIT_S)
            if progress is not None:
                reached = progress["iteration"]
                _write(request, f"event: progress\ndata: {json.dumps(progress)}\n\n")
                pause.wait(EVENT_S)
            elif self.feed.ended:
                _write(request, "event: end\ndata: {}\n\n")
                return
            else:
                _write(request, ": nothing new\n\n")  # a closed page is noticed by writing


class _Server(ThreadingHTTPServer):
    daemon_threads = True  # an open page does not keep the run from ending

    def __init__(self, address: Address, port: int, handler: type[BaseHTTPRequestHandler]) -> None:
        self.address_family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
        super().__init__((address.host, port), handler)

    def handle_error(self, request: object, client_address: object) -> None:
        """Nothing for a page that was closed, as the terminal is the run's."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


def _listening(address: Address, handler: type[BaseHTTPRequestHandler]) -> _Server:
    for port in [0] if address.port == 0 else range(address.port, min(address.port + PORTS_TRIED, 65536)):
        try:
            return _Server(address, port, handler)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise OSError(f"{address}: expected an address of this machine, found {error.strerror}") from None
    raise OSError(f"{address}: expected a free port among the next {PORTS_TRIED}, found all taken")


def _after(query: str) -> int:
    """The iteration of ?after=, -1 where it is no number."""
    try:
        return int(parse_qs(query)["after"][0])
    except (KeyError, ValueError):
        return -1


def _start(request: BaseHTTPRequestHandler, status: HTTPStatus, kind: str | None, length: int | None) -> None:
    request.send_response(status)
    for name, value in HEADERS.items():
        request.send_header(name, value)
    if kind is not None:
        request.send_header("Content-Type", kind)
    request.send_header(*(("Connection", "close") if length is None else ("Content-Length", str(length))))
    request.end_headers()


def _send(request: BaseHTTPRequestHandler, status: HTTPStatus, kind: str | None, body: bytes) -> None:
    _start(request, status, kind, len(body))
    request.wfile.write(body)


def _write(request: BaseHTTPRequestHandler, text: str) -> None:
    request.wfile.write(text.encode())
    request.wfile.flush()
