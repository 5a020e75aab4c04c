"""SynSin's frames with true depth and with small networks; then where users meet it: plans, eval, batches."""

import gc
import json
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cli.cli_samples import pair_arguments
from interpolation_samples import CHAIN, job_of
from omnisyn_cli.baselines.synsin import MonocularDepthEstimator, SynSin, SynSinSessions
from omnisyn_cli.batch.manifest import read_manifest
from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.errors import ImageError, InputError
from omnisyn_cli.evaluation.methods import MethodAtWork, find_method
from omnisyn_cli.geometry.pose import Pose, interpolate_pose
from omnisyn_cli.interpolation.configs import video_config
from omnisyn_cli.interpolation.plan import plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import read_panorama
from omnisyn_cli.pipeline.methods import SYNSIN_MODELS, open_synsin
from omnisyn_cli.runtime import models
from omnisyn_cli.runtime.session import open_session
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import View
from synsin_samples import TINY_SIZE, HallNetworks, write_synsin_models
from synthesis_samples import SIZE, hall_image, hall_view, posed, write_hall, ws_psnr

FIRST, SECOND = posed((0.0, 0.1, 0.8), 2.0, 0.2), posed((0.3, 0.0, -0.8), -1.0, 0.0, 0.3)
BETWEEN = posed((0.1, 0.05, 0.1), 0.7, -0.1, 0.1)
OPTIONS = SynthesisOptions(SIZE, threads=1)


def frames(sources: int, path: list[Waypoint], order: tuple[Pose, ...], views=None) -> list:
    networks = HallNetworks([pose.position for pose in order])
    views = views or [hall_view(FIRST), hall_view(SECOND)]
    return list(synthesize(views, path, SynSin(networks, sources, OPTIONS)))


@pytest.mark.parametrize(
    ("sources", "t", "order"), [(1, 0.4, (FIRST,)), (1, 0.6, (SECOND,)), (2, 0.5, (FIRST, SECOND))]
)
def test_a_frame_shows_the_hall_from_its_place(sources, t, order):
    """Cameras are pitched and rolled; a forgotten turn of any of the three would be seen."""
    (frame,) = frames(sources, [Waypoint(0, t, BETWEEN)], order)
    assert frame.panorama is None
    assert ws_psnr(frame.image, hall_image(BETWEEN, SIZE)) > 27
    assert ws_psnr(frame.image, hall_image(posed((0.1, 0.05, 0.4), 0.7, -0.1, 0.1), SIZE)) < 27


def test_one_source_is_the_nearer_panorama_and_each_is_looked_at_once():
    networks = HallNetworks([FIRST.position, SECOND.position])
    pair = SynSin(networks, 1, OPTIONS).prepare(0, [hall_view(FIRST), hall_view(SECOND)])
    for seen, t in ((1, 0.1), (1, 0.2), (1, 0.49), (2, 0.5), (2, 0.9)):
        pair.frame(Waypoint(0, t, BETWEEN))
        assert networks.looked_at == seen


def test_views_are_let_go_of_with_the_frames():
    view, networks = hall_view(FIRST), HallNetworks([FIRST.position, SECOND.position])
    held = weakref.ref(view)
    gc.disable()
    try:
        method = SynSin(networks, 2, OPTIONS)
        list(synthesize([view, hall_view(SECOND)], [Waypoint(0, 0.5, BETWEEN)], method))
        del view
        assert held() is None
    finally:
        gc.enable()


def test_where_a_panorama_was_taken_it_is_shown():
    first, last = frames(1, [Waypoint(0, 0.0, FIRST), Waypoint(0, 1.0, SECOND)], ())
    assert (first.panorama, last.panorama) == (0, 1)
    np.testing.assert_array_equal(last.image, hall_image(SECOND, SIZE))


def test_masked_pixels_are_no_points():
    """Half of the first panorama is masked and shows nonsense: it is not seen, what the other half shows is."""
    mask = np.ones(SIZE, bool)
    mask[:, :64] = False
    image = np.where(mask[..., None], hall_image(FIRST, SIZE), 5.0).astype(np.float32)
    (frame,) = frames(1, [Waypoint(0, 0.1, FIRST)], (FIRST,), [View(image, FIRST, mask), hall_view(SECOND)])
    shown = frame.image[:, 68:124]
    assert np.abs(shown - hall_image(FIRST, SIZE)[:, 68:124]).mean() < 0.03
    assert frame.image[:, 8:56].mean() < 0.3


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_synsin_models(tmp_path_factory.mktemp("models"))


