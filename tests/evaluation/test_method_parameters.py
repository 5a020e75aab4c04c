"""Parameters after a colon: each changes what its name says and nothing else."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hall_samples import loaded_hall

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.errors import InputError, OmnisynError
from omnisyn_cli.evaluation.methods import MethodAtWork, MethodUnavailableError, find_method
from omnisyn_cli.evaluation.simulated_prior import SimulatedModel
from omnisyn_cli.evaluation.views import LoadedPair
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.pipeline.fusions import FUSIONS, FuserSettings, make_fuser
from omnisyn_cli.pipeline.renderers import RENDERERS
from omnisyn_cli.runtime import models
from omnisyn_cli.stereo.expected_depth import NETWORK_SIZE
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.types import KnownDepth, View
from synthesis_samples import ws_psnr


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    return loaded_hall(tmp_path_factory.mktemp("data"))


def images(name: str, pair: LoadedPair, views: tuple[View, View] | None = None) -> np.ndarray:
    made = MethodAtWork(find_method(name), views or pair.views, threads=1)(pair.size, Stopwatch())
    return np.stack([made.frame(truth.waypoint).image.copy() for truth in pair.truths])


def of_product(pair: LoadedPair, views: tuple[View, View], fusion: str = "geometric", **options: Any) -> np.ndarray:
    """What the product makes of true depth."""
    fuser = make_fuser(fusion, FuserSettings(pair.size, threads=1))
    method = SurfaceMethod(KnownDepth(), SynthesisOptions(pair.size, threads=1, **options), fuser)
    made = method.prepare(0, views)
    return np.stack([made.frame(truth.waypoint).image.copy() for truth in pair.truths])


@pytest.mark.parametrize("renderer", RENDERERS)
def test_a_renderer_can_be_chosen_for_any_method(hall, renderer):
    expected = of_product(hall, hall.views, renderer=RENDERERS[renderer].load())
    np.testing.assert_array_equal(images(f"oracle-depth:renderer={renderer}", hall), expected)


def test_with_one_view_the_picture_of_the_second_is_never_seen(hall):
    first, second = hall.views
    inverted = View(1 - second.image, second.pose, second.mask, second.known_depth)
    one = images("oracle-depth:views=1", hall)
    np.testing.assert_allclose(one, images("oracle-depth:views=1", hall, (first, inverted)), atol=1e-6)
    two, other = images("oracle-depth", hall), images("oracle-depth", hall, (first, inverted))
    assert ws_psnr(two[0], hall.truths[0].image) > ws_psnr(one[0], hall.truths[0].image)
    assert np.abs(two - other).max() > 0.1


def test_the_network_fuses_what_the_views_contradict(hall):
    """With wrong depth the views contradict each other; then the pictures are those of the product's fuser."""
    first, second = hall.views
    wrong = View(first.image, first.pose, first.mask, replace(
        first.known_depth, inverse_depth=1.5 * first.known_depth.inverse_depth))  # fmt: skip
    expected = of_product(hall, (wrong, second), "network")
    corrected = images("oracle-depth:fusion=network", hall, (wrong, second))
    np.testing.assert_array_equal(corrected, expected)
    assert np.abs(corrected - images("oracle-depth", hall, (wrong, second))).max() > 0.01


@pytest.mark.parametrize(("fallback", "options"), [("soft", {"soften": True}), ("crossfade", {"cross_fade": True})])
def test_pairs_of_low_confidence_get_what_the_product_gives_them(hall, fallback, options):
    first, second = hall.views
    wrong = View(first.image, first.pose, first.mask, replace(
        first.known_depth, inverse_depth=4.0 * first.known_depth.inverse_depth))  # fmt: skip
    found = images(f"oracle-depth:fallback={fallback}", hall, (wrong, second))
    np.testing.assert_array_equal(found, of_product(hall, (wrong, second), **options))
    assert np.abs(found - images("oracle-depth:fallback=none", hall, (wrong, second))).max() > 0.1


