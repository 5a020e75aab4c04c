"""The methods: what they are by definition, on pictures where the answer is known; what their parameters change."""

import time
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hall_samples import SIZE, loaded_hall

from omnisyn_cli.baselines.cross_fade import optical_flow
from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.errors import InputError, OmnisynError
from omnisyn_cli.evaluation import methods
from omnisyn_cli.evaluation.methods import (
    METHODS,
    ComparedMethod,
    MethodAtWork,
    MethodUnavailableError,
    PairDepths,
    find_method,
    find_methods,
)
from omnisyn_cli.evaluation.simulated_prior import SimulatedModel
from omnisyn_cli.evaluation.views import LoadedPair
from omnisyn_cli.geometry.pose import Pose, rotation_from_heading
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.pipeline.config import DepthSource, RunConfig
from omnisyn_cli.pipeline.fusions import FUSIONS, FuserSettings, make_fuser
from omnisyn_cli.pipeline.renderers import RENDERERS
from omnisyn_cli.runtime import models
from omnisyn_cli.stereo.expected_depth import NETWORK_SIZE
from omnisyn_cli.synthesis.methods import Pair, SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import Frame
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import DepthEstimate, KnownDepth, View
from synthesis_samples import distance_to_wall, hall_image, posed, ws_psnr


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    return loaded_hall(tmp_path_factory.mktemp("data"))


def at_work(name: str, pair: LoadedPair) -> Pair:
    return MethodAtWork(find_method(name), pair.views, threads=1)(pair.size, Stopwatch())


def pictures(name: str, pair: LoadedPair, path: list[Waypoint] | None = None) -> list[Frame]:
    made = at_work(name, pair)
    shown = (made.frame(waypoint) for waypoint in path or [truth.waypoint for truth in pair.truths])
    return [replace(frame, image=frame.image.copy()) for frame in shown]


def images(name: str, pair: LoadedPair, *views: View) -> np.ndarray:
    return np.stack([picture.image for picture in pictures(name, replace(pair, views=views or pair.views))])


def score(name: str, pair: LoadedPair) -> float:
    return float(np.mean([ws_psnr(p, t.image) for p, t in zip(images(name, pair), pair.truths, strict=True)]))


def misled(view: View, factor: float) -> View:
    """The view with wrong depth: everything is nearer by a factor."""
    return replace(view, known_depth=replace(view.known_depth, inverse_depth=factor * view.known_depth.inverse_depth))


def turned_views(columns: int) -> tuple[View, View]:
    """One place, the second camera turned so that everything is ``columns`` further right in its picture."""
    size = (128, 256)
    first = hall_image(posed((0.5, 0.2, 0)), size)
    second = np.roll(first, columns, axis=1)
    return View(first, Pose.identity()), View(second, Pose.identity())


def test_a_cross_fade_is_the_average_of_turned_pictures():
    first, second = turned_views(0)
    quarter = Pose(rotation_from_heading(np.pi / 2), np.zeros(3))
    pair = LoadedPair((first, View(1 - second.image, second.pose)), (), (128, 256))
    (picture,) = pictures("crossfade", pair, [Waypoint(0, 0.25, quarter)])
    expected = np.roll(0.75 * first.image + 0.25 * (1 - second.image), -64, axis=1)
    np.testing.assert_allclose(picture.image, expected, atol=1e-3)
    assert at_work("crossfade", pair).inverse_depth(picture.waypoint) is None


@pytest.mark.parametrize("columns", [6, -6])
def test_optical_flow_knows_neither_seam_nor_poles(columns):
    first, second = turned_views(columns)
    flow = optical_flow(first.image, second.image)[16:-16]
    np.testing.assert_allclose(flow[..., 1], columns, atol=0.5)
    np.testing.assert_allclose(flow[..., 0], 0, atol=0.5)


