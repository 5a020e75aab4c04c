"""How much memory this process may have, so that what will not fit is said before the work and not after it."""

import os
from contextlib import suppress
from pathlib import Path

BYTES_PER_GB = 1e9

CGROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")
"""Where Linux says what a container may have: bytes, or ``max``."""


def memory_note(expected: float) -> str | None:
    """What there is to say if ``expected`` bytes are more than this process may have."""
    limit = memory_limit()
    if limit is None or expected <= limit:
        return None
    return (
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
