"""Weather: sun, sky and haze of a day."""

import math

import numpy as np

from omnisyn_cli.scenes.palette import Colour, mixed
from omnisyn_cli.scenes.scene import Lighting, Point


def sun_at(bearing: float, elevation: float) -> Point:
    """Unit vector to a sun at a height above the horizon (radians); the bearing turns it about the vertical."""
    flat = math.cos(elevation)
    return flat * math.sin(bearing), math.sin(elevation), flat * math.cos(bearing)


def daylight(rng: np.random.Generator) -> Lighting:
    """Draw a day: clear, cloudy or overcast, at any hour."""
    cover = float(rng.choice([0.15, 0.4, 0.6, 0.95], p=[0.2, 0.3, 0.25, 0.25])) + rng.uniform(-0.1, 0.05)
    elevation = rng.uniform(0.25, 1.25)
    warmth = max(0.0, 1.0 - elevation / 0.8)
    direct = max(0.0, 1.0 - max(0.0, cover - 0.55) * 2.4)
    sun = _scaled((1.0, 0.93 - 0.18 * warmth, 0.82 - 0.38 * warmth), direct * rng.uniform(1.9, 2.6))
    grey = min(1.0, cover)
    fill = 0.75 + 0.55 * grey
    sky = _scaled(mixed((0.50, 0.62, 0.82), (0.80, 0.82, 0.85), grey), fill)
    bounce = _scaled(mixed((0.42, 0.38, 0.33), (0.45, 0.45, 0.45), grey), 0.55 * fill)
    blue = rng.uniform(0.85, 1.2)
    zenith = mixed((0.13 * blue, 0.30 * blue, 0.62), (0.42, 0.48, 0.56), 0.5 * grey)
    horizon = mixed(mixed((0.62, 0.74, 0.86), (0.95, 0.76, 0.56), 0.6 * warmth), (0.78, 0.80, 0.83), grey)
    return Lighting(
        sun_direction=sun_at(rng.uniform(0, 2 * math.pi), elevation), sun=sun, sky=sky, bounce=bounce,
        softness=0.006 + 0.05 * max(0.0, cover - 0.5), zenith=_scaled(zenith, 1.25), horizon=_scaled(horizon, 1.35),
        cloud=_scaled(mixed((1.0, 0.98, 0.95), (0.8, 0.82, 0.85), grey), rng.uniform(1.3, 1.9)), cloud_cover=cover,
        cloud_scale=float(rng.uniform(0.35, 1.1)), haze=float(rng.choice([0.0004, 0.001, 0.003], p=[0.5, 0.35, 0.15])),
        exposure=float(rng.uniform(0.85, 1.35)) * (1.0 + 0.25 * (1.0 - direct)), seed=int(rng.integers(1, 1000)),
    )  # fmt: skip


def _scaled(colour: Colour, factor: float) -> Colour:
    return colour[0] * factor, colour[1] * factor, colour[2] * factor
