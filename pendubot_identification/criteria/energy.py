# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The paper's energy criterion, its equations (3) to (6): work done on the rig against the energy it gained."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.dynamics import dry_friction_terms, energy_terms
from pendubot_identification.model.parameters import MODELS
from pendubot_identification.trajectories.long import Grid, Long, Recording, gridded
from pendubot_identification.trajectories.signals import SMOOTHING, differentiate, held
from pendubot_identification.trajectories.trajectory import Trajectory

Array = NDArray[np.float64]

#: No joint of a bench-top rig turns faster [rad/s]: an angle in degrees, wrapped at a turn, or a jump of an encoder.
TOP_SPEED = 100.0
#: Nor any for half of the time faster than this [rad/s], but in degrees.
FAST = 30.0


@dataclass(frozen=True, slots=True)
class Regression:
    """Residuals linear in theta: eps = y - phi theta."""

    phi: Array  #: regressor, shape (N, D).
    y: Array  #: right-hand side, shape (N,): the torques' work [J], or impulses and work under a bump [N m, W].
    t: Array  #: the time [s] to which each residual belongs, shape (N,), not decreasing.


@dataclass(frozen=True, slots=True)
class Residuals:
    """``count`` residuals linear in theta that span ``duration`` [s], part by part in the order of time.

    Those of a long recording are never all there at once.
    """

    count: int
    duration: float
    parts: Callable[[], Iterator[Regression]]

    @classmethod
    def of(cls, regression: Regression) -> Residuals:
        """Return those of a regression, in one part."""
        return cls(len(regression.y), float(np.ptp(regression.t)), lambda: iter([regression]))


def energy_regression(
    trajectory: Trajectory, window: float | None = None, smoothing: float = SMOOTHING, model: str = 'viscous'
) -> Regression:
    """Return the energy balance of a motion over [t1, t2] for every t2.

        eps = integral of (tau1 - friction1) q1' + (tau2 - friction2) q2' dt - (E(t2) - E(t1))

    ``window`` is t2 - t1 [s]; None takes t1 = the first sample for every t2 (cumulative), which is what the size of the
    paper's J fits. ``smoothing`` [s] is that of :func:`.signals.differentiate`: recorded velocities are not used.
    ``model`` is one of :data:`.parameters.MODELS`; the paper's is ``viscous``. A pendubot's tau2 is zero; a rig with an
    elbow motor brings its torque.

    Raises:
        TrajectoryError: the motion is shorter than the window, has a gap, or is faster than a rig can be.
    """
    (regression,) = energy_residuals(trajectory, window, smoothing, model).parts()
    return regression


def energy_residuals(
    recording: Recording, window: float | None = None, smoothing: float = SMOOTHING, model: str = 'viscous'
) -> Residuals:
    """Return the same of a recording that may be long, in parts, which may raise what :func:`energy_regression` does.

    Raises:
        TrajectoryError: as :func:`energy_regression`.
    """
    grid = gridded(recording)
    span, duration = 0, grid.interval * (grid.size - 1)
    if window is not None:
        if window < grid.interval / 2:
            raise TrajectoryError(
                f'{grid.name}: the sliding window of {window:g} s is shorter than the sampling interval of '
                f'{grid.interval:.4g} s; choose a longer one'
            )
        span = max(1, round(min(window / grid.interval, grid.size)))
        if span >= grid.size:
            raise TrajectoryError(
                f'{grid.name}: {duration:.3f} s are shorter than the sliding window of {window:g} s; choose a '
                'longer part of the recording or a shorter sliding window'
            )
    count = grid.size - max(span, 1)
    return Residuals(count, grid.interval * (count - 1), lambda: _differences(grid, span, smoothing, MODELS[model]))


