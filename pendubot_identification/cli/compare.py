# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot compare``: results side by side, and what each predicts."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pendubot_identification.errors import UsageError, wrong_usage

if TYPE_CHECKING:
    from pendubot_identification.identify.result import Given, Result

    Results = Mapping[str, Result | Given]

Part = tuple[str, float, float]

DESCRIPTION = """\
Set results side by side: every parameter with its standard error, and how far it is from that of the first result,
in standard errors of both together. Differences of up to about 2 are chance; far larger ones say that something
changed, or that the standard errors are too small for what the model cannot describe.

With --on BAG the motion of a bag is simulated by each of them, again and again from a measured state on: parameters
that differ may predict alike, and then the difference does not matter to a controller.
"""
EPILOG = """\
examples:
  pendubot compare monday.yaml friday.yaml
  pendubot compare monday.yaml friday.yaml --on swing@9:18    on motion that neither was estimated from
"""


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser('compare', help='results side by side', description=DESCRIPTION, epilog=EPILOG)
    parser.add_argument('results', nargs='+', type=Path, metavar='RESULT.yaml', help='two or more results')
    parser.add_argument('--on', metavar='BAG[@START:END]', help='a bag whose motion each of them predicts')
    parser.add_argument('--topic', default='/joint_states', help='topic with the joint states (default %(default)s)')
    parser.add_argument(
        '--joints', default='shoulder,elbow', metavar='SHOULDER,ELBOW', help='their joint names (default %(default)s)'
    )
    parser.add_argument('--json', action='store_true', help='print JSON, for programs')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Compare and print.

    Raises:
        PendubotError: fewer than two results, one that cannot be read, or a bag that cannot.
    """
    from pendubot_identification.report.tables import comparison
    from pendubot_identification.results.result_file import read_result

    if len(args.results) < 2:
        raise UsageError(f'{args.results[0]} is one result alone; name two or more to be compared')
    results = {str(path): read_result(path) for path in args.results}
    doubts = [f'{path}: {problem}' for path, data in results.items() for problem in data.unphysical()]
    if len(results) < len(args.results):
        raise UsageError('the same result is named twice; name two or more that differ')
    plain = {'results': list(results), 'parameters': _parameters(results), 'notes': [*doubts, *_shared(results)]}
    if args.on is not None:
        predicted = _predictions(results, args)
        plain |= predicted | {'notes': [*plain['notes'], *predicted['notes']]}
    print(json.dumps(plain, indent=2) if args.json else comparison(plain))
    return 0


def _parameters(results: Results) -> dict[str, Any]:
    """Return by parameter its unit and, a result each, value, standard error, and distance from the first result's.

    The distance is in standard errors of both together; None where one of them is not known or not estimated.
    """
    from pendubot_identification.model.parameters import NAMES, UNITS

    rows: dict[str, Any] = {}
    for name, unit in zip(NAMES, UNITS, strict=True):
        entries = [result.parameters.get(name) for result in results.values()]
        if any(entries):
            values = [None if e is None else e.value for e in entries]
            # How far the data would let a parameter off its bound is not how uncertain it is.
            errors = [None if e is None or e.on_bound else e.std_error for e in entries]
            rows[name] = {
                'unit': unit,
                'value': values,
                'std_error': errors,
                'apart': [_apart(values[0], v, errors[0], e) for v, e in zip(values, errors, strict=True)],
            }
    return rows


def _apart(first: float | None, second: float | None, error: float | None, other: float | None) -> float | None:
    if first is None or second is None or not error or not other:
        return None
    return (second - first) / math.hypot(error, other)


def _shared(results: Results) -> list[str]:
    """Return what the reader should know of results that were estimated from the same motion."""
    used = {name: _training(result) for name, result in results.items()}
    return [
        f'{name} and {other} were estimated from the same motion: their errors have a part in common, so that '
        'differences count for more than they show'
        for k, name in enumerate(used)
        for other in list(used)[k + 1 :]
        if _common(used[name], used[other])
    ]


def _training(result: Result | Given) -> list[Part]:
    """Return of what parts of which bags, by their hash, a result was estimated: first and last sample [s]."""
    from pendubot_identification.recordings.bag_reader import BagWindow

    parts = []
    for bag in result.bags:
        if bag.role == 'training':
            start = BagWindow.parse(bag.bag).start or 0.0
            parts.append((bag.sha256, start, start + bag.duration))
    return parts


def _common(parts: Sequence[Part], others: Sequence[Part]) -> bool:
    return any(a[0] == b[0] and max(a[1], b[1]) <= min(a[2], b[2]) for a in parts for b in others)


def _predictions(results: Results, args: argparse.Namespace) -> dict[str, Any]:
    """Return how far each result's simulation of a bag's motion is off, by horizon."""
    from pendubot_identification.identify.prediction import HORIZONS, predict, state_scale
    from pendubot_identification.recordings.bag_reader import BagWindow, read_recording
    from pendubot_identification.recordings.datasets import span
    from pendubot_identification.trajectories.long import held_parts
    from pendubot_identification.trajectories.motion import Motion
    from pendubot_identification.trajectories.signals import choose_smoothing, evenly_stamped

    from .identify import joints

    with wrong_usage():
        window, names = BagWindow.parse(args.on), joints(args.joints)
    recorded = read_recording(window, topic=args.topic, joint_names=names)
    parts = [evenly_stamped(part) for part in held_parts([recorded.trajectory])]
    # States as all results are held against them; the torque as each result takes it.
    smoothing = choose_smoothing(parts)
    errors, notes = [], []
    for name, result in results.items():
        motions = [Motion.prepare(part, smoothing, result.effort.hold) for part in parts]
        prediction = predict(motions, result.theta.vector(), result.effort.delay, state_scale(motions))
        errors.append(_numbers(prediction.error))
        still = _numbers(prediction.standing_still)
        if _common([(recorded.sha256, *span(recorded.trajectory))], _training(result)):
            notes.append(f'{name} was estimated from a part of {recorded.window}: of that it knows more than it should')
    return {
        'on': str(recorded.window),
        'horizons': list(HORIZONS),
        'error': errors,
        'standing_still': still,
        'notes': notes,
    }


def _numbers(values: Any) -> list[float | None]:
    return [float(value) if math.isfinite(value) else None for value in values]
