"""How frames are made: the registry of methods, this program's own and those that it is compared with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from omnisyn_cli.pipeline.choices import by_name
from omnisyn_cli.pipeline.depth_sources import SYNSIN_DEPTH

if TYPE_CHECKING:
    from omnisyn_cli.baselines.synsin import SynSinSessions
    from omnisyn_cli.compute.stopwatch import Stopwatch
    from omnisyn_cli.synthesis.methods import Method
    from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
    from omnisyn_cli.types import DepthEstimator, Fuser

OMNISYN = "omnisyn"  # the method of this program: surfaces from estimated depth, fused
SYNSIN_MODELS = (SYNSIN_DEPTH, "synsin-encoder", "synsin-decoder")  # names of SynSin's networks in the manifest


@dataclass(frozen=True)
class MethodParts:
    """What methods are made with; each takes what it needs. The last two make what finds depth and joins two layers."""

    options: SynthesisOptions
    clock: Stopwatch | None
    device: str
    frames_on_gpu: bool  # whether a GPU makes these frames, if the device is one
    estimator: Callable[[], DepthEstimator]
    fuser: Callable[[], Fuser]


@dataclass(frozen=True)
class MethodStrategy:
    """A way to make frames."""

    name: str
    description: str  # what it does, in a few words
    make: Callable[[MethodParts], Method]
    networks: tuple[str, ...] = ()  # names in the manifest of its own networks
    draws_surfaces: bool = False  # whether depth, renderer and fusion of a config matter
    is_offered: bool = False  # whether ``omnisyn interpolate`` has it; others are there for evaluation alone
    renderer_label: str = ""  # what it draws with, where no renderer can be chosen
    note: str = ""  # what users should know about its frames


def _make_surfaces(parts: MethodParts) -> Method:
    from omnisyn_cli.fusion.geometric import GeometricFuser
    from omnisyn_cli.synthesis.device import has_device
    from omnisyn_cli.synthesis.methods import SurfaceMethod

    fuser, device = parts.fuser(), None
    if parts.frames_on_gpu and isinstance(fuser, GeometricFuser) and has_device(parts.device):
        from omnisyn_cli.synthesis.device.frames import DeviceFrames

        device = DeviceFrames(parts.options, fuser)
    return SurfaceMethod(parts.estimator(), parts.options, fuser, parts.clock, device)


def _make_crossfade(parts: MethodParts) -> Method:
    from omnisyn_cli.baselines.cross_fade import CrossFadeMethod

    return CrossFadeMethod(parts.options, parts.clock)


def _make_flow(parts: MethodParts) -> Method:
    from omnisyn_cli.baselines.cross_fade import FlowMethod

    return FlowMethod(parts.options, parts.clock)


def _make_synsin(parts: MethodParts, *, sources: int) -> Method:
    from omnisyn_cli.baselines.synsin import SynSin

    networks = open_synsin(device=parts.device, threads=parts.options.threads)
    return SynSin(networks, sources, parts.options, parts.clock)


def open_synsin(*, device: str = "auto", threads: int | None = None) -> SynSinSessions:
    """SynSin's installed networks; InputError: one is missing, of another kind, or unusable on that device."""
    from omnisyn_cli.baselines.synsin import SynSinSessions
    from omnisyn_cli.runtime.session import open_model

    return SynSinSessions(*(open_model(model, device=device, threads=threads) for model in SYNSIN_MODELS))


_SYNSIN: Mapping[str, Any] = {
    "networks": SYNSIN_MODELS, "is_offered": True, "renderer_label": "soft points",
    "note": "makes pictures of the size of its networks and enlarges them: expect them to be blurred",
}  # fmt: skip

# By name, this program's own first.
METHODS: Mapping[str, MethodStrategy] = by_name(
    MethodStrategy(OMNISYN, "depth, mesh, fusion", _make_surfaces, draws_surfaces=True, is_offered=True),
    MethodStrategy("crossfade", "cross-fade of both rotated panoramas", _make_crossfade),
    MethodStrategy("flow", "both panoramas warped along optical flow (DIS) and cross-faded", _make_flow),
    MethodStrategy("synsin", "SynSin from the nearer panorama", partial(_make_synsin, sources=1), **_SYNSIN),
    MethodStrategy("synsin-2view", "SynSin from both panoramas", partial(_make_synsin, sources=2), **_SYNSIN),
)  # fmt: skip
