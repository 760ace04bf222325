"""Frames to a descriptor that does not block: a frame that is cut short never takes the next one along."""

from __future__ import annotations

import contextlib
import os


class FrameWriter:
    """Writes frames at once, or drops them: a late torque or sample is worth less than none."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._cut = False

    def write(self, data: bytes) -> bool:
        """Write; return whether all of it went out.

        Raises:
            OSError: the device is gone.
        """
        # A delimiter ends what is left of a frame that was cut short.
        data = b'\0' + data if self._cut else data
        sent = 0
        with contextlib.suppress(BlockingIOError):
            sent = os.write(self._descriptor, data)
        complete = sent == len(data)
        self._cut = not complete and (self._cut or sent > 0)
        return complete
