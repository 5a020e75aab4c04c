"""The same batch on Ray: two nodes on this machine, one of them killed midway, and the same bytes."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from batch_samples import contents, line, records, write_lines, write_row

import omnisyn_cli
from omnisyn_cli.batch.executor import RayExecutor, Work
from omnisyn_cli.errors import InputError

pytest.importorskip("ray", reason="Ray is not installed (omnisyn-cli[ray])")
pytestmark = pytest.mark.filterwarnings("ignore")
PATIENCE_SECONDS = 240  # within which some job has to end


@pytest.fixture
def cluster(monkeypatch):
    """A head without processors, which the command connects to, and nodes to be added and killed."""
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(Path(omnisyn_cli.__file__).parents[1]), *sys.path]))
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    store = {"object_store_memory": 80 << 20}
    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False, **store})
    made.small_node = lambda: made.add_node(num_cpus=1, **store)
    yield made
    made.shutdown()


def start(folder: Path, output: Path, *more: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-P", "-m", "omnisyn_cli", "batch", str(folder / "jobs.jsonl"), "-o", str(output)]
    return subprocess.Popen(
        [*command, "--threads", "1", *more], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder
    )


def wait_until(holds: Callable[[], bool], output: Path) -> None:
    """Goes on as long as jobs end every now and then, however slow the machine is."""
    ended, end = -1, 0.0
    while not holds():
        if (count := len(ended_jobs(output))) > ended:
            ended, end = count, time.monotonic() + PATIENCE_SECONDS
        assert time.monotonic() < end, f"{ended} jobs have ended, and none for {PATIENCE_SECONDS} s"
        time.sleep(0.05)


def leave(process: subprocess.Popen[str], output: Path) -> tuple[int, str]:
    wait_until(lambda: process.poll() is not None, output)
    return process.returncode, "".join(process.communicate())


def ended_jobs(output: Path) -> list[dict[str, Any]]:
    return records(output) if (output / "results.jsonl").exists() else []


def workers(folder: Path) -> set[str]:
    """Those that have ended a job."""
    return {record["worker"] for record in ended_jobs(folder)}


def test_a_node_that_dies_midway_takes_nothing_with_it(tmp_path, cluster):
    """The other node does what the lost one had begun, and no worker imports from the folder of the caller."""
    (tmp_path / "numpy.py").write_text("raise ImportError('from the current directory')")
    write_row(tmp_path, 4, size=(64, 128))
    pairs = [(a, b) for a in range(4) for b in range(4) if a != b]
    write_lines(tmp_path / "jobs.jsonl", [line(a, b, frames=20, size="512x256") for a, b in pairs])
    calm = start(tmp_path, tmp_path / "calm", "--workers", "1")
    nodes = [cluster.small_node() for _ in range(2)]
    assert leave(calm, tmp_path / "calm")[0] == 0
    process = start(tmp_path, tmp_path / "out", "--engine", "ray", "--ray-address", cluster.address, "--json")
    wait_until(lambda: len(workers(tmp_path / "out")) > 1 or process.poll() is not None, tmp_path / "out")
    assert process.poll() is None, process.communicate()
    cluster.remove_node(nodes[0], allow_graceful=False)
    assert len(records(tmp_path / "out")) < len(pairs), "it was too fast for a node to be killed in the middle"
    code, words = leave(process, tmp_path / "out")
    assert code == 0, words
    assert json.JSONDecoder().raw_decode(words, words.index("{"))[0]["done"] == len(pairs)  # progress follows
    assert contents(tmp_path / "out") == contents(tmp_path / "calm")
    assert sorted(record["id"] for record in records(tmp_path / "out")) == sorted(f"{a}-{b}" for a, b in pairs)
    assert max(record["attempts"] for record in records(tmp_path / "out")) == 2, "nothing was lost with the node"


def test_a_cluster_that_is_not_there_is_refused_in_one_line(monkeypatch):
    """Ray itself takes a minute and a half to find that out, so its words are put in its mouth."""

    def init(**arguments: Any) -> None:
        raise RuntimeError(f"nobody at {arguments['address']}\nmore of it")

    monkeypatch.setattr("ray.init", init)
    with pytest.raises(InputError) as raised, RayExecutor(Work("nothing:at_all"), 1, 1, address="127.0.0.1:1"):
        pass
    message = "expected a Ray cluster at 127.0.0.1:1, got 'nobody at 127.0.0.1:1'; check --ray-address"
    assert str(raised.value) == message
