# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Fault trials: ``python -m benchmarks.faults [--short] [--board c] [NAME ...]`` prints targets and figures.

The long trials take about half an hour on a quiet machine with two cores; ``--short`` runs the tests' short trials.
"""

import argparse
import os
import sys
import tempfile
from pathlib import Path

from test.domain import take_domain
from test.firmware.building import made
from test.processes import BOARDS, MODULES

from . import bridge, ownership, recorder
from .table import HEADER, row


def main():
    trials = [*bridge.TRIALS, *ownership.TRIALS, *recorder.TRIALS]
    names = [trial.name for trial in trials]
    parser = argparse.ArgumentParser(prog='python -m benchmarks.faults', description=__doc__)
    parser.add_argument('names', nargs='*', metavar='NAME', help=f'trials: {", ".join(names)} (default: all)')
    parser.add_argument('--short', action='store_true', help='seconds instead of minutes')
    boards = 'the virtual board: in Python, or the firmware in C (default %(default)s)'
    parser.add_argument('--board', choices=BOARDS, default='python', help=boards)
    options = parser.parse_args()
    if unknown := set(options.names) - set(names):
        parser.error(f'there is no trial {", ".join(sorted(unknown))}; the trials are {", ".join(names)}')
    if options.board == 'c':
        made('host')
    MODULES['virtual_board'] = BOARDS[options.board]
    take_domain()
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    missed = False
    print(HEADER, flush=True)
    for trial in trials:
        if options.names and trial.name not in options.names:
            continue
        with tempfile.TemporaryDirectory(prefix='fault-trial-') as folder:
            os.environ['ROS_LOG_DIR'] = folder
            for figure in trial.run(Path(folder), not options.short):
                print(row(trial.fault, figure), flush=True)
                missed |= not figure.met
    return int(missed)


if __name__ == '__main__':
    sys.exit(main())
