"""The methods that are compared, by name: what is measured, upper bounds, baselines and ablations.

A method is a :class:`~omnisyn_cli.pipeline.config.RunConfig`, perhaps changed, and what only an evaluation may do: look
at the true depth, make surfaces of another density, hide the second panorama. Names are ``base`` or ``base:key=value``,
such as ``oracle-depth:metres=2:depth=512x256``, by the parameters that ``docs/evaluation.md`` lists.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.errors import InputError, OmnisynError
from omnisyn_cli.evaluation.grouping import BOUND, TOUR_PARAMETER
from omnisyn_cli.evaluation.simulated_prior import NAME as SIMULATED_PRIOR
from omnisyn_cli.evaluation.simulated_prior import SimulatedModel
from omnisyn_cli.fusion.geometric import Confidence, GeometricFuser, Picture
from omnisyn_cli.geometry.pose import at_same_position
from omnisyn_cli.geometry.sampling import sample_nearest
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.pipeline.config import FALLBACKS, DepthSource, RunConfig, make_method
from omnisyn_cli.pipeline.depth_sources import SYNSIN_DEPTH, make_estimator
from omnisyn_cli.pipeline.fusions import FUSIONS
from omnisyn_cli.pipeline.methods import METHODS as STRATEGIES
from omnisyn_cli.pipeline.presets import DEFAULT_PRESET, PRESETS, SCALE
from omnisyn_cli.pipeline.renderers import RENDERERS
from omnisyn_cli.runtime.models import find_prior, read_manifest, sha256_of
from omnisyn_cli.runtime.monocular_session import NetworkKind
from omnisyn_cli.stereo.monocular_prior import with_monocular_priors
from omnisyn_cli.stereo.refined_estimator import RefinedDepthEstimator
from omnisyn_cli.synthesis.camera_fixed import find_camera_fixed
from omnisyn_cli.synthesis.methods import Pair, SurfacePair
from omnisyn_cli.synthesis.synthesize import Frame, FrameAllocator
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import DepthEstimate, DepthEstimator, Fuser, Layer, View

FIRST_VIEW_SHARE = 1e-9  # share of the way at which the exposure of a frame is still that of the first view


class MethodUnavailableError(OmnisynError):
    """A method cannot work on this pair or in this installation; the message is the reason that tables give."""


class PairDepths:
    """Depth of a pair, and of those beside it in a tour, by source, and its seconds; every source is asked once."""

    def __init__(self) -> None:
        self._found: dict[tuple[DepthSource, bytes], tuple[tuple[DepthEstimate, DepthEstimate], float]] = {}

    def recall(
        self, source: DepthSource, estimator: DepthEstimator, first: View, second: View
    ) -> tuple[tuple[DepthEstimate, DepthEstimate], float]:
        """What the source's estimator finds, and the seconds that it took when it was asked."""
        masks = (b"" if view.mask is None else view.mask.tobytes() for view in (first, second))
        key = (source, b"".join((first.pose.position.tobytes(), second.pose.position.tobytes(), *masks)))
        if key not in self._found:
            begin = time.perf_counter()
            found = estimator(first, second)
            self._found[key] = (found, time.perf_counter() - begin)
        return self._found[key]


@dataclass(frozen=True)
class ComparedMethod:
    """A method that can be compared."""

    name: str  # as it is chosen and listed
    description: str  # what it does, in a few words
    config: RunConfig  # what its frames are made with; depth from files is the truth, which no other method sees
    depth_size: tuple[int, int] | None = None  # height and width of the surfaces' grids; None is that of the estimates
    shows_first_only: bool = False  # whether the second panorama is hidden
    is_in_tour: bool = False  # whether the panoramas before and after the pair take part in its depth
    leaves_out_camera_fixed: bool = False  # whether what moves with the camera is masked

    def ingredients(self) -> tuple[str, ...]:
        """What its results depend on besides its name: settings, and the digests of its networks."""
        digests = {name: entry.sha256 for name, entry in read_manifest().items()}
        digests |= {name: sha256_of(Path(name)) for name in self.config.networks if Path(name).is_file()}
        return (repr(self.config), *(digests.get(name, "") for name in self.config.networks))


