# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Runs a task of the studio in a separate process: the job as a JSON line on stdin, events as JSON lines on stdout.

The last event has ``done``, or ``problem``: a sentence, and the options that correct it.
"""

import json
import os
import resource
import shlex
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pendubot_identification import api
from pendubot_identification.errors import PendubotError, ResultError, sentence
from pendubot_identification.setting import words
from pendubot_identification.trajectories.conventions import CONVERSION

#: Smallest number of points of the preview of a longer motion.
POINTS = 300
#: Shortest time between two reports of progress [s].
INTERVAL = 0.1
#: The files for other programs.
EXPORTS = [f'pendubot.{suffix}' for suffix in ('xml', 'urdf', 'yaml', 'm', 'h', 'py')]
#: The options for reading a recording.
READING = {'joint_names', *(setting.name for setting in CONVERSION)}
Emit = Callable[[Mapping[str, Any]], None]


def describe(job: Mapping[str, Any], emit: Emit) -> dict[str, Any]:
    """Return the columns, topics, joints, options and preview of a recording."""
    options = {name: value for name, value in _options(job).items() if name in READING}
    found = api.describe(job['bags'][0], **options)
    shown = {name: getattr(found, name) for name in ('columns', 'taken', 'topics', 'joints', 'options')}
    shown |= {'taken_as': found.taken_as, 'problem': found.problem and _problem(found.problem)}
    if (motion := found.motion) is not None:
        step = max(1, len(motion) // POINTS)
        columns = {'q1': motion.q[:, 0], 'q2': motion.q[:, 1], 'tau1': motion.tau[:, 0]}
        columns |= {'tau2': motion.tau[:, 1]} if motion.tau[:, 1].any() else {}
        shown['preview'] = {name: [float(f'{x:.5g}') for x in values[::step]] for name, values in columns.items()}
    return shown


def check(job: Mapping[str, Any], emit: Emit) -> list[dict[str, Any]]:
    """Return the findings of the checks."""
    return [each.plain() for each in api.check(*job['bags'], validate=job['validate'], **_options(job))]


def identify(job: Mapping[str, Any], emit: Emit) -> dict[str, Any]:
    """Identify, and write the page, the result and files for other programs into the folder ``output``."""
    last, step = 0.0, ''

    def progress(activity: str, done: int, of: int, best: float) -> None:
        nonlocal last, step
        if activity != step or time.monotonic() - last >= INTERVAL:
            last, step = time.monotonic(), activity
            emit({'progress': activity, 'done': done, 'of': of, 'best': best if best == best else None})

    bounds = words(job['options'].get('bounds', ''))
    found = api.identify(*job['bags'], validate=job['validate'], bounds=bounds, progress=progress, **_options(job))
    emit({'progress': 'drawing the page', 'done': 0, 'of': 0, 'best': None})
    folder = Path(job['folder']) / 'output'
    try:
        found.report(folder, overwrite=True)
    except ResultError as error:
        why = getattr(error.__cause__, 'strerror', error)
        raise PendubotError(f'the result cannot be stored ({why}); {job["no_space"]}') from error
    missing = {}
    for name in EXPORTS:
        try:
            found.export(folder / name, overwrite=True)
        except PendubotError as error:
            missing[name] = sentence(error)
    files = sorted(each.name for each in folder.iterdir())
    command = found.command.replace('START.yaml', shlex.quote(job['options'].get('start', '')))
    return {'level': found.level.name, 'command': command, 'files': files, 'missing': missing}


def _options(job: Mapping[str, Any]) -> dict[str, Any]:
    options = {name: value for name, value in job['options'].items() if name != 'bounds'}
    return options | ({'joint_names': options.pop('joints')} if 'joints' in options else {})


def _problem(error: Exception) -> dict[str, Any]:
    window = getattr(error, 'first', '').rpartition('@')[2]  # of a recording that is too long
    return {'sentence': sentence(error), 'remedy': getattr(error, 'remedy', {}), 'window': window}


def main() -> None:
    """Do the job on stdin; without one, the studio has ended."""
    # A file that unpacks to more than the memory gives an error message, and the computer stays usable.
    limit = max(4 << 30, os.sysconf('SC_PHYS_PAGES') * os.sysconf('SC_PAGE_SIZE') // 2)
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    events, sys.stdout = sys.stdout, sys.stderr

    def emit(event: Mapping[str, Any]) -> None:
        print(json.dumps(event), file=events, flush=True)

    tasks: dict[str, Callable[..., Any]] = {'describe': describe, 'check': check, 'identify': identify}
    if text := sys.stdin.readline():
        job = json.loads(text)
        tempfile.tempdir = job['folder']  # which is deleted with the session, and converted bags with it
        try:
            os.chdir(Path(job['folder']) / 'files')
            emit({'done': tasks[job['task']](job, emit)})
        except Exception as error:
            emit({'problem': _problem(error)})


if __name__ == '__main__':
    main()
