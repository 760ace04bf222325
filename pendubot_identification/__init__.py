# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Identification of a pendubot: from the board's bytes to a latched parameter vector.

Scripts and notebooks import the names of :mod:`.api` from here; __init__.pyi lists them for type checkers.
"""

import os
from typing import Any

from . import kernel

__version__ = '1.0.0'
#: Names of api.py, which is imported at their first use because the import is slow.
__all__ = [
    'HANGING',
    'UPRIGHT',
    'Identified',
    'Level',
    'Parameters',
    'Pendubot',
    'PendubotError',
    'Trajectory',
    'accelerations',
    'check',
    'compare',
    'describe',
    'identify',
    'read',
    'simulate',
]

kernel.wanted = os.environ.get('PENDUBOT_KERNEL', 'on') != 'off'
kernel.threads = int(given) if (given := os.environ.get('PENDUBOT_THREADS', '')).isdecimal() else 0
kernel.cores = len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else os.cpu_count() or 1


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    from importlib import import_module

    return getattr(import_module('.api', __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
