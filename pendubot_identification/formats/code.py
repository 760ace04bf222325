# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The model as code in MATLAB, C and Python: parameters, and functions without dependencies.

The equations of :mod:`..model.dynamics` are written here once; each language substitutes its own names.
"""

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from pendubot_identification.model.dynamics import GRAVITY, SIGN_WIDTH, STRIBECK_SPEED
from pendubot_identification.model.parameters import MODELS


class Entry(NamedTuple):
    """A parameter, its standard error if known, and its meaning."""

    name: str
    value: float
    error: float | None
    meaning: str


def _equations(size: int, names: Mapping[str, str]) -> tuple[str, ...]:
    """Return M11, M12, M22 of M(q), h1, h2 of V(q, v) v + G(q), and the friction f1, f2 of ``size`` parameters.

    ``names``: a language's names of parameters, functions, angles q1, q2, velocities v1, v2 and torques tau1, tau2.
    """
    friction = 'b{0}*v{0}'
    if size >= MODELS['geared']:
        more = f'Fs{{0}}*exp(-(v{{0}}/{STRIBECK_SPEED})*(v{{0}}/{STRIBECK_SPEED})) + k{{0}}*fabs(tau{{0}})'
        friction += f' + (Fc{{0}} + {more})*tanh(v{{0}}/{SIGN_WIDTH})'
    elif size >= MODELS['coulomb']:
        friction += f' + Fc{{0}}*tanh(v{{0}}/{SIGN_WIDTH})'
    equations = (
        'P1 + P2 + 2*P3*cos(q2)',
        'P2 + P3*cos(q2)',
        'P2 + J2' if size >= MODELS['rotor'] else 'P2',
        f'-P3*sin(q2)*(2*v1*v2 + v2*v2) + {GRAVITY}*(P4*cos(q1) + P5*cos(q1 + q2))',
        f'P3*sin(q2)*v1*v1 + {GRAVITY}*P5*cos(q1 + q2)',
        friction.format(1),
        friction.format(2),
    )
    return tuple(re.sub(r'[A-Za-z]\w*', lambda word: names.get(word[0], word[0]), text) for text in equations)


def _indexed(pattern: str, first: int) -> dict[str, str]:
    """Return a language's name for each angle, velocity and torque: ``pattern`` of the vector and the index."""
    return {f'{vector}{k + 1}': pattern.format(vector, first + k) for vector in ('q', 'v', 'tau') for k in (0, 1)}


def _lines(pattern: str, items: Sequence[object]) -> str:
    return '\n'.join(pattern.format(item) for item in items)


def matlab(parameters: Sequence[Entry], comments: Sequence[str]) -> str:
    """Return a script, also for Octave, that makes a struct ``pendubot``: parameters and function handles."""
    names = {e.name: f'pendubot.{e.name}' for e in parameters} | _indexed('{}({})', 1) | {'fabs': 'abs'}
    m11, m12, m22, h1, h2, f1, f2 = _equations(len(parameters), names)
    return f"""\
{_lines('% {}', comments)}
{_lines('pendubot.{0.name} = {0.value!r};  % {0.meaning}', parameters)}
pendubot.theta = [{' '.join(repr(e.value) for e in parameters)}];
pendubot.std_error = [{' '.join('NaN' if e.error is None else repr(e.error) for e in parameters)}];
pendubot.names = {{{', '.join(repr(e.name) for e in parameters)}}};
% The model with these values; q [rad], v [rad/s] and tau [N m] contain shoulder and elbow.
pendubot.mass_matrix = @(q) [{m11}, {m12}; {m12}, {m22}];
pendubot.bias = @(q, v) [{h1}; {h2}];
pendubot.friction = @(v, tau) [{f1}; {f2}];
pendubot.acceleration = @(q, v, tau) pendubot.mass_matrix(q) \\ ...
    ([tau(1); tau(2)] - pendubot.bias(q, v) - pendubot.friction(v, tau));
% for ode45: @(t, x) pendubot.derivative(x, [0; 0]), x = [q1; q2; v1; v2]
pendubot.derivative = @(x, tau) [x(3); x(4); pendubot.acceleration(x(1:2), x(3:4), tau)];
"""


