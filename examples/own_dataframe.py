# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""From a log as a DataFrame to parameters: python own_dataframe.py [FILE.csv].

The columns are time, shoulder, elbow and torque, with angles in degrees that are 0 when hanging.
"""

import sys

import numpy as np
import pandas

from pendubot_identification import HANGING, Pendubot, identify, read, simulate

if len(sys.argv) > 1:
    log = pandas.read_csv(sys.argv[1])
else:  # a simulated rig
    rig = Pendubot(P1=0.0148, P2=0.0051, P3=0.0046, P4=0.1003, P5=0.0303, b1=0.0008, b2=0.0001)
    t = np.arange(1500) * 0.01
    torque = np.where(t % 1 < 0.05, np.random.default_rng(1).uniform(-2, 2, len(t)), 0.0)
    shoulder, elbow = np.degrees(simulate(rig, t, torque).q - HANGING).round(2).T
    log = pandas.DataFrame({'time': t, 'shoulder': shoulder, 'elbow': elbow, 'torque': torque})

# The columns, and the convention of the angles; read() returns the motion in rad from the horizontal.
reading = {'columns': {'t': 'time', 'q1': 'shoulder', 'q2': 'elbow', 'tau1': 'torque'}}
reading |= {'degrees': True, 'zero': 'hanging'}
motion = read(log, **reading)
print(f'{len(motion)} samples, {motion.duration:.2f} s; it starts at {motion.q[0]} rad')

# The first ten seconds are for training, the rest is for validation.
found = identify(log[log.time < 10], validate=[log[log.time >= 10]], **reading)
print(found)
print(found.frame().drop(columns='meaning'))  # one row for each parameter
