"""What is shipped is what its checkpoints say, to the byte."""

from pathlib import Path

import onnx
import pytest
import torch

from omnisyn_cli.runtime.models import read_manifest
from omnisyn_cli.training.publish import publish

MODELS = Path(__file__).parents[2] / "models"

SHIPPED = {
    "completion-balanced": ["completion-balanced"],
    "depth-guided": ["depth-guided"],
    "depth-paper-narrow": ["depth-paper-narrow"],
    "fusion-paper-narrow": ["fusion-paper-narrow"],
    "fusion-residual": ["fusion-residual"],
    "synsin-small": ["synsin-depth", "synsin-encoder", "synsin-decoder"],
}
"""Models by the checkpoint that they come from."""

NAMED = {"depth-guided": "depth-guided"}
"""What was exported with ``--name``: the others have the name of their kind and variant."""


def test_every_shipped_model_has_a_checkpoint():
    assert sorted(name for names in SHIPPED.values() for name in names) == sorted(read_manifest(MODELS))


@pytest.mark.parametrize("checkpoint", SHIPPED)
def test_shipped_models_are_what_their_checkpoints_export_to(tmp_path, checkpoint):
    """Byte for byte, where the same release of torch writes them."""
    names, known = SHIPPED[checkpoint], read_manifest(MODELS)
    shipped = onnx.load(MODELS / known[names[0]].file)
    if shipped.producer_version != torch.__version__.split("+")[0]:
        pytest.skip(f"shipped models were written by torch {shipped.producer_version}, this is {torch.__version__}")
    file = MODELS / "checkpoints" / f"{checkpoint}.pt"
    published = {entry.name: entry for entry, _ in publish(file, tmp_path, name=NAMED.get(checkpoint))}
    assert sorted(published) == sorted(names)
    for name in names:
        assert (published[name].sha256, published[name].parameters) == (known[name].sha256, known[name].parameters)
        assert (tmp_path / published[name].file).read_bytes() == (MODELS / known[name].file).read_bytes()
