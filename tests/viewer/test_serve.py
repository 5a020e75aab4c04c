"""What a served folder answers to whom: files of the walk, to names of this machine."""

import http.client
import socket
from collections.abc import Iterator
from pathlib import Path
from threading import Thread

import pytest

from omnisyn_cli.interpolation.viewer.serve import served

FILES = {"index.html": b"<p>walk", "0000.bin": b"\x00\x01", "secret.txt": b"secret", ".hidden": b"secret"}


@pytest.fixture
def port(tmp_path: Path) -> Iterator[int]:
    """Of a server of a folder in which more lies than a walk."""
    folder = tmp_path / "walk"
    (folder / "below").mkdir(parents=True)
    for name, content in FILES.items():
        (folder / name).write_bytes(content)
    (folder / "below" / "0000.bin").write_bytes(b"secret")
    (tmp_path / "outside").write_bytes(b"secret")
    (folder / "0001.bin").symlink_to(tmp_path / "outside")
    with served(folder) as (_, server):
        thread = Thread(target=server.serve_forever)
        thread.start()
        yield server.server_port
        server.shutdown()
        thread.join()


def answer(port: int, path: str, host: str | None = "127.0.0.1", method: str = "GET") -> tuple[int, bytes, str]:
    """Status, content and headers."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    connection.putrequest(method, path, skip_host=True)
    if host is not None:
        connection.putheader("Host", host)
    connection.endheaders()
    got = connection.getresponse()
    found = got.status, got.read(), str(got.headers)
    connection.close()
    return found


@pytest.mark.parametrize("host", ["127.0.0.1:80", "localhost", "localhost:1234"])
def test_a_walk_is_served_to_this_machine(port: int, host: str) -> None:
    for path, name in (("/", "index.html"), ("/index.html?x=1", "index.html"), ("/0000.bin", "0000.bin")):
        status, content, headers = answer(port, path, host)
        assert (status, content) == (200, FILES[name])
        assert "Server" not in headers
        assert "Python" not in headers
    assert answer(port, "/", host, "HEAD")[:2] == (200, b"")


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "", None, "localhost.:1", "[::1]"])
def test_names_of_others_are_answered_nothing(port: int, host: str | None) -> None:
    """Such as a page whose name was made to lead to this machine after it was loaded."""
    assert answer(port, "/", host)[0] == 403


@pytest.mark.parametrize(
    "path",
    ["/secret.txt", "/.hidden", "/0001.bin", "/below", "/below/", "/below/0000.bin", "/../outside", "/%2e%2e/outside",
     "/%00", "/x%00", "/%ff", "/index.html%00", "/" + "a" * 5000, "http://evil.example/"],
)  # fmt: skip
def test_nothing_but_the_walk_is_served(port: int, path: str, capfd: pytest.CaptureFixture[str]) -> None:
    status, content, headers = answer(port, path)
    assert status == 404
    assert b"secret" not in content
    assert "Python" not in headers
    assert capfd.readouterr() == ("", "")


def test_a_folder_without_its_page_is_not_listed(port: int, tmp_path: Path) -> None:
    (tmp_path / "walk" / "index.html").unlink()
    assert answer(port, "/")[0] == 404


@pytest.mark.parametrize(
    "sent",
    [b"\x00\xff\r\n\r\n", b"GET\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n", b"POST / HTTP/1.1\r\n\r\n", b"",
     b"GET / HTTP/1.1\r\nHost" + b"x" * 70_000],
)  # fmt: skip
def test_what_is_no_request_is_no_crash(port: int, sent: bytes, capfd: pytest.CaptureFixture[str]) -> None:
    with socket.create_connection(("127.0.0.1", port), timeout=30) as connection:
        connection.sendall(sent)
        connection.shutdown(socket.SHUT_WR)
        assert b"Python" not in connection.recv(1 << 16)
    assert answer(port, "/")[0] == 200
    assert capfd.readouterr() == ("", "")
