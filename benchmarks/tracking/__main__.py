# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Measures the tracking of rigs that change while they move, compared with other methods.

python -m benchmarks.tracking                 the tables of docs/benchmarks.md, with a peer
python -m benchmarks.tracking --others        rigs with other sampling and excitation
"""

import argparse

import numpy as np

from benchmarks.markdown import table
from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.settings import Settings
from pendubot_identification.level import NORMAL_95, Level
from pendubot_identification.tracking.events import Change, Disturbance, State, TrackerSettings
from pendubot_identification.tracking.tracker import Tracker
from pendubot_identification.trajectories.trajectory import Trajectory
from test.changing_rig import Day, record, truth

from .peers import kalman

SECONDS, AT = 600.0, 300.0
WALK = np.array([TrackerSettings().inertia_walk] * 5 + [TrackerSettings().friction_walk] * 4)
RIGS = (
    *((33, 4096, 0.35), (50, 4096, 0.35), (100, 1000, 0.35), (200, 500, 0.35), (200, 4096, 0.8), (200, 4096, 0.15)),
    *((200, 100_000, 0.35), (500, 2000, 0.35), (1000, 10_000, 0.35), (1000, 500, 0.35)),
)
PARTS = slice(0, 5), slice(5, 9)
ERRORS = 'P1 to P5 [%]', 'friction [%]', 'inside', ''
#: Changes at 300 s, or, if gradual, from 100 to 500 s.
CHANGES = {
    'payload of 20 % of link 2': Day(payload=0.2, payload_at=AT),
    'payload of 2 %': Day(payload=0.02, payload_at=AT),
    'motor loses 20 % at once': Day(fades_at=AT),
    'motor loses 20 % in 400 s': Day(fade=0.2, fade_at=100.0),
    'base tilts by 0.01 rad': Day(tilt=0.01, tilt_at=AT),
    'base tilts by 0.1 rad': Day(tilt=0.1, tilt_at=AT),
    'dead zone of 0.01 N m': Day(dead_zone=0.01, dead_zone_at=AT),
    'dead zone of 0.04 N m': Day(dead_zone=0.04, dead_zone_at=AT),
}


def batch(t, q, tau, until):
    """Return the weak criterion's fit of the first seconds, with its defaults."""
    now = t < until
    motion = Trajectory(t[now], q[now], np.column_stack([tau[now], 0 * tau[now]]))
    settings = Settings(('weak',), 'coulomb', 'lsq', hold='zero', delays=(0.0, 0.05), compensate=False)
    return identify([motion], (), settings).best.theta


def track(t, q, tau):
    """Return all states and all events of one rig, each event with the time of its report."""
    tracker, samples = Tracker(), np.column_stack([t, q, tau, 0 * t])
    parts = [samples[k : k + 20] for k in range(0, len(t), 20)]
    updates = [(float(part[-1, 0]), update) for part in parts for update in tracker.feed(part)]
    states = [update for _, update in updates if isinstance(update, State)]
    return states, [each for each in updates if not isinstance(each[1], State)]


def scores(times, theta, deviation, day, since):
    """Return cells: the RMS errors [%] after a time, and the percentage of intervals with the truth, if known.

    ``theta`` and ``deviation``: shape (M, 9) at the times, shape (M,).
    """
    late = times > since
    true = truth(day, times[late])
    error = theta[late] - true
    cells = [f'{np.sqrt(np.square(100 * error[:, p] / true[:, p]).mean()):.3g}' for p in PARTS]
    if deviation is not None:
        reach = NORMAL_95 * deviation[late]
        cells += [f'{100 * (np.abs(error[:, p]) < reach[:, p]).mean():.0f}' for p in PARTS]
    return cells


def of_tracks(tracks, day, since):
    """Return the cells of rigs with the same changes."""
    rows = [(s.t, s.theta, s.std_error) for states, _ in tracks for s in states]
    return scores(*map(np.array, zip(*rows, strict=True)), day, since)


def constant(t, q, tau, tracks):
    """Print the errors after 60 s, divided by the errors of the batch fit of the same data."""
    true = truth(Day(), [0.0])[0]
    at = [next(s for s in states if s.t > 59.5).theta for states, _ in tracks]
    of_batch = [batch(t, *each, 60.0) for each in zip(q, tau, strict=True)]
    rms, rms_batch = (np.sqrt(np.mean(np.square(np.array(each) / true - 1), axis=0)) for each in (at, of_batch))
    ratio = ' '.join(f'{x:.2f}' for x in rms / rms_batch)
    print(f'constant: errors after 60 s over errors of weak: {ratio}; then {", ".join(of_tracks(tracks, Day(), 60))}')


