# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The model in MATLAB, C and Python: parameters, and functions that need nothing else.

The equations of :mod:`..model.dynamics` stand here once, as text that all three languages understand; each puts its own
names in the place of theirs.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from pendubot_identification.model.dynamics import GRAVITY, SIGN_WIDTH, STRIBECK_SPEED
from pendubot_identification.model.parameters import MODELS

#: M(q), symmetric: M11, M12, M22.
MASS_MATRIX = 'P1 + P2 + 2*P3*cos(q2)', 'P2 + P3*cos(q2)', 'P2'
#: V(q, q') q' + G(q).
BIAS = (
    f'-P3*sin(q2)*(2*v1*v2 + v2*v2) + {GRAVITY}*(P4*cos(q1) + P5*cos(q1 + q2))',
    f'P3*sin(q2)*v1*v1 + {GRAVITY}*P5*cos(q1 + q2)',
)


class Entry(NamedTuple):
    """A parameter, its standard error where it is known, and what it means."""

    name: str
    value: float
    error: float | None
    meaning: str


def _mass_matrix(size: int) -> tuple[str, ...]:
    return (*MASS_MATRIX[:2], 'P2 + J2' if size >= MODELS['rotor'] else 'P2')


def _friction(size: int) -> tuple[str, ...]:
    """Return what brakes each joint, as far as a model of so many parameters goes."""
    viscous, dry = 'b{0}*v{0}', ''
    if size >= MODELS['coulomb']:
        dry = f' + Fc{{0}}*tanh(v{{0}}/{SIGN_WIDTH})'
    if size >= MODELS['geared']:
        more = f'Fs{{0}}*exp(-(v{{0}}/{STRIBECK_SPEED})*(v{{0}}/{STRIBECK_SPEED})) + k{{0}}*fabs(tau{{0}})'
        dry = f' + (Fc{{0}} + {more})*tanh(v{{0}}/{SIGN_WIDTH})'
    return tuple((viscous + dry).format(joint) for joint in (1, 2))


def _in(names: Mapping[str, str], expressions: Sequence[str]) -> tuple[str, ...]:
    """Return expressions in a language that has other names for some things."""
    return tuple(re.sub(r'[A-Za-z]\w*', lambda word: names.get(word[0], word[0]), each) for each in expressions)


def _indexed(pattern: str, first: int) -> dict[str, str]:
    """Return a language's name for each angle, velocity and torque: ``pattern`` of the vector and the index."""
    return {f'{vector}{k + 1}': pattern.format(vector, first + k) for vector in ('q', 'v', 'tau') for k in (0, 1)}


def matlab(parameters: Sequence[Entry], comments: Sequence[str]) -> str:
    """Return a script, for Octave too, that makes a struct ``pendubot``: parameters and, as handles, the model."""
    names = {name: f'pendubot.{name}' for name, *_ in parameters} | _indexed('{}({})', 1) | {'fabs': 'abs'}
    m11, m12, m22 = _in(names, _mass_matrix(len(parameters)))
    h1, h2 = _in(names, BIAS)
    f1, f2 = _in(names, _friction(len(parameters)))
    lines = [
        *(f'% {line}' for line in comments),
        *(f'pendubot.{e.name} = {e.value!r};  % {e.meaning}' for e in parameters),
        f'pendubot.theta = [{" ".join(repr(e.value) for e in parameters)}];',
        f'pendubot.std_error = [{" ".join("NaN" if e.error is None else repr(e.error) for e in parameters)}];',
        f'pendubot.names = {{{", ".join(repr(name) for name, *_ in parameters)}}};',
        '% The model, with these values: q [rad], v [rad/s] and tau [N m] are of shoulder and elbow.',
        f'pendubot.mass_matrix = @(q) [{m11}, {m12}; {m12}, {m22}];',
        f'pendubot.bias = @(q, v) [{h1}; {h2}];',
        f'pendubot.friction = @(v, tau) [{f1}; {f2}];',
        'pendubot.acceleration = @(q, v, tau) pendubot.mass_matrix(q) \\ ...',
        '    ([tau(1); tau(2)] - pendubot.bias(q, v) - pendubot.friction(v, tau));',
        '% for ode45: @(t, x) pendubot.derivative(x, [0; 0]), x = [q1; q2; v1; v2]',
        'pendubot.derivative = @(x, tau) [x(3); x(4); pendubot.acceleration(x(1:2), x(3:4), tau)];',
    ]
    return '\n'.join(lines) + '\n'


