"""The inside of a worker: the work function, made once, and answers instead of exceptions."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import platform
import threading
import traceback
from collections.abc import Callable
from typing import Any

from omnisyn_cli.batch.engine import Answer, Work
from omnisyn_cli.errors import OmnisynError

__all__ = ["Performer", "end_with_parent", "limit_threads"]

THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class Performer:
    """Calls the work function, which is made at the first call.

    Args:
        work: what to do.
    """

    def __init__(self, work: Work) -> None:
        self._work = work
        self._function: Callable[[Any], Any] | None = None
        self._name = f"{platform.node()}:{os.getpid()}"

    def __call__(self, payload: Any) -> Answer:
        """The value for a payload, or the error that it ended with; only signals get through."""
        try:
            if self._function is None:
                self._function = _made(self._work)
            return Answer(self._function(payload), None, None, self._name)
        except OmnisynError as error:
            return Answer(None, " ".join(str(error).splitlines()), None, self._name)
        except Exception as error:  # noqa: BLE001  whatever it is, the other jobs go on; the traceback is kept
            message = f"{type(error).__name__}: {error}"
            return Answer(None, " ".join(message.splitlines()), traceback.format_exc(), self._name)


def limit_threads(threads: int) -> None:
    """Cap libraries that read their number of threads when they are loaded; call it before they are."""
    for name in THREAD_VARIABLES:
        os.environ.setdefault(name, str(threads))


def end_with_parent() -> None:
    """End this process with the one that started it, in the middle of whatever is done: nobody wants it any more."""
    threading.Thread(target=_outlive_nobody, daemon=True).start()


def _outlive_nobody() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _made(work: Work) -> Callable[[Any], Any]:
    module, _, name = work.factory.partition(":")
    function: Callable[[Any], Any] = getattr(importlib.import_module(module), name)(work.settings)
    return function
