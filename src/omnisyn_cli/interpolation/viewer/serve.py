"""A server for walks that are folders: of this machine, for this machine, and of nothing but the walk."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from omnisyn_cli.interpolation.viewer.page import INDEX_NAME, MANIFEST_NAME, MODULE_NAME
from omnisyn_cli.io.documents import read_file_itself

HOST = "127.0.0.1"
LOCAL_NAMES = (HOST, "localhost")
"""Names of this machine. A page from elsewhere may have its own name lead here, and must not read what is answered."""

CONTENT_TYPES = {
    INDEX_NAME: "text/html; charset=utf-8", MODULE_NAME: "text/javascript; charset=utf-8",
    MANIFEST_NAME: "application/json",
}  # fmt: skip
BLOCK_NAME = re.compile(r"[0-9a-f]+\.bin", re.ASCII)
"""Of files with names of their own; all others are blocks, see :mod:`omnisyn_cli.interpolation.viewer.packing`."""

SOCKET_TIMEOUT_SECONDS = 30


class _Server(ThreadingHTTPServer):
    def handle_error(self, request: object, client_address: object) -> None:
        """A browser that has gone is no error."""


class _Handler(BaseHTTPRequestHandler):
    """Answers with files of a walk, without saying so on the terminal, nor what program it is."""

    timeout = SOCKET_TIMEOUT_SECONDS

    def __init__(self, *arguments: object, folder: Path) -> None:
        self._folder = folder
        super().__init__(*arguments)  # type: ignore[arg-type]

    def do_GET(self) -> None:
        """The file that is asked for."""
        host = self.headers.get("Host", "").rpartition(":")
        if (host[0] or host[2]) not in LOCAL_NAMES:
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        name = self.path.partition("?")[0].removeprefix("/") or INDEX_NAME
        is_known = name in CONTENT_TYPES or BLOCK_NAME.fullmatch(name)
        content = read_file_itself(self._folder / name) if is_known else None  # no links, which lead elsewhere
        if content is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", CONTENT_TYPES.get(name, "application/octet-stream"))
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(content)

    def do_HEAD(self) -> None:
        """What there is to say about it."""
        self.do_GET()

    def send_response(self, code: int, message: str | None = None) -> None:
        """The first line of an answer, without name and version of the program."""
        self.send_response_only(code, message)

    def log_message(self, format: str, *arguments: object) -> None:  # noqa: A002
        """Nothing."""

    def end_headers(self) -> None:
        """A walk that was made again is shown again; nobody else may embed it, or take it for something else."""
        self.send_header("Cache-Control", "no-cache")
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.send_header("X-Content-Type-Options", "nosniff")
        super().end_headers()


@contextmanager
def served(folder: Path, port: int = 0) -> Iterator[tuple[str, ThreadingHTTPServer]]:
    """The address of a server of a walk, which answers this machine only; a free port by default."""
    with _Server((HOST, port), partial(_Handler, folder=folder)) as server:
        yield f"http://{HOST}:{server.server_port}/", server
