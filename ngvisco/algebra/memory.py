"""Returns the memory of large arrays to the operating system.

The GNU C library maps each array above a bound by itself, and unmaps the array when it is freed. The library
raises the bound to the size of each mapped array that is freed, up to 32 MB. Smaller arrays then share one
heap. The process keeps all pages of the heap below an array in use.
"""

import ctypes
import os
import sys
from functools import cache

LARGE, KEPT = 4 << 20, 32 << 20
"""Least size of arrays that are mapped by themselves, and size of the free memory kept at the heap's end,
bytes."""

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Parameters of ``mallopt``, from malloc.h."""


@cache
def return_large_arrays() -> bool:
    """Fix the bound at ``LARGE`` for the whole process; return whether the C library does so.

    Bounds in the environment, ``MALLOC_MMAP_THRESHOLD_`` or ``GLIBC_TUNABLES``, have precedence. With
    other C libraries the function changes nothing.
    """
    tunables = os.environ.get("GLIBC_TUNABLES", "")
    if "MALLOC_MMAP_THRESHOLD_" in os.environ or "malloc.mmap_threshold" in tunables:
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    return mallopt is not None and bool(mallopt(_MMAP_THRESHOLD, LARGE) and mallopt(_TRIM_THRESHOLD, KEPT))
