"""What there is to say about the machine before the work: memory that is short, and what killed runs have left."""

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

BYTES_PER_GB = 1e9
"""Decimal, as everywhere in messages."""

CGROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")
"""Where Linux says what a container may have: bytes, or ``max``."""


def memory_notes(expected: float) -> Iterator[str]:
    """What there is to say if ``expected`` bytes are more than this process may have."""
    limit = memory_limit()
    if limit is None or expected <= limit:
        return
    yield (
        f"expected {expected / BYTES_PER_GB:.1f} GB of memory, got a limit of {limit / BYTES_PER_GB:.1f}; the system "
        "may end this program: take a smaller --size or fewer --threads"
    )


def memory_limit() -> int | None:
    """The least of what there is, what its container may have, and what its user's limits allow, in bytes.

    None where nobody says.
    """
    limits = []
    with suppress(ImportError, OSError):
        import resource

        soft = (resource.getrlimit(limit)[0] for limit in (resource.RLIMIT_AS, resource.RLIMIT_DATA))
        limits += [limit for limit in soft if limit != resource.RLIM_INFINITY]
    with suppress(OSError, ValueError):
        limits.append(int(CGROUP_LIMIT.read_text(encoding="ascii")))
    with suppress(AttributeError, OSError, ValueError):
        limits.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    return min(limits, default=None)


def leftover_notes(output: Path, pictures: Path | None = None) -> Iterator[str]:
    """What runs that were killed have left where an output goes and anywhere in ``pictures``, and how to remove it."""
    import shlex

    from omnisyn_cli.io.outputs import abandoned

    deeper = sorted(pictures.glob("**/")) if pictures else []
    found = [left for folder in (output.parent, output, *deeper) for left in abandoned(folder)]
    if found:
        names = " ".join(shlex.quote(str(path)) for path in found)
        yield f"runs that were killed have left hidden files; nothing needs them, remove them with: rm -r {names}"
