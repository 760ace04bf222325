# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""From arrays to CasADi expressions of the dynamics, for optimal control: python casadi_dynamics.py [RESULT.yaml].

Needs `pip install casadi`. The same call with `import jax.numpy` in the place of casadi can be differentiated by JAX.
"""

import sys

import numpy as np

try:
    import casadi
except ImportError:
    raise SystemExit('this example needs CasADi: pip install casadi') from None

from pendubot_identification import UPRIGHT, Pendubot, accelerations, identify, simulate

if len(sys.argv) > 1:
    rig = Pendubot.load(sys.argv[1])
else:  # your own arrays in the place of a simulated rig
    rig = Pendubot(P1=0.0148, P2=0.0051, P3=0.0046, P4=0.1003, P5=0.0303, b1=0.0008, b2=0.0001)
    t = np.arange(1500) * 0.01
    torque = np.where(t % 1 < 0.05, np.random.default_rng(1).uniform(-2, 2, len(t)), 0.0)
    rig = identify(t=t, q=simulate(rig, t, torque).q.round(4), tau=torque).pendubot

x, tau = casadi.SX.sym('x', 4), casadi.SX.sym('tau')
q1, q2, v1, v2 = casadi.vertsplit(x)
a1, a2 = accelerations(rig.theta.tolist(), q1, q2, v1, v2, tau, 0.0, lib=casadi)
f = casadi.Function('f', [x, tau], [casadi.vertcat(v1, v2, a1, a2)])

# The torque of least squared sum that moves both links from hanging to upright, at rest, in 1 s with at most 2 N m.
N, h, limit = 100, 0.01, 2.0
problem = casadi.Opti()
X, U = problem.variable(4, N + 1), problem.variable(N)
problem.minimize(casadi.sumsqr(U))
for k in range(N):
    k1 = f(X[:, k], U[k])
    k2 = f(X[:, k] + h / 2 * k1, U[k])
    k3 = f(X[:, k] + h / 2 * k2, U[k])
    k4 = f(X[:, k] + h * k3, U[k])
    problem.subject_to(X[:, k + 1] == X[:, k] + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
problem.subject_to(problem.bounded(-limit, U, limit))
problem.subject_to(X[:, 0] == [-np.pi / 2, 0, 0, 0])
problem.subject_to(X[:, N] == [*UPRIGHT, 0, 0])
problem.set_initial(X[0, :], np.linspace(-np.pi / 2, np.pi / 2, N + 1))
problem.solver('ipopt', {'print_time': False}, {'print_level': 0, 'sb': 'yes', 'max_iter': 1000})
solution = problem.solve()
torque = solution.value(U)

# The package's own simulation under these torques ends there, too.
motion = simulate(rig, np.arange(N + 1) * h, np.append(torque, 0.0))
print(f'{np.abs(torque).max():.3f} N m at most; ends {np.abs(motion.q[-1] - UPRIGHT).max():.1e} rad from upright')
