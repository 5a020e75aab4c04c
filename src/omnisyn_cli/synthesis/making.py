"""What a :class:`~omnisyn_cli.synthesis.recipe.Recipe` names, made: estimators of depth, fusers, whole methods.

Nothing is imported before it is made: most recipes need neither networks nor torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from omnisyn_cli.synthesis.recipe import (
    DEPTH_SOURCES,
    FUSION_MODELS,
    FUSIONS,
    SYNSIN_MODELS,
    SYNSIN_SOURCES,
    DepthSource,
    Recipe,
)
from omnisyn_cli.types import DepthEstimator, Fuser, KnownDepth

if TYPE_CHECKING:
    from omnisyn_cli.compute.stopwatch import Stopwatch
    from omnisyn_cli.baselines.synsin_sessions import SynSinSessions
    from omnisyn_cli.synthesis.device.pair import GpuFrames
    from omnisyn_cli.synthesis.methods import Method

__all__ = ["make_estimator", "make_method"]


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

    Raises:
        InputError: a network cannot be found or loaded, or there is no such device.
    """
    from omnisyn_cli.render.mesh import Cut
    from omnisyn_cli.synthesis.methods import SurfaceMethod
    from omnisyn_cli.synthesis.segments import SynthesisOptions

    options = SynthesisOptions(
        size, recipe.renderer, Cut(recipe.cut, recipe.cut_metres), threads,
        cross_fade=recipe.fallback == "crossfade", confidence=recipe.confidence, adaptive=recipe.adaptive,
    )  # fmt: skip
    if recipe.method in SYNSIN_SOURCES:
        from omnisyn_cli.baselines.synsin import SynSin

        networks = open_synsin(device=recipe.device, threads=threads)
        return SynSin(networks, SYNSIN_SOURCES[recipe.method], options, clock)
    if recipe.method in ("crossfade", "flow"):
        from omnisyn_cli.baselines.fades import CrossFades, FlowFades

        return (FlowFades if recipe.method == "flow" else CrossFades)(options, clock)
    device = _open_gpu(size) if recipe.is_on_gpu else None
    fuser = fuser or make_fuser(
        recipe.fusion, size, device=recipe.device, threads=threads, rows=recipe.fusion_rows, edges=recipe.edges
    )
    estimator = estimator or make_estimator(recipe.depth, device=recipe.device, threads=threads)
    return SurfaceMethod(estimator, options, fuser, clock, device)


def make_estimator(source: DepthSource, *, device: str = "auto", threads: int | None = None) -> DepthEstimator:
    """An estimator that serves any number of pairs.

    Args:
        source: where depth comes from.
        device: where the network runs: ``auto``, ``cpu`` or ``cuda``.
        threads: at most this many; None is one per core.

    Raises:
        ValueError: an unknown source, or no model where one is needed.
        InputError: the model cannot be found or loaded, or not on that device.
    """
    if source.kind not in DEPTH_SOURCES:
        raise ValueError(f"expected a depth source of {', '.join(DEPTH_SOURCES)}, got {source.kind!r}")
    if source.kind == "file":
        return KnownDepth()
    if source.kind == "network":
        from omnisyn_cli.baselines.learned_depth import LearnedDepthEstimator

        return LearnedDepthEstimator(_session(source.model, device, threads))
    if source.kind == "monocular":
        from omnisyn_cli.baselines.synsin_sessions import MonocularDepthEstimator

        return MonocularDepthEstimator(_session(source.model, device, threads))
    from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator, MatchingOptions
    from omnisyn_cli.stereo.depth_sizes import matching_rows

    coarse = matching_rows(source.rows)
    matching = MatchingDepthEstimator(MatchingOptions(size=(coarse, 2 * coarse)), threads)
    if source.kind == "matching":
        return matching
    from omnisyn_cli.runtime.planes import SessionRefinement
    from omnisyn_cli.stereo.refined_estimator import RefinedDepthEstimator

    refinement = SessionRefinement(_session(source.model, device, threads)) if source.model is not None else None
    return RefinedDepthEstimator(matching, refinement, source.rows)


def make_fuser(
    name: str, size: tuple[int, int], *, model: str | None = None, device: str = "auto", threads: int | None = None,
    rows: int = Recipe.fusion_rows, edges: bool = True,
) -> Fuser:  # fmt: skip
    """A fuser for frames of a size.

    Args:
        name: one of :data:`omnisyn_cli.synthesis.recipe.FUSIONS`.
        size: height and width of the frames.
        model: name in the manifest or path of an ONNX file; by default that of
            :data:`omnisyn_cli.synthesis.recipe.FUSION_MODELS`.
        device: where the network runs: ``auto``, ``cpu`` or ``cuda``.
        threads: at most this many; None is one per core.
        rows: that a network which corrects the rules looks at, at most.
        edges: whether pixels at edges are means of samples; never where a network paints.

    Raises:
        ValueError: an unknown name.
        InputError: the model cannot be found or loaded, or not on that device.
    """
    if name not in FUSIONS:
        raise ValueError(f"expected a fusion of {', '.join(FUSIONS)}, got {name!r}")
    if name == "geometric":
        from omnisyn_cli.fusion.geometric import GeometricFuser

        return GeometricFuser(size, threads=threads, edges=edges)
    from omnisyn_cli.runtime.planes import SessionFusion, SessionPainter

    session = _session(model or FUSION_MODELS[name], device, threads)
    if name == "painting":
        from omnisyn_cli.baselines.direct_fuser import DirectFuser

        return DirectFuser(size, SessionPainter(session), threads=threads)
    from omnisyn_cli.fusion.residual import ResidualFuser

    return ResidualFuser(size, SessionFusion(session), rows, threads=threads, edges=edges)


def open_synsin(*, device: str = "auto", threads: int | None = None) -> SynSinSessions:
    """SynSin's networks that are installed.

    Raises:
        InputError: one is not there, is of another kind, or cannot be used on that device.
    """
    from omnisyn_cli.baselines.synsin_sessions import SynSinSessions

    return SynSinSessions(*(_session(model, device, threads) for model in SYNSIN_MODELS))


def _session(model: str | None, device: str, threads: int | None) -> Any:
    from omnisyn_cli.runtime.models import find_model
    from omnisyn_cli.runtime.session import open_session

    if model is None:
        raise ValueError("expected the name or path of a model, got none")
    return open_session(find_model(model), device=device, threads=threads)


def _open_gpu(size: tuple[int, int]) -> GpuFrames:
    from omnisyn_cli.synthesis.device.pair import GpuFrames

    return GpuFrames(size)
