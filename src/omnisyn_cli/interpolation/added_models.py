"""Depth networks that users add under a name, for ``--depth-prior``: copies in the user's folder for data."""

import re
import shutil
from pathlib import Path

from omnisyn_cli.errors import InputError, OutputPathError
from omnisyn_cli.io.outputs import claimed, make_folder, replaced_when_complete, write_parts
from omnisyn_cli.runtime import models
from omnisyn_cli.runtime.monocular_session import MonocularSession, NetworkKind
from omnisyn_cli.runtime.session import open_session

NAME = re.compile(r"(?!none$)[A-Za-z0-9][\w-]*")  # that a network may have: no path, and no parameter of `eval`


def add_model(path: Path, name: str, words: str = "", *, overwrite: bool = False) -> models.ModelEntry:
    """Keep a copy of a depth network under a name, and what its file does not say; its entry in the manifest.

    It is asked about noise first. The manifest is written last, so that a network is there whole or not at all.
    InputError: no such network as a depth prior needs, or no such name; OutputPathError: there is one of that name.
    """
    if not NAME.fullmatch(name):
        raise InputError(f"expected a name of letters, digits, - and _, but not none, got {name!r}; choose another")
    if Path(name).exists() or name in models.read_manifest():
        raise InputError(f"expected a name of its own, got {name!r}, a file here or a bundled network; choose another")
    if path.suffix != ".onnx" or not path.is_file():
        raise InputError(f"{path}: expected a depth network in an .onnx file, got none; check the name")
    with claimed(folder := models.added_models_folder()):
        added = models.read_manifest(folder)
        if name in added and not overwrite:
            raise OutputPathError(f"expected a new name, got {name!r}, which is taken; choose another (or --overwrite)")
        session = MonocularSession(open_session(path), path, NetworkKind.from_words(words))
        session.try_out()
        digest = models.sha256_of(path)
        entry = models.ModelEntry(
            name, models.ADDED_ROLE, variant=words, file=f"{name}-{digest[:12]}.onnx", sha256=digest, size=session.size,
            parameters=session.parameters, training="", licence="", purpose=", ".join(filter(None, ("yours", words))),
        )  # fmt: skip
        make_folder(folder, "networks")
        with replaced_when_complete(folder / entry.file) as temporary:
            shutil.copyfile(path, temporary)
        _write(folder, {**added, name: entry})
    return entry


def remove_model(name: str) -> None:
    """Forget a network that was added. InputError: there is none of that name."""
    with claimed(folder := models.added_models_folder()):
        added = models.read_manifest(folder)
        if name not in added:
            known = ", ".join(added) or "none was added"
            raise InputError(f"expected a network of yours ({known}), got {name!r}; see `omnisyn models`")
        _write(folder, {other: entry for other, entry in added.items() if other != name})


def _write(folder: Path, entries: dict[str, models.ModelEntry]) -> None:
    """Write the manifest, and remove files that were in the former one only."""
    former = models.read_manifest(folder)
    write_parts(folder / models.MANIFEST, [models.manifest_text(entries).encode()])
    for file in {entry.file for entry in former.values()} - {entry.file for entry in entries.values()}:
        (folder / file).unlink(missing_ok=True)
