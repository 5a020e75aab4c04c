"""How frames are made: the registry of methods, this program's own and those that it is compared with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from omnisyn_cli.pipeline.depth_sources import SYNSIN_DEPTH, make_estimator
from omnisyn_cli.pipeline.fusions import FuserSettings, make_fuser

if TYPE_CHECKING:
    from omnisyn_cli.baselines.synsin_sessions import SynSinSessions
    from omnisyn_cli.compute.stopwatch import Stopwatch
    from omnisyn_cli.pipeline.config import Recipe
    from omnisyn_cli.synthesis.methods import Method
    from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
    from omnisyn_cli.types import DepthEstimator, Fuser

__all__ = ["METHODS", "OMNISYN", "SYNSIN_MODELS", "make_method", "open_synsin"]

OMNISYN = "omnisyn"

SYNSIN_MODELS = (SYNSIN_DEPTH, "synsin-encoder", "synsin-decoder")
"""Names of SynSin's networks in the manifest."""


@dataclass(frozen=True)
class MethodParts:
    """What a method is made with besides its recipe.

    Attributes:
        options: size of the frames, threads.
        clock: collects seconds by stage.
        estimator: finds depth in place of the recipe's, for methods that draw surfaces.
        fuser: joins renderings in place of the recipe's, likewise.
    """

    options: SynthesisOptions
    clock: Stopwatch | None = None
    estimator: DepthEstimator | None = None
    fuser: Fuser | None = None


@dataclass(frozen=True)
class MethodStrategy:
    """A way to make frames.

    Attributes:
        name: as users choose it.
        description: what it does, in a few words.
        make: makes it of a recipe and its parts.
        networks: names in the manifest of its own networks.
        draws_surfaces: whether depth, renderer and fusion of a recipe matter.
        is_offered: whether ``omnisyn interpolate`` has it; others are there for evaluation alone.
        renderer_label: what it draws with, where no renderer can be chosen.
        note: what users should know about its frames.
    """

    name: str
    description: str
    make: Callable[[Recipe, MethodParts], Method]
    networks: tuple[str, ...] = ()
    draws_surfaces: bool = False
    is_offered: bool = False
    renderer_label: str = ""
    note: str = ""


def _make_surfaces(recipe: Recipe, parts: MethodParts) -> Method:
    from omnisyn_cli.synthesis.methods import SurfaceMethod

    size, threads = parts.options.size, parts.options.threads
    device = None
    if recipe.is_on_gpu:
        from omnisyn_cli.synthesis.device.pair import GpuFrames

        device = GpuFrames(size)
    settings = FuserSettings(size, threads, recipe.fusion_rows, recipe.edges)
    fuser = parts.fuser or make_fuser(recipe.fusion, settings, device=recipe.device)
    estimator = parts.estimator or make_estimator(recipe.depth, device=recipe.device, threads=threads)
    return SurfaceMethod(estimator, parts.options, fuser, parts.clock, device)


def _make_crossfade(recipe: Recipe, parts: MethodParts) -> Method:
    from omnisyn_cli.baselines.fades import CrossFades

    return CrossFades(parts.options, parts.clock)


def _make_flow(recipe: Recipe, parts: MethodParts) -> Method:
    from omnisyn_cli.baselines.fades import FlowFades

    return FlowFades(parts.options, parts.clock)


def _make_synsin(recipe: Recipe, parts: MethodParts, *, sources: int) -> Method:
    from omnisyn_cli.baselines.synsin import SynSin

    networks = open_synsin(device=recipe.device, threads=parts.options.threads)
    return SynSin(networks, sources, parts.options, parts.clock)


def open_synsin(*, device: str = "auto", threads: int | None = None) -> SynSinSessions:
    """SynSin's networks that are installed.

    Raises InputError: one is not there, is of another kind, or cannot be used on that device.
    """
    from omnisyn_cli.baselines.synsin_sessions import SynSinSessions
    from omnisyn_cli.runtime.session import open_model

    return SynSinSessions(*(open_model(model, device=device, threads=threads) for model in SYNSIN_MODELS))


_SYNSIN: Mapping[str, Any] = {
    "networks": SYNSIN_MODELS, "is_offered": True, "renderer_label": "soft points",
    "note": "makes pictures of the size of its networks and enlarges them: expect them to be blurred",
}  # fmt: skip

METHODS: Mapping[str, MethodStrategy] = MappingProxyType({
    method.name: method
    for method in (
        MethodStrategy(OMNISYN, "depth, mesh, fusion", _make_surfaces, draws_surfaces=True, is_offered=True),
        MethodStrategy("crossfade", "both panoramas, turned, averaged by time", _make_crossfade),
        MethodStrategy("flow", "both panoramas moved along optical flow (DIS), averaged by time", _make_flow),
        MethodStrategy("synsin", "SynSin from the nearer panorama", partial(_make_synsin, sources=1), **_SYNSIN),
        MethodStrategy("synsin-2view", "SynSin from both panoramas", partial(_make_synsin, sources=2), **_SYNSIN),
    )
})  # fmt: skip
"""By name, this program's own first."""


def make_method(
    recipe: Recipe,
    size: tuple[int, int],
    *,
    threads: int | None = None,
    clock: Stopwatch | None = None,
    estimator: DepthEstimator | None = None,
    fuser: Fuser | None = None,
) -> Method:
    """What makes frames of a size by a recipe.

    Args:
        recipe: what they are made with.
        size: height and width of the frames.
        threads: at most this many; None is one per core.
        clock: collects seconds by stage.
        estimator: finds depth in place of the recipe's, for methods that draw surfaces.
        fuser: joins renderings in place of the recipe's, likewise.

    Raises InputError: a network cannot be found or loaded, or there is no such device.
    """
    from omnisyn_cli.render.mesh import Cut
    from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions

    options = SynthesisOptions(
        size, recipe.renderer_strategy.load(), Cut(recipe.cut, recipe.cut_metres), threads,
        cross_fade=recipe.fallback == "crossfade", confidence=recipe.confidence, adaptive=recipe.adaptive,
    )  # fmt: skip
    return recipe.method_strategy.make(recipe, MethodParts(options, clock, estimator, fuser))
