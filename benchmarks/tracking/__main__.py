# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""How well rigs are followed that change while they move, beside what else could follow them.

python -m benchmarks.tracking                 the tables of docs/benchmarks.md, 10 seeds, with peers
python -m benchmarks.tracking --hours 10      false alarms alone, so many hours of motion without a change
python -m benchmarks.tracking --others        rigs that are sampled and driven otherwise
"""

import argparse

import numpy as np

from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.criteria.weak import estimate_delay, residual_weights, weak_regression
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import default_bounds
from pendubot_identification.tracking.events import Change, Disturbance, State
from pendubot_identification.tracking.settings import TrackerSettings
from pendubot_identification.tracking.tracker import Tracker
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.signals import choose_smoothing
from pendubot_identification.trajectories.trajectory import Trajectory
from test.changing_rig import Day, record, truth

from .peers import kalman

SECONDS, AT = 600.0, 300.0
WALK = np.array([TrackerSettings().inertia_walk] * 5 + [TrackerSettings().friction_walk] * 4)
PUSHED = 'pushed by hand 48 times each'
RIGS = (
    *((33, 4096, 0.35), (50, 4096, 0.35), (100, 1000, 0.35), (200, 500, 0.35), (200, 4096, 0.8), (200, 4096, 0.15)),
    *((200, 100_000, 0.35), (500, 2000, 0.35), (1000, 10_000, 0.35), (1000, 500, 0.35)),
)
PARTS = {'P1 to P5': slice(0, 5), 'friction': slice(5, 9)}


def batch(t, q, tau, until):
    """Return the weak criterion's fit of the first seconds, with its defaults."""
    now = t < until
    motion = Trajectory(t[now], q[now], np.column_stack([tau[now], 0 * tau[now]]))
    bounds = default_bounds().of(9)
    made = Motion.prepare(motion, choose_smoothing([motion]))
    delay = estimate_delay([made], 'coulomb', bounds, 0.0, 0.05)
    weights = residual_weights([weak_regression(made, 'coulomb', delay)], bounds)
    regression = weak_regression(made, 'coulomb', delay, weights=weights)
    return Quadratic.reduce(regression.phi, regression.y).minimum(bounds)


def track(t, q, tau):
    """Return all states and all events of one rig, each event with the time at which it was reported."""
    tracker, samples = Tracker(), np.column_stack([t, q, tau, 0 * t])
    states, events = [], []
    for k in range(0, len(t), 20):
        for update in tracker.feed(samples[k : k + 20]):
            if isinstance(update, State):
                states.append(update)
            else:
                events.append((float(samples[min(k + 19, len(t) - 1), 0]), update))
    return states, events


def relative(found, true):
    """Return errors in per cent of the truth."""
    return 100 * (found / true - 1)


def constant(t, q, tau, tracks, day):
    """Print the error after 60 s beside that of the batch, and how often bands hold the truth."""
    ratios, held, errors, of_batch = [], [], [], []
    for k in range(len(q)):
        states, _ = tracks[k]
        true = truth(day, [0.0])[0]
        at = next(s for s in states if s.t > 59.5)
        errors.append(relative(at.theta, true))
        of_batch.append(relative(batch(t, q[k], tau[k], 60.0), true))
        held.append([np.abs(s.theta - true) < 1.96 * s.std_error for s in states if s.t > 60])
    rms, rms_batch = (np.sqrt(np.mean(np.square(each), axis=0)) for each in (errors, of_batch))
    ratios = rms / rms_batch
    held = 100 * np.mean(np.concatenate(held), axis=0)
    print('| constant | P1 | P2 | P3 | P4 | P5 | b1 | b2 | Fc1 | Fc2 |\n|---|---|---|---|---|---|---|---|---|---|')
    for name, row in (
        ('error after 60 s, rms [%]', rms),
        ('of the batch', rms_batch),
        ('ratio', ratios),
        ('bands hold [%]', held),
    ):
        print(f'| {name} | ' + ' | '.join(f'{x:.2g}' if x < 10 else f'{x:.0f}' for x in row) + ' |', flush=True)


