"""Monocular depth networks that users bring: what their files say, what they are asked, and answers that are kept."""

from __future__ import annotations

import hashlib
import json
import math
import os
import secrets
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.errors import InputError
from omnisyn_cli.runtime.models import sha256_of
from omnisyn_cli.runtime.session import run_network

MAP_READINGS = ("depth", "inverse-depth", "log-depth")  # what the numbers of a map may be
READING_WORDS = (*MAP_READINGS, "points")  # those of a network; points are their distance from the camera
# What users may say of a network that its file does not.
KIND_WORDS = ("panorama", "perspective", *READING_WORDS, "imagenet")
# Height and width of pictures where a network takes any: networks divide them by 14, 16 or 32.
PANORAMA_SIZE, PERSPECTIVE_SIZE = (448, 896), (448, 448)
# Of the channels of pictures, for networks that were not exported with it.
IMAGENET_MEAN, IMAGENET_DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
MIN_RELATIVE_SPREAD = 1e-4  # of the numbers of an answer: a network with less says the same of every pixel
PROCESS_STATUS = Path("/proc/self/status")  # of Linux
MAX_KEPT_ANSWERS = 500  # files in the folder of answers; the oldest go first. One has 0.5 to 1.6 MB.


@dataclass(frozen=True)
class NetworkKind:
    """What a network is asked and what its numbers are; None is found out."""

    is_panoramic: bool | None = None  # whether it sees panoramas; else perspective pictures
    reading: str | None = None  # one of :data:`READING_WORDS`
    is_normalized: bool = False  # whether its pictures have the mean and deviation of ImageNet

    @staticmethod
    def from_words(text: str) -> NetworkKind:
        """Of words of :data:`KIND_WORDS`, separated by commas. InputError: another one, or two that exclude another."""
        words = [word.strip() for word in text.split(",") if word.strip()]
        readings = [word for word in words if word in READING_WORDS]
        if not set(words) <= set(KIND_WORDS) or len(readings) > 1 or {"panorama", "perspective"} <= set(words):
            raise InputError(
                f"expected panorama or perspective, one of {', '.join(READING_WORDS)}, and imagenet, separated by "
                f"commas, got {text!r}; leave out what the file says itself"
            )
        shape = "panorama" in words if {"panorama", "perspective"} & set(words) else None
        return NetworkKind(shape, readings[0] if readings else None, "imagenet" in words)


class NetworkCost(NamedTuple):
    """What a network takes for a picture on this machine, as it was measured when it was asked first."""

    seconds: float
    memory: int  # bytes, those of its weights among them


