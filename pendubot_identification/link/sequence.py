# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Sequence numbers (u16, wrapping) of the frames that come."""

from __future__ import annotations

from .events import Counters


class Sequence:
    """Counts frames that are lost, that come twice in a row, and that come after a later one.

    One that comes too late stays lost, since it is not used.
    """

    def __init__(self, counters: Counters) -> None:
        self._counters = counters
        self._last: int | None = None
        self._gap = False
        self._lost_in_gap = 0

    def begin(self) -> None:
        """Forget the last number: the sender begins anew. So nothing was lost in a gap that is not confirmed."""
        self._counters.lost -= self._lost_in_gap
        self._lost_in_gap = 0
        self._last = None

    def allow_gap(self) -> None:
        """Take the next frame as later than the last: during a silence the numbers may go more than half round."""
        self._gap = True

    def confirm_gap(self) -> None:
        """Note that the sender is the same as before the gap: what is missing was lost."""
        self._lost_in_gap = 0

    def follows(self, seq: int) -> bool:
        """Return whether this is the next number, or the first."""
        return self._last is None or seq == (self._last + 1) & 0xFFFF

    def accept(self, seq: int, later: bool) -> bool:
        """Count a frame; return whether to use it: it is neither a duplicate nor too late.

        ``later`` says that by its clock it was sent after the last.
        """
        step = 1 if self._last is None else (seq - self._last) & 0xFFFF
        if step == 0:
            self._counters.duplicates += 1
            return False
        if step >= 0x8000 and not (self._gap or later):
            self._counters.out_of_order += 1
            return False
        self._last = seq
        self._counters.lost += step - 1
        if self._gap:
            self._gap, self._lost_in_gap = False, step - 1
        return True
