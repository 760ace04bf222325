# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Measures swing-up and balancing of the virtual rig with parameters of several origins, and the stability margins.

    python -m benchmarks.speed.balance [--live] [--seeds 20] [--rates 200 500] [--from truth weak ...]

Prints Markdown tables of the rig `balance` with encoders of 4000 counts, 4 ms of motor delay and 2 N m: from 20 starts
near upright (each angle within 0.1 rad) and 20 from hanging (within 0.2 rad), at rest. A trial is held if both angles
stay within 0.2 rad of upright for 10 s, beginning at most 1 s (upright) or 10 s (hanging) after the start. Without
--live, trials are simulated; with it, they run over the board's protocol, a pty, the bridge, DDS and the balancer, in
real time, for 12 s and more each, on an otherwise idle machine. The last table shows margins.
"""

import os

os.environ['OPENBLAS_NUM_THREADS'] = '1'  # before numpy: the matrices are small
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')

import argparse
import math
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.markdown import head, line
from pendubot_identification.control.controller import UPRIGHT, Controller
from pendubot_identification.control.linear_control import Design, Loop, margins
from pendubot_identification.control.plan import HELD, deviation, simulate_closed_loop
from pendubot_identification.errors import ControlError
from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.settings import Settings
from pendubot_identification.model.parameters import BALANCE, Parameters
from pendubot_identification.model.simulation import HANGING, LatePlant, quantised
from pendubot_identification.trajectories.trajectory import Trajectory

LAG, LIMIT, TIME = 0.004, 2.0, 10.0
#: Start angles, largest deviation of each angle from them [rad], and latest time at which the rig is held [s].
STARTS = {'upright': ((UPRIGHT, 0.0), 0.1, 1.0), 'hanging': (HANGING, 0.2, 10.0)}
#: Origins of the parameters.
SOURCES = ('truth', 'likelihood', 'weak', 'energy', 'energy over 0.5 s')


class Known(NamedTuple):
    """The controller's parameters and input delay [s] of the rig."""

    parameters: Parameters
    lag: float


class Trial(NamedTuple):
    """The outcome of one start: time until held [s], RMS of the worse angle [rad] and of the torque, its peak [N m]."""

    held: float
    angle: float
    torque: float
    peak: float


def assessed(t, q, tau, begin):
    """Return the outcome of a trial from its samples after arming."""
    wrong = (deviation(q) > HELD) & (t <= begin + TIME)
    first = int(np.flatnonzero(wrong)[-1]) + 1 if wrong.any() else 0
    peak = float(abs(tau).max())
    if first >= len(t) or t[first] > begin or t[-1] - t[first] < TIME - 0.01:
        return Trial(math.inf, math.nan, math.nan, peak)
    quiet = (t >= t[first] + 1) & (t <= t[first] + TIME)
    return Trial(float(t[first]), *(float(np.sqrt((x[quiet] ** 2).mean())) for x in (deviation(q), tau)), peak)


def simulated(known, rate, start, seed):
    place, spread, begin = STARTS[start]
    rng = np.random.default_rng(seed)
    q1, q2 = (q + rng.uniform(-spread, spread) for q in place)
    loop = Loop(1 / rate, known.lag, LIMIT)
    controller = Controller(Design.make(known.parameters, loop))
    run = simulate_closed_loop(controller, LatePlant(BALANCE, LAG, (q1, q2)), begin + TIME + 2, enough=TIME + 2)
    return assessed(run.motion.t, run.motion.q, run.motion.tau[:, 0], begin)


def live_trials(known, rate, start, seeds):
    """Run trials over pty, bridge and DDS; each trial has a new board, but bridge and balancer continue."""
    from test.live import LiveRig
    from test.processes import parameters, spin_until
    from test.rig import ARMED

    _, spread, begin = STARTS[start]
    with tempfile.TemporaryDirectory() as folder:
        rig = LiveRig(Path(folder), rate)

        def stopped():
            return any(status.message.startswith('stopped') for status in rig.said())

        try:
            rig.publish(known.parameters, delay=known.lag)
            rig.start('balancer', *parameters(accept_warn='true'))
            rig.start_bridge()
            for seed in range(seeds):
                board = rig.start_board(start=start, spread=spread, delay=LAG, seed=seed)
                rig.begin()
                rig.statuses.clear()
                deadline = time.monotonic() + begin + TIME + 5
                while time.monotonic() < deadline and rig.held()[1] < TIME + 0.1 and not stopped():
                    spin_until(rig.node, stopped, 0.5)
                rig.call('/balancer/stop')
                t, q, tau, status = rig.motion()
                armed = (status & ARMED).astype(bool)
                trial = assessed(t[armed] - t[armed][0], q[armed], tau[armed], begin)
                if not math.isfinite(trial.held):
                    last = rig.said()[-1].message if rig.said() else 'nothing'
                    print(f'<!-- {start}, {rate} Hz, seed {seed}: the balancer reports: {last} -->', flush=True)
                yield trial
                board.stop()
        finally:
            rig.close()


