"""Memory that array programs free and want again at once, kept by the process."""

import ctypes

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # numbers of mallopt(3)
_KEPT_BYTES = 100_000_000


def keep_freed_memory() -> bool:
    """Let this process keep up to 100 MB of what it frees, instead of returning it page by page.

    Every temporary array of numpy above 128 kB is otherwise mapped, cleared and unmapped by the
    system, which takes longer than filling it: a batched filter step then costs two to six times as
    much. A process that computes many lanes calls this function once.

    Returns:
        Whether the C library can be told (glibc); elsewhere nothing happens.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        return False
    return bool(mallopt(_TRIM_THRESHOLD, _KEPT_BYTES) and mallopt(_MMAP_THRESHOLD, _KEPT_BYTES))
