"""A server for walks that are folders: of this machine, for this machine."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

HOST = "127.0.0.1"


class _Handler(SimpleHTTPRequestHandler):
    """Serves files without saying so."""

    def log_message(self, format: str, *arguments: object) -> None:  # noqa: A002
        """Nothing."""

    def end_headers(self) -> None:
        """A walk that was made again is shown again."""
        self.send_header("Cache-Control", "no-cache")
        super().end_headers()


@contextmanager
def served(folder: Path, port: int = 0) -> Iterator[tuple[str, ThreadingHTTPServer]]:
    """The address of a server of a folder, which answers this machine only; a free port by default."""
    with ThreadingHTTPServer((HOST, port), partial(_Handler, directory=str(folder))) as server:
        yield f"http://{HOST}:{server.server_port}/", server
