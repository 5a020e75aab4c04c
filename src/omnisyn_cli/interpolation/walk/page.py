"""A packed walk as one HTML file that loads nothing, or as a folder for a server."""

from __future__ import annotations

import base64
import hashlib
import json
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from omnisyn_cli.interpolation.walk.contents import RULES, Walk

__all__ = ["MOST_BYTES", "page_files", "single_page"]

MOST_BYTES = 32 * 2**20
"""Of one file: what phones open without running out of memory."""

SCRIPTS = (
    "vectors", "blocks", "shaders", "surface", "renderer", "world", "walker", "controls", "fade", "headset", "main",
)  # fmt: skip
"""Files of ``web``, in the order in which they need each other."""


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
    script, style = _script(), _read("page.css")
    policy = (
        f"default-src 'none'; script-src {_hash(script)}; style-src {_hash(style)}; img-src data: blob:; "
        f"connect-src {connect}; base-uri 'none'; form-action 'none'"
    )
    template = Environment(
        loader=PackageLoader("omnisyn_cli.interpolation.walk", "web"), undefined=StrictUndefined, autoescape=True
    ).get_template("page.html")
    values = _for_script(walk.manifest)
    page = template.render(policy=policy, title=walk.title, style=style, walk=values, blocks=blocks, script=script)
    return page.encode()


@cache
def _script() -> str:
    """All scripts as one, behind the rules as constants of theirs and of shaders."""
    numbers = {name: f"{value:.9g}" for name, value in RULES.items()}
    defines = "".join(f"#define {name} {_with_point(number)}\n" for name, number in numbers.items())
    constants = "".join(f"const {name} = {number};\n" for name, number in numbers.items())
    parts = "\n".join(_read(f"{name}.js") for name in SCRIPTS)
    return f"'use strict';\n(() => {{\n{constants}const CONSTANTS = `{defines}`;\n{parts}}})();\n"


def _with_point(number: str) -> str:
    """As a shader takes a floating-point number."""
    return number if "." in number or "e" in number else f"{number}.0"


def _read(name: str) -> str:
    return (files("omnisyn_cli.interpolation.walk") / "web" / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}'"


def _for_script(values: Any) -> str:
    """JSON that ends no element and begins no comment."""
    return json.dumps(values, ensure_ascii=True, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
