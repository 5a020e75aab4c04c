"""Learned perceptual distance by a network that the user has: mean over the six faces of a cube around the panorama."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.metrics.image import check_same_size
from omnisyn_cli.geometry.pose import rotation_taking
from omnisyn_cli.geometry.sampling import sample_bicubic
from omnisyn_cli.geometry.sphere import FORWARD
from omnisyn_cli.runtime.session import open_session

# Where the six faces look: forward, backward, right, up, left, down.
FACES = (FORWARD, -FORWARD, *np.eye(3)[:2], *-np.eye(3)[:2])
SMALLEST_FACE = 64  # pixels; a network of five poolings has nothing left of less


class Lpips:
    """LPIPS of two panoramas; 0 for equal ones, smaller is better.

    A network for flat pictures is run on the six faces of a cube, as it knows no poles. Faces have the size that the
    file fixes, else half the panorama's height (at least 64). The ONNX file has two inputs, float images ``(batch, 3,
    height, width)`` in [-1, 1], and the distance as first output (it is averaged). InputError: it is not one.

    Source: Zhang et al., The unreasonable effectiveness of deep features as a perceptual metric, 2018.
    """

    def __init__(self, path: Path, *, threads: int | None = None) -> None:
        self._path = path
        self._session = open_session(path, device="cpu", threads=threads)
        inputs = self._session.get_inputs()
        if len(inputs) != 2 or not all(_is_image(entry) for entry in inputs):
            got = ", ".join(f"{entry.name}: {entry.type} {tuple(entry.shape)}" for entry in inputs)
            raise InputError(
                f"{path}: expected two float images (batch, 3, height, width) in [-1, 1], got {got}; export the "
                "network with two image inputs"
            )
        self._names = [entry.name for entry in inputs]
        self._face_size = inputs[0].shape[2:]  # what is not fixed is a name or None

    def __call__(self, image: Float[np.ndarray, "height width 3"], truth: Float[np.ndarray, "height width 3"]) -> float:
        """Mean over the faces of two panoramas, RGB in [0, 1]; ValueError: sizes; InputError: the network fails."""
        check_same_size(image, truth)
        face_side = max(SMALLEST_FACE, len(image) // 2)
        is_fixed = all(isinstance(length, int) for length in self._face_size)
        height, width = self._face_size if is_fixed else (face_side, face_side)
        distances = []
        for directions in cube_directions(height, width):
            faces = [_network_input(picture, directions) for picture in (image, truth)]
            try:
                found = self._session.run(None, dict(zip(self._names, faces, strict=True)))
            except Exception as error:
                shape = faces[0].shape
                raise InputError(
                    f"{self._path}: expected a network for images {shape}, ONNX Runtime says: {error}"
                ) from error
            distances.append(float(np.mean(found[0])))
        return float(np.mean(distances))


def cube_directions(height: int, width: int) -> Float[np.ndarray, "6 height width 3"]:
    """Vectors (not normalised) through the pixel centres of the six faces of a cube around the viewer."""
    x, y = (np.linspace(-1.0, 1.0, 2 * count + 1)[1::2] for count in (width, height))
    right, up = np.broadcast_arrays(x[None, :], -y[:, None])
    face = np.stack([right, up, np.full_like(right, -1.0)], axis=-1)
    return np.stack([face @ rotation_taking(FORWARD, axis).T for axis in FACES])


def _network_input(image: np.ndarray, directions: np.ndarray) -> Float[np.ndarray, "1 3 height width"]:
    face = np.clip(sample_bicubic(image, directions), 0.0, 1.0)
    return np.ascontiguousarray((2.0 * face - 1.0).transpose(2, 0, 1)[None], np.float32)


def _is_image(entry: Any) -> bool:
    """Whether an input takes one RGB image; sizes that are not fixed are names or None."""
    if entry.type != "tensor(float)" or len(entry.shape) != 4:
        return False
    batch, channels, *_ = entry.shape
    return (not isinstance(batch, int) or batch == 1) and (not isinstance(channels, int) or channels == 3)
