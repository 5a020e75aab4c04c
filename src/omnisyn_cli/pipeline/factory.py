"""A method made of a config."""

from __future__ import annotations

from typing import TYPE_CHECKING

from omnisyn_cli.pipeline.depth_sources import make_estimator
from omnisyn_cli.pipeline.fusions import FuserSettings, make_fuser
from omnisyn_cli.pipeline.methods import MethodParts

if TYPE_CHECKING:
    from omnisyn_cli.compute.stopwatch import Stopwatch
    from omnisyn_cli.pipeline.config import RunConfig
    from omnisyn_cli.synthesis.methods import Method
    from omnisyn_cli.types import DepthEstimator, Fuser


def make_method(
    config: RunConfig, size: tuple[int, int], *, threads: int | None = None, clock: Stopwatch | None = None,
    estimator: DepthEstimator | None = None, fuser: Fuser | None = None,
) -> Method:  # fmt: skip
    """Frames of a size by a config; surfaces may have an own estimator and fuser. InputError: no network or device."""
    from omnisyn_cli.render.mesh import Cut
    from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions

    options = SynthesisOptions(
        size, config.renderer_strategy.load(), Cut(config.cut, config.cut_metres), threads,
        cross_fade=config.fallback == "crossfade", soften=config.fallback == "soft", confidence=config.confidence,
        adaptive=config.adaptive,
    )  # fmt: skip
    settings = FuserSettings(size, threads, config.fusion_rows, config.edges)
    networks = "auto" if config.device == "cuda" and config.draws_surfaces else config.device
    return config.method_strategy.make(MethodParts(
        options, clock, config.device, config.frames_on_gpu and fuser is None,
        lambda: estimator or make_estimator(config.depth, device=networks, threads=threads),
        lambda: fuser or make_fuser(config.fusion, settings, device=networks),
    ))  # fmt: skip
