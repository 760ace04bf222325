# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Simulation of a pendubot: in steps of constant torque, and as complete trajectories."""

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pendubot_identification.arrays import Array
from pendubot_identification.errors import ParameterError, TrajectoryError
from pendubot_identification.trajectories.trajectory import Trajectory

from .dynamics import GRAVITY, SIGN_WIDTH, Pair, advance
from .parameters import Parameters

#: Positions [rad] when hanging.
HANGING: Pair = (-math.pi / 2, 0.0)


@dataclass(frozen=True, slots=True)
class StepSettings:
    """The Runge-Kutta step, with an error far below one encoder count."""

    longest: float = 1e-3  #: Longest step [s].
    shortest: float = 1e-6  #: Shortest step of a real rig [s], a hundredth of what the stiffest known one needs.
    of_swing: float = 0.03  #: Longest step times the highest frequency of the rig [rad/s].
    of_decay: float = 0.25  #: Longest step times the highest decay rate by friction [1/s].
    stable: float = 2.5  #: The same for a coarse simulation, which is unstable beyond 2.78.
    finest: int = 20  #: Largest number of parts of a step of a coarse simulation.


SETTINGS = StepSettings()


class Plant:
    """A simulated pendubot with positions q [rad] and velocities qd [rad/s], under piecewise constant torques.

    Raises:
        ParameterError: the parameters are not physical, or need too short steps.
    """

    def __init__(self, parameters: Parameters, q: Pair = HANGING, qd: Pair = (0.0, 0.0)) -> None:
        self.become(parameters)
        self._state: tuple[float, ...] = (*q, *qd)

    def become(self, parameters: Parameters) -> None:
        """Change the parameters, without a change of positions and velocities.

        Raises:
            ParameterError: the parameters are not physical, or need too short steps.
        """
        if problems := parameters.unphysical():
            raise ParameterError(f'no rig moves like this: {problems[0]}; give the parameters of a real one')
        self._swing_rate, self._friction_rate, self._load_rate = _plant_rates(parameters)
        self.parameters = parameters
        self._theta = tuple(float(value) for value in parameters.vector())

    @property
    def q(self) -> Pair:
        """Joint positions [rad]."""
        return self._state[0], self._state[1]

    @property
    def qd(self) -> Pair:
        """Joint velocities [rad/s]."""
        return self._state[2], self._state[3]

    def place(self, q: Pair, qd: Pair) -> None:
        """Set positions [rad] and velocities [rad/s]."""
        self._state = (*q, *qd)

    def advance(self, tau: Pair, duration: float) -> None:
        """Advance the state by ``duration`` [s] under constant torques [N m]."""
        friction = self._friction_rate + self._load_rate[0] * abs(tau[0]) + self._load_rate[1] * abs(tau[1])
        steps = max(1, math.ceil(duration * max(self._swing_rate, friction) - 1e-9))
        h = duration / steps
        for _ in range(steps):
            self._state = advance(self._theta, self._state, tau, h, math)


class LatePlant(Plant):
    """A simulated pendubot with an input delay: each torque acts ``delay`` [s] after it was applied."""

    def __init__(self, parameters: Parameters, delay: float, q: Pair = HANGING, qd: Pair = (0.0, 0.0)) -> None:
        super().__init__(parameters, q, qd)
        self._pending = deque([((0.0, 0.0), delay)])

    def advance(self, tau: Pair, duration: float) -> None:
        """Advance the state by ``duration`` [s] under earlier torques; ``tau`` [N m] acts after the delay."""
        self._pending.append((tau, duration))
        while duration > 1e-12:
            torque, left = self._pending.popleft()
            part = min(left, duration)
            if part > 1e-12:
                super().advance(torque, part)
            duration -= part
            if left - part > 1e-12:
                self._pending.appendleft((torque, left - part))

    def ahead(self, torques: Iterable[Pair], duration: float) -> tuple[Pair, Pair]:
        """Return q and qd after all pending torques and ``torques`` [N m], each for ``duration`` [s], have acted."""
        here = self._state
        for tau, left in (*self._pending, *((tau, duration) for tau in torques)):
            if left > 1e-12:
                super().advance(tau, left)
        q, qd, self._state = self.q, self.qd, here
        return q, qd


def longest_step(parameters: Parameters, torque: float) -> float:
    """Return the longest step [s] of :class:`Plant` under shoulder torques of at most ``torque`` [N m].

    Raises:
        ParameterError: see :class:`Plant`.
    """
    swing, friction, load = _plant_rates(parameters)
    return 1 / max(swing, friction + load[0] * torque)