def c(parameters: Sequence[Entry], comments: Sequence[str]) -> str:
    """Return a header: ``PENDUBOT_P1`` ..., ``PENDUBOT_THETA``, and from C99 and in C++ the model as functions."""
    names = {name: f'PENDUBOT_{name}' for name, *_ in parameters} | _indexed('{}[{}]', 0)
    mass, bias, friction = (_in(names, e) for e in (_mass_matrix(len(parameters)), BIAS, _friction(len(parameters))))
    lines = [
        '/*',
        *(f' * {line.replace("*/", "* /").replace("/*", "/ *")}' for line in comments),
        ' */',
        '#ifndef PENDUBOT_PARAMETERS_H',
        '#define PENDUBOT_PARAMETERS_H',
        '',
        *(f'#define PENDUBOT_{e.name} ({e.value!r})  /* {e.meaning} */' for e in parameters),
        '',
        f'#define PENDUBOT_COUNT {len(parameters)}',
        f'#define PENDUBOT_THETA {{{", ".join(f"PENDUBOT_{name}" for name, *_ in parameters)}}}',
    ]
    return (
        '\n'.join(lines)
        + f"""

#if defined(__cplusplus) || (defined(__STDC_VERSION__) && __STDC_VERSION__ >= 199901L)
#include <math.h>

/* The model: q [rad], v [rad/s], tau [N m] and what comes out are of shoulder and elbow. */

static inline void pendubot_mass_matrix(const double q[2], double M[2][2])
{{
  M[0][0] = {mass[0]};
  M[0][1] = M[1][0] = {mass[1]};
  M[1][1] = {mass[2]};
}}

static inline void pendubot_bias(const double q[2], const double v[2], double h[2])
{{
  h[0] = {bias[0]};
  h[1] = {bias[1]};
}}

static inline void pendubot_friction(const double v[2], const double tau[2], double f[2])
{{
  (void)tau;
  f[0] = {friction[0]};
  f[1] = {friction[1]};
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

#endif
"""
    )


def python(parameters: Sequence[Entry], comments: Sequence[str]) -> str:
    """Return a module that needs nothing but Python; with ``lib=numpy`` it takes arrays, with casadi expressions."""
    names = {name: f'lib.{name}' for name in ('cos', 'sin', 'tanh', 'exp', 'fabs')}
    mass, bias, friction = (_in(names, e) for e in (_mass_matrix(len(parameters)), BIAS, _friction(len(parameters))))
    lines = [
        *(f'# {line}' for line in comments),
        '',
        '"""A pendubot: its parameters, and its model.',
        '',
        'q [rad], v [rad/s] and tau [N m] are pairs: shoulder, elbow. ``lib`` has cos, sin, tanh, exp and fabs: math',
        'for numbers, numpy or jax.numpy for arrays, casadi for expressions.',
        '"""',
        '',
        'import math',
        '',
        *(f'{e.name} = {e.value!r}  # {e.meaning}' for e in parameters),
        f'NAMES = ({", ".join(repr(name) for name, *_ in parameters)})',
        f'THETA = ({", ".join(name for name, *_ in parameters)})',
        f'STD_ERROR = {tuple(e.error for e in parameters)}',
    ]
    return (
        '\n'.join(lines)
        + f'''


def mass_matrix(q, lib=math):
    """Return M(q) [kg m^2] as two rows."""
    q2 = q[1]
    m12 = {mass[1]}
    return ({mass[0]}, m12), (m12, {mass[2]})


def bias(q, v, lib=math):
    """Return V(q, v) v + G(q) [N m]: what Coriolis forces and gravity ask for."""
    q1, q2, v1, v2 = q[0], q[1], v[0], v[1]
    return (
        {bias[0]},
        {bias[1]},
    )


def friction(v, tau=(0.0, 0.0), lib=math):
    """Return what brakes the joints [N m]."""
    v1, v2, tau1, tau2 = v[0], v[1], tau[0], tau[1]
    return (
        {friction[0]},
        {friction[1]},
    )


def acceleration(q, v, tau, lib=math):
    """Return q1'', q2'' [rad/s^2]."""
    (m11, m12), (_, m22) = mass_matrix(q, lib)
    (h1, h2), (f1, f2) = bias(q, v, lib), friction(v, tau, lib)
    r1, r2 = tau[0] - h1 - f1, tau[1] - h2 - f2
    determinant = m11*m22 - m12*m12
    return (m22*r1 - m12*r2) / determinant, (m11*r2 - m12*r1) / determinant
'''
    )
