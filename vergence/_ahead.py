"""Compile kernels in a second process while the first one compiles others.

Numba compiles in one thread. If nothing is cached yet and there is a second processor, another
process compiles the kernels that a command needs later, into the cache that both share.
"""

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Final

from vergence._jit import GufuncKernel, any_compiled, cache_folder

_STARTED_PROCESSES: Final[list["subprocess.Popen[bytes]"]] = []
"""Started processes, kept because Python warns if a running one is garbage-collected."""


def compile_in_background(kernel_paths: Sequence[str]) -> None:
    """Start a process that compiles kernels; nothing waits for it or depends on it.

    Args:
        kernel_paths: names `module:function` of kernels, or of functions that compile something, in
            the order in which they are needed.
    """
    if cache_folder() is None or any_compiled() or _processors() < 2:
        return
    try:
        process = subprocess.Popen(
            [sys.executable, "-m", __name__, *kernel_paths],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError:  # the kernels are then compiled at their first call
        return
    _STARTED_PROCESSES.append(process)


def _processors() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def compiler_of(kernel_path: str) -> Callable[[], None]:
    """Compile method of the kernel that `module:function` names, or the function it names."""
    module, _, attribute = kernel_path.partition(":")
    named: GufuncKernel | Callable[[], None] = getattr(import_module(module), attribute)
    return named.compile if isinstance(named, GufuncKernel) else named


if __name__ == "__main__":
    for word in sys.argv[1:]:
        compiler_of(word)()
