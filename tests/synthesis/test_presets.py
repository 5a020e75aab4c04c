"""Presets, configs and fusions by name: which networks take part, and what is made of it."""

import dataclasses
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from interpolation_samples import CHAIN, job_of
from omnisyn_cli.baselines.cross_fade import CrossFadeMethod, FlowMethod
from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.bench_settings import BenchJob
from omnisyn_cli.evaluation.methods import find_method
from omnisyn_cli.fusion.geometric import GeometricFuser
from omnisyn_cli.fusion.input_channels import INPUT_CHANNELS
from omnisyn_cli.fusion.residual import ResidualFuser
from omnisyn_cli.fusion.warp_candidates import CANDIDATE_CHANNELS
from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.plan import plan_interpolation, with_preset
from omnisyn_cli.interpolation.planning import duration
from omnisyn_cli.interpolation.planning.figures import Figures, Setting
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import read_panorama
from omnisyn_cli.networks.export import export_network
from omnisyn_cli.networks.fusion import FusionConfig, ResidualFusionUNet
from omnisyn_cli.pipeline.config import DepthSource, RunConfig, make_method
from omnisyn_cli.pipeline.depth_sources import make_estimator
from omnisyn_cli.pipeline.fusions import FUSIONS, FuserSettings, make_fuser
from omnisyn_cli.pipeline.methods import SYNSIN_MODELS
from omnisyn_cli.pipeline.presets import DEFAULT_PRESET, PRESETS, REPRODUCTIONS, SCALE
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.synthesis.trajectory import Waypoint, plan_path
from omnisyn_cli.types import KnownDepth
from synthesis_samples import SIZE, hall_image, hall_view, posed, write_hall, ws_psnr

PAPER = PRESETS["paper"].config
USUAL = RunConfig()


@pytest.fixture
def images(tmp_path: Path) -> list[Path]:
    return write_hall(tmp_path, CHAIN[:2], (64, 128), with_depth=False)


def test_every_preset_is_on_the_scale_or_beside_it() -> None:
    assert list(PRESETS) == [*SCALE, *REPRODUCTIONS]
    assert list(SCALE) == ["fast", "balanced"]
    assert DEFAULT_PRESET in SCALE
    assert sorted(p.config.depth.rows for p in SCALE.values()) == [p.config.depth.rows for p in SCALE.values()]
    assert {preset.config.fusion for preset in PRESETS.values()} <= set(FUSIONS)


def test_the_paper_preset_has_the_settings_of_the_paper(tmp_path: Path, images: list[Path]) -> None:
    job = job_of(tmp_path, images, preset="paper")
    plan = plan_interpolation(job)
    assert plan.config == PAPER
    assert (PAPER.depth.kind, PAPER.fusion) == ("network", "painting")
    assert (PAPER.renderer, PAPER.cut, PAPER.cut_metres) == ("two-pass", None, 2.0)
    assert PAPER.networks == (PAPER.depth.model, FUSIONS["painting"].model)
    assert plan.describe()["renderer"] == "two-pass"
    assert plan.memory > plan_interpolation(replace(job, renderer="mesh")).memory
    large = replace(job, size=(1024, 2048))  # frames of this size take more than making surfaces
    assert plan_interpolation(large).memory > plan_interpolation(replace(large, fusion="geometric")).memory


def test_what_is_asked_for_beside_the_preset_comes_first(tmp_path: Path, images: list[Path]) -> None:
    job = job_of(tmp_path, images, preset="paper")
    asked = plan_interpolation(replace(job, renderer="mesh", cut=0.1, fusion="geometric")).config
    assert asked == replace(PAPER, renderer="mesh", cut=0.1, cut_metres=None, fusion="geometric")
    assert plan_interpolation(replace(job, cut_metres=1.0)).config == replace(PAPER, cut_metres=1.0)
    assert plan_interpolation(replace(job, depth="matching")).config.depth.model is None


