"""The live page's server: two paths on loopback, a thread for each request, nothing from anywhere else."""

from __future__ import annotations

import contextlib
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files

from flightstack_logs.live.board import Board

HOST = "127.0.0.1"
_TIMEOUT_S = 5.0


class PageServer(ThreadingHTTPServer):
    """`http://127.0.0.1:PORT/`; OSError where the port is taken."""

    daemon_threads = True
    allow_reuse_address = True  # of connections of the last flight that are still dying; never beside another server
    block_on_close = False

    def __init__(self, port: int, board: Board) -> None:
        super().__init__((HOST, port), _Request)
        self.board = board
        self.page = files(__package__).joinpath("page.html").read_bytes()
        self.stopped = False
        self._thread = threading.Thread(target=self.serve_forever, args=(0.2,), name="live page", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """No further request is answered."""
        self.stopped = True
        self.shutdown()
        self.server_close()

    def handle_error(self, request: object, client_address: object) -> None:
        """A browser that goes away is nobody's error."""


class _Request(BaseHTTPRequestHandler):
    timeout, disable_nagle_algorithm = _TIMEOUT_S, True
    protocol_version = "HTTP/1.1"  # a browser keeps its connection: no new thread for each of its questions
    server: PageServer

    def do_GET(self) -> None:
        """The page, or what it shows."""
        if self.server.stopped:
            self.close_connection = True
            return
        name = (self.headers.get("Host") or "").rpartition(":")[0]
        if name not in (HOST, "localhost"):  # another site's name that leads here
            self.send_error(403)
        elif self.path == "/":
            self._answer("text/html; charset=utf-8", self.server.page)
        elif self.path == "/state":
            self._answer("application/json", self.server.board.as_json())
        else:
            self.send_error(404)

    def _answer(self, kind: str, body: bytes) -> None:
        with contextlib.suppress(OSError):
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(body)

    def log_message(self, format: str, *arguments: object) -> None:
        """Requests are not told."""
