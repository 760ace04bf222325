"""The paper's energy criterion, its equations (3) to (6): work done on the rig against the energy it gained."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .dynamics import dry_friction_terms, energy_terms
from .errors import TrajectoryError
from .parameters import MODELS
from .signals import SMOOTHING, differentiate, held, resample
from .trajectory import Trajectory

Array = NDArray[np.float64]

#: No joint of a bench-top rig turns faster [rad/s]: an angle in degrees, wrapped at a turn, or a jump of an encoder.
TOP_SPEED = 100.0


@dataclass(frozen=True, slots=True)
class Regression:
    """Residuals linear in theta: eps = y - phi theta.

    Attributes:
        phi: regressor, shape (N, D).
        y: right-hand side, shape (N,): the torques' work [J] or, in the weak criterion, what corresponds to it [N m].
        t: the time [s] to which each residual belongs, shape (N,), not decreasing.
    """

    phi: Array
    y: Array
    t: Array


def energy_regression(
    trajectory: Trajectory, window: float | None = None, smoothing: float = SMOOTHING, model: str = 'viscous'
) -> Regression:
    """Return the energy balance of a motion over [t1, t2] for every t2.

        eps = integral of (tau1 - friction1) q1' + (tau2 - friction2) q2' dt - (E(t2) - E(t1))

    Args:
        trajectory: the motion; its own velocities, if any, are not used.
        window: t2 - t1 [s]; None takes t1 = the first sample for every t2 (cumulative), which is what the size of
            the paper's J fits. A pendubot's tau2 is zero; a rig with an elbow motor brings its torque.
        smoothing: the differentiator's window [s], see :func:`.signals.differentiate`.
        model: the name of one of :data:`.parameters.MODELS`; the paper's is ``viscous``, friction b1 q1' and b2 q2'.

    Raises:
        TrajectoryError: the motion is shorter than the window, has a gap, or is faster than a rig can be.
    """
    motion = resample(trajectory)
    q, qd = differentiate(motion.q, motion.interval, smoothing)
    require_plausible_speed(trajectory.name, motion.t - motion.t[0], qd)
    work = _work(trajectory, motion)
    dry = dry_friction_terms(qd, np.zeros_like(qd))[..., :2] * qd[..., None]
    rates = np.column_stack([qd**2, dry[..., 0], dry[..., 1]])
    means = (rates[1:] + rates[:-1]) / 2 * motion.interval
    load = np.abs(motion.tau[:-1]) * means[:, 2:4]
    viscous, coulomb, stribeck = np.split(_accumulated(means), 3, axis=1)
    rotor = qd[:, 1] ** 2 / 2
    phi = np.column_stack([energy_terms(q, qd), viscous, coulomb, rotor, stribeck, _accumulated(load)])
    phi = phi[:, : MODELS[model]]
    if window is None:
        return Regression(phi[1:] - phi[0], work[1:] - work[0], motion.t[1:])
    if window < motion.interval / 2:
        raise TrajectoryError(
            f'{trajectory.name}: the sliding window of {window:g} s is shorter than the sampling interval of '
            f'{motion.interval:.4g} s; choose a longer one'
        )
    span = max(1, round(min(window / motion.interval, len(motion))))
    if span >= len(motion):
        raise TrajectoryError(
            f'{trajectory.name}: {motion.duration:.3f} s are shorter than the sliding window of {window:g} s; choose a '
            'longer part of the recording or a shorter sliding window'
        )
    return Regression(phi[span:] - phi[:-span], work[span:] - work[:-span], motion.t[span:])


def require_plausible_speed(name: str, elapsed: Array, qd: Array) -> None:
    """Refuse velocities [rad/s], shape (N, 2), at ``elapsed`` seconds of a recording, that no rig can have.

    Raises:
        TrajectoryError: it says which joint turns so fast, and when.
    """
    fastest = np.abs(qd).max(axis=0)
    if fastest.max() > TOP_SPEED:
        joint = int(fastest.argmax())
        raise TrajectoryError(
            f'{name}: the {("shoulder", "elbow")[joint]} turns at {fastest[joint]:.0f} rad/s, '
            f'{elapsed[np.abs(qd[:, joint]).argmax()]:.3f} s after its start, and at most {TOP_SPEED:g} '
            'is plausible; are its angles in radians, unwrapped, and without jumps?'
        )


def _work(recorded: Trajectory, motion: Trajectory) -> Array:
    """Return the work done [J] from the recording's start until each time of the resampled motion.

    A held torque does the work tau[k] (q[k+1] - q[k]) on its joint, whatever the motion in between. It is summed
    over the samples as they were recorded: on a grid of other times a torque of one sample may be held for none.
    """
    done = _accumulated((recorded.tau[:-1] * np.diff(recorded.q, axis=0)).sum(axis=1))
    k = held(recorded.t, motion.t)
    return np.asarray(done[k] + (recorded.tau[k] * (motion.q - recorded.q[k])).sum(axis=1))


def _accumulated(increments: Array) -> Array:
    return np.concatenate([np.zeros_like(increments[:1]), np.cumsum(increments, axis=0)])
