# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Linear control of a balanced pendubot: linearisation, sampling, discrete LQR and Kalman gains, and their margins.

Near a balanced configuration x = (q - q*, q') [rad, rad/s] moves as x' = A x + B (tau - tau*). The loop is sampled with
dead time: the torque computed from a sample acts D seconds after it. The regulator predicts the state over D and feeds
that back, which is the LQR of the plant augmented by its delay states (Artstein's reduction: what the pending torques
do to the state is known, and the rest is a plant without delay).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_discrete_are

from pendubot_identification.errors import ControlError
from pendubot_identification.model.dynamics import GRAVITY, mass_matrix
from pendubot_identification.model.parameters import Parameters

Array = NDArray[np.float64]

#: What the encoders see of the state.
_MEASURED = np.eye(2, 4)
#: Gains, and delays [s], beyond which margins are not looked for.
_LARGEST_GAIN, _LONGEST_DELAY = 100.0, 0.2
#: In so many steps they are first looked for, coarsely.
_GRID = 81


@dataclass(frozen=True, slots=True)
class Equilibrium:
    """A configuration in which the rig stays: positions q1, q2 [rad] and the shoulder torque that holds it [N m]."""

    q1: float
    q2: float
    tau: float


def equilibrium(parameters: Parameters, q1: float = math.pi / 2, standing: bool = True) -> Equilibrium:
    """Return the equilibrium with link 1 at ``q1`` [rad] and link 2 above its joint (``standing``) or below it.

    A pendubot has one for every q1: no torque acts on link 2, which is upright or hangs, and the motor holds link 1.
    """
    return Equilibrium(q1, (math.pi / 2 if standing else -math.pi / 2) - q1, parameters.P4 * GRAVITY * math.cos(q1))


def linearise(parameters: Parameters, at: Equilibrium) -> tuple[Array, Array]:
    """Return A, shape (4, 4), and B, shape (4, 1), of x' = A x + B (tau - tau*) about an equilibrium.

    M q'' + b q' + dG/dq (q - q*) = (tau - tau*, 0). Dry friction has no slope that a motion of any size feels: the
    linear model is without it.
    """
    p = parameters
    inverse = np.linalg.inv(mass_matrix(p.vector(), [at.q1, at.q2]))
    lower = -p.P5 * GRAVITY * math.sin(at.q1 + at.q2)
    stiffness = np.array([[lower - p.P4 * GRAVITY * math.sin(at.q1), lower], [lower, lower]])
    A, B = np.zeros((4, 4)), np.zeros((4, 1))
    A[:2, 2:] = np.eye(2)
    A[2:, :2] = -inverse @ stiffness
    A[2:, 2:] = -inverse @ np.diag([p.b1, p.b2])
    B[2:, 0] = inverse[:, 0]
    return A, B


def sampled(A: Array, B: Array, duration: float) -> tuple[Array, Array]:
    """Return what x becomes after ``duration`` [s] under a constant torque: Phi, shape (4, 4), and Gamma, (4, 1)."""
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    block = expm(block * duration)
    return block[:n, :n], block[:n, n:]


@dataclass(frozen=True, slots=True)
class Weights:
    """What the regulator and the estimator are designed for; torques as fractions of the rig's weight (P4 + P5) g.

    Attributes:
        angle: deviation [rad] of an angle that weighs as much as ``torque``.
        torque: see there; the smaller it is, the nearer to the least torque that balances at all.
        disturbance: torque on each joint, white from sample to sample at 100 Hz, that the model leaves unexplained: the
            larger, the more the estimator believes the encoders.
        counts_per_turn: of the encoders, whose rounding is the noise.
    """

    angle: float = 0.1
    torque: float = 0.06
    disturbance: float = 0.15
    counts_per_turn: int = 4000


@dataclass(frozen=True, slots=True)
class Regulator:
    """Gains for one equilibrium, period and dead time.

    Attributes:
        A, B: the linear model.
        period: between samples [s].
        delay: from a sample to the moment when the torque computed from it acts [s].
        K: shape (4,); tau = tau* - K x, x predicted ``delay`` ahead.
        S: shape (4, 4); x^T S x is the cost to go, which a regulated rig without disturbance never increases.
        L: shape (4, 2); Kalman gain of the positions' innovation.
    """

    A: Array
    B: Array
    period: float
    delay: float
    K: Array
    S: Array
    L: Array


def design(parameters: Parameters, at: Equilibrium, period: float, delay: float, weights: Weights) -> Regulator:
    """Design the discrete LQR and the steady Kalman filter.

    Args:
        parameters: the rig's.
        at: where to balance.
        period: between samples [s].
        delay: from a sample to the moment when the torque computed from it acts [s].
        weights: what matters how much.

    Raises:
        ControlError: there is no such regulator, because the motor cannot move what has to be balanced.
    """
    A, B = linearise(parameters, at)
    Phi, Gamma = sampled(A, B, period)
    weight = (parameters.P4 + parameters.P5) * GRAVITY
    Q, R = np.diag([1, 1, 0, 0]) / weights.angle**2, np.eye(1) / (weights.torque * weight) ** 2
    both = np.vstack([np.zeros((2, 2)), np.linalg.inv(mass_matrix(parameters.vector(), [at.q1, at.q2]))])
    _, pushes = sampled(A, both, period)
    disturbance = pushes @ pushes.T * (weights.disturbance * weight) ** 2 * (0.01 / period)
    noise = np.eye(2) * (2 * math.pi / weights.counts_per_turn) ** 2 / 12
    try:
        S = solve_discrete_are(Phi, Gamma, Q, R)
        covariance = solve_discrete_are(Phi.T, _MEASURED.T, disturbance, noise)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ControlError(
            'no controller can be designed for these parameters: the motor hardly moves what has to be balanced; '
            'identify the rig again'
        ) from error
    K = np.linalg.solve(Gamma.T @ S @ Gamma + R, Gamma.T @ S @ Phi)
    L = covariance @ _MEASURED.T @ np.linalg.inv(_MEASURED @ covariance @ _MEASURED.T + noise)
    return Regulator(A, B, period, delay, K[0], S, L)


def closed_loop(regulator: Regulator, gain: complex = 1.0, delay: float | None = None) -> Array:
    """Return the transition matrix, over one period, of the rig under the regulator: stable when all |z| < 1.

    Args:
        regulator: the design.
        gain: multiplies the torque on its way to the rig; complex, it turns the loop's phase.
        delay: the rig's own dead time [s], where it is not the one that was designed for.

    Returns:
        Shape (8 + N, 8 + N): of the rig's x, its estimate before the measurement, and the torques of N samples.
    """
    fixed, moved = _parts(regulator, regulator.delay if delay is None else delay)
    return fixed + gain * moved


def _parts(r: Regulator, delay: float) -> tuple[Array, Array]:
    """Return the closed loop without what the torques do to the rig, and that."""
    Phi, own = _effects(r, delay, r.period)
    _, assumed = _effects(r, r.delay, r.period)
    ahead, pending = _effects(r, r.delay, r.delay)
    past = max(map(len, (own, assumed, pending))) - 1
    own, assumed, pending = (np.pad(each, ((0, past + 1 - len(each)), (0, 0))) for each in (own, assumed, pending))
    rig, estimate, torques = np.split(np.eye(8 + past), [4, 8])
    corrected = estimate + r.L @ _MEASURED @ (rig - estimate)
    torque = -r.K @ (ahead @ corrected + pending[1:].T @ torques)
    torques = np.vstack([torque, torques])
    fixed = np.vstack([Phi @ rig, Phi @ corrected + assumed.T @ torques, torques[:past]])
    moved = np.zeros_like(fixed)
    moved[:4] = own.T @ torques
    return fixed, moved


def _effects(r: Regulator, delay: float, span: float) -> tuple[Array, Array]:
    """Return what becomes of the state over ``span`` [s] after a sample: its transition, and the effect of torques.

    Row j of the effects, shape (N, 4), belongs to the torque that was computed j samples before this one.
    """
    effects = []
    for j in range(math.ceil(delay / r.period - 1e-9) + 1):
        begin, end = max(0.0, delay - j * r.period), min(span, delay - (j - 1) * r.period)
        effect = np.zeros(4)
        if end > begin:
            effect = (sampled(r.A, r.B, span - end)[0] @ sampled(r.A, r.B, end - begin)[1])[:, 0]
        effects.append(effect)
    return sampled(r.A, r.B, span)[0], np.array(effects)


@dataclass(frozen=True, slots=True)
class Margins:
    """How far the rig may be from what was designed for, one thing at a time, before the loop is unstable.

    Attributes:
        gain_down, gain_up: factors of the torque; the rig being unstable, there is a lower one.
        phase: [rad].
        delay: more dead time than designed for [s].
    """

    gain_down: float
    gain_up: float
    phase: float
    delay: float


def margins(regulator: Regulator) -> Margins:
    """Return the margins of a design, exact for the sampled loop: where its closed loop ceases to be stable.

    Raises:
        ControlError: it is not even stable as designed.
    """
    r = regulator
    if not _stable(closed_loop(r)):
        raise ControlError(
            f'a sample every {1e3 * r.period:g} ms and a dead time of {1e3 * r.delay:.3g} ms are too slow to hold this '
            'rig upright; sample faster, or shorten the delay'
        )
    fixed, moved = _parts(r, r.delay)
    up = _edge(lambda power: fixed + math.exp(power) * moved, math.log(_LARGEST_GAIN))
    down = _edge(lambda power: fixed + math.exp(-power) * moved, math.log(_LARGEST_GAIN))
    phase = _edge(lambda angle: fixed + complex(math.cos(angle), -math.sin(angle)) * moved, math.pi)
    delay = _edge(lambda more: closed_loop(r, delay=r.delay + more), _LONGEST_DELAY)
    return Margins(math.exp(-down), math.exp(up), phase, delay)


def _stable(matrix: Array) -> bool:
    return bool(abs(np.linalg.eigvals(matrix)).max() < 1)


def _edge(loop: Callable[[float], Array], furthest: float) -> float:
    """Return up to where a loop that is stable at 0 stays so, at most ``furthest``."""
    grid = np.linspace(0, furthest, _GRID)
    outside = next((k for k in range(1, len(grid)) if not _stable(loop(grid[k]))), None)
    if outside is None:
        return furthest
    low, high = grid[outside - 1], grid[outside]
    for _ in range(20):
        middle = (low + high) / 2
        low, high = (middle, high) if _stable(loop(middle)) else (low, middle)
    return float(low)