class MonocularSession:
    """One picture in, numbers of depth out; a :class:`omnisyn_cli.stereo.monocular_answer.PictureNetwork`.

    InputError: it takes no single picture, or any size and ``kind`` says none, or its weights lie in another file.
    """

    def __init__(self, session: Any, path: Path, kind: NetworkKind) -> None:
        entries = session.get_inputs()
        shape = list(entries[0].shape)
        if len(entries) != 1 or len(shape) != 4 or 3 not in (shape[1], shape[3]) or "float" not in entries[0].type:
            found = ", ".join(f"{entry.name} {list(entry.shape)} of {entry.type}" for entry in entries)
            raise InputError(
                f"{path}: expected a depth network with one picture of 3 channels in floats as input, got {found}; "
                "export it with a single input"
            )
        self._session, self._path, self._kind = session, path, kind
        self._name, self._dtype = entries[0].name, np.float16 if "16" in entries[0].type else np.float32
        self._has_channels_first = shape[1] == 3
        sides = shape[2:] if self._has_channels_first else shape[1:3]
        self.size, self.is_panoramic = self._shape_of_pictures(sides)
        self.parameters = _parameters(path)
        self._key = hashlib.sha256(f"{sha256_of(path)} {kind}".encode()).hexdigest()[:16]

    def _shape_of_pictures(self, sides: list[Any]) -> tuple[tuple[int, int], bool]:
        is_panoramic = self._kind.is_panoramic
        if all(isinstance(side, int) and side > 0 for side in sides):
            return (sides[0], sides[1]), sides[1] == 2 * sides[0] if is_panoramic is None else is_panoramic
        if is_panoramic is None:
            raise InputError(
                f"{self._path}: expected a network of one size, got one of any size; say what it sees "
                "(--depth-prior-kind panorama or perspective)"
            )
        return PANORAMA_SIZE if is_panoramic else PERSPECTIVE_SIZE, is_panoramic

    def __call__(
        self, picture: Float32[np.ndarray, "3 height width"]
    ) -> tuple[Float32[np.ndarray, "rows cols"], tuple[str, ...], bool]:
        """Its numbers, their possible readings, if along rays. InputError: no map of its shape, or a flat one."""
        file = self.answer_file(picture)
        answer = _kept(file)
        if answer is None:
            answer, _ = self._asked(picture)
            np.save(content := BytesIO(), answer)
            _keep(file, content.getvalue())
        numbers, is_points = answer[..., 0], answer.shape[-1] == 3
        if is_points:
            return np.linalg.norm(answer, axis=-1), ("depth",), True
        return numbers, MAP_READINGS if self._kind.reading is None else (self._kind.reading,), False

    def answer_file(self, picture: Float32[np.ndarray, "3 height width"]) -> Path:
        """Where the answer to a picture is or will be kept."""
        return answers_folder() / f"{self._key}-{hashlib.sha256(picture.tobytes()).hexdigest()[:32]}.npy"

    @property
    def cost(self) -> NetworkCost | None:
        """What it costs where it runs, with so many threads; None where it was never asked."""
        with suppress(OSError, ValueError, TypeError):
            return NetworkCost(*json.loads(self._cost_file.read_text(encoding="ascii")))
        return None

    @property
    def _cost_file(self) -> Path:
        provider, threads = self._session.get_providers()[0], self._session.get_session_options().intra_op_num_threads
        return answers_folder() / f"{self._key}-{provider}-{threads}.json"

    def try_out(self) -> NetworkCost:
        """What it costs, by asking about noise unless that is known. InputError: as of a call."""
        return self.cost or self._asked(np.random.default_rng(0).random((3, *self.size), np.float32))[1]

    def _asked(self, picture: np.ndarray) -> tuple[Float32[np.ndarray, "rows cols channels"], NetworkCost]:
        """A map, or three with the coordinates of points; and what it cost."""
        if self._kind.is_normalized:
            mean, deviation = (np.reshape(each, (3, 1, 1)) for each in (IMAGENET_MEAN, IMAGENET_DEVIATION))
            picture = (picture - mean) / deviation
        batch = (picture if self._has_channels_first else np.moveaxis(picture, 0, -1))[None].astype(self._dtype)
        height, width = self.size
        wants_points = self._kind.reading == "points"
        begin = time.perf_counter()
        former_peak = peak_memory() or 0
        answers = run_network(self._session, {self._name: np.ascontiguousarray(batch)})
        seconds = time.perf_counter() - begin
        for answer in answers:
            found = _as_map(answer, wants_points, width / height)
            if found is not None:
                middle = np.abs(np.median(found))
                if not np.ptp(found) > MIN_RELATIVE_SPREAD * middle:
                    raise InputError(
                        f"{self._path}: expected depth that varies, got {middle:.3g} everywhere; name another"
                    )
                memory = self._path.stat().st_size + (peak_memory() or 0) - former_peak
                cost = NetworkCost(seconds, memory)
                if self.cost is None:
                    _keep(self._cost_file, json.dumps(cost).encode())
                return found, cost
        shapes = ", ".join(str(list(entry.shape)) for entry in self._session.get_outputs())
        what = "points" if wants_points else "depth"
        raise InputError(
            f"{self._path}: expected a map of {what} that is as wide to high as its {width}x{height} picture, got "
            f"{shapes}; name another"
        )


def _as_map(answer: np.ndarray, is_points: bool, ratio: float) -> np.ndarray | None:
    """An output as ``(rows, cols, channels)``; None where it is something else."""
    found = np.squeeze(answer)
    if found.ndim == 3 and 3 in (found.shape[0], found.shape[2]) and is_points:
        found = found if found.shape[2] == 3 else np.moveaxis(found, 0, -1)
    elif found.ndim == 2 and not is_points:
        found = found[..., None]
    else:
        return None
    return found if abs(found.shape[1] / found.shape[0] / ratio - 1.0) < 0.02 else None


def answers_folder() -> Path:
    """Where answers are kept: ``omnisyn/answers`` in the user's folder for caches."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "omnisyn" / "answers"


def _parameters(path: Path) -> int:
    """How many a network has. InputError: they lie in another file, by which answers would have to be kept as well."""
    import onnx

    weights = onnx.load(path, load_external_data=False).graph.initializer
    if any(weight.data_location == onnx.TensorProto.EXTERNAL for weight in weights):
        raise InputError(
            f"{path}: expected a network with its weights in one file, got one with weights beside it; export it with "
            "external_data=False"
        )
    return sum(math.prod(weight.dims) for weight in weights)


def peak_memory() -> int | None:
    """Bytes that this process held at most, of Linux itself: ``getrusage`` says no less than the parent held."""
    with suppress(OSError, IndexError):
        status = PROCESS_STATUS.read_text(encoding="ascii", errors="replace")
        return 1024 * int(status.partition("VmHWM:")[2].split()[0])
    if sys.platform == "win32":
        return None
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def _kept(file: Path) -> np.ndarray | None:
    with suppress(OSError, ValueError, EOFError):
        return np.asarray(np.load(file, allow_pickle=False), np.float32)
    return None


def _keep(file: Path, content: bytes) -> None:
    """Write a file, whole or not at all, and remove the oldest answers; a full or read-only disk keeps none."""
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        partial_file = file.with_suffix(f".{secrets.token_hex(4)}.part")
        try:
            partial_file.write_bytes(content)
            partial_file.replace(file)
        finally:
            partial_file.unlink(missing_ok=True)
        answers = (each for each in file.parent.iterdir() if each.suffix != ".json")
        files = sorted(answers, key=lambda each: each.stat().st_mtime)
        for old in files[:-MAX_KEPT_ANSWERS]:
            old.unlink(missing_ok=True)
