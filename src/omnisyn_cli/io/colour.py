"""Colours of files as the sRGB that everything here works in: embedded ICC profiles, and linear light of EXR and HDR.

Profiles of cameras and telephones (Display P3, Adobe RGB, ProPhoto) are three curves and a matrix, which are read here.
Profiles with tables, as printers have, are passed over.

Source: ICC.1:2022, sections 7.2 and 9.2, 10.6 (``curveType``), 10.18 (``parametricCurveType``); IEC 61966-2-1 (sRGB).
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Shaped

# Linear sRGB of XYZ under D50, the profile connection space (Lindbloom, Bradford-adapted).
SRGB_FROM_PCS = np.array(
    [[3.1338561, -1.6168667, -0.4906146], [-0.9787684, 1.9161415, 0.0334540], [0.0719453, -0.2289914, 1.4052427]]
)
MAX_TAGS = 1000  # a profile has a dozen tags
MIN_COLOUR_CHANGE = 1.0 / 255.0  # of any of the tried colours, below which a profile is sRGB by another name
MAX_WHITE_ERROR = 0.05  # of linear light: a profile whose white is farther from sRGB's is broken, or of no display
# Levels at which sRGB's curve is tabulated, by square roots: neighbours differ by two levels of 16 bits at most.
CURVE_STEPS = 1 << 16
BAND_ROWS = 64  # rows that are converted together, so that little memory is needed
# Linear light from which the view transform rolls off, so that windows and lamps keep their shape. Set by hand.
SHOULDER_START = 0.6
PARAMETRIC_COUNTS = (1, 3, 4, 5, 7)  # parameters by the kind of a parametric curve

Curve = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class ColourProfile:
    """From samples to linear sRGB: a curve for each channel, then a matrix."""

    curves: tuple[Curve, Curve, Curve]
    srgb_from_device: Float[np.ndarray, "3 3"]

    def linear(self, colour: Float[np.ndarray, "*pixels 3"]) -> Float[np.ndarray, "*pixels 3"]:
        """Linear sRGB of colours in [0, 1]; beyond [0, 1] where sRGB has no such colour."""
        light = np.stack([curve(colour[..., k]) for k, curve in enumerate(self.curves)], axis=-1)
        return np.asarray(light @ self.srgb_from_device.T)

    @property
    def changes_colours(self) -> bool:
        """Whether its colours are finite, others than sRGB's, and white is white."""
        tried = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 6)] * 3), axis=-1)
        light = self.linear(tried)
        change = np.abs(srgb_curve(np.clip(light, 0.0, 1.0)) - tried).max()
        is_sound = np.isfinite(light).all() and np.abs(light[-1, -1, -1] - 1.0).max() < MAX_WHITE_ERROR
        return bool(is_sound and change >= MIN_COLOUR_CHANGE)

    def to_srgb(self, samples: Shaped[np.ndarray, "height width 3"], peak: int) -> Shaped[np.ndarray, "height width 3"]:
        """Samples of unsigned integers with white at ``peak``, converted and rounded to the same type."""
        levels = np.linspace(0.0, 1.0, peak + 1)
        light = np.stack([curve(levels) for curve in self.curves], axis=-1).astype(np.float32)
        matrix = self.srgb_from_device.T.astype(np.float32)
        steps = (np.arange(CURVE_STEPS + 1) / CURVE_STEPS) ** 2
        table = np.rint(peak * srgb_curve(steps)).astype(samples.dtype)
        out = np.empty_like(samples)
        for top in range(0, len(samples), BAND_ROWS):
            band = samples[top : top + BAND_ROWS]
            linear = np.stack([light[band[..., k], k] for k in range(3)], axis=-1) @ matrix
            root = np.sqrt(np.clip(linear, 0.0, 1.0)) * np.float32(CURVE_STEPS)
            out[top : top + BAND_ROWS] = table[np.rint(root).astype(np.int32)]
        return out


def srgb_curve(light: Float[np.ndarray, "*pixels"]) -> Float[np.ndarray, "*pixels"]:
    """Samples in sRGB of linear light, both in [0, 1]."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)


def view_transform(light: Float[np.ndarray, "*pixels"]) -> Float[np.ndarray, "*pixels"]:
    """What a screen shows of linear light: sRGB's curve, with a shoulder that no light is too bright for."""
    room = 1.0 - SHOULDER_START
    excess = np.maximum(light - SHOULDER_START, 0.0)
    rolled = np.where(excess > 0.0, SHOULDER_START + room * (1.0 - np.exp(-excess / room)), np.maximum(light, 0.0))
    return np.asarray(srgb_curve(rolled), np.float32)


def parse_profile(data: bytes) -> ColourProfile | None:
    """The profile of an RGB device with curves and a matrix; None for all others, sRGB itself and broken ones."""
    try:
        (count,) = struct.unpack_from(">I", data, 128)
        if count > MAX_TAGS:
            return None
        places = (struct.unpack_from(">4sII", data, 132 + 12 * k) for k in range(count))
        tags = {name: data[offset : offset + size] for name, offset, size in places}
        columns = [struct.unpack_from(">3i", tags[name], 8) for name in (b"rXYZ", b"gXYZ", b"bXYZ")]
        red, green, blue = (_curve(tags[name]) for name in (b"rTRC", b"gTRC", b"bTRC"))
    except (KeyError, struct.error, ValueError, IndexError):
        return None
    profile = ColourProfile((red, green, blue), SRGB_FROM_PCS @ (np.array(columns).T / 65536.0))
    with np.errstate(all="ignore"):
        return profile if data[16:20] == b"RGB " and profile.changes_colours else None


def _curve(tag: bytes) -> Curve:
    """Linear light of samples in [0, 1]."""
    if tag[:4] == b"para":
        (kind,) = struct.unpack_from(">H", tag, 8)
        numbers = np.array(struct.unpack_from(f">{PARAMETRIC_COUNTS[kind]}i", tag, 12)) / 65536.0
        return lambda x: _parametric(kind, numbers, x)
    if tag[:4] != b"curv":
        raise ValueError(tag[:4])
    (count,) = struct.unpack_from(">I", tag, 8)
    if count < 2:
        gamma = struct.unpack_from(">H", tag, 12)[0] / 256.0 if count else 1.0
        return lambda x: np.asarray(x**gamma)
    table = np.array(struct.unpack_from(f">{count}H", tag, 12)) / 65535.0
    return lambda x: np.interp(x, np.linspace(0.0, 1.0, count), table)


def _parametric(kind: int, numbers: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The five kinds as the last: ``(a·x + b)^g + e`` from d on, ``c·x + f`` below."""
    g, a, b, c, d, e, f = np.pad(numbers, (0, 7 - len(numbers)))
    if kind == 0:
        a = 1.0
    if kind in (1, 2):
        e = f = c if kind == 2 else 0.0
        c, d = 0.0, -b / a
    return np.asarray(np.where(x >= d, np.maximum(a * x + b, 0.0) ** g + e, c * x + f))
