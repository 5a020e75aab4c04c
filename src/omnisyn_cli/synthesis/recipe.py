"""What frames are made with, as one value in which nothing is left open; and the names that users choose by.

Importing this takes no time, so that commands can offer the names before anything is loaded.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

__all__ = [
    "DEPTH_MODELS",
    "DEPTH_SOURCES",
    "DEVICES",
    "FALLBACKS",
    "FUSIONS",
    "METHODS",
    "NETWORKED_DEPTH",
    "OMNISYN",
    "RENDERERS",
    "SYNSIN_MODELS",
    "DepthSource",
    "Recipe",
]

DEPTH_SOURCES = ("file", "matching", "refined", "network", "monocular")
"""Where depth comes from. ``file``: what came with the panoramas. ``matching``: classical stereo. ``refined``: matching
made better by a network. ``network``: a stereo network alone. ``monocular``: a network that looks at each panorama by
itself."""

NETWORKED_DEPTH = ("refined", "network", "monocular")
"""Those that a network has a part in."""

RENDERERS = ("mesh", "two-pass")
"""How surfaces are drawn, see :mod:`omnisyn_cli.render.renderer`."""

FUSIONS = ("geometric", "network", "painting")
"""How two renderings become one picture. ``geometric``: by rules. ``network``: by rules that a network corrects where
the views contradict each other. ``painting``: a network paints all of it, as in the paper."""

FUSION_MODELS: Mapping[str, str] = MappingProxyType({"network": "fusion-residual", "painting": "fusion-paper-narrow"})
"""Name in the manifest of the network that has a part in a fusion."""

FALLBACKS = ("none", "crossfade", "fail")
"""What is done about pairs of low confidence: a warning, the photographs cross-faded in doubtful regions, nothing."""

DEVICES = ("auto", "cpu", "cuda")

OMNISYN = "omnisyn"

METHODS = (OMNISYN, "synsin", "synsin-2view")
"""How frames are made: this program's way or, to compare it with, SynSin from the nearer panorama or from both."""

SYNSIN_MODELS = ("synsin-depth", "synsin-encoder", "synsin-decoder")
"""Names of SynSin's networks in the manifest; the first finds depth in one panorama."""

SYNSIN_SOURCES: Mapping[str, int] = MappingProxyType({"synsin": 1, "synsin-2view": 2})
"""How many panoramas a frame is made of, by method."""

DEPTH_MODELS: Mapping[str, str] = MappingProxyType({"monocular": SYNSIN_MODELS[0]})
"""Name in the manifest of the network of a source of depth that no preset has."""


@dataclass(frozen=True)
class DepthSource:
    """Where depth comes from.

    Attributes:
        kind: one of :data:`DEPTH_SOURCES`.
        rows: that it is looked for at; refined estimates have half of them, those of matching alone as many, but not
            more than it is good at, see :mod:`omnisyn_cli.stereo.depth_sizes`; a network alone answers in a size of its own.
        model: for :data:`NETWORKED_DEPTH`: a name in the manifest, or the path of an ONNX file; for ``refined`` None
            leaves the network out, to compare with.
    """

    kind: str = "file"
    rows: int = 512
    model: str | None = None

    @property
    def networks(self) -> tuple[str, ...]:
        """Those that have a part in it."""
        return () if self.model is None else (self.model,)


@dataclass(frozen=True)
class Recipe:
    """What frames are made with.

    Attributes:
        depth: where it comes from.
        method: one of :data:`METHODS`, to all but the first of which only the depth's network and the device matter;
            or, for comparisons alone, ``crossfade`` or ``flow``.
        renderer: one of :data:`RENDERERS`.
        cut: share of inverse depth by which neighbouring pixels differ where surfaces are cut; None cuts at none.
        cut_metres: step of depth at which they are cut (the paper's rule), likewise.
        adaptive: whether flat surfaces are drawn with fewer triangles.
        fusion: one of :data:`FUSIONS`.
        fusion_rows: that a network which corrects the rules looks at, at most.
        edges: whether pixels at edges are means of samples, see :mod:`omnisyn_cli.fusion.supersampling`; meshes that rules fuse
            have some.
        fallback: one of :data:`FALLBACKS`.
        confidence: whether every frame gets a map of its confidence.
        device: where networks run, one of :data:`DEVICES`.
        is_on_gpu: whether frames are made on a GPU too.
    """

    depth: DepthSource = DepthSource()
    method: str = OMNISYN
    renderer: str = "mesh"
    cut: float | None = 0.05
    cut_metres: float | None = None
    adaptive: bool = False
    fusion: str = "geometric"
    fusion_rows: int = 96
    edges: bool = True
    fallback: str = "none"
    confidence: bool = False
    device: str = "auto"
    is_on_gpu: bool = False

    def of_known_depth(self) -> Recipe:
        """The same where depth comes from files: no network for fusion saw such renderings, it makes them worse."""
        return replace(self, depth=replace(self.depth, kind="file", model=None), fusion="geometric")

    @property
    def networks(self) -> tuple[str, ...]:
        """Those that have a part in it, by name in the manifest or as paths: of depth, then of fusion."""
        if self.method in SYNSIN_SOURCES:
            return SYNSIN_MODELS
        fusing = FUSION_MODELS.get(self.fusion)
        return (*self.depth.networks, *(() if fusing is None else (fusing,)))
