"""Returns the memory of large arrays to the operating system.

The GNU C library maps an array by itself, and unmaps it when it is freed, if the array is larger than a
bound. The library raises the bound to the size of each mapped array that is freed, up to 32 MB. Smaller
arrays then share one heap, whose pages below any array in use stay with the process.
"""

import ctypes
import os
import sys
from functools import cache

LARGE, KEPT = 4 << 20, 32 << 20
"""Size of arrays that are mapped by themselves, bytes; and free memory at the heap's end that is kept."""

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Parameters of ``mallopt``, from malloc.h."""


@cache
def return_large_arrays() -> bool:
    """Fix the bound at ``LARGE`` for the whole process; return whether the C library does so.

    Bounds in the environment, ``MALLOC_MMAP_THRESHOLD_`` or ``GLIBC_TUNABLES``, have precedence. Other C
    libraries stay as they are.
    """
    tunables = os.environ.get("GLIBC_TUNABLES", "")
    if "MALLOC_MMAP_THRESHOLD_" in os.environ or "malloc.mmap_threshold" in tunables:
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    return mallopt is not None and bool(mallopt(_MMAP_THRESHOLD, LARGE) and mallopt(_TRIM_THRESHOLD, KEPT))
