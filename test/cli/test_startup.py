# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The start of the command line: few imports, ASCII terminals, no ROS, and the settings of the kernel."""

import json
import os
import subprocess
import sys

import pytest

from pendubot_identification import __version__
from test.cli.conftest import FAST
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


def child(*arguments, **options):
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, **options)


def imported(*arguments):
    return set(json.loads(child('-c', CHILD, *arguments, check=True).stderr.splitlines()[-1]))


@pytest.mark.parametrize(
    ('arguments', 'unwanted'),
    [
        (['identify', '--help'], {'numpy', 'mcap', 'rosbags', 'yaml', 'scipy', 'matplotlib', 'tqdm', 'jinja2'}),
        (['info', SAMPLE], {'scipy', 'matplotlib', 'tqdm', 'jinja2'}),
        (['identify', SAMPLE, *FAST], {'matplotlib', 'jinja2'}),
    ],
)
def test_unneeded_modules_are_not_imported(arguments, unwanted):
    modules = imported(*arguments)
    assert ('numpy' in modules) == ('numpy' not in unwanted)
    assert not modules & {*unwanted, 'rclpy'}


def test_version_shows_whether_the_kernel_is_used():
    command = ('-m', 'pendubot_identification.cli.main', '--version')
    version = child(*command, env={'PENDUBOT_KERNEL': 'off'}, check=True).stdout
    assert version == f'pendubot {__version__}, numpy (the compiled kernel is switched off by PENDUBOT_KERNEL)\n'


@pytest.mark.parametrize(('given', 'threads'), [('3', 3), ('many', 0)])
def test_the_variable_pendubot_threads_limits_the_kernel(given, threads):
    command = ('-c', 'import pendubot_identification.kernel as kernel; print(kernel.threads)')
    assert int(child(*command, env={**os.environ, 'PENDUBOT_THREADS': given}, check=True).stdout) == threads


def test_the_command_line_works_without_ros_and_on_an_ascii_terminal(inputs, tmp_path):
    """A blocker refuses to import rclpy and messages; -S omits the import hooks of wheels."""
    blocker = tmp_path / 'without_ros.py'
    blocker.write_text(
        'import sys\n'
        'class Blocker:\n'
        '    def find_spec(self, name, path=None, target=None):\n'
        "        if name.split('.')[0] in ('rclpy', 'rosidl_pycommon') or name.split('.')[0].endswith('_msgs'):\n"
        "            raise ModuleNotFoundError(f'no module named {name!r}: there is no ROS here')\n"
        'sys.meta_path.insert(0, Blocker())\n'
        'from pendubot_identification.cli.main import main\n'
        'raise SystemExit(main(sys.argv[1:]))\n'
    )
    env = {k: v for k, v in os.environ.items() if not k.startswith(('ROS', 'AMENT', '_ROS'))}
    env['PYTHONPATH'] = os.pathsep.join([str(ROOT), *(p for p in sys.path if p.endswith('site-packages'))])
    env['PYTHONIOENCODING'] = 'ascii'
    result = child('-S', blocker, 'identify', inputs / 'swing', *FAST, '--verbose', env=env)
    assert (result.returncode, result.stderr) == (0, '')
    assert r'\xb1' in result.stdout, 'signs beyond ASCII must be escaped'
    demo = child('-S', blocker, 'demo', env=env)
    assert (demo.returncode, 'Traceback' in demo.stderr) == (1, False)
    assert 'the demo needs ROS 2' in demo.stderr
