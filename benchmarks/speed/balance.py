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
import itertools
import math
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.markdown import table
from pendubot_identification.control.controller import UPRIGHT, Controller
from pendubot_identification.control.linear_control import Design, Loop, margins
from pendubot_identification.control.plan import HELD, deviation, simulate_closed_loop
from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.settings import Settings
from pendubot_identification.model.parameters import BALANCE, Parameters
from pendubot_identification.model.simulation import HANGING, LatePlant
from test.virtual import recording

LAG, LIMIT, TIME = 0.004, 2.0, 10.0
#: Start angles, largest deviation of each angle from them [rad], and latest time at which the rig is held [s].
STARTS = {'upright': ((UPRIGHT, 0.0), 0.1, 1.0), 'hanging': (HANGING, 0.2, 10.0)}
#: Origins of the parameters.
SOURCES = ('truth', 'likelihood', 'weak', 'energy', 'energy over 0.5 s')


class Known(NamedTuple):
    """The controller's parameters and input delay [s] of the rig, and the level of their identification."""

    parameters: Parameters
    lag: float
    level: str = ''


class Trial(NamedTuple):
    """The outcome of one start: time until held [s], and RMS of the worse angle [rad] and of the torque [N m]."""

    held: float
    angle: float
    torque: float


def assessed(t, q, tau, begin):
    """Return the outcome of a trial from its samples after arming."""
    wrong = (deviation(q) > HELD) & (t <= begin + TIME)
    first = int(np.flatnonzero(wrong)[-1]) + 1 if wrong.any() else 0
    if first >= len(t) or t[first] > begin or t[-1] - t[first] < TIME - 0.01:
        return Trial(math.inf, math.nan, math.nan)
    quiet = (t >= t[first] + 1) & (t <= t[first] + TIME)
    return Trial(float(t[first]), *(float(np.sqrt((x[quiet] ** 2).mean())) for x in (deviation(q), tau)))


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
    with tempfile.TemporaryDirectory() as folder, LiveRig(Path(folder), rate) as rig:

        def stopped():
            return any(status.message.startswith('stopped') for status in rig.said())

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


def identified():
    """Identify the rig from quantized angles under the exciter's pulses of 2 N m, by every criterion."""
    motion = recording(1800, rig=BALANCE, delay=LAG, strength=LIMIT)
    ways = {
        '': {'criteria': ('energy', 'weak', 'likelihood')},
        ' over 0.5 s': {'criteria': ('energy',), 'sliding': 0.5},
    }
    return {
        e.criterion + way: Known(Parameters.from_vector(e.theta), max(0.0, e.effort.delay), e.level.name)
        for way, chosen in ways.items()
        for e in identify([motion[:900]], [motion[900:]], Settings(model='viscous', hold='zero', **chosen)).estimates
    }


def errors_of(sources):
    for source, known in sources.items():
        error = np.abs(known.parameters.vector() / BALANCE.vector() - 1)[:5].max()
        yield source, known.level, f'{100 * error:.1f} % of P1 to P5', f'{1e3 * known.lag:.2f} ms'


def held(sources, options):
    for (source, known), rate, start in itertools.product(sources.items(), options.rates, STARTS):
        if known.level == 'ERROR':  # the balancer refuses them
            continue
        if options.live:
            trials = list(live_trials(known, rate, start, options.seeds))
        else:
            trials = [simulated(known, rate, start, seed) for seed in range(options.seeds)]
        good = [x for x in trials if math.isfinite(x.held)]
        after, angle, torque = np.median(good or [[math.nan] * 3], axis=0)
        figures = f'{after:.1f} s', f'{1e3 * angle:.1f} mrad', f'{torque:.3f} N m'
        yield source, f'{rate} Hz', start, f'{len(good)} of {len(trials)}', *figures


def margins_at(rates):
    for rate in rates:
        m = margins(Design.make(BALANCE, Loop(1 / rate, LAG, LIMIT)))
        gain, phase = f'{m.gain_down:.2f} to {m.gain_up:.2f}', f'{math.degrees(m.phase):.0f} degrees'
        yield f'{rate} Hz', gain, phase, f'{1e3 * m.delay:.1f} ms'


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
    known = {'truth': Known(BALANCE, LAG)}
    if set(options.sources) - {'truth'}:
        known |= identified()
    sources = {name: known[name] for name in options.sources}
    table(('parameters', 'level', 'largest error', 'delay found'), errors_of(sources))
    how, figures = 'live' if options.live else 'simulated', ('after', 'RMS angle', 'RMS torque')
    table((f'{how}: parameters', 'rate', 'start', 'held', *figures), held(sources, options))
    if not options.live:
        table(('rate', 'gain', 'phase', 'delay'), margins_at(options.rates))


if __name__ == '__main__':
    main()
