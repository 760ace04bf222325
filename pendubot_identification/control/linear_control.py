# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Linear control of the upright pendubot: linearisation, sampling, discrete LQR and Kalman gains, and their margins.

Near upright x = (q - q*, q') [rad, rad/s] satisfies x' = A x + B tau. The loop is sampled and has a dead time: the
torque from a sample acts D seconds after it. The regulator feeds back the state predicted D ahead. It is equivalent to
the LQR of the plant augmented by its delay states (Artstein's reduction).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import bisect

from pendubot_identification.arrays import Array
from pendubot_identification.errors import ControlError
from pendubot_identification.model.dynamics import GRAVITY, linearised, padded
from pendubot_identification.model.parameters import Parameters


@dataclass(frozen=True, slots=True)
class ControlSettings:
    """Weights of the regulator, noise of the estimator, and the search for margins."""

    angle: float = 0.1  #: Deviation of an angle with unit cost [rad].
    #: Torque with unit cost as a fraction of the rig's weight (P4 + P5) g; a smaller fraction uses less torque.
    torque: float = 0.06
    disturbance: float = 0.15  #: Standard deviation of the unmodelled torque, white at 100 Hz, as the same fraction.
    counts_per_turn: int = 4000  #: Encoder resolution; its quantization is the measurement noise.
    largest_gain: float = 100.0  #: Largest gain in the search for margins.
    longest_delay: float = 0.2  #: Longest additional delay in the search for margins [s].
    grid: int = 81  #: Number of grid points in the search for margins.


SETTINGS = ControlSettings()
#: The output matrix: encoders measure positions.
_MEASURED = np.eye(2, 4)


def linearise(parameters: Parameters) -> tuple[Array, Array]:
    """Return A, shape (4, 4), and B, shape (4, 2), of x' = A x + B tau upright; tau are the torques of both joints.

    Dry friction is omitted, because its slope at rest is too steep for a linear model of any finite motion.
    """
    viscous = replace(parameters, Fc1=0.0, Fc2=0.0, Fs1=0.0, Fs2=0.0, k1=0.0, k2=0.0).vector()
    point = linearised(padded(viscous), np.array([math.pi / 2, 0.0, 0.0, 0.0]), np.zeros(2))
    return np.vstack([np.eye(2, 4, 2), point.by_state]), np.vstack([np.zeros((2, 2)), point.inverse])


def sampled(A: Array, B: Array, duration: float) -> tuple[Array, Array]:
    """Return the zero-order-hold model over ``duration`` [s]: Phi, shape (4, 4), and Gamma, shape (4, M) like B."""
    states, inputs = B.shape
    both = expm(duration * np.vstack([np.hstack([A, B]), np.zeros((inputs, states + inputs))]))[:states]
    return both[:, :states], both[:, states:]


@dataclass(frozen=True, slots=True)
class Loop:
    """The sampled control loop: the torque from a sample is applied at the next sample."""

    period: float  #: Sampling period [s].
    lag: float = 0.0  #: Delay of the motor behind the board's report [s].
    limit: float = 2.0  #: Largest torque [N m].

    @property
    def delay(self) -> float:
        """Dead time from a sample until its torque acts [s]."""
        return self.period + self.lag


@dataclass(frozen=True, slots=True)
class Design:
    """Regulator and estimator for a rig and a loop."""

    parameters: Parameters  #: Parameters of the rig.
    theta: tuple[float, ...]  #: The same parameters as plain numbers, which are faster.
    loop: Loop
    K: Array  #: Regulator gain, shape (4,): tau = -K x, with x predicted over the dead time.
    L: Array  #: Kalman gain of the positions' innovation, shape (4, 2).

    @classmethod
    def make(cls, parameters: Parameters, loop: Loop) -> Design:
        """Design the discrete LQR and the steady Kalman filter for physical parameters.

        Raises:
            ControlError: the centre of mass of link 2 is unsuitable, or the rig is not controllable.
        """
        if parameters.P5 <= 0 or parameters.P3 <= 0:
            raise ControlError(
                f'the centre of mass of link 2 is at the elbow or behind it (P3 = {parameters.P3:.3g}, P5 = '
                f'{parameters.P5:.3g}); this controller needs P3 and P5 above 0'
            )
        A, both = linearise(parameters)
        Phi, pushes = sampled(A, both, loop.period)
        weight = (parameters.P4 + parameters.P5) * GRAVITY
        # In units of the torque with unit cost; in N m the equation is ill-conditioned for a small rig.
        unit = SETTINGS.torque * weight
        Gamma, Q, R = unit * pushes[:, :1], np.diag([1, 1, 0, 0]) / SETTINGS.angle**2, np.eye(1)
        disturbance = pushes @ pushes.T * (SETTINGS.disturbance * weight) ** 2 * (0.01 / loop.period)
        noise = np.eye(2) * (2 * math.pi / SETTINGS.counts_per_turn) ** 2 / 12
        try:
            S = solve_discrete_are(Phi, Gamma, Q, R)
            covariance = solve_discrete_are(Phi.T, _MEASURED.T, disturbance, noise)
        except (np.linalg.LinAlgError, ValueError) as error:
            raise ControlError(
                'no controller can be designed for these parameters: the rig is hardly controllable by its motor; '
                'identify the rig again'
            ) from error
        K = unit * np.linalg.solve(Gamma.T @ S @ Gamma + R, Gamma.T @ S @ Phi)
        L = covariance @ _MEASURED.T @ np.linalg.inv(_MEASURED @ covariance @ _MEASURED.T + noise)
        return cls(parameters, tuple(map(float, parameters.vector())), loop, K[0], L)

    def torque(self, x: tuple[float, ...]) -> float:
        """Return the torque [N m] at a deviation from upright [rad, rad/s]."""
        a, b, c, d = self.K
        return -float(a * x[0] + b * x[1] + c * x[2] + d * x[3])


def closed_loop(design: Design, delay: float | None = None, rig: Parameters | None = None) -> tuple[Array, Array]:
    """Return two matrices F and M, so that F + g M is the transition matrix of the closed loop over one period.

    The loop is stable if all eigenvalues have |z| < 1. The factor g multiplies the torque; a complex g changes the
    phase.

    Args:
        design: regulator and estimator.
        delay: dead time of the rig [s]; None: as designed.
        rig: parameters of the rig; None: as designed.

    Returns:
        Shapes (8 + N, 8 + N): the state is x, its estimate before the measurement, and the torques of N samples.
    """
    loop, delay = design.loop, design.loop.delay if delay is None else delay
    past = math.ceil(max(delay, loop.delay) / loop.period - 1e-9)
    Phi_rig, actual = _effects(rig or design.parameters, loop.period, delay, loop.period, past)
    Phi, assumed = _effects(design.parameters, loop.period, loop.delay, loop.period, past)
    ahead, pending = _effects(design.parameters, loop.period, loop.delay, loop.delay, past)
    state, estimate, torques = np.split(np.eye(8 + past), [4, 8])
    corrected = estimate + design.L @ _MEASURED @ (state - estimate)
    torque = -design.K @ (ahead @ corrected + pending[1:].T @ torques)
    torques = np.vstack([torque, torques])
    fixed = np.vstack([Phi_rig @ state, Phi @ corrected + assumed.T @ torques, torques[:past]])
    moved = np.zeros_like(fixed)
    moved[:4] = actual.T @ torques
    return fixed, moved


def _effects(rig: Parameters, period: float, delay: float, span: float, past: int) -> tuple[Array, Array]:
    """Return the transition matrix over ``span`` [s] after a sample, shape (4, 4), and the effects of torques.

    Row j of the effects, shape (past + 1, 4), belongs to the torque from j samples before this one.
    """
    A, both = linearise(rig)
    B, effects = both[:, :1], np.zeros((past + 1, 4))
    for j in range(past + 1):
        begin, end = max(0.0, delay - j * period), min(span, delay - (j - 1) * period)
        if end - begin > 1e-9 * period:
            effects[j] = (sampled(A, B, span - end)[0] @ sampled(A, B, end - begin)[1])[:, 0]
    return sampled(A, B, span)[0], effects


@dataclass(frozen=True, slots=True)
class Margins:
    """Stability margins, each with the other quantities as designed."""

    gain_down: float  #: Smallest stable factor of the torque.
    gain_up: float  #: Largest stable factor of the torque.
    phase: float  #: Phase margin [rad].
    delay: float  #: Largest stable dead time in addition to the designed dead time [s].


def margins(design: Design, rig: Parameters | None = None) -> Margins:
    """Return the margins of a design on its own rig, or on ``rig``, from the poles of the closed loop.

    Raises:
        ControlError: the loop is unstable.
    """
    loop, (fixed, moved) = design.loop, closed_loop(design, rig=rig)
    if _radius(fixed + moved) >= 1:
        raise ControlError(
            f'a sample every {1e3 * loop.period:g} ms and a dead time of {1e3 * loop.delay:.3g} ms are too slow to '
            'hold this rig upright; sample faster, or shorten the delay'
        )
    up = _edge(lambda power: fixed + math.exp(power) * moved, math.log(SETTINGS.largest_gain))
    down = _edge(lambda power: fixed + math.exp(-power) * moved, math.log(SETTINGS.largest_gain))
    phase = _edge(lambda angle: fixed + complex(math.cos(angle), -math.sin(angle)) * moved, math.pi)
    delay = _edge(lambda more: np.add(*closed_loop(design, loop.delay + more, rig)), SETTINGS.longest_delay)
    return Margins(math.exp(-down), math.exp(up), phase, delay)


def _radius(matrix: Array) -> float:
    """Return the spectral radius; a loop is stable below 1."""
    return float(abs(np.linalg.eigvals(matrix)).max())


def _edge(loop: Callable[[float], Array], furthest: float) -> float:
    """Return the stability limit of a loop that is stable at 0, at most ``furthest``."""
    grid = np.linspace(0, furthest, SETTINGS.grid)
    outside = next((k for k in range(1, len(grid)) if _radius(loop(grid[k])) >= 1), None)
    if outside is None:
        return furthest
    return float(bisect(lambda value: _radius(loop(value)) - 1, grid[outside - 1], grid[outside], rtol=1e-6))