def identified():
    """Identify the rig from quantized angles under the exciter's pulses of 2 N m, by every criterion."""
    t, train = np.arange(1800) * 0.01, PulseTrain(amplitude_min=-2, amplitude_max=2)
    rig, states, tau = LatePlant(BALANCE, LAG), [], np.array([[train.torque(x), 0.0] for x in t])
    for torque in tau:
        states.append(rig.q)
        rig.advance((torque[0], 0.0), 0.01)
    motion = quantised(Trajectory(t, np.array(states), tau), 4000)
    ways = {
        '': {'criteria': ('energy', 'weak', 'likelihood')},
        ' over 0.5 s': {'criteria': ('energy',), 'sliding': 0.5},
    }
    return {
        e.criterion + way: (Known(Parameters.from_vector(e.theta), max(0.0, e.effort.delay)), e.level.name)
        for way, chosen in ways.items()
        for e in identify([motion[:900]], [motion[900:]], Settings(model='viscous', hold='zero', **chosen)).estimates
    }


def compare(options):
    sources = {'truth': (Known(BALANCE, LAG), '')}
    if set(options.sources) - {'truth'}:
        sources |= identified()
    print('\n' + head('parameters', 'level', 'largest error', 'delay found'))
    for source in options.sources:
        known, level = sources[source]
        error = np.abs(known.parameters.vector() / BALANCE.vector() - 1)[:5].max()
        print(line(source, level, f'{100 * error:.1f} % of P1 to P5', f'{1e3 * known.lag:.2f} ms'))
    how, figures = 'live' if options.live else 'simulated', ('after', 'RMS angle', 'RMS torque', 'peak torque')
    print('\n' + head(f'{how}: parameters', 'rate', 'start', 'held', *figures))
    for source in options.sources:
        known, _ = sources[source]
        for rate in options.rates:
            for start in STARTS:
                try:
                    if options.live:
                        trials = list(live_trials(known, rate, start, options.seeds))
                    else:
                        trials = [simulated(known, rate, start, seed) for seed in range(options.seeds)]
                except ControlError as error:
                    print(line(source, f'{rate} Hz', start, error, '', '', '', ''), flush=True)
                    continue
                good = [x for x in trials if math.isfinite(x.held)]
                held, angle, torque, _ = np.median(good or [[math.nan] * 4], axis=0)
                peak = max(x.peak for x in trials)
                cells = f'{held:.1f} s', f'{1e3 * angle:.1f} mrad', f'{torque:.3f} N m', f'{peak:.3f} N m'
                print(line(source, f'{rate} Hz', start, f'{len(good)} of {len(trials)}', *cells))


def print_margins(rates):
    print('\n' + head('rate', 'gain', 'phase', 'delay'))
    for rate in rates:
        m = margins(Design.make(BALANCE, Loop(1 / rate, LAG, LIMIT)))
        gain, phase = f'{m.gain_down:.2f} to {m.gain_up:.2f}', f'{math.degrees(m.phase):.0f} degrees'
        print(line(f'{rate} Hz', gain, phase, f'{1e3 * m.delay:.1f} ms'))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--live', action='store_true', help='over pty, bridge and DDS, and the comparison alone')
    parser.add_argument('--seeds', type=int, default=20)
    parser.add_argument('--rates', type=int, nargs='+', default=[200, 500])
    parser.add_argument('--from', dest='sources', nargs='+', default=SOURCES, choices=SOURCES)
    options = parser.parse_args()
    if options.live:
        import rclpy

        from test.domain import take_domain

        take_domain()
        rclpy.init()
    compare(options)
    if not options.live:
        print_margins(options.rates)


if __name__ == '__main__':
    main()
