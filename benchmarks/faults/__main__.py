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

import rclpy

from benchmarks.markdown import table
from test.domain import take_domain
from test.firmware.building import made
from test.processes import BOARDS, MODULES

from . import bridge, ownership, recorder


def main():
    trials = [*bridge.TRIALS, *ownership.TRIALS, *recorder.TRIALS]
    names = ['all', *(trial.name for trial in trials)]
    parser = argparse.ArgumentParser(prog='python -m benchmarks.faults', description=__doc__)
    listed = f'trials: {", ".join(names)} (default: %(default)s)'
    parser.add_argument('names', nargs='*', metavar='NAME', default='all', choices=names, help=listed)
    parser.add_argument('--short', action='store_true', help='seconds instead of minutes')
    boards = 'the virtual board: in Python, or the firmware in C (default %(default)s)'
    parser.add_argument('--board', choices=BOARDS, default='python', help=boards)
    options = parser.parse_args()
    if options.board == 'c':
        made('host')
    MODULES['virtual_board'] = BOARDS[options.board]
    take_domain()
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    chosen = [trial for trial in trials if options.names == 'all' or {'all', trial.name} & {*options.names}]
    verdicts = []
    table(('fault', 'wanted', 'measured', ''), rows(chosen, not options.short, verdicts))
    return int(not all(verdicts))


def rows(trials, long, verdicts):
    """Run trials; yield a row of each figure, and append to the verdicts whether it meets its target."""
    for trial in trials:
        with tempfile.TemporaryDirectory(prefix='fault-trial-') as folder:
            os.environ['ROS_LOG_DIR'] = folder
            rclpy.init()
            for figure in trial.run(Path(folder), long):
                verdicts.append(figure.met)
                yield trial.fault, figure.wanted, figure.measured, 'met' if figure.met else '**missed**'
            rclpy.try_shutdown()


if __name__ == '__main__':
    sys.exit(main())
