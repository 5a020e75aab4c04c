"""A config says everything: which networks take part, and what is made of it."""

from dataclasses import replace

import numpy as np
import pytest

from omnisyn_cli.baselines.cross_fade import CrossFadeMethod, FlowMethod
from omnisyn_cli.pipeline.config import DepthSource, RunConfig
from omnisyn_cli.pipeline.depth_sources import make_estimator
from omnisyn_cli.pipeline.factory import make_method
from omnisyn_cli.pipeline.fusions import FUSIONS
from omnisyn_cli.pipeline.methods import SYNSIN_MODELS
from omnisyn_cli.pipeline.presets import PRESETS
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.trajectory import Waypoint
from synthesis_samples import hall_image, hall_view, posed, ws_psnr

SIZE = (64, 128)
HALF_WAY = Waypoint(0, 0.5, posed((0, 0, 0)))


@pytest.mark.parametrize(
    ("name", "kind"), [("crossfade", CrossFadeMethod), ("flow", FlowMethod), ("omnisyn", SurfaceMethod)]
)
def test_a_method_is_what_its_recipe_names_and_makes_frames_of_its_size(name: str, kind: type) -> None:
    views = [hall_view(posed((0, 0, z)), SIZE) for z in (0.5, -0.5)]
    method = make_method(RunConfig(method=name), (32, 64), threads=1)
    assert type(method) is kind
    pair = method.prepare(0, views)
    frame, geometry = pair.frame(HALF_WAY), pair.inverse_depth(HALF_WAY)
    assert frame.image.shape == (32, 64, 3)
    assert (geometry is None) == (pair.depths is None) == (name != "omnisyn")
    if geometry is not None:
        np.testing.assert_allclose(geometry, 0.25, rtol=0.02)


def test_an_estimator_and_a_fuser_of_ones_own_take_the_place_of_the_recipes() -> None:
    """The config names networks that do not exist: nobody looks for them."""
    views = [hall_view(posed((0, 0, z)), SIZE) for z in (0.5, -0.5)]
    config = RunConfig(DepthSource("refined", model="nowhere"), fusion="painting")
    method = make_method(
        config, SIZE, threads=1, estimator=lambda *_: tuple(view.known_depth for view in views),
        fuser=lambda first, second, t: 0.5 * first.colour[..., :3] + 0.5 * second.colour[..., :3],
    )  # fmt: skip
    image = method.prepare(0, views).frame(HALF_WAY).image
    assert ws_psnr(np.clip(image, 0, 1), hall_image(HALF_WAY.pose, SIZE)) > 30


def test_known_depth_needs_no_network_and_changes_nothing_else() -> None:
    for preset in PRESETS.values():
        known = preset.config.of_known_depth()
        assert known.networks == ()
        assert replace(known, depth=preset.config.depth, fusion=preset.config.fusion) == preset.config


def test_networks_are_those_of_depth_and_fusion_or_of_synsin() -> None:
    assert RunConfig().networks == ()
    assert RunConfig(DepthSource("network", model="mine.onnx"), fusion="network").networks == (
        "mine.onnx", FUSIONS["network"].model
    )  # fmt: skip
    assert RunConfig(method="synsin").networks == SYNSIN_MODELS


def test_sources_without_a_name_or_a_model_are_refused() -> None:
    with pytest.raises(ValueError, match="file, matching, refined"):
        make_estimator(DepthSource("guess"))
    for kind in ("network", "monocular"):
        with pytest.raises(ValueError, match="path of a model, got none"):
            make_estimator(DepthSource(kind))


@pytest.mark.parametrize(
    ("unknown", "message"),
    [
        (RunConfig(renderer="magic"), r"renderer of mesh, two-pass, points, got 'magic'"),
        (RunConfig(fusion="magic"), r"fusion of geometric, network, painting, got 'magic'"),
        (RunConfig(method="magic"), r"method of omnisyn, .*, got 'magic'"),
        (RunConfig(DepthSource("magic")), r"depth source of file, .*, got 'magic'"),
    ],
)
def test_an_unknown_name_is_refused_with_the_known_ones(unknown, message):
    with pytest.raises(ValueError, match=message):
        make_method(unknown, (32, 64))
