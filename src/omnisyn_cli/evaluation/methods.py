"""The methods that are compared, by name: what is measured, upper bounds, baselines and ablations.

Names are ``base`` or ``base:key=value``. Every method that finds depth takes ``cut`` (cut meshes where inverse depth
changes by more than this share), ``metres`` (at steps of depth, as the paper does), ``depth`` (WIDTHxHEIGHT of the
estimates, which is the density of the mesh), ``renderer`` (``points``, ``two-pass``), ``fusion=network`` (the geometric
fusion is corrected by a network), ``fusion=painting`` (a network paints, as in the paper) or ``views=1`` (only the
first panorama is shown): ``matching:cut=0.02``, ``oracle-depth:metres=2:depth=512x256``,
``omnisyn-balanced:fusion=network``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType

from omnisyn_cli.errors import InputError
from omnisyn_cli.estimators import make_estimator
from omnisyn_cli.evaluation.flow import CrossFade, FlowFade
from omnisyn_cli.evaluation.synsin import SynSinSynthesizer
from omnisyn_cli.evaluation.synthesizers import (
    DepthMemory,
    GeometricSynthesizer,
    MethodUnavailableError,
    Recipe,
    Synthesizer,
    first_view_only,
    geometric_fuser,
    network_fuser,
)
from omnisyn_cli.presets import DEFAULT_PRESET, FUSION_MODELS, PRESETS, SYNSIN_MODELS, SYNSIN_SOURCES
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.render.renderer import RENDERERS
from omnisyn_cli.runtime.models import read_manifest
from omnisyn_cli.synsin import open_synsin
from omnisyn_cli.types import KnownDepth, View

__all__ = ["METHODS", "Method", "MethodOptions", "find_method", "find_methods"]


@dataclass(frozen=True)
class MethodOptions:
    """What all methods are made with.

    Attributes:
        threads: at most this many; None is one per core.
        device: where networks run: ``auto``, ``cpu`` or ``cuda``.
        memory: depth of the pair that another method has found already; None: there is none.
    """

    threads: int | None = None
    device: str = "auto"
    memory: DepthMemory | None = None


Factory = Callable[[tuple[View, View], MethodOptions], Synthesizer]
"""Sets a method to work on a pair; raises MethodUnavailableError where it cannot."""


@dataclass(frozen=True)
class Method:
    """A method that can be compared.

    Attributes:
        name: as it is chosen and listed.
        description: what it does, in a few words.
        make: sets it to work.
        ingredients: tells what its results depend on besides its name, such as the networks that are installed.
    """

    name: str
    description: str
    make: Factory
    ingredients: Callable[[], tuple[str, ...]] = tuple


RecipeFactory = Callable[[MethodOptions], Recipe]


def _matching(options: MethodOptions) -> Recipe:
    return Recipe("matching", make_estimator("matching", threads=options.threads))


def _monocular(options: MethodOptions) -> Recipe:
    try:
        estimator = make_estimator("monocular", model=SYNSIN_MODELS[0], device=options.device, threads=options.threads)
    except InputError as error:
        raise MethodUnavailableError(str(error)) from error
    return Recipe("monocular", estimator)


def _synsin(name: str, views: tuple[View, View], options: MethodOptions) -> Synthesizer:
    try:
        networks = open_synsin(device=options.device, threads=options.threads)
    except InputError as error:
        raise MethodUnavailableError(str(error)) from error
    return SynSinSynthesizer(networks, views, SYNSIN_SOURCES[name], options.threads)


def _oracle(_: MethodOptions) -> Recipe:
    return Recipe("truth", KnownDepth(), sees_truth=True)


def _preset(name: str) -> RecipeFactory:
    """The recipe of a preset of the product; unavailable where its network is missing."""

    def make(options: MethodOptions) -> Recipe:
        preset = PRESETS[name]
        try:
            estimator = make_estimator(
                preset.depth, rows=preset.depth_rows, model=preset.model, device=options.device, threads=options.threads
            )
        except InputError as error:
            raise MethodUnavailableError(str(error)) from error
        fuser = geometric_fuser if preset.fusion == "geometric" else network_fuser(options.device, preset.fusion)
        cut = Cut() if preset.cut_metres is None else Cut(relative=None, metres=preset.cut_metres)
        return Recipe(f"preset {name}", estimator, renderer=preset.renderer, cut=cut, fuser=fuser)

    return make


def _installed(name: str, parameters: tuple[str, ...]) -> tuple[str, ...]:
    """A preset, and the digests of its network and of that for fusion, as far as they are there and take part."""
    preset = PRESETS.get(name)
    settings = () if preset is None else (repr(preset), _digest(preset.model))
    fusions = {FUSED_BY[parameter] for parameter in parameters if parameter in FUSED_BY}
    fusions |= {preset.fusion} if preset is not None else set()
    return (*settings, *(_digest(model) for fusion, model in FUSION_MODELS.items() if fusion in fusions))


def _with_synsin(name: str, parameters: tuple[str, ...]) -> tuple[str, ...]:
    """The same, and the digests of SynSin's networks."""
    return (*map(_digest, SYNSIN_MODELS), *_installed(name, parameters))


