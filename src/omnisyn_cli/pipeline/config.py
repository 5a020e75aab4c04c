"""What frames are made with, as one value in which nothing is left open, and the method that it stands for."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from omnisyn_cli.pipeline.choices import chosen
from omnisyn_cli.pipeline.depth_sources import DepthSource, make_estimator
from omnisyn_cli.pipeline.fusions import FUSIONS, FuserSettings, FusionStrategy, make_fuser
from omnisyn_cli.pipeline.methods import METHODS, OMNISYN, MethodParts, MethodStrategy
from omnisyn_cli.pipeline.renderers import RENDERERS, RendererStrategy

if TYPE_CHECKING:
    from omnisyn_cli.compute.stopwatch import Stopwatch
    from omnisyn_cli.synthesis.methods import Method
    from omnisyn_cli.types import DepthEstimator, Fuser

__all__ = ["DEVICES", "FALLBACKS", "MIN_PAIR_SCORE", "DepthSource", "RunConfig", "frame_size", "make_method"]

MIN_PAIR_SCORE = 0.3  # confidence of a pair below which the program warns: frames have visible errors in many places
# What else is done about such pairs, and the ``scored_db`` below which their photographs are cross-faded in doubtful
# regions; 19.2 is a score of 0.3. (Of nine real triples two have 8 and 9 dB; the next has 10.9 and would lose 2 dB.)
FALLBACKS: dict[str, float] = {"auto": 10.0, "crossfade": 19.2, "none": 0.0, "fail": 0.0}
DEVICES = ("auto", "cpu", "cuda")  # that networks run on, and that make frames


def frame_size(size: str | tuple[int, int]) -> tuple[int, int]:
    """Height and width of ``2048x1024``, or of both numbers in either order; ValueError: not twice as wide as high."""
    numbers = size.lower().split("x")[::-1] if isinstance(size, str) else [str(number) for number in sorted(size)]
    height, width = map(int, numbers) if len(numbers) == 2 and all(map(str.isdecimal, numbers)) else (0, 0)
    if height == 0 or width != 2 * height:
        raise ValueError(f"expected WIDTHxHEIGHT, twice as wide as high, such as 2048x1024, got {size!r}")
    return height, width


@dataclass(frozen=True)
class RunConfig:
    """What frames are made with."""

    depth: DepthSource = field(default_factory=DepthSource)  # where it comes from
    method: str = OMNISYN  # one of :data:`~omnisyn_cli.pipeline.methods.METHODS`; to others only the device matters
    renderer: str = "mesh"  # one of :data:`~omnisyn_cli.pipeline.renderers.RENDERERS`
    # share of inverse depth by which neighbouring pixels differ where surfaces are cut; None cuts at none
    cut: float | None = 0.05
    cut_metres: float | None = None  # step of depth at which they are cut (the paper's rule), likewise
    adaptive: bool = False  # whether flat surfaces are drawn with fewer triangles
    fusion: str = "geometric"  # one of :data:`~omnisyn_cli.pipeline.fusions.FUSIONS`
    fusion_rows: int = 96  # that a network which corrects the rules looks at, at most
    edges: bool = True  # whether pixels at edges are means of samples (:mod:`omnisyn_cli.fusion.supersampling`)
    fallback: str = "none"  # one of :data:`FALLBACKS`
    confidence: bool = False  # whether every frame gets a map of its confidence
    device: str = "auto"  # where networks run and frames are made, one of :data:`DEVICES`

    def of_known_depth(self) -> RunConfig:
        """The same where depth comes from files: no network for fusion saw such renderings, it makes them worse."""
        return replace(
            self, depth=replace(self.depth, kind="file", model=None, prior=None, descriptors=None), fusion="geometric"
        )

    @property
    def method_strategy(self) -> MethodStrategy:
        """What its method can do; ValueError for an unknown one, as of the other strategies."""
        return chosen(METHODS, self.method, "method")

    @property
    def renderer_strategy(self) -> RendererStrategy:
        """What its renderer can do."""
        return chosen(RENDERERS, self.renderer, "renderer")

    @property
    def fusion_strategy(self) -> FusionStrategy:
        """What its fusion can do."""
        return chosen(FUSIONS, self.fusion, "fusion")

    @property
    def faded_below(self) -> float:
        """The decibels (``scored_db``) below which a pair is cross-faded."""
        return FALLBACKS[self.fallback]

    @property
    def draws_surfaces(self) -> bool:
        """Whether depth, renderer and fusion matter to its method."""
        return self.method_strategy.draws_surfaces

    @property
    def frames_on_gpu(self) -> bool:
        """Whether a GPU can make its frames."""
        return self.draws_surfaces and self.renderer == "mesh" and self.fusion_strategy.by_rules

    @property
    def estimates_depth(self) -> bool:
        """Whether depth is estimated: it is neither read from files nor of no importance to the method."""
        return self.draws_surfaces and not self.depth.strategy.reads_files

    @property
    def networks(self) -> tuple[str, ...]:
        """Those that have a part in it, by name in the manifest or as paths: of depth, then of fusion."""
        fusing = self.fusion_strategy.model if self.draws_surfaces else None
        return self.method_strategy.networks or (*self.depth.networks, *(() if fusing is None else (fusing,)))


def make_method(
    config: RunConfig, size: tuple[int, int], *, threads: int | None = None, clock: Stopwatch | None = None,
    estimator: DepthEstimator | None = None, fuser: Fuser | None = None,
) -> Method:  # fmt: skip
    """Frames of a size by a config; surfaces may have an own estimator and fuser. InputError: no network or device."""
    from omnisyn_cli.render.mesh import Cut
    from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions

    options = SynthesisOptions(
        size, config.renderer_strategy.load(), Cut(config.cut, config.cut_metres), threads,
        faded_below=config.faded_below, confidence=config.confidence, adaptive=config.adaptive,
    )  # fmt: skip
    settings = FuserSettings(size, threads, config.fusion_rows, config.edges)
    networks = "auto" if config.device == "cuda" and config.draws_surfaces else config.device
    return config.method_strategy.make(MethodParts(
        options, clock, config.device, config.frames_on_gpu and fuser is None,
        lambda: estimator or make_estimator(config.depth, device=networks, threads=threads),
        lambda: fuser or make_fuser(config.fusion, settings, device=networks),
    ))  # fmt: skip
