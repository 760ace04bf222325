# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""From arrays to parameters, a figure and a URDF: python own_arrays.py [FOLDER]."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from pendubot_identification import HANGING, Pendubot, identify, simulate

# Put your arrays in the place of a simulated rig: angles in degrees, 0 when hanging, and torques in mN m.
rig = Pendubot(P1=0.0148, P2=0.0051, P3=0.0046, P4=0.1003, P5=0.0303, b1=0.0008, b2=0.0001)
t = np.arange(1500) * 0.01
torque = np.where(t % 1 < 0.05, np.random.default_rng(1).uniform(-2000, 2000, len(t)), 0.0)
angles = np.degrees(simulate(rig, t, torque / 1000).q - HANGING).round(2)

# The first half is for training, the second for validation. identify(frame, ...) takes columns t, q1, q2, tau1.
found = identify(t=t, q=angles, tau=torque, degrees=True, zero='hanging', torque_unit='mNm')
print(found)

if len(sys.argv) > 1:
    folder = Path(sys.argv[1])
    figure, axes = plt.subplots(2, sharex=True)
    found.plot(axes=axes)  # measured and simulated q1 and q2; found.plot() draws the whole figure of the report
    figure.savefig(folder / 'simulation.png')
    print('written to', found.export(folder / 'rig.urdf'), 'and', found.report(folder / 'report'))