def substeps(parameters: Parameters, torques: Array, step: float) -> int:
    """Return the number of parts of a Runge-Kutta step [s] that is stable under friction at rest.

    ``torques``: typical torques of both joints [N m], shape (2,).
    """
    if parameters.unphysical():
        return SETTINGS.finest
    _, friction, load = _step_rates(parameters)
    rate = SETTINGS.of_decay * (friction + load[0] * torques[0] + load[1] * torques[1])
    return math.ceil(min(max(step * float(rate) / SETTINGS.stable, 1.0), SETTINGS.finest))


def _plant_rates(parameters: Parameters) -> tuple[float, float, Pair]:
    """Return the step rates of a rig. Raises ParameterError: it needs shorter steps than a real rig."""
    swing, friction, load = _step_rates(parameters)
    if (step := 1 / max(swing, friction)) < SETTINGS.shortest:
        raise ParameterError(
            f'this rig can only be simulated in steps of {step:.2g} s, and {SETTINGS.shortest:g} s or more is '
            'expected: its friction or torques are too large for its inertia; check their units'
        )
    return swing, friction, load


def _step_rates(p: Parameters) -> tuple[float, float, Pair]:
    """Return the step rates [1/s] for the swing and for friction, and the additional rates per torque [1/(s N m)].

    No eigenvalue of the inverse of M(q) exceeds the largest trace(M) over q2, divided by the smallest det(M).
    """
    m11, m22 = p.P1 + p.P2 + 2 * abs(p.P3), p.P2 + p.J2
    determinant = p.P1 * p.P2 - p.P3**2 + p.J2 * (p.P1 + p.P2 - 2 * abs(p.P3))
    swing = math.sqrt(GRAVITY * (abs(p.P4) + 2 * abs(p.P5)) * (m11 + m22) / determinant)
    shoulder, elbow = m22 / determinant / SETTINGS.of_decay, m11 / determinant / SETTINGS.of_decay
    # Dry friction is steepest at rest.
    slopes = p.b1 + (p.Fc1 + p.Fs1) / SIGN_WIDTH, p.b2 + (p.Fc2 + p.Fs2) / SIGN_WIDTH
    return (
        max(1 / SETTINGS.longest, swing / SETTINGS.of_swing),
        shoulder * slopes[0] + elbow * slopes[1],
        (shoulder * p.k1 / SIGN_WIDTH, elbow * p.k2 / SIGN_WIDTH),
    )


def simulate(
    parameters: Parameters, t: ArrayLike, tau: ArrayLike, q: Pair = HANGING, qd: Pair = (0.0, 0.0)
) -> Trajectory:
    """Return the motion from q [rad] and qd [rad/s] at the times t [s], shape (N,), including velocities.

    Torques tau [N m], shape (N, 2), are held from sample to sample.

    Raises:
        ParameterError: the parameters are not physical, or need too short steps.
        TrajectoryError: a shape or a number is invalid, or the simulation diverges.
    """
    times, torques = np.asarray(t, dtype=float), np.asarray(tau, dtype=float)
    states = np.tile(np.array((*q, *qd), dtype=float), (len(times), 1))
    Trajectory(times, states[:, :2], torques, states[:, 2:], name='the simulation')  # checks the arguments
    plant = Plant(parameters, q, qd)
    for k, step in enumerate(np.diff(times)):
        try:
            plant.advance((float(torques[k, 0]), float(torques[k, 1])), float(step))
            finite = all(map(math.isfinite, (*plant.q, *plant.qd)))
        except (ValueError, ArithmeticError):
            finite = False
        if not finite:
            raise TrajectoryError(
                f'the simulation diverges {times[k + 1] - times[0]:.3g} s after its start: '
                f'torques of up to {np.abs(torques).max():g} N m are too large for these parameters; give smaller ones'
            )
        states[k + 1] = (*plant.q, *plant.qd)
    return Trajectory(times, states[:, :2], torques, states[:, 2:], name='simulation')


def quantised(trajectory: Trajectory, counts_per_turn: int) -> Trajectory:
    """Return the trajectory with positions quantised by encoders that are 0 when hanging, without velocities."""
    zero = np.array(HANGING)
    count = 2 * math.pi / counts_per_turn
    q = np.round((trajectory.q - zero) / count) * count + zero
    return Trajectory(trajectory.t, q, trajectory.tau, name=trajectory.name)