def test_the_other_presets_are_drawn_exactly_and_cut_relatively(tmp_path: Path, images: list[Path]) -> None:
    plan = plan_interpolation(job_of(tmp_path, images, preset="paper"))
    for name in SCALE:
        other = plan_interpolation(job_of(tmp_path, images, preset=name, adaptive=True))
        assert other.config == replace(PRESETS[name].config, fallback="auto")
        assert (other.config.renderer, other.config.cut) == ("mesh", USUAL.cut)
        plan = replace(plan, job=replace(plan.job, adaptive=True))
        assert with_preset(plan, name).describe() == other.describe()
        assert with_preset(plan, name).config == other.config


def test_known_depth_is_fused_by_rules_with_this_preset_too(tmp_path: Path) -> None:
    config = plan_interpolation(job_of(tmp_path, write_hall(tmp_path, CHAIN[:2]), preset="paper")).config
    assert (config.depth.kind, config.depth.model) == ("file", None)
    assert (config.fusion, config.renderer) == ("geometric", "two-pass")


def test_no_budget_chooses_a_reproduction(tmp_path: Path, images: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """Even where it was measured and looks both fast and accurate."""
    setting = Setting("omnisyn-paper", (64, 128), 1)
    stages = dict.fromkeys(("start", "decode", "depth", "check", "mesh", "render", "fuse", "encode"), 1e-6)
    tempting = Figures(setting, config=PAPER, seconds=stages, probe=1.0, source=(64, 128), scores={"hall": 99.0})
    with_paper = (*duration.shipped_table(), tempting)
    monkeypatch.setattr(duration, "shipped_table", lambda: with_paper)
    plan = plan_interpolation(job_of(tmp_path, images))
    assert duration.apply_budget(plan, 1e9).job.preset in SCALE
    with pytest.raises(InputError, match="renderer 'mesh' with a budget, got 'two-pass'"):
        duration.apply_budget(plan_interpolation(job_of(tmp_path, images, preset="paper")), 1e9)


def test_measurements_are_of_the_scale_unless_asked_otherwise() -> None:
    assert not set(BenchJob(Path("data")).methods.split(",")) & {"omnisyn-paper", "synsin"}


def test_the_evaluation_has_the_preset_with_all_its_settings() -> None:
    method = find_method("omnisyn-paper")
    assert method.config == PAPER
    assert repr(PAPER) in method.ingredients()
    changed = find_method("omnisyn-paper:renderer=mesh:cut=0.05")
    assert changed.config == replace(PAPER, renderer="mesh", cut=0.05, cut_metres=None)


def test_the_help_describes_every_preset(omnisyn) -> None:
    words = " ".join(omnisyn.made("interpolate", "--help").out.split())
    for name, preset in PRESETS.items():
        assert f"{name} {preset.summary}" in words


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
    [(RunConfig(renderer="magic"), r"renderer of mesh, two-pass, points, got 'magic'"),
     (RunConfig(fusion="magic"), r"fusion of geometric, network, painting, got 'magic'"),
     (RunConfig(method="magic"), r"method of omnisyn, .*, got 'magic'"),
     (RunConfig(DepthSource("magic")), r"depth source of file, .*, got 'magic'")],
)  # fmt: skip
def test_an_unknown_name_is_refused_with_the_known_ones(unknown, message):
    with pytest.raises(ValueError, match=message):
        make_method(unknown, (32, 64))


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


def test_a_fresh_network_fuses_geometrically_and_any_leaves_the_photographs_at_both_ends(models):
    settings = FuserSettings(SIZE, threads=1)
    _, plain = frames(make_fuser("geometric", settings))
    _, same = frames(make_fuser("network", settings, model=models["fresh"], device="cpu"))
    np.testing.assert_array_equal(same, plain)
    views, other = frames(make_fuser("network", settings, model=models["random"], device="cpu"))
    np.testing.assert_array_equal(other[0], views[0].image)
    np.testing.assert_array_equal(other[-1], views[1].image)
    assert np.abs(other - plain)[1:-1].max() > 0.01


def fuse_with(model, monkeypatch):
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


def test_the_commands_know_the_names(omnisyn):
    words = ("interpolate", "a.jpg", "b.jpg", "--poses", "p.json", "-o", "v.mp4", "--fusion", "magic")
    assert "'geometric', 'network', 'painting'" in omnisyn.misused(*words)
    words = ("train", "fusion", "run", "--pool", "p", "--validation-pool", "v", "--variant", "magic")
    assert "residual, paper" in omnisyn.misused(*words)
