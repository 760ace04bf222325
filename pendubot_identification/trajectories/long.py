# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A recording too long to be held: all of it piece by piece, and stretches of it that stand for the rest."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .signals import on_grid, require_dense, resample, strays
from .trajectory import Trajectory

Array = NDArray[np.float64]

#: A recording of more samples than this, or that lasts longer than this [s], is long: held, with all that is made of
#: it, it would take hundreds of megabytes and minutes.
LONG_SAMPLES, LONG_SECONDS = 200_000, 600.0
#: So many stretches of a long recording, of this length [s], stand for it where all of it is too much.
STRETCHES, STRETCH = 12, 8.0
#: A stretch in which less work was done than this part of the most tells little.
DRIVEN = 0.1
#: A piece's length [s], without what it shares with its neighbours.
PIECE = 10.0
#: Samples after which a cubic spline's end is no longer felt, twice: (2 - sqrt 3)^50 is 1e-29.
SETTLED = 100
#: Samples of which a survey keeps but the earliest and the latest.
THINNED = 100
#: Pieces of which intervals are counted before the counts are added up.
TOGETHER = 50

Read = Callable[[], Iterator[Trajectory]]


def is_long(samples: float, duration: float) -> bool:
    """Tell whether so many samples over so many seconds are too long to be held, and worth being taken in stretches."""
    return duration > LONG_SECONDS or (samples > LONG_SAMPLES and duration > 2 * STRETCHES * STRETCH)


class Piece(NamedTuple):
    """A part of a recording, and what it shares with its neighbours: as recorded, and on the recording's uniform grid.

    ``at`` is the number of its first sample in the recording, ``first`` that of its first place on the grid. The places
    from ``begin`` on and before ``end`` are its own.
    """

    recorded: Trajectory
    at: int
    even: Trajectory
    first: int
    begin: int
    end: int


class Grid(NamedTuple):
    """A held recording on a uniform grid of ``size`` places, ``interval`` [s] apart."""

    name: str
    interval: float
    size: int
    whole: Piece

    def pieces(self, reach: float) -> Iterator[Piece]:
        """Return all of it in one piece."""
        yield self.whole


