# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The paper's energy criterion, its equations (3) to (6): work done on the rig against the energy it gained."""

import math
from dataclasses import dataclass

import numpy as np

from pendubot_identification.arrays import Array
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.model.dynamics import dry_friction_terms, energy_terms
from pendubot_identification.model.parameters import MODELS
from pendubot_identification.trajectories.signals import SMOOTHING, differentiate, held, resample
from pendubot_identification.trajectories.trajectory import Trajectory

#: No joint of a bench-top rig turns faster [rad/s], or further between two samples [rad]: its angle is in degrees,
#: wrapped at a turn, or its encoder jumped. Links of 2 cm reach 300 rad/s; a smoothed wrap steps by pi.
TOP_SPEED, TOP_STEP = 500.0, 0.8 * math.pi
#: Above this median [rad/s] such angles may be in degrees.
FAST = 30.0


@dataclass(frozen=True, slots=True)
class Regression:
    """Residuals linear in theta: eps = y - phi theta."""

    phi: Array  #: regressor, shape (N, D).
    #: right-hand side, shape (N,): the torques' work [J], or impulses and work under a test function [N m, W].
    y: Array
    t: Array  #: the time [s] to which each residual belongs, shape (N,), not decreasing.


def energy_regression(
    trajectory: Trajectory, window: float | None = None, smoothing: float = SMOOTHING, model: str = 'viscous'
) -> Regression:
    """Return the energy residual of a motion over [t1, t2] for every t2.

        eps = integral of (tau1 - friction1) q1' + (tau2 - friction2) q2' dt - (E(t2) - E(t1))

    ``window`` is t2 - t1 [s]; None takes t1 = the first sample for every t2 (cumulative), which is what the size of the
    paper's J fits. ``smoothing`` [s] is that of :func:`.signals.differentiate`: recorded velocities are not used.
    ``model`` is one of :data:`.parameters.MODELS`; the paper's is ``viscous``. A pendubot's tau2 is zero; a rig with an
    elbow motor brings its torque.

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
    """Return what multiplies the parameters, and the work [J], summed from the start on, of a recording made even."""
    step = even.interval
    q, qd = differentiate(even.q, step, smoothing)
    require_plausible_speed(even.name, even.t, qd, step)
    # A held torque does the work tau[k] (q[k+1] - q[k]) on its joint, whatever the motion in between. It is summed
    # over the samples as they were recorded: on a grid of other times a torque may be held for no time.
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
    """Refuse velocities [rad/s], shape (N, 2), at the times t [s] of a recording, that no rig can have.

    ``interval`` is the time between two recorded samples [s].

    Raises:
        TrajectoryError: it says which joint turns so fast, and when.
    """
    fastest, limit = np.abs(qd).max(axis=0), min(TOP_SPEED, TOP_STEP / interval)
    if fastest.max() > limit:
        joint = int(fastest.argmax())
        # Angles that jump do so now and then.
        degrees = float(np.median(np.abs(qd).max(axis=1))) > FAST
        raise TrajectoryError(
            f'{name}: the {("shoulder", "elbow")[joint]} turns at {fastest[joint]:.4g} rad/s at '
            f'{t[np.abs(qd[:, joint]).argmax()]:.3f} s, and at most {limit:.4g} is plausible; are its '
            'angles in radians, unwrapped and without jumps, and its stamps true?'
            + (' If they are in degrees, add --degrees' if degrees else ''),
            **({'degrees': 'true'} if degrees else {}),
        )


def _accumulated(increments: Array) -> Array:
    """Return the sums from 0 on, one more than there are increments."""
    return np.cumsum(np.concatenate([np.zeros_like(increments[:1]), increments]), axis=0)
