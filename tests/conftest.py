"""While tests run, the shapes in the signatures of ``omnisyn_cli.geometry`` are checked at every call."""

import os
import sys
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from jaxtyping import install_import_hook

os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # who waits for a core lets others have theirs
install_import_hook("omnisyn_cli.geometry", "typechecker.check").__enter__()

settings.register_profile("patient", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")  # what takes long on a busy machine is not wrong

MOST_WORKERS = 4  # Each of them holds up to 3 GiB.


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """As many as there are cores for the suite or a folder; a file is done before workers have begun."""
    from omnisyn_cli.compute.threads import available_threads

    is_of_files = any(Path(argument.partition("::")[0]).is_file() for argument in config.args)
    return 0 if is_of_files else min(available_threads(), MOST_WORKERS)


@pytest.fixture
def omnisyn(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Any:
    """The command line in this process: a :class:`cli.cli_samples.Omnisyn`."""
    from cli.cli_samples import Omnisyn

    return Omnisyn(capsys, tmp_path)


@pytest.fixture
def pair(tmp_path: Path) -> Any:
    """The first two panoramas of the chain: an :class:`interpolation_samples.Hall`."""
    return _hall(tmp_path, 2)


@pytest.fixture
def chain(tmp_path: Path) -> Any:
    """All three panoramas of the chain: an :class:`interpolation_samples.Hall`."""
    return _hall(tmp_path, 3)


def _hall(folder: Path, count: int) -> Any:
    from interpolation_samples import CHAIN, Hall
    from synthesis_samples import write_hall

    return Hall(folder, write_hall(folder, CHAIN[:count]))


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Small tensors: a second thread of torch costs more than it brings, the more so on a busy machine."""
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)
