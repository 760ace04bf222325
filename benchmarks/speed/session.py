# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What one waits for: recordings of real rigs and the sample bag, from the shell; and the same fit by scipy."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

import numpy as np
from scipy.optimize import minimize

import pendubot_identification as pendubot
from benchmarks.speed.measure import REPETITIONS, cpu, seconds
from pendubot_identification.criteria.likelihood import fit, fitted_information, physical
from pendubot_identification.identify.fitting import GEARED, TrainingData, fit_composite
from pendubot_identification.identify.settings import Settings
from test.conftest import RECORDINGS, ROOT

PENDUBOT = Path(sys.executable).with_name('pendubot')
BAG = 'bags/paper_experiment'
#: Of single criteria.
ALONE = ('--criterion energy', '--criterion weak --model geared', '--criterion likelihood --model geared')
#: Fits start with all parameters so many times too large; J where a filter diverges; where scipy stops at the latest.
OFF, LOST, LIMITS = 1.2, 1e9, {'maxiter': 500, 'maxfun': 500}


def rigs():
    """Return the training recordings of each real rig, by its name; none where they are not."""
    if not RECORDINGS.exists():
        return {}
    roles = [line.split(',') for line in (RECORDINGS / 'manifest.csv').read_text().splitlines()[1:]]
    groups = sorted({row[1] for row in roles})
    return {g: [str(RECORDINGS / row[0]) for row in roles if row[1:3] == [g, 'train']] for g in groups}


def used(arguments, environment):
    """Return what a command took: time and processor time [s], and memory at its most [MB]."""
    begin = os.times().elapsed
    process = subprocess.Popen(
        arguments, cwd=ROOT, env={**os.environ, **environment}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    _, status, use = os.wait4(process.pid, 0)
    if os.waitstatus_to_exitcode(status) not in (0, 3):
        raise RuntimeError(f'{arguments} failed')
    return os.times().elapsed - begin, use.ru_utime + use.ru_stime, use.ru_maxrss / 1024


def whole():
    """Return a table of whole commands; those of real rigs where their recordings are."""
    with tempfile.TemporaryDirectory() as folder:
        identify = [str(PENDUBOT), 'identify', '--output', str(Path(folder, 'r.yaml')), '--force']
        works = {'sample bag': ([*identify, BAG], {})}
        for rig, files in rigs().items():
            default = [*identify, *files]
            works[f'{rig}, {len(files)} recordings'] = default, {}
            works[f'{rig}, on one core'] = ['taskset', '-c', '0', *default], {}
            works[f'{rig}, without the kernel'] = default, {'PENDUBOT_KERNEL': 'off'}
            for options in ALONE:
                works[f'{rig}, `{options}`'] = [*default, *options.split()], {}
        taken = {name: [] for name in works}
        for _ in range(REPETITIONS):
            for name, work in works.items():
                taken[name].append(used(*work))
    rows = ['| `pendubot identify` of | time | processor | memory |', '|---|---|---|---|']
    for name, each in taken.items():
        wall, processor, memory = (median(values) for values in zip(*each, strict=True))
        rows.append(f'| {name} | {seconds(wall)} | {seconds(processor)} | {memory:.0f} MB |')
    return '\n'.join(rows)


def beside_scipy():
    """Return a table of one fit of the likelihood at 0.05 s by processor time: scoring here, and scipy's L-BFGS-B."""
    rows = [
        '| likelihood of | by | unknowns | evaluations | J | processor | over ours |',
        '|---|---|---|---|---|---|---|',
    ]
    for rig, paths in {'sample bag': [str(ROOT / BAG)], **rigs()}.items():
        trajectories = [pendubot.read(path) for path in paths]
        data = TrainingData.prepare(trajectories, Settings().of_rig(trajectories))
        problem = fit_composite(data, lambda *_: None, effects=False).rough
        start = np.where(np.arange(len(problem.fit.x)) < GEARED, OFF, 1.0) * problem.fit.x
        spent = {}
        for name, work in {'this package': ours, 'L-BFGS-B': scipys}.items():
            begin = cpu()
            cost, evaluations = work(problem, np.clip(start, problem.lower, problem.upper))
            spent[name] = cpu() - begin
            ratio = spent[name] / spent['this package']
            unknowns = int((problem.lower < problem.upper).sum())
            rows.append(
                f'| {rig} | {name} | {unknowns} | {evaluations} | {cost:.6g} | {seconds(spent[name])} | {ratio:.3g} |'
            )
    return '\n'.join(rows)


def ours(problem, start):
    """Return the least cost that this package finds, and the number of its steps."""
    found = fit(problem.likelihood, start, problem.lower, problem.upper, 40, 0.05)
    return found.cost, found.iterations


def scipys(problem, start):
    """Return the least cost that scipy finds with the same slopes, and how often it asked for them."""
    like, sought = problem.likelihood, problem.lower < problem.upper
    scale = np.append(like.scale, np.ones(len(start) - len(like.scale)))

    def value(z):
        x = start.copy()
        x[sought] = z * scale[sought]
        if not physical(x):
            return LOST, np.zeros(len(z))
        evaluation = like.evaluate(x, sought)
        slope, _ = fitted_information(like, evaluation, x)
        cost = float(evaluation.costs.sum()) + like.prior(x)
        return (cost, (slope * scale)[sought]) if np.isfinite(cost) else (LOST, np.zeros(len(z)))

    bounds = np.column_stack([problem.lower, problem.upper])[sought] / scale[sought, None]
    found = minimize(value, (start / scale)[sought], jac=True, method='L-BFGS-B', bounds=bounds, options=LIMITS)
    return found.fun, found.nfev
