"""A packed walk as one HTML file that loads nothing, or as a folder for a server; and its program as an ES module."""

import base64
import hashlib
import json
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from omnisyn_cli.interpolation.viewer.contents import RULES
from omnisyn_cli.interpolation.viewer.packing import Blocks
from omnisyn_cli.io.outputs import write_parts

MAX_PAGE_BYTES = 32 * 2**20  # of one file: what phones open without running out of memory
# Files of ``web`` that make up the module, in the order in which they need each other.
SCRIPTS = (
    "vectors", "blocks", "shaders", "surface", "renderer", "world", "walker", "controls", "fade", "headset", "map",
    "hotspots", "measure", "dollhouse", "walk",
)  # fmt: skip
# Files of a folder besides its blocks.
INDEX_NAME, MODULE_NAME, MANIFEST_NAME = "index.html", "omnisyn-walk.js", "walk.json"
NAMED_BLOCK = re.compile(r'(?<=")[0-9a-f]{4,32}\.bin(?=")')  # names of blocks in the text of a manifest
# What a folder's page shows where it cannot load its program.
NEEDS_A_SERVER = "<p>Browsers read the files of this walk from a web server only, such as omnisyn view --serve.</p>\n"


def write_page(path: Path, manifest: dict[str, Any], contents: Sequence[bytes]) -> int:
    """Write a walk and its blocks as one file, whole or not at all; how many bytes it has."""
    blocks = "".join(
        f'<script type="text/plain" id="block-{number}">{base64.b64encode(content).decode("ascii")}</script>\n'
        for number, content in enumerate(contents)
    )
    held = f'<script type="application/json" id="walk">{_for_script(manifest)}</script>\n{blocks}'
    page = _page(manifest["title"], held, module_code() + _read("page.js"), folder=False)
    write_parts(path, [page])
    return len(page)


def write_folder(folder: Path, manifest: dict[str, Any], blocks: Blocks) -> int:
    """Write what a folder has besides its blocks; how many bytes all of it has."""
    script = f"import {{ OmnisynWalk }} from './{MODULE_NAME}';\n{_read('page.js')}"
    files = {
        INDEX_NAME: _page(manifest["title"], NEEDS_A_SERVER, script, folder=True),
        MODULE_NAME: module_code().encode(),
        MANIFEST_NAME: _for_script({**manifest, "files": blocks.names}).encode(),
    }
    for name, content in files.items():
        write_parts(folder / name, [content])
    return blocks.size + sum(map(len, files.values()))


def _page(title: str, held: str, script: str, *, folder: bool) -> bytes:
    """Nothing runs or styles but what has these hashes; in a folder also what lies beside the page."""
    style, own, connect = _read("page.css"), " 'self'" if folder else "", "'self'" if folder else "'none'"
    policy = (
        f"default-src 'none'; script-src {_hash(script)}{own}; style-src {_hash(style)}; img-src data: blob:; "
        f"connect-src {connect}; base-uri 'none'; form-action 'none'"
    )
    values = {"policy": policy, "title": title, "style": style, "held": held, "script": script}
    template = Environment(undefined=StrictUndefined, autoescape=True).from_string(_read("page.html"))
    return template.render(values).encode()


@cache
def module_code() -> str:
    """The program as one ES module, with the rules as constants of scripts and shaders, its elements and its style."""
    numbers = {name: f"{value:.9g}" for name, value in RULES.items()}
    defines = "".join(  # shaders take floating-point numbers with a point
        f"#define {name} {number}{'' if set(number) & {'.', 'e'} else '.0'}\n" for name, number in numbers.items()
    )
    constants = "".join(f"const {name} = {number};\n" for name, number in numbers.items())
    texts = {"MARKUP": _read("walk.html"), "STYLE": _read("walk.css")}
    held = "".join(f"const {name} = {_for_script(text)};\n" for name, text in texts.items())
    return f"{constants}const CONSTANTS = `{defines}`;\n{held}" + "\n".join(_read(f"{name}.js") for name in SCRIPTS)


def _read(name: str) -> str:
    loader = PackageLoader("omnisyn_cli.interpolation.viewer", "web")
    return loader.get_source(Environment(autoescape=True), name)[0]


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode('ascii')}'"


def _for_script(values: Any) -> str:
    """JSON that ends no element and begins no comment."""
    return json.dumps(values, ensure_ascii=True, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
