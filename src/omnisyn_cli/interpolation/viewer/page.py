"""A packed walk as one HTML file that loads nothing, or as a folder for a server."""

import base64
import hashlib
import json
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from omnisyn_cli.interpolation.viewer.contents import RULES, Walk
from omnisyn_cli.io.outputs import staged_folder, write_parts

MAX_PAGE_BYTES = 32 * 2**20
"""Of one file: what phones open without running out of memory."""

SCRIPTS = (
    "vectors", "blocks", "shaders", "surface", "renderer", "world", "walker", "controls", "fade", "headset", "main",
)  # fmt: skip
"""Files of ``web``, in the order in which they need each other."""


def write_page(path: Path, walk: Walk) -> int:
    """Write the walk as one file, whole or not at all; how many bytes it has."""
    page = single_page(walk)
    write_parts(path, [page])
    return len(page)


def write_folder(folder: Path, walk: Walk) -> int:
    """Write the walk as a folder for a server; files of other walks in it stay. How many bytes it has."""
    files = page_files(walk)
    with staged_folder(folder) as staged:
        for name, content in files.items():
            write_parts(staged / name, [content])
    return sum(map(len, files.values()))


def single_page(walk: Walk) -> bytes:
    """The walk as one file."""
    blocks = "".join(
        f'<script type="text/plain" id="block-{number}">{base64.b64encode(content).decode("ascii")}</script>\n'
        for number, content in enumerate(walk.blocks.contents)
    )
    return _page(walk, blocks, connect="'none'")


def page_files(walk: Walk) -> dict[str, bytes]:
    """The walk as files of a folder by name: ``index.html`` and what it fetches."""
    names = [f"{number:04d}.bin" for number in range(len(walk.blocks.contents))]
    served = Walk(walk.title, {**walk.manifest, "files": names}, walk.blocks)
    return {"index.html": _page(served, "", connect="'self'"), **dict(zip(names, walk.blocks.contents, strict=True))}


def _page(walk: Walk, blocks: str, *, connect: str) -> bytes:
    """Nothing runs or styles but what has these hashes; nothing is fetched but from ``connect``."""
    script, style = page_code()
    policy = (
        f"default-src 'none'; script-src {_hash(script)}; style-src {_hash(style)}; img-src data: blob:; "
        f"connect-src {connect}; base-uri 'none'; form-action 'none'"
    )
    values = {"policy": policy, "title": walk.title, "style": style, "blocks": blocks, "script": script}
    return _web().get_template("page.html").render(values, walk=_for_script(walk.manifest)).encode()


@cache
def page_code() -> tuple[str, str]:
    """All scripts as one, behind the rules as constants of theirs and of shaders; and the style."""
    numbers = {name: f"{value:.9g}" for name, value in RULES.items()}
    defines = "".join(f"#define {name} {_with_point(number)}\n" for name, number in numbers.items())
    constants = "".join(f"const {name} = {number};\n" for name, number in numbers.items())
    parts = "\n".join(_read(f"{name}.js") for name in SCRIPTS)
    script = f"'use strict';\n(() => {{\n{constants}const CONSTANTS = `{defines}`;\n{parts}}})();\n"
    return script, _read("page.css")


def _with_point(number: str) -> str:
    """As a shader takes a floating-point number."""
    return number if "." in number or "e" in number else f"{number}.0"


@cache
def _web() -> Environment:
    loader = PackageLoader("omnisyn_cli.interpolation.viewer", "web")
    return Environment(loader=loader, undefined=StrictUndefined, autoescape=True)


def _read(name: str) -> str:
    loader = _web().loader
    if loader is None:
        raise FileNotFoundError(name)
    return loader.get_source(_web(), name)[0]


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}'"


def _for_script(values: Any) -> str:
    """JSON that ends no element and begins no comment."""
    return json.dumps(values, ensure_ascii=True, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
