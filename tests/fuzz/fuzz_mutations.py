"""Files made hostile: bits, bytes, lengths, numbers, names and trees changed, always the same for the same seed."""

import json
import random
import re
import zlib
from collections.abc import Callable
from typing import Any

NASTY_TOKENS = (
    b"1e999", b"-1e999", b"1e308", b"-0", b"1e-320", b"NaN", b"Infinity", b"99999999999999999999", b"-1", b"0",
    b"9" * 5000, b"null", b"true", b"[]", b"{}", b'""', b'"\\u0000"', b'"\\ud800"', b'"../../../etc/passwd"',
    b'"/dev/zero"', b'"' + b"a" * 5000 + b'"', b"[" * 20_000, b'{"a":' * 20_000, b"\x00", b"\xff\xfe", b"\xef\xbb\xbf",
    b"\r", b",", b";", b"#", b"'",
)  # fmt: skip
NASTY_VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2**31, 2**63, 10**400, -(10**400), 1e308, -1e308, 5e-324, 0.5, "", " ", "\0", "\ud800",
    "a" * 5000, "../x", "/etc/passwd", "nan", "inf", "1e999", [], {}, [[]], [None], {"": None}, [0] * 1000,
)  # fmt: skip
INTERESTING = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
TOKEN = re.compile(rb'"[^"\n]{0,200}"|-?\d+(?:\.\d+)?(?:e-?\d+)?')
PNG = b"\x89PNG\r\n\x1a\n"
Change = Callable[[bytearray, random.Random], None]


def mutated(data: bytes, rng: random.Random) -> bytes:
    """The file with one to four changes; PNG checksums are made right again half of the time."""
    if rng.random() < 0.4 and (tree := _tree_changed(data, rng)) is not None:
        return tree
    changed = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        rng.choice(CHANGES)(changed, rng)
    return _with_checksums(bytes(changed)) if rng.random() < 0.5 else bytes(changed)


def _place(data: bytearray, rng: random.Random) -> int:
    """Anywhere, headers most of the time."""
    return rng.randrange(min(len(data), 200) if rng.random() < 0.5 else len(data)) if data else 0


def _flip(data: bytearray, rng: random.Random) -> None:
    if data:
        data[_place(data, rng)] ^= 1 << rng.randrange(8)


def _set(data: bytearray, rng: random.Random) -> None:
    if data:
        data[_place(data, rng)] = rng.choice(INTERESTING) & 0xFF


def _number(data: bytearray, rng: random.Random) -> None:
    """A binary number of 2 or 4 bytes, in either order."""
    at, size = _place(data, rng), rng.choice((2, 4))
    value = rng.choice(INTERESTING) & (256**size - 1)
    data[at : at + size] = value.to_bytes(size, rng.choice(("big", "little")))


def _digit(data: bytearray, rng: random.Random) -> None:
    """Another digit, sign or exponent without a change of length, as text inside binary files needs it."""
    digits = [at for at, byte in enumerate(data) if 0x30 <= byte <= 0x39]
    if digits:
        data[rng.choice(digits)] = rng.choice(b"0123456789-e.")


def _delete(data: bytearray, rng: random.Random) -> None:
    at = _place(data, rng)
    del data[at : at + rng.choice((1, 2, 16, 300))]


def _repeat(data: bytearray, rng: random.Random) -> None:
    at = _place(data, rng)
    data[at:at] = data[at : at + rng.choice((1, 4, 40, 400))] * rng.choice((1, 2, 50))


def _insert(data: bytearray, rng: random.Random) -> None:
    at = _place(data, rng)
    data[at:at] = rng.randbytes(rng.choice((1, 2, 8)))


def _cut(data: bytearray, rng: random.Random) -> None:
    del data[_place(data, rng) :]


def _token(data: bytearray, rng: random.Random) -> None:
    found = list(TOKEN.finditer(bytes(data[:20_000])))
    if found:
        match = rng.choice(found)
        data[match.start() : match.end()] = rng.choice(NASTY_TOKENS)


CHANGES: tuple[Change, ...] = (_flip, _set, _number, _digit, _delete, _repeat, _insert, _cut, _token, _token)


def _tree_changed(data: bytes, rng: random.Random) -> bytes | None:
    """JSON, or one line of JSONL, with a value, key or element changed; None for everything else."""
    lines = data.split(b"\n")
    is_lines = len(lines) > 1 and lines[0].startswith(b"{") and lines[0].endswith(b"}")
    at = rng.randrange(len(lines)) if is_lines else 0
    try:
        tree = json.loads(lines[at] if is_lines else data)
    except ValueError:
        return None
    for _ in range(rng.randint(1, 2)):
        tree = _node_changed(tree, rng)
    text = json.dumps(tree).encode()
    return b"\n".join([*lines[:at], text, *lines[at + 1 :]]) if is_lines else text


def _node_changed(node: Any, rng: random.Random) -> Any:
    if isinstance(node, dict) and node and rng.random() < 0.9:
        key = rng.choice(list(node))
        match rng.randrange(6):
            case 0:
                return {other: value for other, value in node.items() if other != key}
            case 1:
                name = rng.choice(("", "x", "\0", "version", "../a.png", "a" * 300))
                return {(name if other == key else other): value for other, value in node.items()}
        return {**node, key: _node_changed(node[key], rng)}
    if isinstance(node, list) and node and rng.random() < 0.9:
        at = rng.randrange(len(node))
        match rng.randrange(6):
            case 0:
                return node[:at] + node[at + 1 :]
            case 1:
                return node[:at] + [node[at]] * rng.choice((2, 50)) + node[at + 1 :]
        return [*node[:at], _node_changed(node[at], rng), *node[at + 1 :]]
    return rng.choice(NASTY_VALUES)


def _with_checksums(data: bytes) -> bytes:
    """A PNG whose chunks have the checksums of what they hold now; other files as they are."""
    if not data.startswith(PNG):
        return data
    parts, at = [PNG], len(PNG)
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        body = data[at + 4 : at + 8 + length]
        parts += [data[at : at + 4], body, zlib.crc32(body).to_bytes(4, "big")]
        at += 12 + length
    return b"".join(parts) + data[at:]
