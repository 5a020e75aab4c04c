import numpy as np
import pytest
import torch

from omnisyn_cli.errors import InputError
from omnisyn_cli.networks.doubt import CONFIDENCE_PLANE, FACTORS, ROOT_PLANE, DoubtConfig
from omnisyn_cli.runtime.models import read_manifest
from omnisyn_cli.stereo.doubt import EAST_PLANE
from omnisyn_cli.training.data import list_pool, load_samples
from omnisyn_cli.training.doubt_pool import (
    DoubtPoolConfig,
    DoubtSample,
    draw_doubt,
    make_doubt,
    stored_doubt,
)
from omnisyn_cli.training.loop import TrainConfig, load_network, train
from omnisyn_cli.training.losses import doubt_loss, doubt_scores
from omnisyn_cli.training.publish import publish

SIZE = (64, 128)
TINY = DoubtConfig("tiny", planes=27, widths=(8, 12), fine=6)


@pytest.fixture(scope="module")
def pool(tmp_path_factory):
    """A few small scenes."""
    folder = tmp_path_factory.mktemp("doubt")
    paths = [make_doubt(folder, seed, DoubtPoolConfig(size=SIZE)) for seed in range(3)]
    return [path for path in paths if path is not None]


def test_a_scene_holds_the_truth_beside_what_was_estimated(pool):
    """The estimate is far nearer to the truth there than to that half a turn away."""
    own, elsewhere = [], []
    for path in pool:
        samples = load_samples(path, DoubtSample)
        assert len(samples) == 2
        assert samples[0].metres == samples[1].metres > 0.05
        for sample in samples:
            assert sample.planes.shape == (27, *SIZE)
            assert sample.edges.shape == SIZE
            assert np.isfinite(sample.planes).all()
            for turn, errors in ((0, own), (SIZE[0], elsewhere)):
                errors.append(np.abs(sample.planes[ROOT_PLANE] - np.roll(sample.edges, turn, axis=1)).mean())
    assert np.mean(own) < 0.7 * np.mean(elsewhere)


def test_windows_are_parts_of_what_is_stored_mirrored_or_not(pool):
    one, same = (draw_doubt(pool, np.random.default_rng(3), 12) for _ in range(2))
    assert torch.equal(one.planes, same.planes)
    assert one.planes.shape == (12, 27, SIZE[0], SIZE[1] // 4)
    stored = [sample for path in pool for sample in load_samples(path, DoubtSample)]
    turned = []
    for planes, root in zip(one.planes.numpy(), one.root.numpy(), strict=True):
        found = [
            flip
            for sample in stored
            for begin in range(SIZE[1])
            for flip in (1, -1)
            if np.array_equal(root[0, :, ::flip], np.roll(sample.edges, -begin, axis=1)[:, : SIZE[1] // 4])
            and np.array_equal(
                flip * planes[EAST_PLANE, :, ::flip],
                np.roll(sample.planes[EAST_PLANE], -begin, axis=1)[:, : SIZE[1] // 4],
            )
        ]
        assert len(found) == 1
        turned += found
    assert set(turned) == {1, -1}


def told(right, off):
    """Planes with a map that is ``off`` times too near in the right half, and the logits of somebody who knows that."""
    planes = torch.zeros((1, 27, *right.shape[-2:]))
    factor = torch.ones_like(right)
    factor[..., right.shape[-1] // 2 :] = off
    planes[:, ROOT_PLANE], planes[:, CONFIDENCE_PLANE] = (right * factor).sqrt(), 0.5
    logits = torch.stack([torch.where(factor < bound, 8.0, -8.0) for bound in FACTORS], dim=1)
    return planes, logits


@pytest.mark.parametrize("off", [1.01, 1.03, 1.07, 1.2, 2.0])
def test_the_loss_prefers_who_knows_and_tells_nothing_where_the_truth_is_unknown(off):
    truth = 0.2 + torch.rand((1, 32, 64), generator=torch.Generator().manual_seed(0))
    planes, logits = told(truth, off)
    target = truth.sqrt()[:, None]
    right, doubtful, wrong = (doubt_loss(sign * logits, planes, target) for sign in (1.0, 0.0, -1.0))
    assert right < 0.01 < doubtful < 1.0 < wrong
    unknown = target.clone()
    unknown[..., :32] = torch.nan
    worse = logits.clone()
    worse[..., :32] = -8.0
    torch.testing.assert_close(doubt_loss(worse, planes, unknown), doubt_loss(logits, planes, unknown))


def test_scores_say_what_is_known_beyond_the_confidence_that_was_shown():
    truth = torch.full((1, 32, 64), 0.3)
    planes, logits = told(truth, 1.5)
    scores = doubt_scores(logits, planes, truth.sqrt()[:, None])
    assert scores["surprise"] < 0.01
    assert scores["surprise_before"] == pytest.approx(np.log(2.0), abs=1e-4)
    assert scores["error"] < 0.01
    assert scores["error_before"] == pytest.approx(0.5, abs=1e-4)


def test_a_network_learns_from_the_pool_and_is_exported(pool, tmp_path):
    folder = str(pool[0].parent)
    stage = TrainConfig(folder, folder, size=SIZE, batch=2, rate=3e-3, warmup_steps=5, validate_every=60, ema=0.9)
    rows = []
    trainer = train(TINY, stage, tmp_path / "run", steps=180, report=rows.append)
    assert trainer.step == 180
    assert rows[-1]["loss"] < rows[0]["loss"]
    assert rows[-1]["surprise"] < np.log(2.0)
    network, state = load_network(tmp_path / "run" / "checkpoint.pt")
    assert state["kind"] == "doubt"
    with torch.no_grad():
        answer = network(stored_doubt(pool[0], 0).planes)
    assert answer.shape == (1, len(FACTORS), *SIZE)
    publish(tmp_path / "run" / "checkpoint.pt", tmp_path / "models", pool=pool[0].parent)
    assert read_manifest(tmp_path / "models")["doubt-tiny"].role == "doubt"


def test_pools_of_other_networks_are_refused(pool):
    with pytest.raises(InputError, match="scenes for another network"):
        list_pool(pool[0].parent, "pool", "evidence")
    assert list_pool(pool[0].parent, "doubt-pool") == sorted(pool)
