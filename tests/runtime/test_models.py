"""Models by name; networks share the processor with the encoder and with other programs."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from omnisyn_cli.errors import InputError
from omnisyn_cli.runtime.models import find_model, read_manifest
from omnisyn_cli.runtime.session import open_session

ENTRY = """
version = {version}
[[models]]
name = "depth-test"
role = "depth"
variant = "fast"
file = "depth-test.onnx"
sha256 = "{digest}"
size = [256, 512]
parameters = 5
training = "never"
licence = "Apache-2.0"
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "depth-test.onnx").write_bytes(b"weights")
    digest = hashlib.sha256(b"weights").hexdigest()
    (tmp_path / "manifest.toml").write_text(ENTRY.format(version=1, digest=digest))
    return tmp_path


def test_a_model_is_found_by_name_and_by_path(folder):
    assert read_manifest(folder)["depth-test"].size == (256, 512)
    path = folder / "depth-test.onnx"
    assert find_model("depth-test", folder) == find_model(str(path), folder) == path


def test_what_was_changed_or_is_missing_is_named(folder):
    for name, words in (("depth-unknown", "depth-test"), (str(folder / "nothing.onnx"), "found none")):
        with pytest.raises(InputError, match=words):
            find_model(name, folder)
    for change, words in ((lambda file: file.write_bytes(b"other weights"), "sha256"), (Path.unlink, "no file")):
        change(folder / "depth-test.onnx")
        with pytest.raises(InputError, match=words):
            find_model("depth-test", folder)


def test_no_manifest_means_no_models(tmp_path):
    assert read_manifest(tmp_path) == {}


@pytest.mark.parametrize("text", ["version = 1\n[[models]]\nname = 3", "not toml", ENTRY.format(version=2, digest="0")])
def test_malformed_manifests_are_refused(tmp_path, text):
    (tmp_path / "manifest.toml").write_text(text)
    with pytest.raises(InputError, match=r"manifest\.toml"):
        read_manifest(tmp_path)


def test_threads_that_wait_sleep() -> None:
    session = open_session(find_model("completion-balanced"), device="cpu", threads=2)
    options = session.get_session_options()
    assert options.get_session_config_entry("session.intra_op.allow_spinning") == "0"
    assert options.intra_op_num_threads == 2


OPENS_A_SESSION = """
from omnisyn_cli.runtime.session import open_model
open_model("completion-balanced", device="cpu")
"""


def test_networks_run_without_telling_anybody(tmp_path: Path) -> None:
    """Newer releases of ONNX Runtime would keep a queue of what they tell in the user's home."""
    kept = {name: value for name, value in os.environ.items() if name not in {"CI", "ORT_DISABLE_TELEMETRY"}}
    homes = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "XDG_DATA_HOME", "XDG_CONFIG_HOME"), str(tmp_path))
    subprocess.run([sys.executable, "-c", OPENS_A_SESSION], env={**kept, **homes}, check=True)
    assert list(tmp_path.rglob("*")) == []
