# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot compare``: results side by side, and what each predicts."""

from __future__ import annotations

import argparse
import itertools
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pendubot_identification.errors import UsageError, wrong_usage

from .reading import add_joints, add_reading, reading_of, save_map

if TYPE_CHECKING:
    from pendubot_identification.results.result import Parameter, PartialResult
    from pendubot_identification.trajectories.conversion import Conversion

Part = tuple[str, float, float]

DESCRIPTION = """\
Set results side by side: every parameter with its standard error, and how far it is from that of the first result,
in standard errors of both together, t. p is the probability of a t as large by chance (Welch's t test). A p far below
0.05 says that something changed, or that the standard errors are too small for what the model cannot describe.

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
    parser.add_argument('--on', metavar='BAG[@START:END]', help='a bag or file whose motion each of them predicts')
    add_joints(parser)
    add_reading(parser)
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
    with wrong_usage():
        reading = reading_of(args)
    if args.on is None and (words := reading.options()):
        raise UsageError(f'{" ".join(words)} says how a recording is read, and none is; add --on BAG, or leave it out')
    results = {str(path): read_result(path) for path in args.results}
    if len(results) < len(args.results):
        raise UsageError('the same result is named twice; name two or more that differ')
    used = {name: _training(result) for name, result in results.items()}
    notes = [f'{name}: {problem}' for name, result in results.items() for problem in result.unphysical()]
    notes += [
        f'{name} and {other} were estimated from the same motion: their errors have a part in common, so that '
        'differences count for more than they show'
        for name, other in itertools.combinations(used, 2)
        if _common(used[name], used[other])
    ]
    found = {'results': list(results), 'parameters': _parameters(list(results.values())), 'notes': notes}
    if args.on is not None:
        found |= _predictions(args, reading, results, used, notes)
    print(json.dumps(found, indent=2) if args.json else comparison(found))
    return 0


def _parameters(results: Sequence[PartialResult]) -> dict[str, Any]:
    """Return by parameter its unit and, a result each, value, standard error, and Welch's t test against the first.

    ``apart`` is the distance in standard errors of both together, ``p`` its two-sided probability; None where one of
    them is not known or not estimated.
    """
    from pendubot_identification.model.parameters import NAMES, UNITS

    rows: dict[str, Any] = {}
    for name, unit in zip(NAMES, UNITS, strict=True):
        entries = [result.parameters.get(name) for result in results]
        values = [None if e is None else e.value for e in entries]
        # How far the data would let a parameter off its bound is not how uncertain it is.
        errors = [None if e is None or e.on_bound else e.std_error for e in entries]
        tests = [_welch(entries[0], entry) for entry in entries]
        if any(entries):
            apart, p = (list(column) for column in zip(*tests, strict=True))
            rows[name] = {'unit': unit, 'value': values, 'std_error': errors, 'apart': apart, 'p': p}
    return rows


def _welch(a: Parameter | None, b: Parameter | None) -> tuple[float | None, float | None]:
    """Return t and its two-sided probability (Welch, Biometrika 34, 1947)."""
    from scipy.special import ndtr, stdtr

    if a is None or b is None or a.on_bound or b.on_bound or not a.std_error or not b.std_error:
        return None, None
    parts = [(a.std_error**2, a.degrees_of_freedom), (b.std_error**2, b.degrees_of_freedom)]
    variance = sum(s for s, _ in parts)
    t = (b.value - a.value) / math.sqrt(variance)
    inverse = sum(s**2 / n for s, n in parts if n) / variance**2
    return t, float(2 * (stdtr(1 / inverse, -abs(t)) if inverse else ndtr(-abs(t))))


def _training(result: PartialResult) -> list[Part]:
    """Return of what parts of which bags, by their hash, a result was estimated: first and last sample [s]."""
    from pendubot_identification.recordings.bag_reader import BagWindow

    used = [(bag, BagWindow.parse(bag.bag).start or 0.0) for bag in result.bags if bag.role == 'training']
    return [(bag.sha256, start, start + bag.duration) for bag, start in used]


def _common(parts: Sequence[Part], others: Sequence[Part]) -> bool:
    return any(a[0] == b[0] and max(a[1], b[1]) <= min(a[2], b[2]) for a in parts for b in others)


def _predictions(
    args: argparse.Namespace,
    reading: Conversion,
    results: Mapping[str, PartialResult],
    used: Mapping[str, list[Part]],
    notes: list[str],
) -> dict[str, Any]:
    """Return how far each result's simulation of a bag's motion is off, by horizon; note who knows that motion."""
    from pendubot_identification.identify.prediction import HORIZONS, predict, state_scale
    from pendubot_identification.recordings.bag_reader import BagWindow, read_trajectory
    from pendubot_identification.recordings.datasets import require_files, span
    from pendubot_identification.results.result import known
    from pendubot_identification.trajectories.motion import Motion
    from pendubot_identification.trajectories.signals import choose_smoothing, evenly_stamped

    from .identify import joints

    with wrong_usage():
        window, names = BagWindow.parse(args.on), joints(args.joints)
        require_files(reading, [window.path])
    recorded = read_trajectory(window, topic=args.topic, joint_names=names, conversion=reading)
    notes += [recorded.note] if recorded.note else []
    save_map(args, reading)
    motion = evenly_stamped(recorded.trajectory)
    # States as all results are held against them; the torque as each result takes it.
    smoothing = choose_smoothing([motion])
    errors, still = [], None
    for name, result in results.items():
        motions = [Motion.prepare(motion, smoothing, result.effort.hold)]
        prediction = predict(motions, result.theta.vector(), result.effort.delay, state_scale(motions))
        errors.append(prediction.error)
        still = prediction.persistence
        if _common([(recorded.sha256, *span(recorded.trajectory))], used[name]):
            notes.append(f'{name} was estimated from a part of {recorded.window}: of that it knows more than it should')
    found = {'horizons': HORIZONS, 'error': errors, 'persistence': still}
    return {'on': str(recorded.window), **known(found)}
