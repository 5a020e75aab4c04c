"""Worker processes that import nothing from the current directory.

Workers are started as ``python -c``, which looks for modules in the current directory first. That may be a folder that
somebody else has made, with a ``pickle.py`` in it.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess

# Of the environment: an interpreter with it leaves the current directory out of its search path.
SAFE_PATH_VARIABLE = "PYTHONSAFEPATH"


@contextmanager
def environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Processes that are started inside have these variables in their environment."""
    former = {name: os.environ[name] for name in variables if name in os.environ}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name in variables:
            del os.environ[name]
        os.environ.update(former)


def safe_path() -> AbstractContextManager[None]:
    """Interpreters that are started inside do not look for modules in the current directory."""
    return environment({SAFE_PATH_VARIABLE: "1"})


class _SafeProcess(SpawnProcess):
    def start(self) -> None:
        with safe_path():
            super().start()


class _SafeContext(SpawnContext):
    Process = _SafeProcess


def spawn_context() -> SpawnContext:
    """What starts worker processes afresh, so that none inherits threads, locks or a search path to be wary of."""
    if os.name == "posix":  # queues and locks need this helper, an interpreter too, which lives as long as the program
        with safe_path():
            resource_tracker.ensure_running()
    return _SafeContext()
