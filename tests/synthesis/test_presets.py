"""The scale from fast to balanced, and beside it the paper's method with the paper's settings."""

from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from interpolation_samples import CHAIN, job_of
from omnisyn_cli.cli.interpolate import interpolate
from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.bench_settings import BenchJob
from omnisyn_cli.evaluation.methods import find_method
from omnisyn_cli.interpolation.plan import plan_interpolation, with_preset
from omnisyn_cli.interpolation.planning import duration
from omnisyn_cli.interpolation.planning.figures import Figures, Setting
from omnisyn_cli.pipeline.config import RunConfig
from omnisyn_cli.pipeline.fusions import FUSIONS
from omnisyn_cli.pipeline.presets import DEFAULT_PRESET, PRESETS, REPRODUCTIONS, SCALE
from synthesis_samples import write_hall

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
        assert other.config == replace(PRESETS[name].config, fallback="soft")
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


def test_the_help_describes_every_preset() -> None:
    words = " ".join(CliRunner().invoke(interpolate, ["--help"]).output.split())
    for name, preset in PRESETS.items():
        assert f"{name} {preset.summary}" in words
