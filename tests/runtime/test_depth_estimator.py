"""The estimator around a network: here an oracle that knows the scene stands in for it."""

from types import SimpleNamespace

import numpy as np
import pytest

from ball_samples import FIRST, SECOND, SIZE, ball
from omnisyn_cli.baselines.learned_depth import LearnedDepthEstimator
from omnisyn_cli.errors import ImageError, InputError
from omnisyn_cli.geometry import sweep
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.runtime import image_networks
from omnisyn_cli.runtime.session import open_model, open_session
from omnisyn_cli.types import View


class Oracle:
    """Answers with the truth of the pair and remembers the images it was shown."""

    def __init__(self, first, second):
        here, other, baseline = sweep.forward_frame(first, second)
        self.truth = [ball(here)[0] * baseline, sweep.swap_cameras_in_forward_frame(ball(other)[0]) * baseline]
        self.seen = []

    def get_modelmeta(self):
        return SimpleNamespace(custom_metadata_map={"frame": "forward"})

    def get_inputs(self):
        return [SimpleNamespace(name=name, shape=[1, 3, *SIZE]) for name in ("first", "second")]

    def run(self, _, images):
        self.seen.append((images["first"], images["second"]))
        answer = self.truth[len(self.seen) - 1].astype(np.float32)[None, None]
        return [answer, np.ones_like(answer)]


def view(pose, mask=None, size=SIZE):
    return View(ball(pose, size)[1].astype(np.float32), pose, mask)


@pytest.mark.parametrize("size", [SIZE, (128, 256), (32, 64)])
def test_the_network_is_shown_its_frame_and_its_answer_comes_back_in_metres(size):
    oracle = Oracle(FIRST, SECOND)
    estimates = LearnedDepthEstimator(oracle)(view(FIRST, size=size), view(SECOND, size=size))
    here, other, _ = sweep.forward_frame(FIRST, SECOND)
    expected = [ball(pose)[1] for pose in (here, other)]
    for shown, truth in zip(oracle.seen[0], expected, strict=True):
        assert np.abs(shown[0].transpose(1, 2, 0) - truth).max() < 0.03
    for shown, truth in zip(oracle.seen[1], expected[::-1], strict=True):
        assert np.abs(sweep.swap_cameras_in_forward_frame(shown[0].transpose(1, 2, 0)) - truth).max() < 0.03
    for estimate, pose in zip(estimates, (FIRST, SECOND), strict=True):
        np.testing.assert_allclose(estimate.inverse_depth, ball(pose)[0], rtol=0.02)
        assert estimate.confidence.min() > 0.95
        assert estimate.inverse_depth.dtype == estimate.confidence.dtype == np.float32


@pytest.mark.parametrize("name", ["epipole_frame", "forward_frame"])
def test_exchanging_the_roles_is_the_frame_of_the_way_back(name):
    hold, exchange = getattr(sweep, name), getattr(sweep, f"swap_cameras_in_{name}")
    there, back = hold(FIRST, SECOND)[0], hold(SECOND, FIRST)[1]
    np.testing.assert_allclose(exchange(ball(there)[1]), ball(back)[1], atol=1e-9)
    np.testing.assert_array_equal(exchange(exchange(ball(there)[1])), ball(there)[1])


def test_exchanging_the_views_exchanges_the_answers():
    one, two = LearnedDepthEstimator(Oracle(FIRST, SECOND))(view(FIRST), view(SECOND))
    second, first = LearnedDepthEstimator(Oracle(SECOND, FIRST))(view(SECOND), view(FIRST))
    np.testing.assert_allclose(first.inverse_depth, one.inverse_depth, rtol=0.02)
    np.testing.assert_allclose(second.inverse_depth, two.inverse_depth, rtol=0.02)


def test_masked_pixels_have_no_confidence():
    mask = np.ones((128, 256), bool)
    mask[:, :128] = False
    first, second = LearnedDepthEstimator(Oracle(FIRST, SECOND))(view(FIRST, mask), view(SECOND))
    assert np.all(first.confidence[:, :64] == 0)
    assert first.confidence[:, 64:].min() > 0.5
    assert second.confidence.min() > 0.5


def test_equal_positions_say_nothing():
    turned = Pose(SECOND.rotation, FIRST.position)
    for estimate in LearnedDepthEstimator(Oracle(FIRST, SECOND))(view(FIRST), view(turned)):
        assert not estimate.inverse_depth.any()
        assert not estimate.confidence.any()


def test_panoramas_that_are_not_two_to_one_are_refused():
    with pytest.raises(ImageError, match="64×64"):
        LearnedDepthEstimator(Oracle(FIRST, SECOND))(View(np.zeros((64, 64, 3)), FIRST), view(SECOND))


def test_who_looks_through_a_surface_contradicts_it_and_who_is_blocked_does_not():
    frame, other, baseline = sweep.epipole_frame(FIRST, SECOND)
    there, back = ball(frame)[0] * baseline, ball(other)[0] * baseline
    up = Pose(np.eye(3), np.array([0.0, -1.0, 0.0]))
    assert sweep.free_space_agreement(there, back, up).min() > 0.9
    assert sweep.free_space_agreement(there, 2 * back, up).min() > 0.9  # something nearer hides it
    assert sweep.free_space_agreement(there, 0.5 * back, up).max() < 0.1
    assert sweep.free_space_agreement(0 * there, 0 * back, up).min() == 1  # both see the sky


