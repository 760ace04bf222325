# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The optional compiled kernel, called through ctypes; its C code lies beside the modules that call it.

:func:`library` is None if the installation had no compiler, or if ``PENDUBOT_KERNEL=off`` is set. Then numpy computes
the same results more slowly.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ctypes import CDLL

#: Version of the kernel's functions; a library of another version is not used.
VERSION = 11
#: Number of lanes of a block of work; least work of a thread [ns].
BLOCK = 8
WORTH_A_THREAD = 3e5

#: Settings from the environment: whether to use the kernel, and its largest number of threads (0: one on each core that
#: this process may use). Results do not depend on the number of threads.
wanted = True
threads = 0
cores = 1


def library() -> CDLL | None:
    """Return the kernel, whose pointers are addresses of C-ordered arrays; None if it is missing or not wanted."""
    return _library() if wanted else None


def description() -> str:
    """Return a text on the implementation in use."""
    if not wanted:
        return 'numpy (the compiled kernel is switched off by PENDUBOT_KERNEL)'
    if library() is None:
        return 'numpy (there is no compiled kernel of this version: install the package again, with a C compiler)'
    return 'compiled kernel'


@cache
def _library() -> CDLL | None:
    return opened('_kernel_avx512') or opened('_kernel')


def opened(name: str) -> CDLL | None:
    """Return a kernel; None if it is missing or this processor cannot run it. All kernels give the same numbers."""
    # Imported here, because the command line's --help does not need them.
    from ctypes import CDLL, c_double, c_int64, c_void_p
    from importlib.machinery import PathFinder
    from sys import modules

    # Only beside this package, because the kernel of another installation has other C code.
    spec = PathFinder.find_spec(f'{__package__}.{name}', modules[__package__].__path__)
    if spec is None or spec.origin is None:
        return None
    try:
        kernel = CDLL(spec.origin)
        kernel.pendubot_version.restype = c_int64
        if kernel.pendubot_version() != VERSION:
            return None
        sizes, pointer = c_int64, c_void_p
        kernel.pendubot_roll.argtypes = [*[sizes] * 4, c_double, *[pointer] * 5]
        kernel.pendubot_sensitivities.argtypes = [*[sizes] * 5, c_double, *[pointer] * 5]
        kernel.pendubot_filter.argtypes = [sizes, sizes, pointer]
        kernel.pendubot_mde.argtypes = [*[pointer] * 6, sizes, *[pointer] * 3]
    except (OSError, AttributeError):
        return None  # built for another processor, or of another version
    return kernel


def share(function: Any, blocks: int, nanoseconds: float, *arguments: Any) -> None:
    """Call ``function(begin, end, *arguments)`` for all blocks of work, which take ``nanoseconds`` each, on threads."""
    from concurrent.futures import ThreadPoolExecutor

    parts = max(1, min(threads or cores, blocks, int(blocks * nanoseconds / WORTH_A_THREAD)))
    if parts == 1:
        function(0, blocks, *arguments)
        return
    edges = [blocks * k // parts for k in range(parts + 1)]
    with ThreadPoolExecutor(parts) as pool:
        list(pool.map(lambda begin, end: function(begin, end, *arguments), edges, edges[1:]))
