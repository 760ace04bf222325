# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What one waits for: recordings of real rigs and the sample bag, from the shell; and the same fit by scipy."""

import os
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import block_diag, hstack

import pendubot_identification as pendubot
from pendubot_identification.criteria.levenberg_marquardt import levenberg_marquardt
from pendubot_identification.criteria.shooting import AgainstStates, Segments
from pendubot_identification.identify.recipes import Data
from pendubot_identification.identify.settings import Settings
from test.benchmark.measure import REPETITIONS, cpu, seconds
from test.conftest import RECORDINGS, ROOT

PENDUBOT = Path(sys.executable).with_name('pendubot')
BAG = 'bags/paper_experiment'
#: Of single criteria.
ALONE = ('--criterion energy', '--criterion weak --model geared', '--criterion trajectory --model geared')
#: Segments [s] from one to the next; a residual at which a motion is lost.
LENGTH, STRIDE, LOST = 0.5, 0.2, 1e5


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
    """Return a table of one fit of half-second segments by processor time, here and by scipy: the same residuals."""
    rows = ['| segments of | by | unknowns | J | processor | over ours |', '|---|---|---|---|---|---|']
    for rig, paths in {'sample bag': [str(ROOT / BAG)], **rigs()}.items():
        data = Data.prepare([pendubot.read(path) for path in paths], Settings())
        model = 'viscous' if rig == 'sample bag' else 'geared'
        limits = data.settings.box(model), data.settings.delays
        comparison = AgainstStates(Segments.cut(data.motions, LENGTH, STRIDE, max(map(abs, limits[1]))), data.scale)
        start, lanes = data.start(model), len(comparison.segments)
        works = {'this package': ours, 'least_squares, told what depends on what': scipys}
        if rig == 'sample bag':  # minutes of any other
            works['least_squares'] = partial(scipys, told=False)
        spent = {}
        for name, work in works.items():
            begin = cpu()
            cost = work(comparison, *start, *limits)
            spent[name] = cpu() - begin
            ratio = spent[name] / spent['this package']
            unknowns = len(start[0]) + 1 + 4 * lanes
            rows.append(
                f'| {rig} | {name} | {unknowns} | {cost / (4 * lanes):.6g} | {seconds(spent[name])} | {ratio:.3g} |'
            )
    return '\n'.join(rows)


def ours(comparison, theta, delay, box, delays):
    """Return the least cost that this package finds."""
    return levenberg_marquardt(comparison, theta, delay, box, delays, tolerance=1e-6).cost


def scipys(comparison, theta, delay, box, delays, told=True):
    """Return the least cost that scipy finds, every motion simulated by the kernel."""
    initial = comparison.initial(delay)
    size, lanes = len(theta) + 1, initial.shape[1]

    def residuals(z):
        states = comparison.segments.roll(z[: size - 1], z[size:].reshape(lanes, 4).T)
        return np.clip(np.nan_to_num(comparison.residuals(states, z[size - 1]).ravel(), nan=LOST), -LOST, LOST)

    start = np.concatenate([theta, [delay], initial.T.ravel()])
    lower, upper = np.full((2, len(start)), [[-np.inf], [np.inf]])
    lower[:size], upper[:size] = [*box.lower, delays[0]], [*box.upper, delays[1]]
    # It takes no bounds that are equal, and no start on one.
    lower, upper = lower - 1e-9, upper + 1e-9
    depends = None
    if told:
        rows = residuals(start).size // lanes
        depends = hstack([np.ones((rows * lanes, size)), block_diag([np.ones((rows, 4))] * lanes)])
    limits = {'bounds': (lower, upper), 'ftol': 1e-6, 'max_nfev': 200}
    return 2 * least_squares(residuals, start, jac_sparsity=depends, x_scale='jac', **limits).cost