@pytest.fixture
def installed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> SynSinSessions:
    monkeypatch.setattr(models, "models_folder", lambda: folder)
    return open_synsin(device="cpu", threads=1)


def test_installed_networks_make_frames_of_any_size(installed):
    options = SynthesisOptions((48, 96), threads=1)
    assert (installed.size, installed.radius, installed.points) == (TINY_SIZE, 2.0, 8)
    for sources in (1, 2):
        pair = SynSin(installed, sources, options).prepare(0, [hall_view(FIRST), hall_view(SECOND)])
        frame = pair.frame(Waypoint(0, 0.5, BETWEEN))
        assert frame.image.shape == (48, 96, 3)
        assert frame.image.dtype == np.float32
        assert 0.0 <= frame.image.min() <= frame.image.max() <= 1.0


def test_monocular_depth_does_not_depend_on_the_other_panorama_or_how_a_camera_is_held(installed):
    estimator = installed.estimator
    level = hall_view(posed((0.0, 0.1, 0.8)), (128, 256))
    one, other = estimator(level, hall_view(SECOND))
    again, _ = estimator(level, hall_view(BETWEEN))
    np.testing.assert_array_equal(one.inverse_depth, again.inverse_depth)
    assert one.inverse_depth.shape == other.confidence.shape == TINY_SIZE
    assert (one.confidence == 1).all()
    turned = hall_view(posed((0.0, 0.1, 0.8), np.pi), (128, 256))
    rolled = np.roll(one.inverse_depth, 32, axis=1)
    np.testing.assert_allclose(estimator(turned, level)[0].inverse_depth, rolled, rtol=0.02, atol=2e-3)


def test_a_mask_is_no_confidence_and_other_shapes_are_refused(installed):
    mask = np.ones(SIZE, bool)
    mask[32:] = False
    found, _ = installed.estimator(hall_view(FIRST, SIZE, mask), hall_view(SECOND))
    assert (found.confidence[:16] == 1).all()
    assert (found.confidence[16:] == 0).all()
    with pytest.raises(ImageError, match="twice as wide as high"):
        installed.estimator(View(np.zeros((8, 8, 3), np.float32), FIRST), hall_view(SECOND))


def test_networks_of_other_kinds_are_refused(folder):
    depth, encoder = (open_session(folder / f"synsin-{part}.onnx") for part in ("depth", "encoder"))
    with pytest.raises(InputError, match="output 'inverse_depth'"):
        MonocularDepthEstimator(encoder)
    with pytest.raises(InputError, match="input 'points'"):
        SynSinSessions(depth, encoder, encoder)


def test_networks_that_are_not_installed_are_named(tmp_path, monkeypatch):
    monkeypatch.setattr(models, "models_folder", lambda: tmp_path)
    with pytest.raises(InputError, match="'synsin-depth'"):
        open_synsin()


@pytest.fixture(autouse=True)
def _installed(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(models, "models_folder", lambda: folder)


@pytest.mark.parametrize("method", ["synsin", "synsin-2view"])
def test_a_clip_begins_and_ends_with_the_photographs(tmp_path: Path, method: str) -> None:
    images = write_hall(tmp_path, CHAIN)
    plan = plan_interpolation(job_of(tmp_path, images, method=method, frames=5))
    summary = run_interpolation(plan).describe()
    assert (summary["method"], summary["confidence"], summary["depth"]) == (method, None, "monocular")
    assert summary["model"] == ", ".join(SYNSIN_MODELS)
    assert summary["triangles"] == []
    made = [read_panorama(path).original for path in sorted((tmp_path / "out").iterdir())]
    for frame, photograph in zip(made[::2], images, strict=True):
        np.testing.assert_array_equal(frame, read_panorama(photograph).original)
    assert made[1].shape == (*SIZE, 3)
    assert made[1].std() > 1


def test_pictures_from_one_panorama_and_from_two_differ(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2])
    shown = []
    for method in ("synsin", "synsin-2view"):
        plan = plan_interpolation(job_of(tmp_path, images, method=method, output=tmp_path / method))
        run_interpolation(plan)
        shown.append(read_panorama(sorted((tmp_path / method).iterdir())[1]).image)
    assert np.abs(shown[0] - shown[1]).mean() > 1e-3


