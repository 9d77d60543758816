"""Compiles kernels in a second process while the first one has others to compile.

Numba compiles in one thread. Where nothing is cached yet and there is another processor, kernels
that a command needs later are made there, into the cache that both share.
"""

import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Final

from vergence._jit import Kernel, cache_folder

_RUNNING: Final[list["subprocess.Popen[bytes]"]] = []
"""Processes that Python would warn of if they were forgotten."""


def compile_ahead(kernels: Sequence[str]) -> None:
    """Let another process compile kernels; nothing waits for it, and nobody needs it.

    Args:
        kernels: their names, `module:function`, or those of functions that compile something;
            those that are needed first before the others.
    """
    folder = cache_folder()
    if folder is None or any(folder.rglob("*.nbi")) or _processors() < 2:
        return
    try:
        process = subprocess.Popen(
            [sys.executable, "-m", __name__, *kernels],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except OSError:  # then they are compiled when they are called
        return
    _RUNNING.append(process)


def _processors() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def compiler_of(name: str) -> Callable[[], None]:
    """What compiles the kernel, or what the function does, that `module:function` names."""
    module, _, attribute = name.partition(":")
    named: Kernel | Callable[[], None] = getattr(import_module(module), attribute)
    return named.compile if isinstance(named, Kernel) else named


if __name__ == "__main__":
    for word in sys.argv[1:]:
        compiler_of(word)()
