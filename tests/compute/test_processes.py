"""Worker processes run nothing that happens to lie in the current directory."""

import ast
import subprocess
import sys
from pathlib import Path

import omnisyn_cli

PACKAGE = Path(omnisyn_cli.__file__).parent

PROGRAM = """
import os
from concurrent.futures import ProcessPoolExecutor

from omnisyn_cli.compute.processes import spawn_context

if __name__ == "__main__":
    with ProcessPoolExecutor(1, mp_context=spawn_context()) as pool:
        assert pool.submit(os.getpid).result() != os.getpid()
    ours, theirs = spawn_context().Pipe()
    process = spawn_context().Process(target=theirs.send, args=("alive",))
    process.start()
    assert ours.recv() == "alive"
    process.join()
    assert "PYTHONSAFEPATH" not in os.environ
"""

SHADOWS = ("pickle", "signal", "struct", "threading", "traceback", "socket")
"""Modules of the standard library that every worker imports."""


def test_workers_import_nothing_from_the_current_directory(tmp_path: Path) -> None:
    folder = tmp_path / "downloaded"
    folder.mkdir()
    for name in SHADOWS:
        (folder / f"{name}.py").write_text(f"open('ran', 'a').write('{name} ')\nraise ImportError\n")
    (tmp_path / "program.py").write_text(PROGRAM)
    done = subprocess.run(
        [sys.executable, tmp_path / "program.py"], cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert not (folder / "ran").exists()


def test_interpreters_are_started_with_a_safe_path_only() -> None:
    """Pools and processes are asked of ``spawn_context``; who starts Python itself does so inside ``safe_path``."""
    for path in sorted(PACKAGE.rglob("*.py")):
        if path == PACKAGE / "compute" / "processes.py":
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        contexts = (node for node in ast.walk(tree) if isinstance(node, ast.With))
        safe = [node for node in contexts if "safe_path()" in map(ast.unparse, (i.context_expr for i in node.items))]
        allowed = {id(node) for context in safe for node in ast.walk(context)}
        for node in ast.walk(tree):
            name = node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
            assert name not in ("get_context", "set_start_method"), f"{path}:{node.lineno}"
            assert name != "executable" or id(node) in allowed, f"{path}:{node.lineno}"
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("ProcessPoolExecutor"):
                assert "mp_context=spawn_context()" in ast.unparse(node), f"{path}:{node.lineno}"