@dataclass(frozen=True, slots=True)
class Long:
    """A recording that is read again and again, and never held; with what :class:`Grid` has."""

    name: str  #: of the recording.
    read: Read  #: gives its samples from the first on, some thousands at a time.
    samples: int  #: how many there are.
    start: float  #: the first stamp [s].
    last: float  #: the last one [s].
    interval: float  #: of the uniform grid on which it is taken [s].
    size: int  #: places of that grid.
    near: bool  #: whether the stamps lie on it but for their jitter; else positions are interpolated.
    lost: int  #: about how many samples are missing.
    stretches: tuple[Trajectory, ...]  #: in which most work was done, spread as far as it was.

    def __len__(self) -> int:
        return self.samples

    @property
    def duration(self) -> float:
        """Seconds from the first to the last sample."""
        return self.last - self.start

    @property
    def end(self) -> float:
        """The last place of the grid [s]."""
        return self.time(self.size - 1)

    def time(self, place: int) -> float:
        """Return where a place of the grid lies [s]."""
        return self.start + self.interval * place

    def times(self, begin: int, end: int) -> Array:
        """Return where consecutive places lie [s], shape (end - begin,)."""
        return np.asarray(self.start + self.interval * np.arange(begin, end))

    @classmethod
    def survey(cls, name: str, read: Read, duration: float, part: Callable[[float, float], str]) -> Long | None:
        """Read a recording of about ``duration`` [s] once; None where it does not even hold one stretch.

        ``part`` tells what the part of it between two times [s] is called.

        Raises:
            TrajectoryError: samples too far apart, a gap, or stamps that repeat or run backwards.
        """
        stamps = _Stamps(name)
        best: dict[int, tuple[float, Trajectory]] = {}  # in each twelfth the stretch in which most work was done
        most = list[tuple[float, Trajectory]]()  # and those of all
        for stretch in _cut(read(), STRETCH):
            stamps.add(stretch.t)
            if len(stretch) < 2 or stretch.duration < STRETCH - 2 * stretch.interval:
                continue
            # Without any torque, what moves more.
            work = float((np.abs(np.diff(stretch.q, axis=0)) * (np.abs(stretch.tau[:-1]) + 1e-9)).sum())
            twelfth = min(int((stretch.t[0] - stamps.start) / duration * STRETCHES), STRETCHES - 1)
            if twelfth not in best or work > best[twelfth][0]:
                best[twelfth] = work, stretch
            most = sorted([*most, (work, stretch)], key=lambda each: -each[0])[:STRETCHES]
        if not most:
            return None
        enough = DRIVEN * most[0][0]
        found = {float(stretch.t[0]): stretch for work, stretch in best.values() if work >= enough}
        # Where nothing much was done in a twelfth, the best of others take its place.
        for work, stretch in most:
            if len(found) < STRETCHES and work >= enough:
                found[float(stretch.t[0])] = stretch
        stretches = [
            replace(stretch, name=part(round(begin, 3), round(begin, 3) + STRETCH))
            for begin, stretch in sorted(found.items())
        ]
        interval, size, near = stamps.grid()
        return cls(
            name, read, stamps.count, stamps.start, stamps.last, interval, size, near, stamps.lost, tuple(stretches)
        )

    def pieces(self, reach: float) -> Iterator[Piece]:
        """Return the recording piece by piece, each with ``reach`` [s] and more of both neighbours."""
        reach += SETTLED * self.interval
        held, at, begin = list[Trajectory](), 0, 0
        parts = _cut(self.read(), PIECE)
        new = next(parts, None)
        while new is not None:
            held.append(new)
            following = next(parts, None)
            known = (new.t[-1] - reach - self.start) / self.interval
            end = self.size if following is None else min(int(known), self.size - 1)
            if end > begin:
                recorded = _together(held)
                even, first = self._even(recorded, at)
                yield Piece(recorded, at, even, first, begin, end)
                begin = end
                drop = int(np.searchsorted(recorded.t, self.time(begin) - reach))
                held, at = [recorded[drop:]], at + drop
            new = following

    def _even(self, recorded: Trajectory, at: int) -> tuple[Trajectory, int]:
        """Return samples on the recording's grid, and the first place's number."""
        if self.near:
            return replace(recorded, t=self.times(at, at + len(recorded))), at
        first = int(np.ceil((recorded.t[0] - self.start) / self.interval - 1e-9))
        last = min(int((recorded.t[-1] - self.start) / self.interval + 1e-6), self.size - 1)
        return on_grid(recorded, self.times(first, last + 1), self.interval), first


Recording = Trajectory | Long


def gridded(recording: Recording) -> Grid | Long:
    """Return a recording on a uniform grid; what is not long is one piece.

    Raises:
        TrajectoryError: samples too far apart, or a gap too long to be bridged.
    """
    if isinstance(recording, Long):
        return recording
    even = resample(recording)
    size = len(even)
    return Grid(recording.name, even.interval, size, Piece(recording, 0, even, 0, 0, size))


def held_parts(recordings: Sequence[Recording]) -> list[Trajectory]:
    """Return what is held of recordings: the stretches of long ones, and all of others."""
    return [part for r in recordings for part in (r.stretches if isinstance(r, Long) else (r,))]