def _digest(model: str | None) -> str:
    """Of a network of the manifest; empty where there is none."""
    entry = read_manifest().get(model) if model else None
    return entry.sha256 if entry else ""


def _changed(base: RecipeFactory, **changes: object) -> RecipeFactory:
    return lambda options: replace(base(options), **changes)  # type: ignore[arg-type]


@dataclass(frozen=True)
class _Entry:
    """A geometric method: description, recipe, and the preset that the recipe looks at, if it does."""

    description: str
    recipe: RecipeFactory
    preset: str = ""


def _of_preset(description: str, name: str, **changes: object) -> _Entry:
    return _Entry(description, _changed(_preset(name), **changes), name)


RECIPES: Mapping[str, _Entry] = MappingProxyType(
    {
        "matching": _Entry("depth by matching, mesh, geometric fusion", _matching),
        "omnisyn-fast": _of_preset("the preset fast", "fast"),
        "omnisyn-balanced": _of_preset("the preset balanced", "balanced"),
        "omnisyn-accurate": _of_preset("the preset accurate", "accurate"),
        "omnisyn-paper": _of_preset("the preset paper: the method of the paper with narrower networks", "paper"),
        "omnisyn-points": _of_preset(
            "the default preset with a cloud of points instead of the mesh", DEFAULT_PRESET, renderer="points"
        ),
        "omnisyn-two-pass": _of_preset(
            "the default preset with the paper's two-pass rasteriser", DEFAULT_PRESET, renderer="two-pass"
        ),
        "first-view-only": _of_preset(
            "the default preset's depth, only the first panorama is shown", DEFAULT_PRESET, fuser=first_view_only
        ),
        "monocular": _Entry("depth from each panorama alone, mesh, geometric fusion", _monocular),
        "oracle-depth": _Entry("the true depth: an upper bound", _oracle),
    }
)  # fmt: skip
"""Geometric methods by name."""

PLAIN: Mapping[str, tuple[str, Callable[[tuple[View, View], int | None], Synthesizer]]] = MappingProxyType(
    {
        "crossfade": ("both panoramas, turned, averaged by time", CrossFade),
        "flow": ("both panoramas moved along optical flow (DIS), averaged by time", FlowFade),
    }
)
"""Methods without geometry."""

FUSED_BY = {f"fusion={name}": name for name in FUSION_MODELS}
"""Fusions with a network by the parameter that asks for them."""

SYNSIN: Mapping[str, str] = MappingProxyType(
    {
        "synsin": "SynSin from the nearer panorama",
        "synsin-2view": "SynSin from both panoramas",
    }
)
"""SynSin's points and networks, by the name of the method."""

ONE_VIEW = "views=1"