def test_what_moves_with_the_camera_is_not_seen_if_it_is_left_out(hall):
    capped = []
    for view in hall.views:
        image = view.image.copy()
        image[-len(image) // 10 :] = (1.0, 0.0, 1.0)
        capped.append(replace(view, image=image))
    kept, left_out = (images(f"oracle-depth{each}", hall, tuple(capped)) for each in ("", ":nadir=auto"))
    is_cap = [each[:, -4:, :, 1] < each[:, -4:, :, [0, 2]].min(axis=-1) - 0.3 for each in (kept, left_out)]
    assert is_cap[0].mean() > 0.8
    assert is_cap[1].mean() < 0.3


def test_results_of_the_fusion_network_depend_on_it_and_others_do_not():
    digest = models.read_manifest()[FUSIONS["network"].model].sha256
    assert find_method("matching:fusion=network").ingredients()[1:] == (digest,)
    assert digest in find_method("omnisyn-balanced:cut=0.1:fusion=network").ingredients()
    assert digest in find_method("omnisyn-balanced").ingredients()
    for name in ("matching", "omnisyn-fast", "omnisyn-balanced:fusion=geometric", "oracle-depth:views=1"):
        assert digest not in find_method(name).ingredients()


def test_with_nothing_learned_in_it_the_product_needs_no_network(hall, monkeypatch):
    monkeypatch.setattr(models, "read_manifest", lambda folder=None: {})
    plain = images("omnisyn-fast:model=none:fusion=geometric", hall)
    assert np.isfinite(plain).all()
    assert plain.std() > 0.05
    assert find_method("omnisyn-balanced:model=none:prior=none:fusion=geometric").config.networks == ()
    with pytest.raises(MethodUnavailableError, match="completion-balanced"):
        images("omnisyn-fast", hall)


def test_a_simulated_prior_knows_the_truth_up_to_its_error(hall):
    """Up to the noise, which has the deviation that was asked for, and only where the truth is known."""
    views = hall.views
    answer = SimulatedModel(views, 0.1)(replace(views[0], known_depth=None))
    directions = pixel_directions(*NETWORK_SIZE)
    truth = resize_area(views[0].known_depth.inverse_depth, NETWORK_SIZE)
    error = np.log(answer.at(directions @ views[0].pose.rotation.T).values[0]) - np.log(truth)
    assert np.std(error[truth > 0]) == pytest.approx(0.1, abs=0.02)
    with pytest.raises(OmnisynError, match="true depth"):
        SimulatedModel([replace(view, known_depth=None) for view in views], 0.1)(views[0])


@pytest.mark.parametrize(
    ("parameter", "prior", "kind"),
    [
        ("prior=simulated(0.1)", "simulated(0.1)", ""),
        ("prior=a.onnx:prior-kind=perspective+depth", "a.onnx", "perspective,depth"),
    ],
)  # fmt: skip
def test_a_prior_can_be_chosen(parameter, prior, kind):
    depth = find_method(f"omnisyn-balanced:{parameter}").config.depth
    assert (depth.prior, depth.prior_kind) == (prior, kind)


def test_without_a_fusion_network_the_method_is_unavailable_and_says_so(hall, monkeypatch):
    monkeypatch.setattr(models, "read_manifest", lambda folder=None: {})
    with pytest.raises(MethodUnavailableError, match=FUSIONS["network"].model):
        images("oracle-depth:fusion=network", hall)


def test_one_view_is_not_fused():
    with pytest.raises(InputError, match="got both in 'oracle-depth:views=1:fusion=network'"):
        find_method("oracle-depth:views=1:fusion=network")


@pytest.mark.parametrize(
    "parameter", ["fusion=mean", "fusion=", "model=none", "renderer=nosuch", "renderer=", "views=2", "views=", "view=1"]
)
def test_what_is_no_parameter_is_refused(parameter):
    with pytest.raises(
        InputError, match="fusion=geometric, fusion=network, fusion=painting, edges=none, adaptive=none, fallback=soft"
    ):
        find_method(f"oracle-depth:{parameter}")


def test_a_method_that_is_not_there_says_what_is_missing(hall, monkeypatch):
    monkeypatch.setattr(models, "read_manifest", lambda folder=None: {})
    for name in ("monocular", "synsin", "synsin-2view"):
        with pytest.raises(MethodUnavailableError, match="'synsin-depth'"):
            images(name, hall)
