"""What a street is like, before anything stands in it."""

from dataclasses import dataclass

import numpy as np

END = 85.0
"""Half the length of the street, metres."""


@dataclass(frozen=True)
class StreetPlan:
    """Style and measures of a street along z; lengths in metres.

    Attributes:
        style: "town", "suburb", "office" or "square".
        road: half width of the roadway.
        pavement: width of each pavement.
        kerb: height of the pavement above the road.
        slope: rise per metre along z.
        crossings: z and half width of each crossing road.
    """

    style: str
    road: float
    pavement: float
    kerb: float
    slope: float
    crossings: tuple[tuple[float, float], ...]

    def ground(self, z: float, raised: bool = True) -> float:
        """Height of the road, or of the pavement, at z."""
        return self.slope * z + (self.kerb if raised else 0.0)

    def is_crossing(self, z: float, margin: float = 0.0) -> bool:
        """Whether z lies on a crossing road."""
        return any(abs(z - middle) < half + margin for middle, half in self.crossings)

    def blocks(self) -> list[tuple[float, float]]:
        """The stretches of z between the crossings."""
        edges = [-END]
        for middle, half in sorted(self.crossings):
            edges += [middle - half, middle + half]
        edges.append(END)
        return [(edges[i], edges[i + 1]) for i in range(0, len(edges), 2) if edges[i + 1] > edges[i] + 1.0]


def draw_plan(rng: np.random.Generator) -> StreetPlan:
    """Draw the plan of a street."""
    style = str(rng.choice(["town", "suburb", "office", "square"], p=[0.4, 0.2, 0.22, 0.18]))
    slope = 0.0 if rng.random() < 0.6 else rng.uniform(-0.06, 0.06)
    middles = (rng.uniform(-45, -9), rng.uniform(6, 50))
    crossings = [(middle, rng.uniform(3.0, 6.0)) for middle in middles if rng.random() < 0.6]
    return StreetPlan(
        style=style,
        road=float(rng.choice([rng.uniform(2.6, 4.2), rng.uniform(4.2, 8.0)])),
        pavement=rng.uniform(1.4, 4.5),
        kerb=rng.uniform(0.08, 0.17),
        slope=slope,
        crossings=tuple(crossings),
    )