def test_what_agrees_amid_what_does_not_counts_less():
    frame, other, baseline = sweep.epipole_frame(FIRST, SECOND)
    there, back = ball(frame)[0] * baseline, ball(other)[0] * baseline
    up = Pose(np.eye(3), np.array([0.0, -1.0, 0.0]))
    assert sweep.neighbourhood_agreement(there, 2 * back, up) == pytest.approx(2 / 3, abs=0.01)  # hidden: not confirmed
    usual = sweep.neighbourhood_agreement(there, back, up)
    there[30, [0, 2]] *= 4.0  # beside column 1, which is as it was, and over the seam from column 127
    doubted = sweep.neighbourhood_agreement(there, back, up)
    assert (doubted[30, [1, 127]] < 0.8 * usual[30, [1, 127]]).all()
    assert doubted[:, 10:120] == pytest.approx(usual[:, 10:120])


def test_devices_and_files_that_are_not_there_are_refused(tmp_path):
    with pytest.raises(InputError, match="abacus"):
        open_session(tmp_path / "model.onnx", device="abacus")
    (tmp_path / "model.onnx").write_bytes(b"no model")
    with pytest.raises(InputError, match="ONNX Runtime says"):
        open_session(tmp_path / "model.onnx", device="cpu")


class Session:
    """Answers with what it is given; says what it takes and gives as ONNX Runtime does."""

    def __init__(self, answers, inputs=("planes",), outputs=("shares",)):
        self.answers, self.inputs, self.outputs = answers, inputs, outputs

    def get_inputs(self):
        return [SimpleNamespace(name=name, shape=(1, 1)) for name in self.inputs]

    def get_outputs(self):
        return [SimpleNamespace(name=name) for name in self.outputs]

    def run(self, _, inputs):
        assert inputs["planes"].shape in ((1, 52, 32, 64), (1, 19, 32, 64), (1, 8, 32, 64))
        return self.answers


PLANES = np.zeros((52, 32, 64), np.float32)


def test_answers_lose_their_batch():
    shares = np.arange(8192.0).reshape(1, 4, 32, 64)
    np.testing.assert_array_equal(image_networks.FusionSession(Session([shares]), "shares")(PLANES), shares[0])


@pytest.mark.parametrize(
    ("session", "output", "complaint"),
    [
        (Session([], inputs=("first", "second")), "shares", "expected a model with the input"),
        (Session([], outputs=("colour",)), "shares", "expected a model with the input"),
        (Session([]), "colour", "the outputs 'colour', got"),
        (Session([np.zeros((1, 1, 32, 64))]), "shares", "outputs of"),
        (Session([np.zeros((1, 1, 32, 64))], outputs=("colour",)), "colour", "outputs of"),
        (Session([np.full((1, 4, 32, 64), np.nan)]), "shares", "finite"),
    ],
)
def test_other_models_and_broken_answers_are_refused(session, output, complaint):
    with pytest.raises(InputError, match=complaint):
        image_networks.FusionSession(session, output)(PLANES)


def test_a_painter_gives_its_picture():
    picture = np.random.default_rng(0).random((1, 3, 32, 64))
    found = image_networks.FusionSession(Session([picture], outputs=("colour",)), "colour")(PLANES[:8])
    np.testing.assert_array_equal(found, picture[0].astype(np.float32))


def test_evidence_is_padded_to_what_the_network_takes_and_answers_are_cut_again():
    """Over the seam, and on beyond the last row."""
    planes = np.random.default_rng(0).random((19, 30, 60), dtype=np.float32)

    class Echo(Session):
        def run(self, names, inputs):
            super().run(names, inputs)
            given = inputs["planes"][0]
            np.testing.assert_array_equal(given[:, :30, 60:], planes[..., :4])
            np.testing.assert_array_equal(given[:, 30:, :60], np.repeat(planes[:, -1:], 2, axis=1))
            return [given[None, :1], given[None, 1:2]]

    found = image_networks.CompletionSession(Echo([], outputs=("inverse_depth", "confidence")))(planes)
    np.testing.assert_array_equal(found, planes[:2])
    with pytest.raises(InputError, match="a completion model with the input 'planes'"):
        image_networks.CompletionSession(Session([], inputs=("first", "second")))


def test_a_guided_depth_network_answers_in_the_unit_of_the_way() -> None:
    """A plain grey room says nothing about parallax: whatever the way is called, the network guesses alike."""
    ask = image_networks.GuidedDepthSession(lambda: open_model("depth-guided", threads=1, keeps_memory=False))
    grey = np.full((3, 256, 512), 0.5, np.float32)
    short, long = (ask(grey, grey, np.array([0.0, 0.0, -length])) for length in (1.0, 2.25))
    for inverse_depth, confidence in (short, long):
        assert inverse_depth.shape == confidence.shape == (256, 512)
        assert inverse_depth.min() >= 0.0
        assert 0.0 <= confidence.min() <= confidence.max() <= 1.0
    assert np.median(long[0] / short[0]) == pytest.approx(1.0, abs=0.2)
    with pytest.raises(InputError, match="a guided depth model with the inputs 'first'"):
        image_networks.GuidedDepthSession(lambda: Session([]))(grey, grey, np.array([0.0, 0.0, -1.0]))
