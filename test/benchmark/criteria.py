# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""How far each criterion's answers lie from the truth, how honest their intervals are, and how they predict real rigs.

    python -m test.benchmark.criteria [--seeds 50] [--processes 2] [--rig virtual|recordings|all] [--test]

Prints Markdown tables. Virtual rigs: median size of the errors in %, and of the worst parameter's; how many fits
converged (energy and weak: all runs of MDE at the exact minimum), left the encoders' rounding alone (exact), have P1
to P5 within 1 %, are flagged (WARN or ERROR), and are neither; the share of the 95 % intervals that hold the truth,
in %. Real rigs, where there are any: parameters, and errors of simulation in standard deviations of the states, of
train with each recording predicted by the others. Those set apart as test are looked at with --test alone, and seldom.
"""

import os

os.environ['OMP_NUM_THREADS'] = '1'  # before numpy: every process works alone

import argparse
import csv
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pendubot_identification.criteria.energy import energy_regression
from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.excitation.excitation import PulseTrain
from pendubot_identification.identify.identification import identify
from pendubot_identification.identify.prediction import HORIZONS, Prediction, predict, state_scale
from pendubot_identification.identify.settings import Settings
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import BALANCE, NAMES, PAPER, Parameters, default_bounds
from pendubot_identification.model.simulation import quantised, simulate
from pendubot_identification.recordings.table_reader import TableReader
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.reading import Reading
from test.conftest import RECORDINGS

COUNTS, RATE, SAMPLES, SEVEN = 4000, 100, 900, NAMES[:7]
RIGS = {'paper': PAPER, 'larger': BALANCE}
PULSES = {'1 s, ±1 N m': PulseTrain(), '5 s, ±2 N m': PulseTrain(period=5, amplitude_min=-2, amplitude_max=2)}
CELLS = [(rig, pulses) for rig in RIGS for pulses in PULSES]
#: How the recordings are identified: criterion, and what is not the default.
WAYS = {'energy': {}, 'energy over 0.5 s': {'sliding': 0.5}, 'weak': {}, 'likelihood': {}}
WAYS |= {'likelihood, start off by 3': {}}
#: The energy criterion elsewhere: rate [Hz], counts per turn (0: exact), smoothing [s], sliding window [s].
ENERGY = ((100, 4000, 0.02, None), (100, 0, 0.02, None), (100, 4000, 0.05, 0.5), (1000, 4000, 0.02, None))
ENERGY += ((1000, 0, 0.02, None), (1000, 4000, 0.02, 0.5))
TOLD = 'converged', 'exact', '< 1 %', 'flagged', 'neither'
#: P1 P2 P3 P4 P5 b1 b2 Fc1 Fc2 J2, from the README beside the recordings.
PUBLISHED = {
    'dfki_C1_sysid': np.array([0.0596, 0.0505, 0.0320, 0.2298, 0.1600, 0.001, 0.001, 0.251, 0.188, 0.0026]),
    'dfki_A0_sysid': np.array([0.1112, 0.0235, 0.0333, 0.3491, 0.1111, 0.001, 0.001, 0.146, 0.123, 0.0032]),
}
#: Real rigs are judged against states smoothed over so many seconds, the torque as it was measured.
JUDGING = 0.04, 'linear'


class Fit(NamedTuple):
    """One identification: errors in per cent of the truth, and whether its 95 % intervals hold it, shapes (7,)."""

    cell: tuple
    seed: int
    way: str
    error: np.ndarray
    held: np.ndarray
    told: tuple  # of TOLD, which are true
    flags: tuple
    seconds: float


def recording(rig, pulses, seed, rate=RATE, samples=2 * SAMPLES, counts=COUNTS):
    t, train = np.arange(samples) / rate, replace(PULSES[pulses], seed=seed)
    motion = simulate(RIGS[rig], t, np.column_stack([[train.torque(x) for x in t], np.zeros(samples)]))
    return quantised(motion, counts) if counts else motion


def fits(job):
    """Identify the first half of a recording in every way, each judged on the second half as by default."""
    cell, seed = job
    truth, motion = RIGS[cell[0]].vector(), recording(*cell, seed)
    first, second = motion[:SAMPLES], motion[SAMPLES:]
    result = []
    for way, options in WAYS.items():
        settings = Settings((way.replace(',', '').split()[0],), 'viscous', seed=seed + 1, **options)
        if 'start' in way:
            off = 3.0 ** np.random.default_rng([seed, 7]).choice([-1, 1], 7)
            settings = replace(settings, start=Parameters.from_vector(truth * off))
        begin = time.perf_counter()
        answers = identify([first], [second], settings).estimates
        seconds = time.perf_counter() - begin
        found = next(e for e in answers if e.criterion == settings.criteria[0])
        error, held = (found.theta / truth - 1) * 100, np.abs(found.theta - truth) <= found.half_width
        converged = found.converged and (np.isnan(found.J_exact) or found.runs_at_minimum == len(found.J_runs))
        near, flags = np.abs(error[:5]).max() < 1, found.warnings if found.level > Level.OK else ()
        told = converged, found.exact, near, bool(flags), not (near or flags)
        result.append(Fit(*job, way, error, held, told, flags, seconds))
    return result


def energy_error(job):
    """Return the error in per cent of the energy criterion's exact minimum."""
    (rate, counts, smoothing, sliding), seed = job
    regression = energy_regression(recording(*CELLS[0], seed, rate, SAMPLES * rate // RATE, counts), sliding, smoothing)
    return (Quadratic.reduce(regression.phi, regression.y).minimum(default_bounds().of(7)) / PAPER.vector() - 1) * 100


def row(*cells, before=''):
    print(f'{before}| {" | ".join(map(str, cells))} |')


def head(*cells):
    row(*cells, before='\n')
    print('|' + '---|' * len(cells))


def errors_row(names, errors, *more):
    """Print the median error of each parameter and of the worst one; errors of shape (fits, 7)."""
    sizes = *np.median(np.abs(errors), axis=0), np.median(np.abs(errors).max(axis=1))
    row(*names, *(f'{size:.2g}' if size < 9.95 else f'{size:.0f}' for size in sizes), *more)


def virtual(seeds, pool):
    """Print what is found of the virtual rigs."""
    results = pool.map(fits, [(c, seed) for c in CELLS for seed in range(seeds)])
    everything = [fit for result in results for fit in result]
    print(f'\n## Virtual rigs: {SAMPLES} samples at {RATE} Hz, {COUNTS} counts per turn, {seeds} seeds each\n')
    print('Errors in %.')
    head('rig', 'pulses', 'way', *SEVEN, 'worst', 's')
    for cell in CELLS:
        for way in WAYS:
            of = [fit for fit in everything if (fit.cell, fit.way) == (cell, way)]
            errors_row([*cell, way], [fit.error for fit in of], f'{np.median([fit.seconds for fit in of]):.1f}')
    head('way', 'rig', 'pulses', 'fits', *TOLD, *SEVEN, 'all')
    for way in WAYS:
        for cell in [*(CELLS if way == 'likelihood' else []), ('all', 'all')]:
            of = [fit for fit in everything if fit.way == way and cell in (fit.cell, ('all', 'all'))]
            held, told = np.mean([fit.held for fit in of], axis=0), np.sum([fit.told for fit in of], axis=0)
            row(way, *cell, len(of), *told, *(f'{100 * share:.0f}' for share in held), f'{100 * held.mean():.1f}')
    print('\nThe likelihood with an error of 1 % or more in P1 to P5:\n')
    for fit in everything:
        if 'likelihood' in fit.way and not fit.told[2]:
            said = '; '.join(fit.flags) or 'NOT FLAGGED'
            print(f'- {", ".join(fit.cell)}, seed {fit.seed}, {fit.way}: {np.round(fit.error, 1)} % {said}')
    print("\nThe energy criterion's exact minimum on the paper's rig, pulses of 1 s:")
    head('rate', 'counts per turn', 'differentiator', 'energy over', *SEVEN, 'worst')
    errors = np.reshape(list(pool.map(energy_error, [(v, s) for v in ENERGY for s in range(seeds)])), (-1, seeds, 7))
    for (rate, counts, smoothing, sliding), error in zip(ENERGY, errors, strict=True):
        span = 'central differences' if smoothing * rate < 4 else f'{smoothing:g} s'
        errors_row([f'{rate} Hz', counts or 'exact', span, f'{sliding:g} s' if sliding else 'all'], error)


def zeros(found):
    """Return in words how far off [degrees] the zeros of every recording are."""
    angles = np.degrees(np.concatenate([found.zeros.angles, found.zeros.std_error])).T
    return [
        f'{name[-10:-4]}: {q1:.1f} ± {e1:.1f} and {q2:.1f} ± {e2:.1f}'
        for name, (q1, q2, e1, e2) in zip(found.zeros.recordings, angles, strict=True)
    ]


def real(job):
    """Return what is found of a real rig: estimates by model, simulation errors, and sentences."""
    group, roles = job
    rows = list(csv.DictReader((RECORDINGS / 'manifest.csv').open()))
    files = {role: [r['file'] for r in rows if (r['group'], r['role']) == (group, role)] for role in roles}
    recorded = {role: [TableReader(RECORDINGS / file, Reading()).motion for file in files[role]] for role in roles}
    motions = {role: [Motion.prepare(t, *JUDGING) for t in recorded[role]] for role in roles}
    scales = {role: state_scale(motions[role]) for role in roles}

    def again(trajectories, found, model):
        return identify(trajectories, settings=Settings(criteria=(found.criterion,), model=model)).best

    def predicted(role, found, which=slice(None)):
        of = motions[role][which]
        # A torque that is held acts half an interval later than one that changes linearly.
        delay = found.effort.delay + (of[0].interval / 2 if found.effort.hold == 'zero' else 0.0)
        return predict(of, found.theta, delay, scales[role])

    train, estimates, errors = recorded['train'], {}, {}
    told = []
    for model in ('rotor', 'geared', 'auto'):
        begin = time.perf_counter()
        found = identify(train, settings=Settings(model=model)).best
        name = f'{model}, {found.criterion}'
        told.append(f'Model {model}: {name}, in {time.perf_counter() - begin:.0f} s')
        if name in estimates:
            continue
        without = [again([*train[:k], *train[k + 1 :]], found, model) for k in range(len(train))]
        apart = Prediction.pool([predicted('train', f, slice(k, k + 1)) for k, f in enumerate(without)])
        estimates[name], errors[name] = found, [*apart.error]
        if found.zeros is not None:
            told.append(f'{name}: zeros are off by [degrees] {"; ".join(zeros(found))}')
        if 'test' in roles:
            errors[name] += [*predicted('test', found).error]
            other = again(recorded['test'], found, model)
            off = np.abs(found.theta - other.theta) > 1.96 * np.hypot(found.std_error, other.std_error)
            told.append(f'{name}: train and test agree but for {[NAMES[k] for k in np.flatnonzero(off)]} of {off.size}')
    published = [predicted(role, replace(found, theta=PUBLISHED[group])) for role in roles]
    errors['published'] = [error for prediction in published for error in prediction.error]
    errors['persistence'] = [error for prediction in published for error in prediction.persistence]
    return group, estimates, errors, told


def recordings(roles, pool):
    """Print what is found of the real rigs."""
    for group, estimates, errors, told in pool.map(real, [(group, roles) for group in PUBLISHED]):
        print(f'\n## {group}\n\nEstimates from train, ± half a 95 % interval.')
        head('', 'published', *estimates)
        columns = [[f'{value:.4f}' for value in PUBLISHED[group]]]
        for found in estimates.values():
            columns.append([f'{a:.4f} ± {1.96 * b:.4f}' for a, b in zip(found.theta, found.std_error, strict=True)])
        for k, name in enumerate(NAMES):
            row(name, *(column[k] if k < len(column) else '' for column in columns))
        head('', *(f'{role}, {h:g} s' for role in roles for h in HORIZONS))
        for name, of in errors.items():
            row(name, *(f'{error:.3f}' for error in of))
        print('\n' + '\n'.join(f'- {sentence}' for sentence in told))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=50, help='recordings of each virtual rig and excitation')
    parser.add_argument('--processes', type=int, default=2)
    parser.add_argument('--rig', choices=('virtual', 'recordings', 'all'), default='all')
    parser.add_argument('--test', action='store_true', help='look at the recordings set apart as test, too')
    args = parser.parse_args()
    with ProcessPoolExecutor(args.processes) as pool:
        if args.rig != 'recordings':
            virtual(args.seeds, pool)
        if args.rig != 'virtual' and (RECORDINGS / 'manifest.csv').exists():
            recordings(('train', 'test') if args.test else ('train',), pool)


if __name__ == '__main__':
    main()
