# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The optional compiled kernel, called through ctypes: the C beside the modules that call it.

:func:`library` is None where no compiler was there at installation, or ``PENDUBOT_KERNEL=off`` is set: then numpy does
the same, slower.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ctypes import CDLL

#: Of the kernel's functions; a library of another version is not used.
VERSION = 8

#: Set by the package from the environment: whether to use the kernel, and on how many threads at most (0: one on each
#: core that this process may use). Results do not depend on the threads.
wanted = True
threads = 0


def library() -> CDLL | None:
    """Return the kernel, whose pointers are addresses of C-ordered arrays; None where it is not there or not wanted."""
    return _library() if wanted else None


def description() -> str:
    """Say which path is taken, for people."""
    if not wanted:
        return 'numpy (the compiled kernel is switched off by PENDUBOT_KERNEL)'
    return 'compiled kernel' if library() is not None else 'numpy (no compiled kernel: there was no C compiler)'


@cache
def _library() -> CDLL | None:
    return opened('_kernel_avx512') or opened('_kernel')


def opened(name: str) -> CDLL | None:
    """Return one kernel; None where it is not there or this processor cannot run it. All give the same numbers."""
    # Imported here, because the command line's --help needs neither.
    from ctypes import CDLL, c_double, c_int64, c_void_p
    from importlib.machinery import PathFinder
    from sys import modules

    # Only beside this package: another installation's is made from other C.
    spec = PathFinder.find_spec(f'{__package__}.{name}', modules[__package__].__path__)
    if spec is None or spec.origin is None:
        return None
    try:
        found = CDLL(spec.origin)
        found.pendubot_version.restype = c_int64
        if found.pendubot_version() != VERSION:
            return None
        sizes, pointer = c_int64, c_void_p
        found.pendubot_roll.argtypes = [*[sizes] * 5, c_double, *[pointer] * 4]
        found.pendubot_sensitivities.argtypes = [*[sizes] * 5, c_double, *[pointer] * 4]
        found.pendubot_filter.argtypes = [sizes, pointer]
        found.pendubot_mde.argtypes = [pointer, sizes, *[pointer] * 7]
        found.pendubot_mde.restype = c_int64
        for function in ('roll', 'sensitivities', 'filter'):
            getattr(found, f'pendubot_{function}').restype = None
    except (OSError, AttributeError):
        return None  # made for another processor, or for another version
    return found
