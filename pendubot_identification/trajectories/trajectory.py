# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A recorded or simulated motion, and the description of its source in a result."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pendubot_identification.arrays import Array, Flags
from pendubot_identification.errors import TrajectoryError

#: Fewest samples for seven parameters after smoothing, with residuals for their uncertainty.
MINIMUM_SAMPLES = 50
#: Values must be smaller, so that sums of their squares are finite.
LARGEST = 1e150


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Samples of one motion, in the order of time.

    Raises:
        TrajectoryError: shapes disagree, a value is not finite or too large, or stamps do not increase.
    """

    t: Array  #: time [s], shape (N,), strictly increasing.
    q: Array  #: joint positions [rad], shape (N, 2): q1 from the horizontal, q2 relative to link 1.
    tau: Array  #: joint torques [N m], shape (N, 2); tau[k] is applied from sample k until sample k+1.
    qd: Array | None = None  #: joint velocities [rad/s], shape (N, 2), or None where none were recorded.
    name: str = 'trajectory'  #: its source, for messages.

    def __post_init__(self) -> None:
        for label in ('t', 'q', 'tau', 'qd'):  # also of lists
            if (given := getattr(self, label)) is not None:
                object.__setattr__(self, label, np.asarray(given, dtype=float))
        n = self.t.size
        if self.t.ndim != 1:
            raise TrajectoryError(f'{self.name}: t has shape {self.t.shape}; ({n},) is expected')
        for label, values in (('q', self.q), ('tau', self.tau), ('qd', self.qd)):
            if values is None:
                continue
            if values.shape != (n, 2):
                raise TrajectoryError(f'{self.name}: {label} has shape {values.shape}; ({n}, 2) is expected')
            bad = np.flatnonzero(~(np.abs(values) < LARGEST).all(axis=1))
            if bad.size:
                found = f'{self.name}: {bad.size} of {n} samples hold a {label} that is not a number below {LARGEST:g}'
                if bad.size == n:
                    raise TrajectoryError(f'{found}; record it for both joints, an effort without a motor as 0')
                raise TrajectoryError(
                    f'{found}, the first at {self.t[bad[0]]:.3f} s; choose a window without them, or leave them out: '
                    'add --skip-missing',
                    skip_missing='true',
                )
        if not np.isfinite(self.t).all():
            raise TrajectoryError(f'{self.name}: a stamp is not a finite number; give every sample a time in seconds')
        wrong = np.flatnonzero(np.diff(self.t) <= 0)
        if wrong.size:
            k = int(wrong[0])
            step = self.t[k + 1] - self.t[k]
            fault = 'repeats' if step == 0 else f'runs backwards by {-step:.6g} s'
            raise TrajectoryError(
                f'{self.name}: the stamp of sample {k + 1} {fault} ({wrong.size} such in {n} samples); stamps must '
                'increase: use the time at which the board sampled, or choose a window without the fault'
            )

    def __len__(self) -> int:
        return len(self.t)

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]; 0 for fewer than two samples."""
        return float(self.t[-1] - self.t[0]) if len(self.t) > 1 else 0.0

    @property
    def interval(self) -> float:
        """The median sampling interval [s]."""
        return float(np.median(np.diff(self.t), overwrite_input=True))

    def __getitem__(self, index: slice | Flags) -> Trajectory:
        qd = None if self.qd is None else self.qd[index]
        return replace(self, t=self.t[index], q=self.q[index], tau=self.tau[index], qd=qd)

    def require_samples(self) -> Trajectory:
        """Return this trajectory. Raises TrajectoryError: it holds fewer than :data:`MINIMUM_SAMPLES`."""
        if len(self) < MINIMUM_SAMPLES:
            expected = f'choose a window of {MINIMUM_SAMPLES} or more'
            raise TrajectoryError(f'{self.name}: {len(self)} samples are too few; {expected}')
        return self


@dataclass(frozen=True)
class Source:
    """A recording, or a part of it, that was used for ``training`` or ``validation``, its ``role``."""

    bag: str
    role: str
    samples: int
    duration: float
    sha256: str
    closed: bool
    taken_as: str = ''  #: conversion options inferred from the names and units in the file.
