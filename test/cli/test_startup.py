# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What nobody waits for: libraries that a subcommand does not need are not imported."""

import json
import os
import subprocess
import sys

import pytest

from pendubot_identification import __version__
from test.conftest import ROOT

SAMPLE = 'bags/paper_experiment'
CHILD = """
import json, sys
from pendubot_identification.cli.main import main
try:
    main(sys.argv[1:])
except SystemExit:
    pass
print(json.dumps(sorted({name.split('.')[0] for name in sys.modules})), file=sys.stderr)
"""


def imported(*arguments):
    child = subprocess.run(
        [sys.executable, '-c', CHILD, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=60, check=True
    )
    return set(json.loads(child.stderr.splitlines()[-1]))


@pytest.mark.parametrize('arguments', [['--help'], ['--version'], ['identify', '--help'], ['info', SAMPLE]])
def test_help_and_info_import_nothing_heavy(arguments):
    unwanted = {'scipy', 'matplotlib', 'rclpy', 'tqdm', 'jinja2'}
    if arguments[0] != 'info':
        unwanted |= {'numpy', 'mcap', 'rosbags', 'yaml'}
    assert not imported(*arguments) & unwanted


def test_identifying_leaves_what_it_does_not_need_alone(tmp_path):
    found = imported('identify', SAMPLE, '--output', str(tmp_path / 'result.yaml'))
    assert 'numpy' in found
    assert not found & {'matplotlib', 'jinja2', 'rclpy'}


@pytest.mark.parametrize(('switch', 'path'), [('on', 'compiled kernel'), ('off', 'switched off by PENDUBOT_KERNEL')])
def test_version_says_which_path_is_taken(switch, path):
    said = subprocess.run(
        [sys.executable, '-m', 'pendubot_identification.cli.main', '--version'],
        env={'PENDUBOT_KERNEL': switch},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    ).stdout
    assert said.startswith(f'pendubot {__version__}')
    assert path in said or (switch == 'on' and 'there was no C compiler' in said)


@pytest.mark.parametrize(('given', 'threads'), [('3', 3), ('', 0), ('many', 0), ('-2', 0)])
def test_the_kernel_takes_no_more_threads_than_told(given, threads):
    child = 'import pendubot_identification.kernel as kernel; print(kernel.threads)'
    env = {**os.environ, 'PENDUBOT_THREADS': given}
    command = [sys.executable, '-c', child]
    said = subprocess.run(command, env=env, capture_output=True, text=True, timeout=60, check=True)
    assert int(said.stdout) == threads
