"""Frames made on an NVIDIA GPU, by kernels in numba-cuda: the same pictures as the processor's."""

from importlib.util import find_spec

from omnisyn_cli.errors import InputError


def has_device(name: str) -> bool:
    """Whether a GPU makes frames: for ``auto`` if there is one, for ``cuda`` always. InputError: there is none."""
    missing = "" if name == "cpu" else _what_is_missing()
    if name == "cuda" and missing:
        raise InputError(f"expected a GPU for the frames, got {missing}, or use --device cpu")
    return name != "cpu" and not missing


def _what_is_missing() -> str:
    """What stands against kernels on a GPU here, and what to do; empty if nothing does."""
    from numba import config

    if find_spec("numba_cuda") is None and not config.ENABLE_CUDASIM:
        return "no numba-cuda; install 'omnisyn-cli[cuda]'"
    try:
        from numba import cuda  # takes a while to import

        return "" if cuda.is_available() else "no NVIDIA GPU with a driver for CUDA 12; install one"
    except (ImportError, AttributeError) as error:  # numba-cuda and numpy that do not fit
        return f"a numba-cuda that does not load ({error}); install 'omnisyn-cli[cuda]'"
