"""Large blocks of memory are mapped one by one, also after larger blocks were freed."""

import ctypes
import subprocess
import sys

import pytest

from ngvisco.algebra import memory

PROGRAM = """
import ctypes, runpy, sys

libc, memory = ctypes.CDLL(None), runpy.run_path(sys.argv[1])
names = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost".split()
Heap = type("Heap", (ctypes.Structure,), {"_fields_": [(name, ctypes.c_size_t) for name in names]})
libc.mallinfo2.restype, libc.malloc.restype, libc.free.argtypes = Heap, ctypes.c_void_p, [ctypes.c_void_p]
assert memory["return_large_arrays"]()
before = libc.mallinfo2().hblks
libc.free(libc.malloc(5 * memory["LARGE"]))
large, small = libc.malloc(2 * memory["LARGE"]), libc.malloc(memory["LARGE"] // 2)
print(libc.mallinfo2().hblks - before)
libc.free(large)
print(libc.mallinfo2().hblks - before)
"""


@pytest.mark.skipif(
    sys.platform != "linux" or not hasattr(ctypes.CDLL(None), "mallinfo2"), reason="not the GNU C library"
)
def test_a_large_block_has_a_memory_map_of_its_own_after_a_larger_block_was_freed():
    """The test has its own process, because blocks that fit a heap's free memory are taken from the heap."""
    command = [sys.executable, "-c", PROGRAM, memory.__file__]
    result = subprocess.run(command, capture_output=True, text=True, check=True, env={})
    assert result.stdout.split() == ["1", "0"]


def test_a_memory_threshold_set_in_the_environment_is_kept(monkeypatch):
    for name, value in (
        ("MALLOC_MMAP_THRESHOLD_", "1000000"),
        ("GLIBC_TUNABLES", "glibc.malloc.mmap_threshold=100"),
    ):
        with monkeypatch.context() as patch:
            patch.setenv(name, value)
            assert not memory.return_large_arrays.__wrapped__()
