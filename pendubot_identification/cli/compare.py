# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot compare``: results side by side, and their predictions of a motion."""

from __future__ import annotations

import argparse
import json

from pendubot_identification.errors import UsageError, wrong_usage
from pendubot_identification.recordings.bag_reader import BagWindow, read_trajectory
from pendubot_identification.recordings.datasets import require_files
from pendubot_identification.report.tables import comparison
from pendubot_identification.results.comparison import compare
from pendubot_identification.results.result_file import read_result

from .options import conversion_of, joint_names


def run(args: argparse.Namespace) -> int:
    """Compare and print."""
    if len(args.results) < 2:
        raise UsageError(f'{args.results[0]} is one result alone; name two or more to be compared')
    with wrong_usage():
        conversion, names = conversion_of(args), joint_names(args)
        window = None if args.on is None else BagWindow.parse(args.on)
        if window is not None:
            require_files(conversion, [window.path])
    if window is None and (words := conversion.options()):
        raise UsageError(f'{" ".join(words)} says how a recording is read, and none is; add --on BAG, or leave it out')
    results = {str(path): read_result(path) for path in args.results}
    if len(results) < len(args.results):
        raise UsageError('the same result is named twice; name two or more that differ')
    recorded = None
    if window is not None:
        recorded = read_trajectory(window, topic=args.topic, joint_names=names, conversion=conversion)
    found = compare(results, recorded)
    print(json.dumps(found, indent=2) if args.json else comparison(found))
    return 0
