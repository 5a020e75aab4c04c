"""What a method is to the engine: something that makes pictures at waypoints, with depth and geometry if it has any.

The geometric methods all go through :mod:`omnisyn_cli.synthesis`; they differ in where depth comes from, how it
becomes a surface, where that is cut and how two renderings become one picture.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Protocol

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import InputError, OmnisynError
from omnisyn_cli.fusers import make_fuser
from omnisyn_cli.fusion import GeometricFuser
from omnisyn_cli.geometry.sampling import sample_nearest
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.segments import Stopwatch, SynthesisOptions
from omnisyn_cli.synthesis import Frame, synthesize
from omnisyn_cli.trajectory import Waypoint
from omnisyn_cli.types import DepthEstimate, DepthEstimator, Fuser, Rendering, View

__all__ = [
    "DepthMemory",
    "GeometricSynthesizer",
    "MethodUnavailableError",
    "Picture",
    "Recipe",
    "Synthesizer",
    "first_view_only",
    "geometric_fuser",
    "network_fuser",
]


class MethodUnavailableError(OmnisynError):
    """A method cannot work on this pair or in this installation; the message is the reason that tables give."""


@dataclass(frozen=True)
class Picture:
    """One frame that a method made.

    Attributes:
        image: ``(height, width, 3)`` RGB.
        inverse_depth: ``(height, width)`` 1/metre of what it shows, negative where that is unknown; None for methods
            without geometry.
    """

    image: Float[np.ndarray, "height width 3"]
    inverse_depth: Float[np.ndarray, "height width"] | None = None


class Synthesizer(Protocol):
    """A method at work on one pair."""

    @property
    def depths(self) -> tuple[DepthEstimate, DepthEstimate] | None:
        """The depth it found for both views, once a picture was made; None for methods without."""
        ...

    def pictures(self, path: Sequence[Waypoint], size: tuple[int, int], clock: Stopwatch) -> Iterator[Picture]:
        """A picture of ``size`` for every waypoint, in order; ``clock`` collects seconds by stage."""
        ...


AT_FIRST = 1e-9
"""Share of the way at which the exposure of a frame is still that of the first view."""

MakeFuser = Callable[[tuple[int, int], int | None], Fuser]
"""Makes a fuser for frames of a size that uses at most so many threads."""


def geometric_fuser(size: tuple[int, int], threads: int | None) -> Fuser:
    """The fusion without a network."""
    return GeometricFuser(size, threads=threads)


def network_fuser(device: str, name: str = "network") -> MakeFuser:
    """The fusion with the network that is installed; making it raises MethodUnavailableError where there is none.

    Args:
        device: where it runs.
        name: ``network`` or ``painting``, see :mod:`omnisyn_cli.fusers`.
    """

    def make(size: tuple[int, int], threads: int | None) -> Fuser:
        try:
            return make_fuser(name, size, device=device, threads=threads)
        except InputError as error:
            raise MethodUnavailableError(str(error)) from error

    return make


def first_view_only(size: tuple[int, int], threads: int | None) -> Fuser:
    """A fuser that is blind to the second view; pictures have the exposure of the first."""
    return _FirstViewOnly(geometric_fuser(size, threads))


@dataclass(frozen=True)
class Recipe:
    """A geometric method.

    Attributes:
        source: name of where depth comes from; recipes of equal sources share it.
        estimator: finds depth; gets the views without their true depth unless ``sees_truth``.
        sees_truth: whether the estimator may look at the true depth.
        depth_size: height and width of the surfaces' grids; None is that of the estimates.
        renderer: a name of :data:`omnisyn_cli.render.renderer.RENDERERS`.
        cut: where surfaces are separated.
        fuser: joins both renderings.
    """

    source: str
    estimator: DepthEstimator
    sees_truth: bool = False
    depth_size: tuple[int, int] | None = None
    renderer: str = "mesh"
    cut: Cut = field(default_factory=Cut)
    fuser: MakeFuser = geometric_fuser


class DepthMemory:
    """Depth of one pair by its source, and the seconds that it took; every source is asked once."""

    def __init__(self) -> None:
        self._found: dict[str, tuple[tuple[DepthEstimate, DepthEstimate], float]] = {}

    def recall(self, recipe: Recipe, first: View, second: View) -> tuple[tuple[DepthEstimate, DepthEstimate], float]:
        """What the source of a recipe finds, and the seconds that it took when it was asked."""
        if recipe.source not in self._found:
            begin = time.perf_counter()
            found = recipe.estimator(first, second)
            self._found[recipe.source] = (found, time.perf_counter() - begin)
        return self._found[recipe.source]


class GeometricSynthesizer:
    """A :class:`Recipe` at work.

    Depth that another method has found counts with the seconds that it took there.
    """

    def __init__(
        self, recipe: Recipe, views: tuple[View, View], threads: int | None = None, memory: DepthMemory | None = None
    ) -> None:
        self._recipe, self._threads, self._memory = recipe, threads, memory or DepthMemory()
        self._views = views if recipe.sees_truth else tuple(View(v.image, v.pose, v.mask) for v in views)
        self._depths: tuple[DepthEstimate, DepthEstimate] | None = None

    @property
    def depths(self) -> tuple[DepthEstimate, DepthEstimate] | None:
        """See :class:`Synthesizer`."""
        return self._depths

    def pictures(self, path: Sequence[Waypoint], size: tuple[int, int], clock: Stopwatch) -> Iterator[Picture]:
        """See :class:`Synthesizer`."""
        options = SynthesisOptions(size, self._recipe.renderer, self._recipe.cut, self._threads)
        shows_first_only = self._recipe.fuser is first_view_only
        fuser = _Surveying(self._recipe.fuser(size, self._threads), shows_first_only=shows_first_only)
        estimator = partial(self._estimate, clock)
        if shows_first_only:
            path = [replace(waypoint, t=AT_FIRST) for waypoint in path]
        for made in synthesize(self._views, path, estimator, options, fuser, clock):
            if isinstance(made, Frame):  # one that is shown again has the geometry that it had before
                yield Picture(made.image.copy(), None if made.waypoint.t in (0.0, 1.0) else fuser.inverse_depth)

    def _estimate(self, clock: Stopwatch, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """The depth of both views; ``clock`` is given the seconds that this does not take now."""
        begin = time.perf_counter()
        found, seconds = self._memory.recall(self._recipe, first, second)
        if self._recipe.depth_size is not None:
            found = (_resized(found[0], self._recipe.depth_size), _resized(found[1], self._recipe.depth_size))
        clock.seconds["depth"] += max(0.0, seconds - (time.perf_counter() - begin))
        self._depths = found
        return found


def _resized(estimate: DepthEstimate, size: tuple[int, int]) -> DepthEstimate:
    """An estimate at another size; pixels are taken from where they are, so that no edge is blurred."""
    directions = pixel_directions(*size)
    return DepthEstimate(
        sample_nearest(estimate.inverse_depth, directions), sample_nearest(estimate.confidence, directions)
    )


class _Surveying:
    """A fuser that keeps the geometry of the frame: the nearer surface that is shown, negative where there is none."""

    def __init__(self, fuser: Fuser, *, shows_first_only: bool) -> None:
        self._fuser, self._shows_first_only = fuser, shows_first_only
        self.inverse_depth: np.ndarray | None = None

    def __call__(self, first: Rendering, second: Rendering, t: float) -> np.ndarray:
        shown = first if self._shows_first_only else second
        self.inverse_depth = np.maximum(first.inverse_depth, shown.inverse_depth)
        return self._fuser(first, second, t)


class _FirstViewOnly:
    def __init__(self, fuser: Fuser) -> None:
        self._fuser = fuser

    def __call__(self, first: Rendering, second: Rendering, t: float) -> np.ndarray:
        nothing = np.full_like(second.inverse_depth, -1.0)
        return self._fuser(first, Rendering(nothing, np.zeros_like(second.colour), second.target_from_source), t)
