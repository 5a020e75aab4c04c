import numpy as np
import pytest
import torch

from omnisyn_cli.errors import InputError
from omnisyn_cli.networks.silhouettes import ROOT_PLANE, SilhouetteConfig, SilhouettePrediction
from omnisyn_cli.runtime.models import read_manifest
from omnisyn_cli.stereo.silhouettes import EAST_PLANE
from omnisyn_cli.training.data import list_pool, load_samples
from omnisyn_cli.training.loop import TrainConfig, load_network, train
from omnisyn_cli.training.losses import silhouette_loss, silhouette_scores
from omnisyn_cli.training.publish import publish
from omnisyn_cli.training.silhouette_pool import (
    SilhouettePoolConfig,
    SilhouetteSample,
    draw_silhouettes,
    make_silhouettes,
    stored_silhouettes,
)

SIZE = (64, 128)
TINY = SilhouetteConfig("tiny", planes=27, widths=(8, 12), fine=6)


@pytest.fixture(scope="module")
def pool(tmp_path_factory):
    """A few small scenes."""
    folder = tmp_path_factory.mktemp("silhouettes")
    paths = [make_silhouettes(folder, seed, SilhouettePoolConfig(size=SIZE)) for seed in range(3)]
    return [path for path in paths if path is not None]


def test_a_scene_holds_the_truth_beside_what_was_estimated(pool):
    """The estimate is far nearer to the truth there than to that half a turn away."""
    own, elsewhere = [], []
    for path in pool:
        samples = load_samples(path, SilhouetteSample)
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
    one, same = (draw_silhouettes(pool, np.random.default_rng(3), 12) for _ in range(2))
    assert torch.equal(one.planes, same.planes)
    assert one.planes.shape == (12, 27, SIZE[0], SIZE[1] // 4)
    stored = [sample for path in pool for sample in load_samples(path, SilhouetteSample)]
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


def choice(right, logits):
    """An answer of three roots, of which the second is ``right`` everywhere."""
    roots = torch.stack([right + 0.2, right, right + 0.4], dim=1)
    picked = torch.tensor(logits).view(1, 3, 1, 1).expand_as(roots)
    return SilhouettePrediction(picked, roots, torch.zeros_like(right)[:, None])


def test_the_loss_prefers_the_choice_that_is_right_and_tells_nothing_where_the_truth_is_unknown():
    truth = torch.rand((1, 32, 64), generator=torch.Generator().manual_seed(0))
    first, right, last = (
        silhouette_loss(choice(truth, logits), truth[:, None]) for logits in ([4.0, 0, 0], [0, 4.0, 0], [0, 0, 4.0])
    )
    assert right < 0.2 < first < last
    unknown = truth[:, None].clone()
    unknown[..., :32] = torch.nan
    plain, worse = choice(truth, [0, 4.0, 0]), choice(truth, [0, 4.0, 0])
    worse.roots[..., :32] += 0.5
    torch.testing.assert_close(silhouette_loss(worse, unknown), silhouette_loss(plain, unknown))


def test_scores_say_what_is_gained_beside_silhouettes():
    truth = torch.full((1, 32, 64), 0.3)
    truth[..., 20:40] = 0.8
    planes = torch.zeros((1, 27, 32, 64))
    planes[:, ROOT_PLANE] = truth + 0.2
    scores = silhouette_scores(choice(truth, [0, 4.0, 0]), planes, truth[:, None])
    assert scores["misplaced"] < 1e-3 < 0.8 < scores["misplaced_before"]
    assert scores["within_5"] == 1.0
    assert scores["within_5_before"] == 0.0
    assert scores["moved"] == 1.0
    assert scores["confidence_error"] == pytest.approx(0.5)


def test_a_network_learns_from_the_pool_and_is_exported(pool, tmp_path):
    folder = str(pool[0].parent)
    stage = TrainConfig(folder, folder, size=SIZE, batch=2, rate=3e-3, warmup_steps=5, validate_every=60, ema=0.9)
    rows = []
    trainer = train(TINY, stage, tmp_path / "run", steps=180, report=rows.append)
    assert trainer.step == 180
    assert rows[-1]["loss"] < rows[0]["loss"]
    assert rows[-1]["confidence_error"] < 0.5
    network, state = load_network(tmp_path / "run" / "checkpoint.pt")
    assert state["kind"] == "silhouettes"
    with torch.no_grad():
        answer = network(stored_silhouettes(pool[0], 0).planes)
    assert answer.root().shape == (1, 1, *SIZE)
    publish(tmp_path / "run" / "checkpoint.pt", tmp_path / "models", pool=pool[0].parent)
    assert read_manifest(tmp_path / "models")["silhouettes-tiny"].role == "silhouettes"


def test_pools_of_other_networks_are_refused(pool):
    with pytest.raises(InputError, match="scenes for another network"):
        list_pool(pool[0].parent, "pool", "evidence")
    assert list_pool(pool[0].parent, "silhouette-pool") == sorted(pool)
