# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""From your own recording to parameters: python own_csv.py [FILE.csv].

Without a file, one is made of a simulated rig: columns time, shoulder, elbow and torque, angles in degrees that are 0
where the rig hangs, as much lab software writes them.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from pendubot_identification import HANGING, Pendubot, identify, read, simulate

if len(sys.argv) > 1:
    path = Path(sys.argv[1])
else:
    rig = Pendubot(P1=0.0148, P2=0.0051, P3=0.0046, P4=0.1003, P5=0.0303, b1=0.0008, b2=0.0001)
    t = np.arange(1500) * 0.01
    torque = np.where(t % 1 < 0.05, np.random.default_rng(1).uniform(-2, 2, len(t)), 0.0)
    motion = simulate(rig, t, torque)
    degrees = np.degrees(motion.q - HANGING).round(2)
    path = Path(tempfile.mkdtemp()) / 'swing.csv'
    rows = np.column_stack([t, degrees, torque])
    np.savetxt(path, rows, '%.6g', ',', header='time,shoulder,elbow,torque', comments='')

# What the file calls its columns, and how its angles are measured.
columns = {'t': 'time', 'q1': 'shoulder', 'q2': 'elbow', 'tau1': 'torque'}
motion = read(path, columns=columns, degrees=True, zero='hanging')
print(f'{len(motion)} samples, {motion.duration:.2f} s; it starts at {motion.q[0]} rad')

# The first ten seconds estimate, the rest validates.
found = identify(motion.window(0, 10), validate=[motion.window(10, 15)])
print(found)