def _differences(grid: Grid | Long, span: int, smoothing: float, size: int) -> Iterator[Regression]:
    """Return, part by part, what the sums of the balance gain over so many samples; since the first one for 0."""
    phi, work = np.empty((0, size)), np.empty(0)
    for t, new_phi, new_work in _sums(grid, smoothing, size):
        phi, work = np.concatenate([phi, new_phi]), np.concatenate([work, new_work])
        late, early = slice(max(span, 1), None), slice(0, -span if span else 1)
        gained, done = phi[late] - phi[early], work[late] - work[early]
        kept = slice(-span, None) if span else slice(0, 1)
        phi, work = phi[kept], work[kept]
        yield Regression(gained, done, t[len(t) - len(done) :])


def _sums(grid: Grid | Long, smoothing: float, size: int) -> Iterator[tuple[Array, Array, Array]]:
    """Return, part by part, times [s], what multiplies the parameters, and the work [J], summed from the start on."""
    total: Array = np.zeros((1, 8))
    done, done_at = np.zeros(1), 0
    for piece in grid.pieces(smoothing):
        motion = piece.even
        q, qd = differentiate(motion.q, grid.interval, smoothing)
        # A held torque does the work tau[k] (q[k+1] - q[k]) on its joint, whatever the motion in between. It is summed
        # over the samples as they were recorded: on a grid of other times a torque may be held for no time.
        recorded = piece.recorded
        between = (recorded.tau[:-1] * np.diff(recorded.q, axis=0)).sum(axis=1)
        done, done_at = _accumulated(done[piece.at - done_at], between), piece.at
        own = slice(piece.begin - piece.first, piece.end - piece.first)
        elapsed = grid.interval * np.arange(piece.begin, piece.end, dtype=float)
        require_plausible_speed(grid.name, elapsed, qd[own])
        k = held(recorded.t, motion.t, grid.interval)
        work = (done[k] + (recorded.tau[k] * (motion.q - recorded.q[k])).sum(axis=1))[own]
        # From the last place of the piece before on.
        since = slice(max(own.start - 1, 0), own.stop)
        q, qd, tau = q[since], qd[since], motion.tau[since]
        dry = dry_friction_terms(qd, np.zeros_like(qd))[..., :2] * qd[..., None]
        rates = np.column_stack([qd**2, dry[..., 0], dry[..., 1]])
        means = (rates[1:] + rates[:-1]) / 2 * grid.interval
        load = np.abs(tau[:-1]) * means[:, 2:4]
        sums = _accumulated(total[-1], np.column_stack([means, load]))
        total = sums[-1:]
        new = slice(len(q) - (own.stop - own.start), None)
        viscous, coulomb, stribeck, load = np.split(sums[new], 4, axis=1)
        rotor = qd[new, 1] ** 2 / 2
        phi = np.column_stack([energy_terms(q[new], qd[new]), viscous, coulomb, rotor, stribeck, load])
        yield motion.t[own], phi[:, :size], work


def require_plausible_speed(name: str, elapsed: Array, qd: Array) -> None:
    """Refuse velocities [rad/s], shape (N, 2), at ``elapsed`` seconds of a recording, that no rig can have.

    Raises:
        TrajectoryError: it says which joint turns so fast, and when.
    """
    fastest = np.abs(qd).max(axis=0)
    if fastest.max() > TOP_SPEED:
        joint = int(fastest.argmax())
        # Angles that jump do so now and then.
        degrees = float(np.median(np.abs(qd).max(axis=1))) > FAST
        raise TrajectoryError(
            f'{name}: the {("shoulder", "elbow")[joint]} turns at {fastest[joint]:.4g} rad/s, '
            f'{elapsed[np.abs(qd[:, joint]).argmax()]:.3f} s after its start, and at most {TOP_SPEED:g} '
            'is plausible; are its angles in radians, unwrapped and without jumps, and its stamps true?'
            + (' They look like degrees: add --degrees' if degrees else ''),
            **({'degrees': 'true'} if degrees else {}),
        )


def _accumulated(start: Array | float, increments: Array) -> Array:
    """Return the sums from a start on, one more than there are increments."""
    return np.cumsum(np.concatenate([np.asarray(start)[None], increments]), axis=0)
