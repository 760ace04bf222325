"""Which program holds a port, as Linux tells it."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path


def holders(port: str) -> list[str]:
    """Return, as ``name (process 123)``, the programs that have a device open; those of other users stay hidden."""
    device = os.path.realpath(port)
    found = []
    for process in Path('/proc').glob('[0-9]*'):
        # Processes come and go meanwhile, and others' are not ours to look into.
        with contextlib.suppress(OSError):
            if any(_target(descriptor) == device for descriptor in (process / 'fd').iterdir()):
                found.append(f'{(process / "comm").read_text().strip()} (process {process.name})')
    return found


def _target(descriptor: Path) -> str:
    with contextlib.suppress(OSError):
        return os.readlink(descriptor)
    return ''
