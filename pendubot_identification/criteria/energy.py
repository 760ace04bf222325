# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The energy criterion of the paper, equations (3) to (6): work on the rig minus the change of its energy."""

import math
from dataclasses import dataclass

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.dynamics import dry_friction_terms, energy_terms
from pendubot_identification.model.parameters import MODELS
from pendubot_identification.trajectories.signals import SMOOTHING, differentiate, held, resample
from pendubot_identification.trajectories.trajectory import Trajectory

#: Largest speed [rad/s] and step between two samples [rad] of a bench-top rig: beyond them an angle is in degrees or
#: wrapped, or its encoder jumped. Links of 2 cm reach 300 rad/s; a smoothed wrap steps by pi.
TOP_SPEED, TOP_STEP = 500.0, 0.8 * math.pi
#: Median speed [rad/s] above which such angles may be in degrees.
FAST = 30.0


@dataclass(frozen=True, slots=True)
class Regression:
    """Residuals linear in theta: eps = y - phi theta."""

    phi: Array  #: regressor, shape (N, D).
    #: right-hand side, shape (N,): the torques' work [J], or impulses and work under a test function [N m, W].
    y: Array
    t: Array  #: time of each residual [s], shape (N,), not decreasing.


def energy_regression(
    trajectory: Trajectory, window: float | None = None, smoothing: float = SMOOTHING, model: str = 'viscous'
) -> Regression:
    """Return the energy residual of a motion over [t1, t2] for every t2.

        eps = integral of (tau1 - friction1) q1' + (tau2 - friction2) q2' dt - (E(t2) - E(t1))

    ``window`` is t2 - t1 [s]; None takes the first sample as t1 (cumulative), which agrees with the size of J in the
    paper. ``smoothing`` [s] is the window of :func:`.signals.differentiate`: recorded velocities are not used.
    ``model`` is one of :data:`.parameters.MODELS`, ``viscous`` in the paper. tau2 is zero without an elbow motor.

    Raises:
        TrajectoryError: the motion is shorter than the window, has a gap, or is faster than a rig can be.
    """
    even = resample(trajectory)
    step, size = even.interval, len(even)
    span = 0
    if window is not None:
        if window < step / 2:
            raise TrajectoryError(
                f'{even.name}: the sliding window of {window:g} s is shorter than the sampling interval of '
                f'{step:.4g} s; choose a longer one'
            )
        span = max(1, round(min(window / step, size)))
        if span >= size:
            raise TrajectoryError(
                f'{even.name}: {step * (size - 1):.3f} s are shorter than the sliding window of {window:g} s; choose a '
                'longer part of the recording or a shorter sliding window'
            )
    phi, work = _sums(trajectory, even, smoothing, MODELS[model])
    late, early = slice(max(span, 1), None), slice(0, -span if span else 1)
    return Regression(phi[late] - phi[early], work[late] - work[early], even.t[late])


def _sums(recorded: Trajectory, even: Trajectory, smoothing: float, size: int) -> tuple[Array, Array]:
    """Return the cumulative regressor and the cumulative work [J] of a recording on a uniform grid."""
    step = even.interval
    q, qd = differentiate(even.q, step, smoothing)
    require_plausible_speed(even.name, even.t, qd, step)
    # A held torque does the work tau[k] (q[k+1] - q[k]) on its joint, independent of the motion in between. The sum
    # is over the recorded samples, because a grid may skip a torque.
    done = _accumulated((recorded.tau[:-1] * np.diff(recorded.q, axis=0)).sum(axis=1))
    k = held(recorded.t, even.t)
    work = done[k] + (recorded.tau[k] * (even.q - recorded.q[k])).sum(axis=1)
    dry = dry_friction_terms(qd, np.zeros_like(qd))[..., :2] * qd[..., None]
    rates = np.column_stack([qd**2, dry[..., 0], dry[..., 1]])
    means = (rates[1:] + rates[:-1]) / 2 * step
    load = np.abs(even.tau[:-1]) * means[:, 2:4]
    viscous, coulomb, stribeck, load = np.split(_accumulated(np.column_stack([means, load])), 4, axis=1)
    phi = np.column_stack([energy_terms(q, qd), viscous, coulomb, qd[:, 1] ** 2 / 2, stribeck, load])
    return np.asarray(phi[:, :size]), work


def require_plausible_speed(name: str, t: Array, qd: Array, interval: float) -> None:
    """Reject implausible velocities [rad/s], shape (N, 2), of a recording at the times t [s].

    ``interval`` is the time between two recorded samples [s].

    Raises:
        TrajectoryError: a joint is too fast; the message contains the joint and the time.
    """
    fastest, limit = np.abs(qd).max(axis=0), min(TOP_SPEED, TOP_STEP / interval)
    if fastest.max() > limit:
        joint = int(fastest.argmax())
        # Jumps are rare and hardly change the median.
        degrees = float(np.median(np.abs(qd).max(axis=1))) > FAST
        counts = 'if they are encoder counts, multiply them by 2 pi / counts per turn'
        raise TrajectoryError(
            f'{name}: the {("shoulder", "elbow")[joint]} turns at {fastest[joint]:.4g} rad/s at '
            f'{t[np.abs(qd[:, joint]).argmax()]:.3f} s, and at most {limit:.4g} is plausible; are its '
            'angles in radians, unwrapped and without jumps, and its stamps correct?'
            + (f' If they are in degrees, add --degrees; {counts}' if degrees else ''),
            **({'degrees': 'true'} if degrees else {}),
        )


def _accumulated(increments: Array) -> Array:
    """Return the cumulative sums of increments, starting with 0."""
    return np.cumsum(np.concatenate([np.zeros_like(increments[:1]), increments]), axis=0)
