import csv
import json
import math

import pytest
import torch
from test_loop import equal
from training_samples import ball_walk

from omnisyn_cli.errors import InputError
from omnisyn_cli.networks import guided_depth
from omnisyn_cli.training import recipe
from omnisyn_cli.training.checkpoint import publish
from omnisyn_cli.training.recipe import Recipe, RecipeTrainer, Stage, read_recipe, train_recipe
from omnisyn_cli.training.tasks import TASKS

STAGES = (Stage(32, 2, 4, 1e-3, 5e-4), Stage(64, 1, 4, 4e-4, 0.0))
SMALL = guided_depth.GuidedDepthConfig("small", size=(64, 128), spheres=8, features=8, groups=2, widths=(8, 8, 8, 8, 8))
PLAN = Recipe(
    "small", STAGES, kinds=("room",), height=64, views=3, first_walks=2, early_walks=2, steps_per_walk=2,
    validation_walks=2, validation_pairs=2, validate_every=4, save_every=2, warmup_steps=2,
)  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def _small():
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(TASKS["guided"].variants, "small", SMALL)
        patch.setattr(recipe, "make_walk", lambda seed, _: ball_walk(seed))
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory, _small):
    """A run that nobody disturbs: its trainer, its folder and what it reported."""
    folder, rows = tmp_path_factory.mktemp("whole"), []
    return train_recipe(PLAN, folder, report=rows.append), folder, rows


class KilledError(Exception):
    pass


@pytest.mark.parametrize("killed_at", [1, 5])
def test_a_run_that_is_killed_anywhere_ends_as_if_it_had_not_been(tmp_path, monkeypatch, whole, killed_at):
    advance = RecipeTrainer.advance

    def advance_until_killed(trainer):
        if trainer.step == killed_at:
            raise KilledError
        return advance(trainer)

    monkeypatch.setattr(RecipeTrainer, "advance", advance_until_killed)
    with pytest.raises(KilledError):
        train_recipe(PLAN, tmp_path / "killed")
    monkeypatch.setattr(RecipeTrainer, "advance", advance)
    resumed = train_recipe(PLAN, tmp_path / "killed")
    ours, theirs = ({k: v for k, v in t.state().items() if k not in {"training", "curve"}} for t in (resumed, whole[0]))
    assert resumed.step == 8
    assert equal(ours, theirs)
    figures = [[row["error"] for row in trainer.curve] for trainer in (resumed, whole[0])]
    assert figures[0] == figures[1]


def test_a_run_leaves_its_curve_its_pictures_and_compact_checkpoints(whole):
    _, folder, rows = whole
    assert [row["step"] for row in rows] == [4, 8]
    with (folder / "curve.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    assert [float(row["error"]) for row in table] == [row["error"] for row in rows]
    assert len((folder / "log.jsonl").read_text().splitlines()) == 2
    assert json.loads((folder / "log.jsonl").read_text().splitlines()[-1])["stage"] == 2
    assert sorted(path.name for path in (folder / "pictures").iterdir()) == ["00000004.png", "00000008.png"]
    latest = torch.load(folder / "latest.pt", weights_only=True)
    assert latest["step"] == 8
    assert len(latest["curve"]) == 2
    assert "optimizer" not in latest


def test_another_machine_goes_on_with_new_scenes_and_warms_up(tmp_path):
    train_recipe(PLAN, tmp_path / "run", minutes=0)  # a step
    first = train_recipe(PLAN, tmp_path / "run")
    begun = tmp_path / "run" / "latest.pt"
    longer = Recipe(**{**vars(PLAN), "stages": (*STAGES, Stage(64, 1, 2, 1e-4, 0.0))})
    trainer = train_recipe(longer, tmp_path / "elsewhere", begin_with=begun)
    assert trainer.step == 10
    assert trainer.warm_from == 8
    seeds = sorted(int(path.stem) for path in (tmp_path / "elsewhere" / "walks").iterdir())
    assert seeds[0] >= first.seeds_at(8).stop


def test_scenes_come_soon_at_first_and_the_oldest_go():
    plan = Recipe("small", STAGES, first_walks=5, early_walks=10, steps_per_walk=10, most_walks=18)
    assert [len(plan.walks_after(step)) for step in (0, 3, 30, 40)] == [5, 6, 18, 18]
    assert plan.walks_after(60) == range(3, 21)


def test_rates_fall_along_a_cosine_from_stage_to_stage():
    assert PLAN.rate_at(0) == pytest.approx(1e-3)
    assert PLAN.rate_at(2) == pytest.approx(7.5e-4)
    assert PLAN.rate_at(4) == pytest.approx(4e-4)
    assert PLAN.rate_at(8) == 0.0
    assert PLAN.stage_at(3) == (0, 3)
    assert PLAN.stage_at(4) == (1, 0)
    assert PLAN.stage_at(8) == (2, 0)


RECIPE = """
variant = "small"
height = 64
kinds = ["room"]
[[stages]]
height = 32
batch = 2
steps = 4
rate = 1e-3
final_rate = 0.0
"""


def test_a_recipe_reads_back(tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_text(RECIPE)
    plan = read_recipe(path)
    assert plan.stages == (Stage(32, 2, 4, 1e-3, 0.0),)
    assert plan.kinds == ("room",)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (("height = 64", "heigth = 64"), "heigth"), (("height = 32", "height = 48"), "multiples of 32"),
        (('"small"', '"large"'), "expected a variant"), (("steps = 4", "steps = 0"), "steps"),
        (("[[stages]]", "[stages]"), "expected a recipe"), (("rate = 1e-3", "rate = "), "expected a recipe"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_recipe_is_said(tmp_path, changed, said):
    path = tmp_path / "recipe.toml"
    path.write_text(RECIPE.replace(*changed))
    with pytest.raises(InputError, match=said):
        read_recipe(path)


def test_the_recipes_of_the_repository_are_valid(pytestconfig):
    found = sorted((pytestconfig.rootpath / "models" / "recipes").glob("*.toml"))
    assert found
    assert all(math.isfinite(read_recipe(path).rate_at(0)) for path in found)


def test_the_command_trains_and_wants_meshes_that_are_there(tmp_path, omnisyn):
    (tmp_path / "recipe.toml").write_text(RECIPE)
    command = ("train", "recipe", tmp_path / "recipe.toml", tmp_path / "run")
    omnisyn.misused(*command, "--held-out", "hall")
    omnisyn.misused(*command, "--mesh-scale", "hall", "--meshes", tmp_path)
    made = omnisyn.made(*command, "--device", "cpu", "--threads", 1)
    assert "delta_25" in made.out + made.raw_err


def test_a_compact_checkpoint_is_published(tmp_path, whole):
    ((entry, difference),) = publish(whole[1] / "best.pt", tmp_path / "models")
    assert entry.name == "guided-depth-small"
    assert entry.size == SMALL.size
    assert difference < 1e-4
    assert (tmp_path / "models" / "guided-depth-small.onnx").exists()
