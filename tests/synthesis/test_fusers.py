"""Fusion by name, from the library to the files."""

import dataclasses

import numpy as np
import pytest
import torch
from click.testing import CliRunner

from omnisyn_cli.cli.interpolate import interpolate
from omnisyn_cli.cli.train import train
from omnisyn_cli.errors import InputError
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.fusion.input_channels import INPUT_CHANNELS
from omnisyn_cli.fusion.residual import ResidualFuser
from omnisyn_cli.fusion.warp_candidates import CANDIDATE_CHANNELS
from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.plan import plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import read_panorama
from omnisyn_cli.networks.export import export_network
from omnisyn_cli.networks.fusion import FusionConfig, ResidualFusionUNet
from omnisyn_cli.pipeline.fusions import FUSIONS, FuserSettings, make_fuser
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.synthesis.trajectory import plan_path
from omnisyn_cli.types import KnownDepth
from synthesis_samples import hall_view, posed, write_hall

SIZE = (64, 128)
POSES = (posed((0.0, 0.0, 0.8)), posed((0.2, 0.1, -0.8), heading=0.3))


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Two networks in ONNX files: one that is fresh, and one that answers at random."""
    torch.manual_seed(0)
    config = FusionConfig("tiny", channels=INPUT_CHANNELS + CANDIDATE_CHANNELS, widths=(8, 12), fine=6)
    network = ResidualFusionUNet(config).eval()
    folder = tmp_path_factory.mktemp("models")
    export_network(network, folder / "fresh.onnx")
    torch.nn.init.normal_(network.head.weight, std=0.5)
    export_network(network, folder / "random.onnx")
    return {name: str(folder / f"{name}.onnx") for name in ("fresh", "random")}


def frames(fuser):
    """Along the way through the hall, whose two views are wrong about the distance of its wall."""
    views = [hall_view(pose, SIZE) for pose in POSES]
    wrong = dataclasses.replace(views[0].known_depth, inverse_depth=views[0].known_depth.inverse_depth * 2.0)
    views[0] = dataclasses.replace(views[0], known_depth=wrong)
    path = plan_path(POSES, 5)
    made = synthesize(views, path, SurfaceMethod(KnownDepth(), SynthesisOptions(SIZE, threads=1), fuser))
    return views, np.array([frame.image.copy() for frame in made])


def test_a_fuser_has_the_name_that_it_was_asked_for(models):
    assert type(make_fuser("geometric", FuserSettings(SIZE))) is GeometricFuser
    settings = FuserSettings(SIZE, threads=1)
    assert type(make_fuser("network", settings, model=models["fresh"], device="cpu")) is ResidualFuser
    with pytest.raises(ValueError, match="geometric, network, painting"):
        make_fuser("magic", FuserSettings(SIZE))
    with pytest.raises(InputError, match=r"nothing\.onnx"):
        make_fuser("network", FuserSettings(SIZE), model="nothing.onnx")


def test_a_fresh_network_makes_the_frames_of_the_geometric_fusion(models):
    _, plain = frames(make_fuser("geometric", FuserSettings(SIZE, threads=1)))
    _, same = frames(make_fuser("network", FuserSettings(SIZE, threads=1), model=models["fresh"], device="cpu"))
    np.testing.assert_array_equal(same, plain)


def test_any_network_leaves_the_photographs_at_both_ends(models):
    _, plain = frames(make_fuser("geometric", FuserSettings(SIZE, threads=1)))
    views, other = frames(make_fuser("network", FuserSettings(SIZE, threads=1), model=models["random"], device="cpu"))
    np.testing.assert_array_equal(other[0], views[0].image)
    np.testing.assert_array_equal(other[-1], views[1].image)
    assert np.abs(other - plain)[1:-1].max() > 0.01


def fuse_with(model, monkeypatch):
    """Have the fusion ``network`` take another model."""
    changed = {**FUSIONS, "network": dataclasses.replace(FUSIONS["network"], model=model)}
    for module in ("fusions", "config"):
        monkeypatch.setattr(f"omnisyn_cli.pipeline.{module}.FUSIONS", changed)


def test_from_files_to_frames(tmp_path, models, monkeypatch):
    images = tuple(write_hall(tmp_path, POSES))
    job = InterpolationJob(images, tmp_path / "poses.json", tmp_path / "plain", frames=3, threads=1)
    run_interpolation(plan_interpolation(job))
    fuse_with(models["fresh"], monkeypatch)
    plan = plan_interpolation(dataclasses.replace(job, output=tmp_path / "fused", fusion="network"))
    assert plan.describe()["fusion"] == "network"
    run_interpolation(plan)
    for plain in sorted((tmp_path / "plain").iterdir()):
        fused = read_panorama(tmp_path / "fused" / plain.name).image
        np.testing.assert_array_equal(fused, read_panorama(plain).image)


def test_what_is_missing_or_unknown_is_refused_before_the_work(tmp_path, monkeypatch):
    images = tuple(write_hall(tmp_path, POSES))
    job = InterpolationJob(images, tmp_path / "poses.json", tmp_path / "out", frames=3)
    fuse_with("no-such-network", monkeypatch)
    with pytest.raises(InputError, match="no-such-network"):
        plan_interpolation(dataclasses.replace(job, fusion="network"))
    with pytest.raises(InputError, match="as fusion, got 'magic'"):
        plan_interpolation(dataclasses.replace(job, fusion="magic"))
    assert not (tmp_path / "out").exists()


def test_the_commands_know_the_names():
    result = CliRunner().invoke(
        interpolate, ["a.jpg", "b.jpg", "--poses", "p.json", "-o", "v.mp4", "--fusion", "magic"]
    )
    assert result.exit_code == 2
    assert "'geometric', 'network', 'painting'" in result.output
    result = CliRunner().invoke(train, ["fusion", "run", "--pool", "p", "--validation-pool", "v", "--variant", "magic"])
    assert result.exit_code == 2
    assert "residual, paper" in result.output
