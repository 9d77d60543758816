"""Simulated heads, and the threads that step parts of a batch at the same time.

A head's step reads and writes its own rows only, and its noise is a function of seed, trial and
step, so results do not depend on the number of threads.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from itertools import pairwise
from typing import Any

from vergence.envs.streams import IntArray

_most_threads = 0


def limit_threads(most: int) -> None:
    """Step no batch of this process in more threads than these; 0 for one per processor."""
    global _most_threads
    _most_threads = most


@cache
def processors() -> int:
    """Number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(1, processors() - 1), "heads")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)  # a child has none of the threads


def bounds(count: int, least: int, most: int = 0) -> tuple[int, ...]:
    """First heads of contiguous parts, one per thread that is worth it, and at last `count`."""
    parts = min(most or _most_threads or processors(), count // least)
    if parts < 2:
        return 0, count
    return tuple(count * part // parts for part in range(parts + 1))


def advance_in_threads(
    advance: Callable[..., bool], table: Any, ids: IntArray, *arguments: Any, at: tuple[int, ...]
) -> bool:
    """Call a compiled function without Python's lock for parts of a batch; True if each gave it."""
    if len(at) == 2:
        return advance(table, ids, *arguments)
    submit = partial(_pool().submit, advance, table)
    others = [submit(ids[begin:end], *arguments) for begin, end in pairwise(at[1:])]
    done = [advance(table, ids[: at[1]], *arguments)]
    done += [other.result() for other in others]  # all of them, whatever the first one says
    return all(done)