def c(parameters: Sequence[Entry], comments: Sequence[str]) -> str:
    """Return a header: ``PENDUBOT_P1`` ..., ``PENDUBOT_THETA``, and the model as functions, for C99 and C++."""
    names = {e.name: f'PENDUBOT_{e.name}' for e in parameters} | _indexed('{}[{}]', 0)
    m11, m12, m22, h1, h2, f1, f2 = _equations(len(parameters), names)
    return f"""\
/*
{_lines(' * {}', [line.replace('*/', '* /').replace('/*', '/ *') for line in comments])}
 */
#ifndef PENDUBOT_PARAMETERS_H
#define PENDUBOT_PARAMETERS_H

{_lines('#define PENDUBOT_{0.name} ({0.value!r})  /* {0.meaning} */', parameters)}

#define PENDUBOT_COUNT {len(parameters)}
#define PENDUBOT_THETA {{{', '.join(f'PENDUBOT_{e.name}' for e in parameters)}}}

#include <math.h>

/* The model; q [rad], v [rad/s], tau [N m] and the results contain shoulder and elbow. */

static inline void pendubot_mass_matrix(const double q[2], double M[2][2])
{{
  M[0][0] = {m11};
  M[0][1] = M[1][0] = {m12};
  M[1][1] = {m22};
}}

static inline void pendubot_bias(const double q[2], const double v[2], double h[2])
{{
  h[0] = {h1};
  h[1] = {h2};
}}

static inline void pendubot_friction(const double v[2], const double tau[2], double f[2])
{{
  (void)tau;
  f[0] = {f1};
  f[1] = {f2};
}}

static inline void pendubot_acceleration(const double q[2], const double v[2], const double tau[2], double a[2])
{{
  double M[2][2], h[2], f[2], r[2], determinant;
  pendubot_mass_matrix(q, M);
  pendubot_bias(q, v, h);
  pendubot_friction(v, tau, f);
  r[0] = tau[0] - h[0] - f[0];
  r[1] = tau[1] - h[1] - f[1];
  determinant = M[0][0] * M[1][1] - M[0][1] * M[1][0];
  a[0] = (M[1][1] * r[0] - M[0][1] * r[1]) / determinant;
  a[1] = (M[0][0] * r[1] - M[1][0] * r[0]) / determinant;
}}

#endif
"""


def python(parameters: Sequence[Entry], comments: Sequence[str]) -> str:
    """Return a module without dependencies; its functions take arrays with ``lib=numpy``, expressions with casadi."""
    names = {name: f'lib.{name}' for name in ('cos', 'sin', 'tanh', 'exp', 'fabs')}
    m11, m12, m22, h1, h2, f1, f2 = _equations(len(parameters), names)
    return f'''\
{_lines('# {}', comments)}

"""A pendubot: its parameters, and its model.

q [rad], v [rad/s] and tau [N m] are pairs: shoulder, elbow. ``lib`` provides cos, sin, tanh, exp and fabs: math
for numbers, numpy or jax.numpy for arrays, casadi for expressions.
"""

import math

{_lines('{0.name} = {0.value!r}  # {0.meaning}', parameters)}
NAMES = ({', '.join(repr(e.name) for e in parameters)})
THETA = ({', '.join(e.name for e in parameters)})
STD_ERROR = {tuple(e.error for e in parameters)}


def mass_matrix(q, lib=math):
    """Return M(q) [kg m^2] as two rows."""
    q2 = q[1]
    m12 = {m12}
    return ({m11}, m12), (m12, {m22})


def bias(q, v, lib=math):
    """Return the torques V(q, v) v + G(q) of Coriolis forces and gravity [N m]."""
    q1, q2, v1, v2 = q[0], q[1], v[0], v[1]
    return (
        {h1},
        {h2},
    )


def friction(v, tau=(0.0, 0.0), lib=math):
    """Return the friction torques [N m]."""
    v1, v2, tau1, tau2 = v[0], v[1], tau[0], tau[1]
    return (
        {f1},
        {f2},
    )


def acceleration(q, v, tau, lib=math):
    """Return q1'', q2'' [rad/s^2]."""
    (m11, m12), (_, m22) = mass_matrix(q, lib)
    (h1, h2), (f1, f2) = bias(q, v, lib), friction(v, tau, lib)
    r1, r2 = tau[0] - h1 - f1, tau[1] - h2 - f2
    determinant = m11*m22 - m12*m12
    return (m22*r1 - m12*r2) / determinant, (m11*r2 - m12*r1) / determinant
'''
