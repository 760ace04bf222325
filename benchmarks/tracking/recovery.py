# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Measures the recovery of a balancer after its rig gets a payload, with tracked and with old parameters.

    python -m benchmarks.tracking.recovery [--seeds 10]

The simulated rig is `balance` with encoders of 4000 counts, 200 Hz, 4 ms of motor delay and 2 N m. The tracker
identifies it from pulses; the balancer swings it up and holds it. Then a payload is put on its end, with an impact of
up to 0.3 rad/s at each joint. The motor is off from 2 s later on for 6 s; then the rig is swung up again.
"""

import argparse
import math

import numpy as np

from benchmarks.markdown import table
from pendubot_identification.control.controller import Controller, SafetyLimits
from pendubot_identification.control.linear_control import Design, Loop, margins
from pendubot_identification.control.plan import HELD, deviation
from pendubot_identification.errors import ControlError
from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.level import NORMAL_95, Level
from pendubot_identification.model.parameters import BALANCE, Parameters
from pendubot_identification.model.simulation import HANGING, LatePlant
from pendubot_identification.tracking.events import Change, Lost, Start
from pendubot_identification.tracking.tracker import Tracker

RATE, LAG, LIMIT = 200, 0.004, 2.0
#: Times of the first swing-up, the payload, motor off, the second swing-up, and the end [s].
BEGIN, ON, FALL, AGAIN, END = 12.0, 24.0, 26.0, 32.0, 52.0
COUNT = 2 * math.pi / 4000


def trial(payload, seed, *, tracked):
    """Return the detection [s after the change], positions and torques, and the theta of the last design."""
    rng, loop = np.random.default_rng(seed), Loop(1 / RATE, LAG, LIMIT)
    train = PulseTrain(amplitude_min=-LIMIT, amplitude_max=LIMIT, seed=seed)
    rig, tracker = LatePlant(BALANCE, LAG), Tracker(Start('viscous'))
    controller, known, torque, waiting, rows, detected = None, None, 0.0, [], [], math.nan
    for k in range(round(END * RATE)):
        t = k / RATE
        if k == round(ON * RATE):
            rig.become(BALANCE.carrying(payload))
            rig.place(rig.q, tuple(np.add(rig.qd, rng.uniform(-0.3, 0.3, 2))))
        q = tuple(round((q - zero) / COUNT) * COUNT + zero for q, zero in zip(rig.q, HANGING, strict=True))
        effort = torque
        rows.append((t, *rig.q, effort))
        waiting.append((t, *q, effort, 0.0))
        if len(waiting) == RATE // 10:
            for event in tracker.feed(np.array(waiting)):
                if isinstance(event, (Change, Lost)) and t > ON and math.isnan(detected):
                    detected = t - ON
            waiting, state = [], tracker.state
            if state is not None and state.level is Level.OK and (tracked or t < ON):
                moved = known is None or (abs(state.theta - known) > NORMAL_95 * state.std_error).any()
                known = state.theta if moved else known
                if moved and controller is not None:
                    controller.adopt(Design.make(Parameters.from_vector(known), loop))
        if k == round(FALL * RATE):
            controller = None
        if controller is None and (BEGIN <= t < FALL or t >= AGAIN):
            controller = Controller(Design.make(Parameters.from_vector(known), loop), SafetyLimits(elbow=1e3))
        try:
            pulse = train.torque(t) if t < BEGIN else 0.0
            torque = pulse if controller is None else controller.step(t, q, effort)
        except ControlError:
            break
        rig.advance((effort, 0.0), 1 / RATE)
    return detected, np.array(rows), known


def phase_margin(known, payload):
    """Return the phase margin [deg] of a balancer that is designed for theta on a rig with the payload."""
    design = Design.make(Parameters.from_vector(known), Loop(1 / RATE, LAG, LIMIT))
    return math.degrees(margins(design, BALANCE.carrying(payload)).phase)


def rows(seeds):
    for payload in (0.06, 0.12):
        for tracked in (False, True):
            detected, again, phase = 0, [], []
            for seed in seeds:
                when, rows, known = trial(payload, seed, tracked=tracked)
                t, error = rows[:, 0], deviation(rows[:, 1:3])
                detected += math.isfinite(when)
                phase.append(phase_margin(known, payload))
                last = t[np.flatnonzero(error > HELD)[-1]]
                if t[-1] > END - 1 and last < END - 5:
                    again.append(last - AGAIN)
            found = (f'{each} of {len(seeds)}' for each in (detected, len(again)))
            after = f'{np.median(again or [math.nan]):.1f}'
            yield f'{payload:g} kg', 'tracked' if tracked else 'old', *found, after, f'{min(phase):.1f}'


def main():
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--seeds', type=int, default=10)
    seeds = range(parser.parse_args().seeds)
    table(('payload', 'parameters', 'detected', 'held again', 'after [s]', 'phase margin [deg]'), rows(seeds))


if __name__ == '__main__':
    main()