@pytest.mark.parametrize(
    ("changes", "option"),
    [
        ({"preset": "fast"}, "preset"), ({"depth": "matching"}, "depth"), ({"model": "completion-balanced"}, "model"),
        ({"renderer": "two-pass"}, "renderer"), ({"cut": 0.1}, "cut"), ({"fusion": "network"}, "fusion"),
        ({"adaptive": True}, "adaptive"), ({"fallback": "crossfade"}, "fallback"),
        ({"save_depth": Path("depth")}, "save-depth"), ({"save_confidence": Path("confidence.mp4")}, "save-confidence"),
    ],
)  # fmt: skip
def test_what_means_nothing_to_synsin_is_refused(tmp_path: Path, changes: dict[str, object], option: str) -> None:
    job = job_of(tmp_path, write_hall(tmp_path, CHAIN[:2]), method="synsin", **changes)
    with pytest.raises(InputError, match=f"expected no {option} with the method synsin"):
        plan_interpolation(job)


def test_an_unknown_method_is_refused_and_missing_networks_are_named(tmp_path, monkeypatch) -> None:
    job = job_of(tmp_path, write_hall(tmp_path, CHAIN[:2]), method="synsin")
    with pytest.raises(InputError, match="as method, got 'magic'"):
        plan_interpolation(replace(job, method="magic"))
    assert video_config(job, ()).networks == SYNSIN_MODELS
    monkeypatch.setattr(models, "models_folder", lambda: tmp_path)
    with pytest.raises(InputError, match="'synsin-depth'"):
        plan_interpolation(job)


def test_a_dry_run_tells_the_plan_and_a_budget_is_refused(tmp_path: Path, omnisyn) -> None:
    words = pair_arguments(tmp_path, write_hall(tmp_path, CHAIN[:2]), "a.mp4", "--method")
    plan = omnisyn.json(*words, "synsin-2view", "--dry-run")
    assert (plan["method"], plan["preset"], plan["renderer"]) == ("synsin-2view", "", "soft points")
    assert "enlarges" in plan["notes"][0]
    assert not (tmp_path / "a.mp4").exists()
    assert "--budget only with --method omnisyn" in omnisyn.misused(*words, "synsin", "--budget", "10")


def test_monocular_depth_is_a_source_like_others(tmp_path: Path) -> None:
    job = job_of(tmp_path, write_hall(tmp_path, CHAIN[:2]), depth="monocular", save_depth=tmp_path / "depth")
    plan = plan_interpolation(job)
    assert (plan.config.depth.kind, plan.config.depth.model) == ("monocular", "synsin-depth")
    run_interpolation(plan)
    assert len(list((tmp_path / "depth").iterdir())) == 2


@pytest.mark.parametrize("name", ["synsin", "synsin-2view", "monocular"])
def test_methods_that_are_compared_make_pictures_and_tell_depth(name: str) -> None:
    views = hall_view(CHAIN[0]), hall_view(CHAIN[1])
    made = MethodAtWork(find_method(name), views, threads=1)(SIZE, Stopwatch())
    picture = made.frame(Waypoint(0, 0.5, interpolate_pose(CHAIN[0], CHAIN[1], 0.5)))
    assert picture.image.shape == (*SIZE, 3)
    assert np.isfinite(picture.image).all()
    assert made.depths[0].inverse_depth.shape == TINY_SIZE


@pytest.mark.parametrize("name", ["synsin", "synsin-2view", "monocular"])
def test_results_depend_on_the_networks_that_are_installed(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = find_method(name).ingredients()
    known = models.read_manifest()
    changed = {key: replace(entry, sha256="0") for key, entry in known.items()}
    monkeypatch.setattr("omnisyn_cli.evaluation.methods.read_manifest", lambda: changed)
    assert find_method(name).ingredients() != before


def test_a_line_of_a_batch_can_ask_for_it(tmp_path: Path) -> None:
    write_hall(tmp_path, CHAIN[:2])
    line = {"id": "a", "inputs": ["p0.png", "p1.png"], "poses": "poses.json", "method": "synsin"}
    (tmp_path / "jobs.jsonl").write_text(json.dumps(line) + "\n" + json.dumps({**line, "id": "b", "method": "magic"}))
    manifest = read_manifest(tmp_path / "jobs.jsonl")
    assert ["line 2" in problem and "method" in problem for problem in manifest.problems] == [True]
    (tmp_path / "jobs.jsonl").write_text(json.dumps(line))
    (job,) = read_manifest(tmp_path / "jobs.jsonl").jobs
    assert job.interpolation(tmp_path).method == "synsin"
