# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The limits at which the motor is switched off: the board checks them first, the host checks them again.

All quantities are integers in the units of the protocol, so that firmware and host compute the same values.
"""

from .protocol import Limits, State, Status

#: 2 pi, in 1e-9.
TAU_NANO = 6_283_185_307
#: Number of consecutive fast samples that trip: one wrong encoder sample causes two.
FAST_SAMPLES = 3
#: Largest movement of a shoulder that stands still [counts].
STILL_COUNTS = 2


class LimitMonitor:
    """Checks each sample against the limits; ``counts_per_turn`` is (shoulder, elbow)."""

    def __init__(self, limits: Limits, counts_per_turn: tuple[int, int]) -> None:
        self._limits = limits
        self._counts_per_turn = counts_per_turn
        self._before: tuple[int, int] | None = None
        self._fast = 0
        self._still_at = 0
        self._still_us = 0
        self._heat = 0  # integral of the squared current above the continuous current [mA^2 us]

    def check(self, sample: State, elapsed_us: int, torque: int) -> int:
        """Return the status bits of the limits that a sample exceeds.

        Args:
            sample: the sample; only ``enc1``, ``enc2``, ``current`` and ``vbus`` are used.
            elapsed_us: time since the previous sample [us].
            torque: torque during that time [micro-N m].
        """
        limits, status = self._limits, 0
        travels = (sample.enc1, limits.max_travel1), (sample.enc2, limits.max_travel2)
        before, self._before = self._before or (sample.enc1, sample.enc2), (sample.enc1, sample.enc2)
        fast = False
        for (counts, travel), last, per_turn in zip(travels, before, self._counts_per_turn, strict=True):
            fast |= abs(counts - last) * TAU_NANO > limits.max_speed * elapsed_us * per_turn
            if travel and abs(counts) * TAU_NANO > travel * per_turn * 1_000_000:
                status |= Status.TRAVEL
        self._fast = min(self._fast + 1, FAST_SAMPLES) if limits.max_speed and fast else 0
        if self._fast == FAST_SAMPLES:
            status |= Status.SPEED
        status |= self._stall(sample.enc1, elapsed_us, torque) | self._overload(sample.current, elapsed_us)
        if limits.max_vbus and sample.vbus > limits.max_vbus:
            status |= Status.OVERVOLTAGE
        return status

    def _stall(self, counts: int, elapsed_us: int, torque: int) -> int:
        limits = self._limits
        longest = 1000 * limits.stall_ms
        if not limits.stall_torque or abs(torque) < limits.stall_torque or abs(counts - self._still_at) > STILL_COUNTS:
            self._still_at, self._still_us = counts, 0
            return 0
        self._still_us = min(self._still_us + elapsed_us, longest)
        return Status.STALL if longest and self._still_us == longest else 0

    def _overload(self, current: int, elapsed_us: int) -> int:
        bearable = self._limits.continuous_ma**2
        limit = 3 * bearable * self._limits.overload_ms * 1000
        self._heat = min(max(self._heat + (current**2 - bearable) * elapsed_us, 0), limit)
        return Status.OVERLOAD if limit and self._heat == limit else 0