def test_the_fade_along_flow_is_half_way_where_both_moved():
    views = turned_views(8)
    pair = LoadedPair(views, (), (128, 256))
    (picture,) = pictures("flow", pair, [Waypoint(0, 0.5, Pose.identity())])
    half_way = np.roll(views[0].image, 4, axis=1)
    (fade,) = pictures("crossfade", pair, [Waypoint(0, 0.5, Pose.identity())])
    assert ws_psnr(picture.image, half_way) > ws_psnr(fade.image, half_way) + 10


def test_pictures_too_small_for_flow_are_faded():
    first = hall_image(posed((0, 0, 0)), (16, 32))
    pair = LoadedPair((View(first, Pose.identity()), View(1 - first, Pose.identity())), (), (16, 32))
    (picture,) = pictures("flow", pair, [Waypoint(0, 0.5, Pose.identity())])
    np.testing.assert_allclose(picture.image, 0.5, atol=1e-5)


def test_the_first_view_alone_does_not_depend_on_the_second(hall):
    first, second = hall.views
    other = replace(hall, views=(first, misled(replace(second, image=1 - second.image), 2.0)))
    made, others = (at_work("oracle-depth:views=1", pair) for pair in (hall, other))
    for truth in hall.truths:
        image = made.frame(truth.waypoint).image
        np.testing.assert_allclose(image, others.frame(truth.waypoint).image, atol=1e-5)
        np.testing.assert_array_equal(made.inverse_depth(truth.waypoint), others.inverse_depth(truth.waypoint))
        assert ws_psnr(image, truth.image) > 40
    assert score("oracle-depth", hall) > score("oracle-depth:views=1", hall)
    assert np.abs(images("oracle-depth", hall) - images("oracle-depth", other)).max() > 0.1


def test_only_the_oracle_sees_the_true_depth(hall, monkeypatch):
    """Estimators get views without it, and what is made of lies about it is a worse picture."""
    lies = replace(hall, views=tuple(misled(view, 3.0) for view in hall.views))
    assert score("oracle-depth", lies) < score("oracle-depth", hall) - 10
    seen = []

    def estimator(first: View, second: View) -> None:
        seen.extend([first.known_depth, second.known_depth])
        raise KeyError

    monkeypatch.setattr(methods, "make_estimator", lambda *_, **__: estimator)
    with pytest.raises(KeyError):
        at_work("matching", hall)
    assert seen == [None, None]


def test_pictures_know_how_far_the_hall_is(hall):
    """Their geometry is that of the wall from where they are."""
    made = at_work("oracle-depth", hall)
    for truth in hall.truths:
        expected = 1 / distance_to_wall(truth.waypoint.pose, SIZE)
        np.testing.assert_allclose(made.inverse_depth(truth.waypoint), expected, rtol=0.02)


def test_parameters_change_what_they_name(hall):
    oracle = at_work("oracle-depth:depth=32x16", hall)
    assert oracle.depths is not None
    assert oracle.depths[0].inverse_depth.shape == (16, 32)
    scores = {rest: score(f"oracle-depth{rest}", hall) for rest in ("", ":depth=8x4", ":cut=0.0001", ":metres=0.0001")}
    finest = scores.pop("")
    assert scores[":depth=8x4"] < finest - 3
    assert max(scores.values()) < finest
    assert score("oracle-depth:metres=2", hall) == pytest.approx(finest, abs=1e-9)


REFUSED = {
    "expected": ("nosuch", "crossfade:cut=0.1", "matching:cut=0", "matching:cut=2", "matching:metres=-1",
                 "matching:depth=5x5", "matching:depth=x", "matching:cut", "matching:speed=1", "matching:cut=0.1:x",
                 ""),
    "got both in 'oracle-depth:views=1:fusion=network'": ("oracle-depth:views=1:fusion=network",),
    "fusion=geometric, fusion=network, fusion=painting, edges=none, adaptive=none, fallback=auto": tuple(
        f"oracle-depth:{parameter}" for parameter in
        ("fusion=mean", "fusion=", "model=none", "renderer=nosuch", "renderer=", "views=2", "views=", "view=1")
    ),
}  # fmt: skip