VARIANTS = (
    f"omnisyn-{DEFAULT_PRESET}:fusion=network",
    "matching:metres=2",
    "matching:cut=0.02",
    "matching:cut=0.1",
    "matching:depth=512x256",
    "matching:depth=256x128",
)
"""Ablations that are part of ``all``."""


def find_method(name: str) -> Method:
    """The method of a name.

    Raises:
        InputError: there is none, or it has no such parameter.
    """
    base, *parameters = name.split(":")
    if base in PLAIN and not parameters:
        description, make = PLAIN[base]
        return Method(name, description, lambda views, options: make(views, options.threads))
    if base in SYNSIN and not parameters:
        return Method(name, SYNSIN[base], partial(_synsin, base), partial(_with_synsin, base, ()))
    if base not in RECIPES:
        raise InputError(
            f"expected one of {', '.join((*PLAIN, *SYNSIN, *RECIPES))} as method, got {name!r}; choose one of these"
        )
    entry = RECIPES[base]
    description = entry.description
    changes = [_change(parameter, name) for parameter in parameters]
    fusions = [parameter for parameter in parameters if parameter in FUSED_BY]
    if fusions and ONE_VIEW in parameters:
        raise InputError(f"expected {fusions[0]} or {ONE_VIEW}, got both in {name!r}: one view has nothing to fuse")
    if parameters:
        description = f"{description}; {', '.join(parameters)}"

    def make_geometric(views: tuple[View, View], options: MethodOptions) -> Synthesizer:
        made = entry.recipe(options)
        for change in changes:
            made = change(made, options)
        _check_truth(made, views)
        return GeometricSynthesizer(made, views, options.threads, options.memory)

    ingredients = _with_synsin if base == "monocular" else _installed
    return Method(name, description, make_geometric, partial(ingredients, entry.preset, tuple(parameters)))


def _change(parameter: str, name: str) -> Callable[[Recipe, MethodOptions], Recipe]:
    key, _, value = parameter.partition("=")
    try:
        if key == "cut" and 0 < float(value) <= 1:
            return lambda recipe, _: replace(recipe, cut=Cut(relative=float(value)))
        if key == "metres" and float(value) > 0:
            return lambda recipe, _: replace(recipe, cut=Cut(relative=None, metres=float(value)))
        if key == "renderer" and value in RENDERERS:
            return lambda recipe, _: replace(recipe, renderer=value)
        if parameter in FUSED_BY:
            return lambda recipe, options: replace(recipe, fuser=network_fuser(options.device, FUSED_BY[parameter]))
        if parameter == ONE_VIEW:
            return lambda recipe, _: replace(recipe, fuser=first_view_only)
        if key == "depth":
            width, height = (int(number) for number in value.lower().split("x"))
            if width == 2 * height > 0:
                return lambda recipe, _: replace(recipe, depth_size=(height, width))
    except ValueError:
        pass
    raise InputError(
        f"expected cut=0.05, metres=2, depth=512x256, renderer=points, {', '.join(FUSED_BY)} or {ONE_VIEW} after the "
        f"colon, got {parameter!r} in {name!r}"
    )


def _check_truth(recipe: Recipe, views: tuple[View, View]) -> None:
    if recipe.sees_truth and any(view.known_depth is None for view in views):
        raise MethodUnavailableError("expected the true depth of both panoramas, this pair has none")


METHODS: Mapping[str, Method] = MappingProxyType(
    {name: find_method(name) for name in (*PLAIN, *SYNSIN, *RECIPES, *VARIANTS)}
)
"""What ``all`` stands for, by name."""


def find_methods(text: str) -> list[Method]:
    """``all``, or names separated by commas, each once.

    Raises:
        InputError: a name that there is no method of, or no name.
    """
    if text == "all":
        return list(METHODS.values())
    names = dict.fromkeys(name.strip() for name in text.split(",") if name.strip())
    if not names:
        raise InputError(f"expected 'all' or names of methods, got {text!r}; choose some of {', '.join(METHODS)}")
    return [find_method(name) for name in names]
