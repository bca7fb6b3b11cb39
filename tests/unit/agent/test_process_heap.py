"""Memory of the service process that nobody uses is shared by all threads and given back."""

from __future__ import annotations

import ctypes
import subprocess
import sys

import pytest
from aloud import NOT_HERE

ARENAS = """
import ctypes, os, re, sys, tempfile, threading
libc = ctypes.CDLL(None)
libc.fdopen.restype = ctypes.c_void_p
libc.malloc.restype = ctypes.c_void_p
if sys.argv[1] == "shared":
    from agent.service.owner.process_heap import share_one_heap
    share_one_heap()
together = threading.Barrier(8)

def allocate():
    together.wait()  # each thread has an arena before one of them ends
    libc.malloc(1000)
    together.wait()

threads = [threading.Thread(target=allocate) for _ in range(8)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
with tempfile.TemporaryFile() as file:
    stream = ctypes.c_void_p(libc.fdopen(os.dup(file.fileno()), b"w"))
    libc.malloc_info(0, stream)
    libc.fclose(stream)
    file.seek(0)
    print(len(re.findall(rb"<heap nr", file.read())))
"""
FREED = """
import ctypes, resource, sys
from agent.service.owner.process_heap import release_free_memory
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p

def resident_mb():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 1e6

blocks = [libc.malloc(4000) for _ in range(50_000)]
for block in blocks:
    ctypes.memset(ctypes.c_void_p(block), 1, 4000)
for block in blocks[:-1]:  # the last one is at the end of the heap and keeps the others in it
    libc.free(ctypes.c_void_p(block))
before = resident_mb()
release_free_memory()
print(before - resident_mb())
"""


@pytest.fixture(autouse=True)
def glibc() -> None:
    if not hasattr(ctypes.CDLL(None), "malloc_info"):
        pytest.skip(f"{NOT_HERE}: arenas of the C library: it is not glibc")


def printed(program: str, *arguments: str) -> float:
    done = subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=True)
    return float(done.stdout)


def test_all_threads_share_one_arena() -> None:
    assert printed(ARENAS, "as it is") > 1
    assert printed(ARENAS, "shared") == 1


def test_freed_memory_is_given_back() -> None:
    assert printed(FREED) > 150.0