def sharing(recordings: Sequence[Recording]) -> list[Recording]:
    """Return recordings of which long ones have, together, no more stretches than one alone, but two each at least."""
    several = min(sum(isinstance(r, Long) for r in recordings), STRETCHES // 2)
    return [replace(r, stretches=r.stretches[::several]) if isinstance(r, Long) else r for r in recordings]


class _Stamps:
    """The stamps of a recording as they pass: of intervals and lateness little is kept."""

    def __init__(self, name: str) -> None:
        self._name = name
        self.count, self.start, self.last = 0, np.nan, np.nan
        self._nominal = np.nan
        self._steps: list[tuple[Array, NDArray[np.intp]]] = []
        self._widest, self._widest_at = 0.0, 0.0
        self._extremes: list[Array] = []

    def add(self, t: Array) -> None:
        """Take the stamps [s] that follow."""
        if not self.count:
            self.start, self._nominal = float(t[0]), float(t[-1] - t[0]) / max(len(t) - 1, 1)
            joined = t
        else:
            joined, nothing = np.append(self.last, t), np.zeros((2, 2))
            # Stamps that repeat or run back are refused as those of any motion.
            Trajectory(joined[:2], nothing, nothing, name=f'{self._name}, from {self.last:.3f} s on')
        steps = np.diff(joined)
        if len(steps):
            k = int(np.argmax(steps))
            if steps[k] > self._widest:
                self._widest, self._widest_at = float(steps[k]), float(joined[k])
            self._steps.append(np.unique(steps, return_counts=True))
        if len(self._steps) > TOGETHER:
            self._steps = [self._counted()]
        number = self.count + np.arange(len(t), dtype=float)
        late, groups = t - self.start - self._nominal * number, np.arange(0, len(t), THINNED)
        self._extremes.append(
            np.array([number[groups], np.minimum.reduceat(late, groups), np.maximum.reduceat(late, groups)])
        )
        self.count, self.last = self.count + len(t), float(t[-1])

    def _counted(self) -> tuple[Array, NDArray[np.intp]]:
        """Return which intervals there are, and how many of each."""
        values, place = np.unique(np.concatenate([v for v, _ in self._steps]), return_inverse=True)
        counts = np.bincount(place.ravel(), np.concatenate([c for _, c in self._steps]))
        return values, counts.astype(np.intp)

    @property
    def interval(self) -> float:
        """The median interval [s]."""
        values, counts = self._counted()
        below, total = np.cumsum(counts), self.count - 1
        low, high = (values[np.searchsorted(below, k, side='right')] for k in ((total - 1) // 2, total // 2))
        return float((low + high) / 2)

    @property
    def lost(self) -> int:
        """About how many samples are missing, as :attr:`.Trajectory.lost`."""
        values, counts = self._counted()
        steps = values / self.interval
        longer = max(np.rint((steps * counts).sum()) - counts.sum(), 0)
        return int(min(((np.rint(steps) - 1) * counts)[steps > 1.9].sum(), longer))

    def grid(self) -> tuple[float, int, bool]:
        """Return interval [s] and size of a uniform grid, and whether the stamps lie on it but for their jitter."""
        step = self.interval
        require_dense(self._name, step, self._widest, self._widest_at - self.start)
        spacing = (self.last - self.start) / (self.count - 1)
        number, early, late = np.concatenate(self._extremes, axis=1)
        off = (spacing - self._nominal) * number
        if not strays(max(float((late - off).max()), float((off - early).max())), step):
            return spacing, self.count, True
        return step, int((self.last - self.start) / step + 1e-6) + 1, False


def _cut(parts: Iterable[Trajectory], length: float) -> Iterator[Trajectory]:
    """Return the same samples in parts of ``length`` [s] each, but for the last."""
    waiting = list[Trajectory]()
    for part in parts:
        waiting.append(part)
        if part.t[-1] - waiting[0].t[0] < length:
            continue
        whole = _together(waiting)
        while whole.t[-1] - whole.t[0] >= length:
            end = int(np.searchsorted(whole.t, whole.t[0] + length))
            yield whole[:end]
            whole = whole[end:]
        waiting = [whole]
    if waiting:
        yield _together(waiting)


def _together(parts: Sequence[Trajectory]) -> Trajectory:
    if len(parts) == 1:
        return parts[0]
    t, q, tau = (np.concatenate([getattr(part, name) for part in parts]) for name in ('t', 'q', 'tau'))
    return Trajectory(t, q, tau, name=parts[0].name)
