"""A local frame to build a thing in: turned about the vertical and moved to where it stands."""

import math
from dataclasses import dataclass

from omnisyn_cli.scenes.materials import Material
from omnisyn_cli.scenes.scene import Point, SceneBuilder, Shape


@dataclass(frozen=True)
class Turned:
    """Adds shapes in local coordinates: y is up, the local z axis is turned by ``yaw`` about it."""

    build: SceneBuilder
    base: Point
    yaw: float

    def place(self, x: float, y: float, z: float) -> Point:
        """World coordinates of a local point."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return self.base[0] + c * x + s * z, self.base[1] + y, self.base[2] - s * x + c * z

    def box(
        self,
        centre: Point,
        half: Point,
        material: Material,
        *,
        cap: Material | None = None,
        tint: float = 1.0,
        turn: float = 0.0,
    ) -> None:
        """Add a box; ``turn`` turns it further about its own middle."""
        self.build.add(Shape.BOX, self.place(*centre), half, material, cap=cap, yaw=self.yaw + turn, tint=tint)

    def rod(self, start: Point, end: Point, radius: float, material: Material) -> None:
        """Add a cylinder between two points."""
        self.build.rod(self.place(*start), self.place(*end), radius, material)

    def ellipsoid(self, centre: Point, half: Point, material: Material) -> None:
        """Add an ellipsoid."""
        self.build.add(Shape.ELLIPSOID, self.place(*centre), half, material, yaw=self.yaw)

    def cone(self, centre: Point, half: Point, material: Material) -> None:
        """Add an upright cone."""
        self.build.add(Shape.CONE, self.place(*centre), half, material)
