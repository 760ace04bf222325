# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""From arrays to an LQR that balances the rig upright in simulation: python lqr.py [RESULT.yaml]."""

import sys

import numpy as np
from scipy.linalg import solve_continuous_are

from pendubot_identification import UPRIGHT, Pendubot, identify, simulate

if len(sys.argv) > 1:
    rig = Pendubot.load(sys.argv[1])
else:  # your own arrays in the place of a simulated rig
    rig = Pendubot(P1=0.0148, P2=0.0051, P3=0.0046, P4=0.1003, P5=0.0303, b1=0.0008, b2=0.0001)
    t = np.arange(1500) * 0.01
    torque = np.where(t % 1 < 0.05, np.random.default_rng(1).uniform(-2, 2, len(t)), 0.0)
    found = identify(t=t, q=simulate(rig, t, torque).q.round(4), tau=torque)
    print(found)
    rig = found.pendubot

# x' = A x + B tau near upright, x = [q - UPRIGHT, qd]; an angle of 0.1 rad costs as much as a torque of 0.1 N m.
A, B = rig.linearised()
Q, R = np.diag([1.0, 1.0, 0.0, 0.0]) / 0.1**2, np.eye(1) / 0.1**2
K = (np.linalg.inv(R) @ B.T @ solve_continuous_are(A, B, Q, R))[0]
print('tau = -K x with K =', K.round(3))
print('poles of the closed loop:', np.linalg.eigvals(A - B @ K[None]).round(2))

# Simulate the nonlinear rig under this control every 5 ms, from 0.05 rad off upright.
q, qd, period = (UPRIGHT[0] + 0.05, UPRIGHT[1]), (0.0, 0.0), 0.005
for step in range(400):
    tau = float(-K @ [q[0] - UPRIGHT[0], q[1] - UPRIGHT[1], *qd])
    if step % 50 == 0:
        print(f'{step * period:.2f} s: off by {np.subtract(q, UPRIGHT).round(4)} rad, {tau:+.3f} N m')
    motion = simulate(rig, [0.0, period], tau, q, qd)
    q, qd = tuple(motion.q[-1]), tuple(motion.qd[-1])

off = np.abs(np.subtract(q, UPRIGHT)).max()
print(f'after 2 s: off by {off:.1e} rad')
if not off < 1e-3:
    raise SystemExit('it fell')