class MethodAtWork:
    """A method at work on one pair of views: called with a size and a stopwatch, it makes the pair ready for frames.

    ``views`` have the true depth, kept from all that must not see it. ``known`` is depth that other methods have found,
    which counts with the seconds that it took there. ``around``: the panoramas before and after, for a method in a
    tour, whose own pairs' seconds are not counted here. For ``still`` see :mod:`omnisyn_cli.synthesis.still_outlines`.
    MethodUnavailableError: true depth or a network is missing.
    """

    def __init__(
        self, method: ComparedMethod, views: tuple[View, View], *, threads: int | None = None, device: str = "auto",
        known: PairDepths | None = None, around: tuple[View | None, View | None] = (None, None),
        still: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        self._method, self._threads, self._known = method, threads, known or PairDepths()
        self._config = replace(method.config, device=device)
        sees_truth = self._config.depth.strategy.reads_files
        if sees_truth and self._config.draws_surfaces and any(view.known_depth is None for view in views):
            raise MethodUnavailableError("expected the true depth of both panoramas, this pair has none")
        before, after = around if method.is_in_tour else (None, None)
        self._index, chain = int(before is not None), [view for view in (before, *views, after) if view is not None]
        if method.leaves_out_camera_fixed:
            chain[self._index : self._index + 2] = _without_camera_fixed(*views, still)
        self._views = chain if sees_truth else [View(view.image, view.pose, view.mask) for view in chain]
        with _unavailable_without_network():
            self._estimator = _estimator(self._config.depth, views, device, threads)

    def __call__(self, size: tuple[int, int], clock: Stopwatch) -> Pair:
        """The pair ready for frames of a size; seconds by stage go to the stopwatch."""
        fuser = _FirstViewOnly(size, self._threads) if self._method.shows_first_only else None
        with _unavailable_without_network():
            method = make_method(
                self._config, size, threads=self._threads, clock=clock, estimator=partial(self._depths, clock),
                fuser=fuser,
            )  # fmt: skip
        pair = method.prepare(self._index, self._views)
        return _FirstOfPair(pair) if fuser is not None and isinstance(pair, SurfacePair) else pair

    def _depths(self, clock: Stopwatch, first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        """The depth of both views; ``clock`` is given the seconds that this does not take now."""
        begin = time.perf_counter()
        found, seconds = self._known.recall(self._config.depth, self._estimator, first, second)
        if (size := self._method.depth_size) is not None:
            found = (_resized(found[0], size), _resized(found[1], size))
        taken, own = time.perf_counter() - begin, self._views[self._index]
        is_own = at_same_position(first.pose, own.pose)
        clock.seconds["depth"] += max(0.0, seconds - taken) if is_own else -taken
        return found


def _estimator(source: DepthSource, views: Sequence[View], device: str, threads: int | None) -> DepthEstimator:
    """The estimator of a source, whose prior may be made from the true depth of the views."""
    error = SIMULATED_PRIOR.fullmatch(source.prior or "")
    if error is None:
        return make_estimator(source, device=device, threads=threads)
    estimator = make_estimator(replace(source, prior=None), device=device, threads=threads)
    if not isinstance(estimator, RefinedDepthEstimator):
        raise MethodUnavailableError(f"expected refined depth with a simulated prior, got {source.kind!r}")
    prior = partial(with_monocular_priors, model=SimulatedModel(views, float(error[1])))
    return replace(estimator, matching=replace(estimator.matching, prior=prior))


def _without_camera_fixed(first: View, second: View, still: np.ndarray | None) -> list[View]:
    """Both views, in which what moves with the camera is masked."""
    fixed = find_camera_fixed(first, second, still)
    return [
        view if found is None else replace(view, mask=~found if view.mask is None else view.mask & ~found)
        for view, found in zip((first, second), fixed, strict=True)
    ]


@contextmanager
def _unavailable_without_network() -> Iterator[None]:
    try:
        yield
    except InputError as error:
        raise MethodUnavailableError(str(error)) from error


def _resized(estimate: DepthEstimate, size: tuple[int, int]) -> DepthEstimate:
    """An estimate at another size; pixels are taken from where they are, so that no edge is blurred."""
    directions = pixel_directions(*size)
    inverse_depth, confidence = (sample_nearest(x, directions) for x in (estimate.inverse_depth, estimate.confidence))
    return replace(estimate, inverse_depth=inverse_depth, confidence=confidence)


class _FirstViewOnly:
    """A fuser that is blind to the second view; no :class:`GeometricFuser`, whose rule and twins are not blind."""

    def __init__(self, size: tuple[int, int], threads: int | None) -> None:
        self._fuser: Fuser = GeometricFuser(size, threads=threads)

    def __call__(
        self, first: Layer, second: Layer, t: float, out: Picture | None = None, confidence: Confidence | None = None
    ) -> Picture:
        return self._fuser(first, _nothing_of(second), t, out, confidence)


def _nothing_of(view: Layer) -> Layer:
    """A rendering of a view that shows nothing."""
    unseen = np.full_like(view.inverse_depth, -1.0)
    return Layer.from_arrays(unseen, np.zeros((*unseen.shape, 4), np.float32), view.target_from_source)


class _FirstOfPair:
    """A :class:`~omnisyn_cli.synthesis.methods.Pair` as its first view alone shows it, at that view's exposure."""

    def __init__(self, pair: SurfacePair) -> None:
        self._pair, self.depths = pair, pair.depths

    def frame(self, waypoint: Waypoint, out: FrameAllocator | None = None) -> Frame:
        """What the first view shows."""
        return self._pair.frame(replace(waypoint, t=FIRST_VIEW_SHARE), out)

    def inverse_depth(self, waypoint: Waypoint) -> np.ndarray:
        """Of the first view's surface."""
        return self._pair.inverse_depth(waypoint, (0,))

    def renderings(self, waypoint: Waypoint) -> tuple[Layer, Layer]:
        """Of the first view's surface, and of nothing."""
        first, second = self._pair.renderings(waypoint)
        return first, _nothing_of(second)


_DEFAULT = PRESETS[DEFAULT_PRESET].config  # the config of the default preset, of which ablations change one thing
# Methods without parameters, by name.
BASES: Mapping[str, ComparedMethod] = {
    name: ComparedMethod(name, description, config, shows_first_only=name == "first-view-only")
    for name, description, config in (
        *((name, m.description, RunConfig(method=name)) for name, m in STRATEGIES.items() if not m.draws_surfaces),
        ("matching", "depth by matching, mesh, geometric fusion", RunConfig(DepthSource("matching"), adaptive=True)),
        *((f"omnisyn-{name}", f"the preset {name}", preset.config) for name, preset in SCALE.items()),
        ("omnisyn-paper", "the preset paper: the method of the paper with narrower networks", PRESETS["paper"].config),
        *(
            (f"omnisyn-{renderer}", f"the default preset with {what}", replace(_DEFAULT, renderer=renderer))
            for renderer, what in (
                ("two-pass", "the paper's two-pass rasteriser"), ("points", "a cloud of points instead of meshes"),
            )
        ),
        ("first-view-only", "the default preset's depth, only the first panorama is shown", _DEFAULT),
        (
            "monocular", "depth from each panorama alone, mesh, geometric fusion",
            RunConfig(DepthSource("monocular", model=SYNSIN_DEPTH)),
        ),
        ("oracle-depth", "the true depth: an upper bound", RunConfig(DepthSource("file"))),
    )
}  # fmt: skip
ONE_VIEW = "views=1"  # the parameter of a method that shows the first panorama only
# Parameters that every method with surfaces takes as they are, and what they change in it or in its config.
PLAIN_PARAMETERS: Mapping[str, Mapping[str, Any]] = {
    **{f"fusion={name}": {"fusion": name, "shows_first_only": False} for name in FUSIONS},
    "edges=none": {"edges": False},
    "adaptive=none": {"adaptive": False},
    **{f"fallback={name}": {"fallback": name} for name in FALLBACKS if name != "fail"},
    ONE_VIEW: {"shows_first_only": True},
    "nadir=auto": {"leaves_out_camera_fixed": True},
}
# Parameters of refined depth that leave one of its networks out.
WITHOUT_NETWORK: Mapping[str, Mapping[str, Any]] = {
    f"{part}=none": {part: None} for part in ("model", "prior", "descriptors")
}
MIN_ROWS = 32  # least height of a network's input, which is halved five times
# Ablations that are part of ``all``.
VARIANTS = (
    f"omnisyn-{DEFAULT_PRESET}:fusion=geometric",
    *(f"matching:{change}" for change in ("metres=2", "cut=0.02", "cut=0.1", "depth=512x256", "depth=256x128")),
)


def find_method(name: str) -> ComparedMethod:
    """The method of a name; InputError: there is none, or it has no such parameter."""
    base, *parameters = name.split(":")
    if base not in BASES or (parameters and not BASES[base].config.draws_surfaces):
        raise InputError(f"expected one of {', '.join(BASES)} as method, got {name!r}; choose one of these")
    fusions = [parameter for parameter in parameters if "fusion" in PLAIN_PARAMETERS.get(parameter, {})]
    if fusions and ONE_VIEW in parameters:
        raise InputError(f"expected {fusions[0]} or {ONE_VIEW}, got both in {name!r}: one view has nothing to fuse")
    method = BASES[base]
    for parameter in parameters:
        method = _changed(method, parameter, name)
    if parameters:
        method = replace(method, description=f"{method.description}; {', '.join(parameters)}")
    return replace(method, name=name)


def _changed(method: ComparedMethod, parameter: str, name: str) -> ComparedMethod:
    """The method with a parameter; InputError: it has none of that name, or not with that value."""
    try:
        changes = _changes(method.config, parameter)
    except ValueError:  # no number
        changes = {}
    if not changes:
        raise InputError(
            f"expected cut=0.05, metres=2, depth=512x256, renderer=points|two-pass, {', '.join(PLAIN_PARAMETERS)}, "
            f"model=FILE.onnx, {', '.join(('rows=1024', *WITHOUT_NETWORK))}, prior=FILE.onnx|NAME, "
            f"prior-kind=perspective+depth, prior=simulated(0.1) (where a network refines matching) or "
            f"{TOUR_PARAMETER} (where depth is estimated) after the colon, got {parameter!r} in {name!r}"
        )
    of_method = {key: value for key, value in changes.items() if hasattr(method, key)}
    of_config = {key: value for key, value in changes.items() if key not in of_method}
    return replace(method, config=replace(method.config, **of_config), **of_method)


def _changes(config: RunConfig, parameter: str) -> Mapping[str, Any]:
    """What a parameter changes in a method or its config; nothing where it is none. ValueError: no number."""
    key, _, value = parameter.partition("=")
    depth = config.depth
    if key == "cut" and 0 < float(value) <= 1:
        return {"cut": float(value), "cut_metres": None}
    if key == "metres" and float(value) > 0:
        return {"cut": None, "cut_metres": float(value)}
    if key == "renderer" and value in RENDERERS:
        return {"renderer": value}
    if key == "depth":
        width, height = (int(number) for number in value.lower().split("x"))
        return {"depth_size": (height, width)} if width == 2 * height > 0 else {}
    if key == "model" and value.endswith(".onnx") and depth.strategy.role is not None:
        return {"depth": replace(depth, model=value)}
    if key == "rows" and depth.strategy.model_is_optional and int(value) >= MIN_ROWS:
        return {"depth": replace(depth, rows=int(value))}
    if parameter in WITHOUT_NETWORK and depth.strategy.model_is_optional:
        return {"depth": replace(depth, **WITHOUT_NETWORK[parameter])}
    if key in ("prior", "prior-kind") and depth.strategy.model_is_optional:
        return {"depth": _with_prior(depth, key, value)}
    if parameter == TOUR_PARAMETER and config.estimates_depth:
        return {"is_in_tour": True}
    return PLAIN_PARAMETERS.get(parameter, {})


def _with_prior(depth: DepthSource, key: str, value: str) -> DepthSource:
    """A source with another depth prior, or that of another kind. InputError: there is none."""
    if key == "prior-kind":
        NetworkKind.from_words(words := value.replace("+", ","))
        return replace(depth, prior_kind=words)
    is_simulated = SIMULATED_PRIOR.fullmatch(value) is not None
    prior, words = (value, "") if is_simulated else find_prior(value, depth.prior_kind)
    return replace(depth, prior=prior, prior_kind=words)


# What ``all`` stands for, by name.
METHODS: Mapping[str, ComparedMethod] = {name: find_method(name) for name in (*BASES, *VARIANTS)}
# What ``usual`` stands for: what costs nothing, what needs no network, the presets, and the bound of them all.
DEFAULT_METHODS = ("crossfade", "matching", *(f"omnisyn-{name}" for name in SCALE), BOUND)
# What it stands for between photographs; the last one is what ``interpolate`` does.
PHOTOGRAPH_METHODS = (
    "crossfade", "flow", "matching:nadir=auto", f"omnisyn-{DEFAULT_PRESET}:nadir=auto",
    f"omnisyn-{DEFAULT_PRESET}:fallback=auto:nadir=auto",
)  # fmt: skip


def find_methods(text: str) -> list[ComparedMethod]:
    """``usual``, ``all``, or names separated by commas, each once; InputError: an unknown name, or none."""
    if text in ("usual", "all"):
        return [METHODS[name] for name in (DEFAULT_METHODS if text == "usual" else METHODS)]
    names = dict.fromkeys(name.strip() for name in text.split(",") if name.strip())
    if not names:
        raise InputError(
            f"expected 'usual', 'all' or names of methods, got {text!r}; choose some of {', '.join(METHODS)}"
        )
    return [find_method(name) for name in names]
