# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""From the shell to the answer: every command in a process of its own."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.speed.measure import interleaved, table
from test.conftest import ROOT

PENDUBOT = [str(Path(sys.executable).with_name('pendubot'))]


def command(arguments, kernel='on'):
    env = {**os.environ, 'PENDUBOT_KERNEL': kernel}
    return lambda: subprocess.run(arguments, cwd=ROOT, env=env, capture_output=True, check=True)


def whole():
    with tempfile.TemporaryDirectory() as folder:
        identify = [*PENDUBOT, 'identify', 'bags/paper_experiment', '--output', str(Path(folder, 'r.yaml')), '--force']
        spent = interleaved(
            {
                'python -c pass': command([sys.executable, '-c', 'pass']),
                'pendubot --help': command([*PENDUBOT, '--help']),
                'pendubot info': command([*PENDUBOT, 'info', 'bags/paper_experiment']),
                'python -c "import rclpy"': command([sys.executable, '-c', 'import rclpy']),
                'bridge --help (a node, without starting it)': command(
                    [sys.executable, '-m', 'pendubot_identification.nodes.bridge', '--help']
                ),
                'pendubot identify, three criteria, kernel': command(identify),
                'pendubot identify, three criteria, numpy': command(identify, 'off'),
            }
        )
    return table(spent, ('python -c pass',))
