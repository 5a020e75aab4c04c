"""What a result depends on, as a hash: files, poses, method, options, and the program with its own sources."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import omnisyn_cli
from omnisyn_cli.errors import ImageError
from omnisyn_cli.evaluation.datasets.sources import Pair
from omnisyn_cli.runtime.models import sha256_of

RECORD_VERSION = 3  # counts up when the same inputs are measured or recorded in another way
IGNORED_ROOMS = frozenset({"batch", "cli", "networks", "training"})  # parts of the program that no method goes through


@cache
def digest_of_sources(package: Path) -> str:
    """Of a package's files but for :data:`IGNORED_ROOMS`: between two releases only this tells a change."""
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        name = path.relative_to(package)
        if name.parts[0] not in IGNORED_ROOMS:
            digest.update(f"{name.as_posix()}\n{path.stat().st_size}\n".encode() + path.read_bytes())
    return digest.hexdigest()


class Fingerprints:
    """Hashes of units; every file is read once."""

    def __init__(self) -> None:
        self._files: dict[Path, str] = {}
        self._program = [RECORD_VERSION, omnisyn_cli.__version__, digest_of_sources(Path(omnisyn_cli.__file__).parent)]

    def of(self, pair: Pair, method: Sequence[str], options: Mapping[str, Any]) -> str:
        """Digest of all that a method (name, ingredients) on a pair depends on; ImageError: an unreadable file."""
        frames = [
            [frame.name, frame.pose.position.tolist(), frame.pose.rotation.tolist(), *map(self.of_file, frame.files)]
            for frame in (pair.first, pair.second, *pair.between, pair.before, pair.after)
            if frame is not None
        ]
        described = [*self._program, list(method), dict(options), frames]
        return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()

    def of_file(self, path: Path) -> str:
        """Hexadecimal digest of a file's content; ImageError: it is missing or cannot be read."""
        if path not in self._files:
            try:
                self._files[path] = sha256_of(path)
            except OSError as error:
                raise ImageError(f"{path}: expected a file, got '{error.strerror}'; check the scene") from error
        return self._files[path]
