import pytest
from click.testing import CliRunner

from omnisyn_cli.cli.train import train
from omnisyn_cli.networks.depth import VARIANTS


def run(*arguments):
    return CliRunner().invoke(train, [str(argument) for argument in arguments])


def test_an_unknown_kind_of_scene_is_refused(tmp_path):
    result = run("pool", tmp_path / "pool", "--kind", "streets")
    assert result.exit_code == 2
    assert "'street', 'room'" in result.output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_height_that_the_network_cannot_halve_often_enough_is_refused(tmp_path, variant):
    pools = ("--pool", tmp_path, "--validation-pool", tmp_path)
    result = run("depth", tmp_path / "run", *pools, "--variant", variant, "--height", 100)
    assert result.exit_code == 2
    assert f"multiple of {VARIANTS[variant].size_multiple} for" in result.output
    assert list(tmp_path.iterdir()) == []
