import json
from dataclasses import replace

import pytest
import torch
from training_samples import TINY, make_pool

from omnisyn_cli.compute.threads import allowed_threads
from omnisyn_cli.errors import InputError, TrainingError
from omnisyn_cli.networks.completion import COMPLETION_VARIANTS
from omnisyn_cli.networks.paper import PaperNetwork
from omnisyn_cli.training.checkpoint import REQUIRED_KEYS, compact, load_checkpoint, load_network, save_checkpoint
from omnisyn_cli.training.loop import Trainer, open_trainer, train
from omnisyn_cli.training.tasks import TrainConfig


@pytest.fixture
def config(tmp_path):
    pool = str(make_pool(tmp_path / "pool"))
    return TrainConfig(
        pool, pool, size=(64, 128), batch=1, rate=1e-4, warmup_steps=2, validate_every=4, save_every=2,
        validation_pairs=2,
    )  # fmt: skip


def equal(one, other):
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(equal(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(equal, one, other))
    return torch.equal(one, other) if isinstance(one, torch.Tensor) else one == other


def test_a_stopped_run_goes_on_bit_for_bit(tmp_path, config):
    train(TINY, config, tmp_path / "whole", steps=5)
    train(TINY, config, tmp_path / "stopped", steps=2)
    train(TINY, config, tmp_path / "stopped", steps=5)
    whole, stopped = (load_checkpoint(tmp_path / name / "checkpoint.pt") for name in ("whole", "stopped"))
    assert whole["step"] == 5
    assert equal(whole, stopped)


def test_the_log_holds_one_object_per_validation(tmp_path, config):
    rows = []
    train(TINY, config, tmp_path / "run", steps=8, report=rows.append)
    logged = [json.loads(line) for line in (tmp_path / "run" / "log.jsonl").read_text().splitlines()]
    assert [row["step"] for row in logged] == [4, 8]
    assert len(rows) == 2
    assert 0 <= logged[0]["delta_25"] <= 1


def test_the_best_weights_stay(tmp_path, config):
    train(TINY, config, tmp_path / "run", steps=8)
    logged = [json.loads(line) for line in (tmp_path / "run" / "log.jsonl").read_text().splitlines()]
    best = min(logged, key=lambda row: row["held_out_loss"])
    kept, last = (load_checkpoint(tmp_path / "run" / name) for name in ("best.pt", "checkpoint.pt"))
    assert kept["step"] == best["step"]
    assert kept["best"] == last["best"] == best["held_out_loss"]
    assert load_network(tmp_path / "run" / "best.pt")[1]["scores"] == kept["scores"]


def test_a_run_that_collapses_stops_and_leaves_what_was_before(tmp_path, config):
    train(TINY, config, tmp_path / "run", steps=4)
    state = load_checkpoint(tmp_path / "run" / "checkpoint.pt")
    save_checkpoint(tmp_path / "run" / "checkpoint.pt", {**state, "best": 0.5 * state["best"]})
    with pytest.raises(TrainingError, match=r"at step 8: the run has collapsed; put best\.pt"):
        train(TINY, config, tmp_path / "run", steps=8)
    assert load_checkpoint(tmp_path / "run" / "checkpoint.pt")["step"] == 6
    assert load_checkpoint(tmp_path / "run" / "best.pt")["step"] == 4


def test_a_loss_that_is_no_number_in_one_pair_is_none_at_all(config):
    trainer = Trainer(TINY, config)
    losses = iter([1.0, float("nan")])
    task = replace(trainer.task, loss=lambda answer, batch: torch.tensor(next(losses)))
    loss = task.validate(trainer.averaged_network(), config)["held_out_loss"]
    assert loss != loss
    with pytest.raises(TrainingError, match="got nan"):
        trainer.surpasses(loss)


def test_what_is_best_depends_on_what_it_is_judged_by(tmp_path, config):
    train(TINY, config, tmp_path / "run", steps=4)
    again = open_trainer(TINY, config, tmp_path / "run" / "checkpoint.pt")
    assert again.best < 1e9
    elsewhere = open_trainer(TINY, replace(config, validation_pairs=1), tmp_path / "run" / "checkpoint.pt")
    assert elsewhere.best == float("inf")


def test_a_batch_is_drawn_on_one_thread_while_the_others_learn(config):
    trainer, seen = Trainer(TINY, config), []
    trainer.task = replace(trainer.task, draw=lambda *_: seen.append(allowed_threads()))
    before = allowed_threads()
    trainer._batch()
    trainer.ahead.shutdown()
    assert seen == [1, 1]
    assert allowed_threads() == before


def test_time_ends_a_run_after_a_whole_step(tmp_path, config):
    assert train(TINY, config, tmp_path / "run", minutes=0.0).step == 1
    assert load_checkpoint(tmp_path / "run" / "checkpoint.pt")["step"] == 1


def test_a_cool_down_takes_the_rate_to_zero_and_ends(tmp_path, config):
    train(TINY, config, tmp_path / "run", steps=3)
    cooling = TrainConfig(**{**vars(config), "cooldown_steps": 3})
    trainer = train(TINY, cooling, tmp_path / "run", steps=5)
    assert 0 < trainer.rate() < config.rate
    trainer = train(TINY, cooling, tmp_path / "run")
    assert trainer.is_finished()
    assert trainer.step == 6
    assert trainer.rate() == pytest.approx(0.0, abs=1e-12)


def test_the_rate_rises_during_the_warm_up(config):
    trainer = Trainer(TINY, config)
    rates = []
    for trainer.step in range(4):
        rates.append(trainer.rate())
    assert rates == [config.rate / 2, config.rate, config.rate, config.rate]


def test_a_later_stage_has_its_own_weight_decay(tmp_path, config):
    """Optimisers keep theirs in the checkpoint."""
    train(TINY, config, tmp_path / "run", steps=1)
    trainer = train(TINY, replace(config, weight_decay=0.5), tmp_path / "run", steps=2)
    assert [group["weight_decay"] for group in trainer.optimizer.param_groups] == [0.5]


def test_the_average_follows_the_weights(tmp_path, config):
    trainer = train(TINY, config, tmp_path / "run", steps=3)
    network, state = load_network(tmp_path / "run" / "checkpoint.pt")
    assert state["step"] == 3
    for name, value in network.state_dict().items():
        assert torch.equal(value, trainer.average[name])
    name = "features.down.0.first.weight"
    assert not torch.equal(trainer.average[name], trainer.network.state_dict()[name])


def test_other_files_are_refused(tmp_path, config):
    with pytest.raises(InputError, match="found no file"):
        load_network(tmp_path / "missing.pt")
    (tmp_path / "text.pt").write_text("no checkpoint")
    with pytest.raises(InputError, match="got another file"):
        load_network(tmp_path / "text.pt")
    for index, other in enumerate(({"kind": "depth"}, torch.zeros(3))):
        torch.save(other, tmp_path / f"{index}.pt")
        with pytest.raises(InputError, match="got other tensors"):
            load_checkpoint(tmp_path / f"{index}.pt")
    save_checkpoint(tmp_path / "other.pt", {**Trainer(TINY, config).state(), "kind": "abacus"})
    with pytest.raises(InputError, match="abacus"):
        load_network(tmp_path / "other.pt")


def test_a_checkpoint_of_another_version_is_refused_in_one_line(tmp_path, config):
    """With a setting that is not known here, and with weights of other shapes."""
    state = Trainer(TINY, config).state()
    others = {
        "setting": {**state, "network": {**state["network"], "unheard_of": 1}},
        "weights": {**state, **dict.fromkeys(("weights", "average"), dict.fromkeys(state["average"], torch.zeros(2)))},
    }
    for name, other in others.items():
        path = tmp_path / name / "checkpoint.pt"
        save_checkpoint(path, other)
        for use in (load_network, lambda path: open_trainer(TINY, config, path)):
            with pytest.raises(InputError, match="this version's networks") as caught:
                use(path)
            assert "\n" not in str(caught.value)


def test_a_folder_of_another_kind_of_network_is_refused(tmp_path, config):
    train(TINY, config, tmp_path / "run", steps=1)
    with pytest.raises(InputError, match=r"expected a completion network in .*got a paper network"):
        train(COMPLETION_VARIANTS["balanced"], config, tmp_path / "run", steps=2)


def test_a_kill_while_writing_leaves_the_old_checkpoint(tmp_path, monkeypatch):
    path, state = tmp_path / "checkpoint.pt", dict.fromkeys(REQUIRED_KEYS, 1)
    save_checkpoint(path, state)

    def killed(state, file):
        file.write(b"half a")
        raise KeyboardInterrupt

    monkeypatch.setattr(torch, "save", killed)
    with pytest.raises(KeyboardInterrupt):
        save_checkpoint(path, {**state, "step": 2})
    assert load_checkpoint(path) == state


@pytest.mark.slow
def test_one_pair_can_be_learned_by_heart(tmp_path):
    pool = str(make_pool(tmp_path / "pool", scenes=1, along=(0.0, 1.0)))
    config = TrainConfig(
        pool, pool, size=(64, 128), batch=2, rate=3e-3, ema=0.9, validate_every=100, validation_pairs=2
    )
    rows = []
    train(TINY, config, tmp_path / "run", steps=300, report=rows.append)
    assert rows[-1]["delta_10"] > 0.9
    assert isinstance(load_network(tmp_path / "run" / "checkpoint.pt")[0], PaperNetwork)


def test_a_compact_checkpoint_is_the_same_network_and_can_be_trained_on(tmp_path, config):
    train(TINY, config, tmp_path / "run", steps=3)
    whole = load_checkpoint(tmp_path / "run" / "checkpoint.pt")
    save_checkpoint(tmp_path / "new" / "checkpoint.pt", compact(whole))
    network, _ = load_network(tmp_path / "new" / "checkpoint.pt")
    for name, value in network.state_dict().items():
        torch.testing.assert_close(value, whole["average"][name], rtol=1e-3, atol=1e-4)
    small, large = ((tmp_path / name / "checkpoint.pt").stat().st_size for name in ("new", "run"))
    assert small < large / 3
    trainer = train(TINY, config, tmp_path / "new", steps=5)
    assert trainer.step == 5
    assert all(
        value.dtype == own.dtype
        for value, own in zip(trainer.average.values(), network.state_dict().values(), strict=False)
    )
