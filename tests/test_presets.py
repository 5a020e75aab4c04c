"""The scale from fast to accurate, and beside it the paper's method with the paper's settings."""

from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner

from interpolation_samples import CHAIN, job_of
from omnisyn_cli.cli.interpolate import interpolate
from omnisyn_cli.errors import InputError
from omnisyn_cli.evaluation.bench import BenchJob
from omnisyn_cli.evaluation.budget import apply_budget, shipped_table
from omnisyn_cli.evaluation.methods import MethodOptions, find_method
from omnisyn_cli.evaluation.pareto import Figures, Setting
from omnisyn_cli.fusion.painting import PaintingFuser
from omnisyn_cli.planning import networks_of, plan_interpolation, with_preset
from omnisyn_cli.presets import DEFAULT_PRESET, FUSION_MODELS, FUSIONS, PRESETS, REPRODUCTIONS, SCALE
from omnisyn_cli.render.mesh import Cut
from synthesis_samples import hall_view, write_hall

PAPER = PRESETS["paper"]


@pytest.fixture
def images(tmp_path: Path) -> list[Path]:
    return write_hall(tmp_path, CHAIN[:2], (64, 128), with_depth=False)


def test_every_preset_is_on_the_scale_or_beside_it() -> None:
    assert list(PRESETS) == [*SCALE, *REPRODUCTIONS]
    assert list(SCALE) == ["fast", "balanced", "accurate"]
    assert DEFAULT_PRESET in SCALE
    assert sorted(preset.depth_rows for preset in SCALE.values()) == [p.depth_rows for p in SCALE.values()]
    assert {preset.fusion for preset in PRESETS.values()} <= set(FUSIONS)
    assert set(FUSION_MODELS) < set(FUSIONS)


def test_the_paper_preset_has_the_settings_of_the_paper(tmp_path: Path, images: list[Path]) -> None:
    job = job_of(tmp_path, images, preset="paper")
    plan = plan_interpolation(job)
    assert (plan.depth, plan.model, plan.fusion) == ("network", PAPER.model, "painting")
    assert (plan.renderer, plan.cut) == ("two-pass", Cut(relative=None, metres=2.0))
    assert networks_of(job, plan.entries) == (PAPER.model, FUSION_MODELS["painting"])
    assert plan.describe()["renderer"] == "two-pass"
    assert plan.memory > plan_interpolation(replace(job, renderer="mesh")).memory
    large = replace(job, size=(1024, 2048))  # frames of this size take more than making surfaces
    assert plan_interpolation(large).memory > plan_interpolation(replace(large, fusion="geometric")).memory


def test_what_is_asked_for_beside_the_preset_comes_first(tmp_path: Path, images: list[Path]) -> None:
    job = job_of(tmp_path, images, preset="paper")
    asked = plan_interpolation(replace(job, renderer="mesh", cut=Cut(relative=0.1), fusion="geometric"))
    assert (asked.renderer, asked.cut, asked.fusion) == ("mesh", Cut(relative=0.1), "geometric")
    assert plan_interpolation(replace(job, depth="matching")).model is None


def test_the_other_presets_are_drawn_exactly_and_cut_relatively(tmp_path: Path, images: list[Path]) -> None:
    plan = plan_interpolation(job_of(tmp_path, images, preset="paper"))
    for name in SCALE:
        other = plan_interpolation(job_of(tmp_path, images, preset=name))
        assert (other.renderer, other.cut) == ("mesh", Cut())
        assert with_preset(plan, name).describe() == other.describe()
        assert (with_preset(plan, name).renderer, with_preset(plan, name).cut) == ("mesh", Cut())


def test_known_depth_is_fused_by_rules_with_this_preset_too(tmp_path: Path) -> None:
    plan = plan_interpolation(job_of(tmp_path, write_hall(tmp_path, CHAIN[:2]), preset="paper"))
    assert (plan.depth, plan.model, plan.fusion, plan.renderer) == ("file", None, "geometric", "two-pass")


def test_no_budget_chooses_a_reproduction(tmp_path: Path, images: list[Path]) -> None:
    """Even where it was measured and looks both fast and accurate."""
    table = shipped_table()
    setting = Setting("paper", PAPER.depth_rows, (64, 128), 1)
    stages = dict.fromkeys(("start", "decode", "depth", "mesh", "render", "fuse", "encode", "convert"), 1e-6)
    tempting = Figures(setting, seconds=stages, calibration=1.0, source=(64, 128), ws_psnr=99.0)
    with_paper = replace(table, figures=(*table.figures, tempting))
    plan = plan_interpolation(job_of(tmp_path, images))
    assert apply_budget(plan, 1e9, with_paper, 0.05).job.preset in SCALE
    with pytest.raises(InputError, match="renderer 'mesh' with a budget, got 'two-pass'"):
        apply_budget(plan_interpolation(job_of(tmp_path, images, preset="paper")), 1e9, table, 0.05)


def test_measurements_are_of_the_scale_unless_asked_otherwise() -> None:
    assert BenchJob(Path("data"), Path("report")).presets == tuple(SCALE)


def test_the_evaluation_has_the_preset_with_all_its_settings() -> None:
    method, views = find_method("omnisyn-paper"), (hall_view(CHAIN[0], (64, 128)), hall_view(CHAIN[1], (64, 128)))
    assert repr(PAPER) in method.ingredients()
    recipe = method.make(views, MethodOptions(threads=1))._recipe  # type: ignore[attr-defined]
    assert (recipe.renderer, recipe.cut) == ("two-pass", Cut(relative=None, metres=2.0))
    assert type(recipe.fuser((64, 128), 1)) is PaintingFuser
    changed = find_method("omnisyn-paper:renderer=mesh:cut=0.05").make(views, MethodOptions(threads=1))
    assert (changed._recipe.renderer, changed._recipe.cut) == ("mesh", Cut())  # type: ignore[attr-defined]


def test_the_help_says_that_it_is_no_point_on_the_scale() -> None:
    words = " ".join(CliRunner().invoke(interpolate, ["--help"]).output.split())
    assert "Beside that scale paper: the method of the paper" in words
    assert f"accurate: {SCALE['accurate'].summary}" in words
