"""The trained models that come with the program or that users added: manifests, and files checked before their use."""

import hashlib
import json
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path

from pydantic import TypeAdapter

from omnisyn_cli.errors import InputError

MANIFEST = "manifest.toml"  # name of the file beside the models
MANIFEST_VERSION = 1  # counts up when older programs could not read it
MAX_REASON_CHARS = 500  # characters of what a parser complains about
ADDED_ROLE = "depth-prior"  # of models that users added: networks for `--depth-prior`


@dataclass(frozen=True)
class ModelEntry:
    """One model of a manifest, which has the version and these keys in a table ``[[models]]`` for each."""

    name: str  # what `--model` takes
    role: str  # depth, fusion, …
    variant: str  # of the network, such as paper-narrow; of an added one what its file does not say
    file: str  # beside the manifest
    sha256: str
    size: tuple[int, int]  # rows and columns of the images it takes
    parameters: int
    training: str  # on what
    licence: str
    metrics: Mapping[str, float] = field(default_factory=dict)  # such as delta_25
    purpose: str = ""  # in a few words
    hours: float = 0.0  # of training on one processor core; 0 if unknown


ENTRIES = TypeAdapter(list[ModelEntry])  # checks what a manifest lists


def models_folder() -> Path:
    """Where the default models lie: inside an installed package, or at the root of a checkout."""
    package = Path(__file__).resolve().parents[1]
    installed = package / "models"
    return installed if (installed / MANIFEST).is_file() else package.parents[1] / "models"


def added_models_folder() -> Path:
    """Where models lie that users added: ``omnisyn/models`` in their folder for data."""
    return Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share") / "omnisyn" / "models"


def read_manifest(folder: Path | None = None) -> dict[str, ModelEntry]:
    """The models of a folder by name; none without a manifest. InputError: it is malformed or of another version."""
    path = (folder or models_folder()) / MANIFEST
    if not path.is_file():
        return {}
    try:
        manifest = tomllib.loads(path.read_text(encoding="utf-8"))
        entries = ENTRIES.validate_python(manifest.get("models", []))
    except (OSError, ValueError, RecursionError) as error:  # of TOML, of UTF-8, of pydantic
        reason = f"{error!s:.{MAX_REASON_CHARS}}".replace("\n", " ")
        raise InputError(f"expected a manifest of models in {path}, but {reason}; write it with export-onnx") from error
    if manifest.get("version") != MANIFEST_VERSION:
        raise InputError(
            f"expected version {MANIFEST_VERSION} in {path}, got {manifest.get('version')!r}; update omnisyn"
        )
    return {entry.name: entry for entry in entries}


def manifest_text(entries: Mapping[str, ModelEntry]) -> str:
    """The manifest of these models, which :func:`read_manifest` reads."""
    lines = [f"version = {MANIFEST_VERSION}"]
    for entry in entries.values():
        lines += ["", "[[models]]"]
        plain = [key.name for key in fields(entry) if key.name != "metrics"]
        lines += [f"{key} = {json.dumps(getattr(entry, key), ensure_ascii=False)}" for key in plain]
        if entry.metrics:
            lines += ["", "[models.metrics]", *(f"{key} = {value!r}" for key, value in entry.metrics.items())]
    return "\n".join([*lines, ""])


def find_prior(name: str, words: str) -> tuple[str, str]:
    """The file of a depth prior, given its path or the name that it was added by, and what the file does not say.

    ``words`` say that, else those that it was added with. InputError: no such name, or another file than was added.
    """
    if name.endswith(".onnx"):
        return name, words
    folder = added_models_folder()
    added = read_manifest(folder)
    if name not in added:
        raise InputError(
            f"expected an .onnx file or one of {', '.join(('none', *added))} as --depth-prior, got {name!r}; name the "
            "file, or add it (omnisyn models add)"
        )
    return str(find_model(name, folder)), words or added[name].variant


def find_model(name: str, folder: Path | None = None, *, role: str | None = None) -> Path:
    """The file of a model of the manifest, verified by its sha256; or ``name`` itself if it is a path to a file.

    With ``role`` only models of the manifest with that role are there.
    Raises InputError: there is no such model or file, or the file is not the one that was trained.
    """
    if name.endswith(".onnx"):
        if not Path(name).is_file():
            raise InputError(f"expected an ONNX file at {name}, found none; check the path")
        return Path(name)
    remedy = "reinstall omnisyn-cli" if folder is None else "make or add it again"
    folder = folder or models_folder()
    entries = {k: entry for k, entry in read_manifest(folder).items() if role in (None, entry.role)}
    if name not in entries:
        known, kind = ", ".join(entries) or "none installed", "model" if role is None else f"{role} model"
        raise InputError(f"expected a {kind} of the manifest ({known}) or a path to an .onnx file, got {name!r}")
    path, entry = folder / entries[name].file, entries[name]
    if not path.is_file():
        raise InputError(f"expected the model {name} at {path}, found no file; {remedy}")
    found = sha256_of(path)
    if found != entry.sha256:
        raise InputError(f"expected {path} with sha256 {entry.sha256[:12]}…, got {found[:12]}…; {remedy}")
    return path


def sha256_of(path: Path) -> str:
    """Hexadecimal digest of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