def beside(name, t, q, tau, tracks, day):
    """Print the tracker's and the peers' errors after the first minute."""
    count, seconds = len(q), np.arange(1.0, SECONDS)
    minute = np.concatenate([np.tile(batch(t, q[k], tau[k], 60.0), (len(seconds), 1)) for k in range(count)])
    first = np.array([batch(t, q[k], tau[k], 10.0) for k in range(count)])
    times, theta, deviation = kalman(t, q, tau, first, WALK)
    filtered = np.repeat(times, count), *(each.reshape(-1, 9) for each in (theta, deviation))
    rows = (
        ('tracker', *of_tracks(tracks, day, 60)),
        ('fit of the first 60 s', *scores(np.tile(seconds, count), minute, None, day, 60), '', ''),
        ('EKF', *scores(*filtered, day, 60)),
    )
    table((name, *ERRORS), rows)


def changed(name, tracks, day):
    """Return a row: detection and type of a change, other reports, and the errors from 10 s after it on."""
    at = min(day.payload_at, day.fades_at, day.fade_at, day.tilt_at, day.dead_zone_at)
    after, kinds, false, disturbances, right = [], [], 0, 0, 0
    for _, events in tracks:
        found = [(t, e) for t, e in events if isinstance(e, Change) and e.end >= at][:1]
        false += sum(not isinstance(e, Disturbance) for _, e in events) - len(found)
        disturbances += sum(isinstance(e, Disturbance) for _, e in events)
        for t, change in found:
            after.append(t - at)
            kinds.append(change.kind)
            right += change.begin <= at <= change.end
    late = f'{np.median(after):.2f}, {max(after):.2f}' if after else ''
    cells = [f'{len(after)} of {len(tracks)}', late, right, ', '.join(sorted(set(kinds))), false, disturbances]
    cells += of_tracks(tracks, day, at + (0 if day.fade else 10)) if np.isfinite(at) else [''] * 4
    return name, *cells


def others(seeds):
    """Yield the errors after 100 s of tracking of clean rigs with other sampling and excitation."""
    for rate, counts, strength in RIGS:
        day = Day(strength=strength)
        t, q, tau = record(seeds, [day] * len(seeds), seconds=100.0, rate=float(rate), counts=counts)
        tracks = [track(t, *each) for each in zip(q, tau, strict=True)]
        fine = np.mean([s.level is Level.OK for states, _ in tracks for s in states if s.t > 20])
        last = [(states[-1:], events) for states, events in tracks]
        cells = [*of_tracks(last, day, 20)[:2], *of_tracks(tracks, day, 20)[2:], f'{100 * fine:.0f}']
        yield rate, counts, strength, *cells


def pushes(rng):
    """Return pushes by hand every 12 s, in either direction and at either joint."""
    made = []
    for at in np.arange(20, SECONDS - 10, 12.0):
        begin, joint, sign = at + rng.uniform(0, 5), int(rng.integers(2)), rng.choice([-1, 1])
        made.append((begin, joint, sign * rng.uniform(0.05, 0.4), rng.uniform(0.1, 1)))
    return tuple(made)


def main():
    """Simulate rigs, track them, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=3)
    parser.add_argument('--others', action='store_true', help='rigs with other sampling and excitation')
    args = parser.parse_args()
    seeds = list(range(args.seeds))
    if args.others:
        table(('rate [Hz]', 'counts', 'torque [N m]', *ERRORS, 'OK [%]'), others(seeds))
        return
    rng = np.random.default_rng(7)
    cases = {'constant': [Day()] * len(seeds), 'drift': [Day(drift=0.5)] * len(seeds)}
    cases |= {'hand': [Day(pushes=pushes(rng)) for _ in seeds]}
    cases |= {name: [day] * len(seeds) for name, day in CHANGES.items()}
    runs = {}
    for name, days in cases.items():
        t, q, tau = record(seeds, days, seconds=SECONDS)
        runs[name] = t, q, tau, [track(t, *each) for each in zip(q, tau, strict=True)]
    constant(*runs['constant'])
    beside('drift', *runs['drift'], Day(drift=0.5))
    beside('hand', *runs['hand'], Day())
    reported = 'found', 'after [s]: median, most', 'times right', 'named', 'false', 'disturbances'
    table(('', *reported, *ERRORS), (changed(name, runs[name][3], days[0]) for name, days in cases.items()))


if __name__ == '__main__':
    main()