def beside(name, t, q, tau, tracks, day):
    """Print errors of a rig whose truth is that of a day, beside those of the peers."""
    rows = {}

    def add(who, times, found, deviation=None):
        true = np.moveaxis([truth(day, times)] * found.shape[1], 0, 1)
        late = times > 60
        off = relative(found, true)[late]
        hold = None if deviation is None else np.abs(found - true)[late] < 1.96 * deviation[late]
        rows[who] = [
            *(f'{np.sqrt(np.mean(np.square(off[..., p]))):.3g}' for p in PARTS.values()),
            f'{off[..., PARTS["friction"]].mean():+.2g}',
            *('' if hold is None else f'{100 * hold[..., p].mean():.0f}' for p in PARTS.values()),
        ]

    every = [states for states, _ in tracks]
    count = min(map(len, every))
    own = [
        np.array([[getattr(s, what) for s in states[-count:]] for states in every]) for what in ('theta', 'std_error')
    ]
    add('tracker', np.array([s.t for s in every[0][-count:]]), *(np.moveaxis(each, 0, 1) for each in own))
    first = np.array([batch(t, q[k], tau[k], 10.0) for k in range(len(q))])
    minute = np.array([batch(t, q[k], tau[k], 60.0) for k in range(len(q))])
    times = np.arange(1.0, SECONDS)
    add('fixed, from the first 60 s', times, np.repeat(minute[None], len(times), axis=0))
    add('EKF with theta as states', *kalman(t, q, tau, first, walk=WALK))
    print(f'\n| {name} | P, rms [%] | friction, rms [%] | lag [%] | bands hold P [%] | friction |')
    print('|---|---|---|---|---|---|')
    for who, row in rows.items():
        print(f'| {who} | ' + ' | '.join(row) + ' |', flush=True)


def begins(day):
    """Return when a rig changes [s]."""
    return min(day.payload_at, day.fades_at, day.fade_at, day.tilt_at, day.dead_zone_at)


def afterwards(name, tracks, day):
    """Print errors and bands from 10 s after a change on; of a gradual one, all the time."""
    off, held = [], []
    for states, _ in tracks:
        late = [s for s in states if s.t > begins(day) + (0 if day.fade else 10)]
        true = truth(day, [s.t for s in late])
        off.append(relative(np.array([s.theta for s in late]), true))
        held.append(np.abs(np.array([s.theta for s in late]) - true) < 1.96 * np.array([s.std_error for s in late]))
    off, held = np.concatenate(off), 100 * np.concatenate(held)
    cells = [f'{np.sqrt(np.square(off[:, p]).mean()):.2g}' for p in PARTS.values()]
    cells += [f'{held[:, p].mean():.0f}' for p in PARTS.values()]
    print(f'| {name} | ' + ' | '.join(cells) + ' |', flush=True)


def changes(name, tracks, days):
    """Print how changes are found and called, and what else was reported."""
    after, kinds, false, disturbances, right = [], {}, 0, 0, 0
    for (_, events), day in zip(tracks, days, strict=True):
        at = begins(day)
        found = [(t, e) for t, e in events if isinstance(e, Change) and e.end >= at]
        false += sum(not isinstance(e, Disturbance) for _, e in events) - (1 if found else 0)
        disturbances += sum(isinstance(e, Disturbance) for _, e in events)
        if found:
            t, change = found[0]
            after.append(t - at)
            right += change.begin <= at <= change.end
            kinds[change.kind] = kinds.get(change.kind, 0) + 1
    called = ', '.join(f'{kind} {count}' for kind, count in kinds.items())
    late = f'{np.median(after):.2f}, {max(after):.2f}' if after else ''
    print(
        f'| {name} | {len(after)} of {len(days)} | {late} | {right} | {called} | {false} | {disturbances} |', flush=True
    )


