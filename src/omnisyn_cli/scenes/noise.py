"""Band-limited building blocks of the procedural textures, evaluated at one point at a time.

Everything here knows the footprint, the width in metres (or cells) that one sample covers, and fades to its own mean
when the footprint outgrows the detail: far textures become plain instead of noisy.
"""

import math

import numpy as np

from omnisyn_cli.compute.jit import fast_subkernel

_PERIOD = 128  # lattice points before the noise repeats, a power of two
_MASK = _PERIOD - 1
# Random values, uniform in [0, 1), that all noise interpolates: a table costs less than hashing.
LATTICE = np.random.default_rng(20220809).random((_PERIOD, _PERIOD), dtype=np.float32)


@fast_subkernel
def cell_hash(i, j, seed):  # type: ignore[no-untyped-def]
    """Return a number uniform in [0, 1) for an integer cell."""
    h = (i * 73856093) ^ (j * 19349663) ^ (seed * 83492791)
    h = (h * 2654435761) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 2246822519) & 0xFFFFFFFF
    h ^= h >> 13
    return (h & 0xFFFF) / 65536.0


@fast_subkernel
def smooth_noise(x, y, seed):  # type: ignore[no-untyped-def]
    """Interpolate the lattice smoothly at (x, y), in lattice units; mean 0.5."""
    column, row = math.floor(x), math.floor(y)
    a, b = x - column, y - row
    a, b = a * a * (3.0 - 2.0 * a), b * b * (3.0 - 2.0 * b)
    i, j = int(column) + seed * 29, int(row) + seed * 57
    i0, i1, j0, j1 = i & _MASK, (i + 1) & _MASK, j & _MASK, (j + 1) & _MASK
    near = LATTICE[j0, i0] + (LATTICE[j0, i1] - LATTICE[j0, i0]) * a
    far = LATTICE[j1, i0] + (LATTICE[j1, i1] - LATTICE[j1, i0]) * a
    return near + (far - near) * b


@fast_subkernel
def smooth_noise_3d(x, y, z, seed):  # type: ignore[no-untyped-def]
    """Interpolate between slices of :func:`smooth_noise`; mean 0.5."""
    layer = math.floor(z)
    c = z - layer
    c = c * c * (3.0 - 2.0 * c)
    k = seed + 7 * int(layer)
    low = smooth_noise(x, y, k)
    return low + (smooth_noise(x, y, k + 7) - low) * c


@fast_subkernel
def fractal_noise(x, y, seed, footprint, octaves):  # type: ignore[no-untyped-def]
    """Octaves, fading below four footprints, range about ±1, mean 0; arguments in the coarsest wavelength."""
    total, amplitude, frequency = 0.0, 1.0, 1.0
    for octave in range(octaves):
        visible = min(1.0, 2.0 - 4.0 * footprint * frequency)
        if visible <= 0.0:
            break
        total += amplitude * visible * (smooth_noise(x * frequency, y * frequency, seed + octave) - 0.5)
        amplitude *= 0.62
        frequency *= 2.13  # no power of two, so that the octaves do not repeat together
    return total


@fast_subkernel
def pulse(x, width, footprint):  # type: ignore[no-untyped-def]
    """Return the share of the footprint around x that is covered by the intervals ``[k, k + width)``, k integer."""
    reach = max(footprint, 1e-4)
    low, high = x - 0.5 * reach, x + 0.5 * reach
    low_cell, high_cell = math.floor(low), math.floor(high)
    covered = (high_cell - low_cell) * width + min(high - high_cell, width) - min(low - low_cell, width)
    return covered / reach