@pytest.mark.parametrize(("words", "name"), [(words, name) for words, names in REFUSED.items() for name in names])
def test_names_that_mean_nothing_are_refused(words, name):
    with pytest.raises(InputError, match=words):
        find_method(name)


def test_all_are_those_of_the_table_and_lists_keep_their_order():
    assert [method.name for method in find_methods("all")] == list(METHODS)
    assert len(METHODS) == len(set(METHODS))
    assert "omnisyn-balanced:fusion=geometric" in METHODS
    assert [method.name for method in find_methods("flow, matching:cut=0.3,flow")] == ["flow", "matching:cut=0.3"]
    assert all(method.description for method in METHODS.values())


@pytest.mark.parametrize(
    ("words", "names"),
    [
        ("none installed", ("omnisyn-balanced", "omnisyn-two-pass", "omnisyn-paper", "first-view-only")),
        ("'synsin-depth'", ("monocular", "synsin", "synsin-2view")),
        (FUSIONS["network"].model, ("oracle-depth:fusion=network",)),
    ],
)
def test_a_method_without_its_network_is_unavailable_and_says_which(hall, monkeypatch, words, names):
    monkeypatch.setattr(models, "read_manifest", lambda folder=None: {})
    for name in names:
        with pytest.raises(MethodUnavailableError, match=words):
            at_work(name, hall)


def test_methods_of_one_source_share_its_depth_and_the_seconds_that_it_took(hall, monkeypatch):
    calls, taken = [], []

    def estimator(first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        calls.append((first, second))
        time.sleep(0.2)
        return KnownDepth()(*hall.views)

    monkeypatch.setattr(methods, "make_estimator", lambda *_, **__: estimator)
    known = PairDepths()
    config = RunConfig(DepthSource("matching"))
    method = ComparedMethod("slow", "", config)
    two_pass = replace(method, config=replace(config, renderer="two-pass"))
    for changed in (method, two_pass, replace(method, depth_size=(16, 32))):
        clock = Stopwatch()
        MethodAtWork(changed, hall.views, threads=1, known=known)(hall.size, clock)
        taken.append(clock.seconds["depth"])
    assert min(taken) >= 0.19, "the others would be done at once"
    assert len(calls) == 1
    other = replace(method, config=RunConfig(DepthSource("matching", 256)))
    MethodAtWork(other, hall.views, threads=1, known=known)(hall.size, clock)
    assert len(calls) == 2


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


@pytest.mark.parametrize(
    ("factor", "parameter", "options", "plain", "change"),
    [(1.5, ":fusion=network", {"fusion": "network"}, "", 0.01),
     (4.0, ":fallback=crossfade", {"faded_below": 19.2}, ":fallback=none", 0.1)],
)  # fmt: skip
def test_what_the_views_contradict_is_what_the_product_makes_of_it(hall, factor, parameter, options, plain, change):
    """With wrong depth the views contradict each other, and if it is far wrong, their confidence is low."""
    views = misled(hall.views[0], factor), hall.views[1]
    found = images(f"oracle-depth{parameter}", hall, *views)
    np.testing.assert_array_equal(found, of_product(hall, views, **options))
    assert np.abs(found - images(f"oracle-depth{plain}", hall, *views)).max() > change


def test_what_moves_with_the_camera_is_not_seen_if_it_is_left_out(hall):
    capped = []
    for view in hall.views:
        image = view.image.copy()
        image[-len(image) // 10 :] = (1.0, 0.0, 1.0)
        capped.append(replace(view, image=image))
    kept, left_out = (images(f"oracle-depth{each}", hall, *capped) for each in ("", ":nadir=auto"))
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
    plain = images("omnisyn-fast:model=none:descriptors=none:fusion=geometric", hall)
    assert np.isfinite(plain).all()
    assert plain.std() > 0.05
    assert find_method("omnisyn-balanced:model=none:prior=none:descriptors=none:fusion=geometric").config.networks == ()
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
