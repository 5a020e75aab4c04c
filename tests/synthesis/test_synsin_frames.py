"""SynSin's frames: where things are seen with true depth, however the cameras are held; and small real networks."""

import gc
import weakref
from pathlib import Path

import numpy as np
import pytest

from omnisyn_cli.baselines.synsin import MonocularDepthEstimator, SynSin, SynSinSessions
from omnisyn_cli.errors import ImageError, InputError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.pipeline.methods import open_synsin
from omnisyn_cli.runtime import models
from omnisyn_cli.runtime.session import open_session
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import View
from synsin_samples import TINY_SIZE, HallNetworks, write_synsin_models
from synthesis_samples import hall_image, hall_view, posed, ws_psnr

SIZE = (64, 128)
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


def test_other_numbers_of_panoramas_are_refused():
    with pytest.raises(InputError, match="1 or 2 panoramas"):
        SynSin(HallNetworks([]), 3, OPTIONS)


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
