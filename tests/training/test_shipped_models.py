"""What is shipped can be trained on: the files hold all weights, by their names."""

from pathlib import Path

import onnx
import pytest
import torch

from omnisyn_cli.errors import InputError
from omnisyn_cli.runtime.models import read_manifest
from omnisyn_cli.training.checkpoint import load_network
from omnisyn_cli.training.publish import publish

MODELS = Path(__file__).parents[2] / "models"

ENTRIES = read_manifest(MODELS)


@pytest.mark.parametrize("name", ENTRIES)
def test_the_module_made_of_a_file_is_exported_to_the_same_file(tmp_path, name):
    """Byte for byte, where the same release of torch writes it; and it answers as ONNX Runtime does."""
    entry = ENTRIES[name]
    made = {each.name: (each, difference) for each, difference in publish(MODELS / entry.file, tmp_path, name=None)}
    found, difference = next(each for each in made.values() if each[0].role == entry.role)
    assert found.parameters == entry.parameters
    assert difference < 1e-4
    shipped = onnx.load(MODELS / entry.file)
    written = onnx.load(tmp_path / found.file)
    for one, other in zip(shipped.graph.initializer, written.graph.initializer, strict=True):
        assert onnx.numpy_helper.to_array(one).tobytes() == onnx.numpy_helper.to_array(other).tobytes()
    if shipped.producer_version == torch.__version__.split("+")[0]:
        assert (tmp_path / found.file).read_bytes() == (MODELS / entry.file).read_bytes()


def test_a_file_that_no_manifest_names_is_refused(tmp_path):
    (tmp_path / "mine.onnx").write_bytes((MODELS / "synsin-encoder.onnx").read_bytes())
    with pytest.raises(InputError, match=r"expected a network of the manifest beside .*mine\.onnx, found none"):
        load_network(tmp_path / "mine.onnx")
