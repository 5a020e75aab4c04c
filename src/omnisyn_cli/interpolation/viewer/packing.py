"""Pictures and maps as bytes of a page: photographs as JPEG or PNG, maps predicted and deflated.

A map of whole numbers is kept as what each is above ``left + above − above left`` (Paeth's predictor without its
choice, PNG 1.2, section 6.6), all low bytes before all high bytes, deflated; ``web/blocks.js`` undoes it exactly.
"""

import hashlib
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8, UInt16

from omnisyn_cli.io.encode import jpeg_bytes
from omnisyn_cli.io.outputs import write_parts
from omnisyn_cli.render.mesh import Mesh

NO_SURFACE_CODE = 65535  # code of a vertex without a surface; those of inverse depths are smaller

# Of JPEG files: at 92 they are a third larger. Of the first picture of a panorama: it takes some 50 kB, so that
# something shows at once.
JPEG_QUALITY, PREVIEW_COLUMNS, PREVIEW_QUALITY = 88, 768, 72
MIN_REDUCTION = 1.5  # ratio of the widths of a photograph's levels: less is not worth a level of its own


def level_widths(width: int, *, has_half: bool) -> list[int]:
    """Widths of a photograph's levels: a preview, perhaps half of it for phones, and the whole."""
    preview = [PREVIEW_COLUMNS] if width >= MIN_REDUCTION * PREVIEW_COLUMNS else []
    half = [width // 2] if has_half and width // 2 >= MIN_REDUCTION * PREVIEW_COLUMNS else []
    return [*preview, *half, width]


def block_name(digest: bytes) -> str:
    """File name of a block in a folder: one that stays has the same in the next walk."""
    return f"{digest.hex()[:32]}.bin"


class Blocks:
    """The blocks of a page, numbered in the order in which they were added; equal ones are kept once.

    They are held until all are there, or written into a folder at once, so that a long tour does not have to be held.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder, self._numbers = folder, dict[bytes, int]()
        self.contents: list[bytes] = []
        self.size = 0

    def __len__(self) -> int:
        return len(self._numbers)

    @property
    def names(self) -> list[str]:
        """Their file names in a folder, by number."""
        return [block_name(digest) for digest in self._numbers]

    def add(self, content: bytes) -> int:
        """Its number."""
        digest = hashlib.sha256(content).digest()
        if digest not in self._numbers:
            self._numbers[digest] = len(self._numbers)
            self.size += len(content)
            if self.folder is None:
                self.contents.append(content)
            else:
                write_parts(self.folder / block_name(digest), [content])
        return self._numbers[digest]

    def add_map(self, values: UInt8[np.ndarray, "rows cols"] | UInt16[np.ndarray, "rows cols"]) -> dict[str, int]:
        """What ``web/blocks.js`` finds it by."""
        rows, cols = values.shape
        return {"block": self.add(packed_map(values)), "rows": rows, "cols": cols, "depth": values.itemsize}

    def add_levels(self, samples: UInt8[np.ndarray, "height width 3"], *, is_lossless: bool) -> list[dict[str, Any]]:
        """A photograph in several sizes, see :func:`level_widths`."""
        full = samples.shape[1]
        levels = []
        for width in level_widths(full, has_half=self.folder is not None):
            size = (width, round(samples.shape[0] * width / full))
            reduced = samples if width == full else cv2.resize(samples, size, interpolation=cv2.INTER_AREA)
            quality = PREVIEW_QUALITY if width == PREVIEW_COLUMNS < full else JPEG_QUALITY
            levels.append(self.add_photograph(reduced, is_lossless=is_lossless and width == full, quality=quality))
        return levels

    def add_photograph(
        self, samples: UInt8[np.ndarray, "height width 3"], *, is_lossless: bool, quality: int = JPEG_QUALITY
    ) -> dict[str, Any]:
        """A photograph in one size, and its kind."""
        if is_lossless:
            kind, data = "png", cv2.imencode(".png", np.ascontiguousarray(samples[..., ::-1]))[1].tobytes()
        else:
            kind, data = "jpeg", jpeg_bytes(samples, quality)
        height, width = samples.shape[:2]
        return {"block": self.add(data), "type": f"image/{kind}", "width": width, "height": height}


def packed_map(values: UInt8[np.ndarray, "rows cols"] | UInt16[np.ndarray, "rows cols"]) -> bytes:
    """A map as it is kept in a page."""
    padded = np.pad(values, ((1, 0), (1, 0)))
    rest = padded[1:, 1:] - padded[1:, :-1] - padded[:-1, 1:] + padded[:-1, :-1]
    planes = rest.astype(f"<u{values.itemsize}").view(np.uint8).reshape(-1, values.itemsize).T
    return zlib.compress(planes.tobytes(), 9)


def inverse_depth_codes(inverse_depth: Float[np.ndarray, "rows cols"]) -> tuple[UInt16[np.ndarray, "rows cols"], float]:
    """Square roots of inverse depth in 65,534 equal steps up to that of the greatest, which is returned as well.

    An inverse depth is off by at most one part in its code: by 0.1 % where it is 1/4000 of the greatest.
    """
    peak = max(float(inverse_depth.max()), 1e-6)
    codes = np.rint(np.sqrt(np.maximum(inverse_depth, 0.0) / peak) * (NO_SURFACE_CODE - 1))
    return np.where(inverse_depth < 0.0, NO_SURFACE_CODE, codes).astype(np.uint16), peak


def confidence_codes(mesh: Mesh) -> UInt8[np.ndarray, "quarter_rows quarter_cols"] | None:
    """Square roots of trust in the quarters of quads, and in both caps as beside them; None where all of it is 1."""
    if (mesh.surface_confidence == 1.0).all():
        return None
    image = mesh.quarter_image
    image = np.concatenate([image[:1], image, image[-1:]])
    return np.asarray(np.rint(255.0 * np.sqrt(image)), np.uint8)


def packed_mask(mask: Bool[np.ndarray, "height width"], width: int) -> UInt8[np.ndarray, "rows cols"]:
    """A mask, at most so wide: 255 where a photograph may be used."""
    values = np.where(mask, np.uint8(255), np.uint8(0))
    if mask.shape[1] <= width:
        return values
    return np.asarray(cv2.resize(values, (width, width // 2), interpolation=cv2.INTER_AREA))
