"""Networks share the processor with the encoder and with other programs."""

import os
import subprocess
import sys
from pathlib import Path

from omnisyn_cli.runtime.models import find_model
from omnisyn_cli.runtime.session import open_session


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