def others(seeds):
    """Print how well clean rigs are followed for 100 s that are sampled and driven otherwise."""
    print(
        '| rate [Hz] | counts | torque [N m] | P, rms [%] | friction, rms [%] | bands hold P [%] | friction | OK [%] |'
    )
    print('|---|---|---|---|---|---|---|---|')
    for rate, counts, strength in RIGS:
        day = Day(strength=strength)
        t, q, tau = record(seeds, [day] * len(seeds), seconds=100.0, rate=float(rate), counts=counts)
        off, held, fine = [], [], []
        for k in range(len(q)):
            states = [s for s in track(t, q[k], tau[k])[0] if s.t > 20]
            true = truth(day, [s.t for s in states])
            errors = np.array([s.theta for s in states]) - true
            held.append((np.abs(errors) < 1.96 * np.array([s.std_error for s in states])).mean(axis=0))
            off.append(100 * errors[-1] / true[-1])
            fine.append(np.mean([s.level is Level.OK for s in states]))
        rms = [np.sqrt(np.square(off)[:, p].mean()) for p in PARTS.values()]
        shares = [100 * np.array(held)[:, p].mean() for p in PARTS.values()]
        numbers = f'{rms[0]:.2g} | {rms[1]:.2g} | {shares[0]:.0f} | {shares[1]:.0f} | {100 * np.mean(fine):.0f}'
        print(f'| {rate} | {counts} | {strength} | {numbers} |', flush=True)


def main():
    """Simulate, follow, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=10)
    parser.add_argument('--hours', type=float, help='of motion without a change; nothing but false alarms')
    parser.add_argument('--others', action='store_true', help='rigs that are sampled and driven otherwise')
    args = parser.parse_args()
    if args.others:
        others(range(args.seeds))
        return
    head = (
        '\n| | found | after [s]: median, most | times right | called | false | pushes |\n|---|---|---|---|---|---|---|'
    )
    if args.hours:
        count = round(args.hours * 3600 / SECONDS)
        t, q, tau = record(range(1000, 1000 + count), [Day()] * count, seconds=SECONDS)
        print(head)
        changes(f'no change, {args.hours:g} h', [track(t, q[k], tau[k]) for k in range(count)], [Day()] * count)
        return
    rng = np.random.default_rng(7)
    seeds = list(range(args.seeds))
    pushes = [
        tuple(
            (
                at + rng.uniform(0, 5),
                int(rng.integers(2)),
                rng.choice([-1, 1]) * rng.uniform(0.05, 0.4),
                rng.uniform(0.1, 1),
            )
            for at in np.arange(20, SECONDS - 10, 12.0)
        )
        for _ in seeds
    ]
    cases = {
        'constant': [Day()] * args.seeds,
        'drift': [Day(drift=0.5)] * args.seeds,
        'payload of 20 % of link 2': [Day(payload=0.2, payload_at=AT)] * args.seeds,
        'payload of 2 %': [Day(payload=0.02, payload_at=AT)] * args.seeds,
        'motor fades by 20 % at once': [Day(fades_at=AT)] * args.seeds,
        'motor fades by 20 % in 400 s': [Day(fade=0.2, fade_at=100.0)] * args.seeds,
        'base tilts by 0.01 rad': [Day(tilt=0.01, tilt_at=AT)] * args.seeds,
        'base tilts by 0.1 rad': [Day(tilt=0.1, tilt_at=AT)] * args.seeds,
        'dead zone of 0.01 N m': [Day(dead_zone=0.01, dead_zone_at=AT)] * args.seeds,
        'dead zone of 0.04 N m': [Day(dead_zone=0.04, dead_zone_at=AT)] * args.seeds,
        PUSHED: [Day(pushes=each) for each in pushes],
    }
    days = [day for each in cases.values() for day in each]
    t, q, tau = record(seeds * len(cases), days, seconds=SECONDS)
    of = {name: slice(k * args.seeds, (k + 1) * args.seeds) for k, name in enumerate(cases)}
    tracks = [track(t, q[k], tau[k]) for k in range(len(days))]

    def recorded(name):
        return t, q[of[name]], tau[of[name]], tracks[of[name]]

    constant(*recorded('constant'), Day())
    beside('friction + 50 % in 600 s', *recorded('drift'), cases['drift'][0])
    beside('pushed by hand every 12 s', *recorded(PUSHED), Day())
    print('\n| from 10 s after it on | P, rms [%] | friction, rms [%] | bands hold P [%] | friction |')
    print('|---|---|---|---|---|')
    for name, part in of.items():
        if begins(cases[name][0]) < SECONDS:
            afterwards(name, tracks[part], cases[name][0])
    print(head)
    for name, part in of.items():
        changes(name, tracks[part], cases[name])


if __name__ == '__main__':
    main()
