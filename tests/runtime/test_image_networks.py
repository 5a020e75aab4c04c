from types import SimpleNamespace

import numpy as np
import pytest

from omnisyn_cli.errors import InputError
from omnisyn_cli.runtime.image_networks import (
    CompletionSession,
    FusionSession,
    GuidedDepthSession,
)
from omnisyn_cli.runtime.session import open_model


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
    np.testing.assert_array_equal(FusionSession(Session([shares]), "shares")(PLANES), shares[0])


@pytest.mark.parametrize("names", [{"inputs": ("first", "second")}, {"outputs": ("colour",)}])
def test_other_models_are_refused(names):
    with pytest.raises(InputError, match="expected a model with the input"):
        FusionSession(Session([], **names), "shares")


@pytest.mark.parametrize(
    ("answers", "complaint"),
    [
        ([np.zeros((1, 1, 32, 64))], "outputs of"),
        ([np.full((1, 4, 32, 64), np.nan)], "finite"),
    ],
)
def test_broken_answers_are_refused(answers, complaint):
    with pytest.raises(InputError, match=complaint):
        FusionSession(Session(answers), "shares")(PLANES)


def test_a_painter_gives_its_picture_and_other_models_are_none():
    picture = np.random.default_rng(0).random((1, 3, 32, 64))
    found = FusionSession(Session([picture], outputs=("colour",)), "colour")(PLANES[:8])
    np.testing.assert_array_equal(found, picture[0].astype(np.float32))
    with pytest.raises(InputError, match="the outputs 'colour', got"):
        FusionSession(Session([]), "colour")
    with pytest.raises(InputError, match="outputs of"):
        FusionSession(Session([picture[:, :1]], outputs=("colour",)), "colour")(PLANES[:8])


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

    found = CompletionSession(Echo([], outputs=("inverse_depth", "confidence")))(planes)
    np.testing.assert_array_equal(found, planes[:2])
    with pytest.raises(InputError, match="a completion model with the input 'planes'"):
        CompletionSession(Session([], inputs=("first", "second")))


def test_a_guided_depth_network_is_asked_without_guidance_and_answers_in_the_unit_of_the_way() -> None:
    """A plain grey room says nothing about parallax: whatever the way is called, the network guesses alike."""
    ask = GuidedDepthSession(lambda: open_model("depth-guided", threads=1, keeps_memory=False))
    grey = np.full((3, 256, 512), 0.5, np.float32)
    short, long = (ask(grey, grey, np.array([0.0, 0.0, -length])) for length in (1.0, 2.25))
    for inverse_depth, confidence in (short, long):
        assert inverse_depth.shape == confidence.shape == (256, 512)
        assert inverse_depth.min() >= 0.0
        assert 0.0 <= confidence.min() <= confidence.max() <= 1.0
    assert np.median(long[0] / short[0]) == pytest.approx(1.0, abs=0.2)
    with pytest.raises(InputError, match="a guided depth model with the inputs 'first'"):
        GuidedDepthSession(lambda: Session([]))(grey, grey, np.array([0.0, 0.0, -1.0]))
