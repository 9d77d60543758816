"""Inner loops compiled by numba, kept on disk, and called with many arrays at little cost."""

from vergence.kernels.jit import (
    GufuncKernel,
    compiled,
    compiled_for_threads,
    inlined,
    kernel,
    subroutine,
    untyped_tuple,
)
from vergence.kernels.tables import make_table, make_tuple_reader, unpack_table

__all__ = [
    "GufuncKernel",
    "compiled",
    "compiled_for_threads",
    "inlined",
    "kernel",
    "make_table",
    "make_tuple_reader",
    "subroutine",
    "unpack_table",
    "untyped_tuple",
]
