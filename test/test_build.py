# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""colcon, from PyPI, builds and installs the package, and every program runs from the installation."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from test.conftest import ROOT

PROGRAMS = ('pendubot', 'bridge', 'recorder', 'player', 'identifier', 'exciter', 'balancer', 'tracker', 'virtual_board')
#: Names of files that no clone of the repository has.
UNTRACKED = '.*', '__pycache__', '*.so', '*.egg-info', 'build', 'dist', 'install', 'log', 'reproduction'


def run(command, folder, env, timeout=300):
    done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=timeout)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.build
@pytest.mark.ros
@pytest.mark.parametrize(
    'options', [[], ['--symlink-install', '--packages-select', 'pendubot_identification']], ids=['copied', 'symlinked']
)
def test_colcon_builds_the_package_and_every_program_runs(tmp_path, options):
    shutil.copytree(ROOT, tmp_path / 'src' / 'pendubot_identification', ignore=shutil.ignore_patterns(*UNTRACKED))
    env = {**os.environ, 'PATH': f'{Path(sys.executable).parent}:{os.environ["PATH"]}'}
    env |= {'CC': 'no-such-compiler', 'PENDUBOT_KERNEL': 'on'} if options else {'PENDUBOT_KERNEL': 'on'}
    places = '--base-paths', 'src', 'src/pendubot_identification/pendubot_interfaces'
    listed = run(['colcon', 'list', '--names-only', *places], tmp_path, env)
    assert listed.split() == ['pendubot_identification', 'pendubot_interfaces'], 'the command of README.md builds both'
    run(['colcon', 'build', *options], tmp_path, env)
    installed = tmp_path / 'install' / 'pendubot_identification'
    programs, share = installed / 'lib' / 'pendubot_identification', installed / 'share'

    def sourced(command):
        return run(['bash', '-c', f'source "{tmp_path}/install/setup.bash" && {command}'], tmp_path, env)

    found = {path.name for path in programs.iterdir() if os.access(path, os.X_OK)}
    assert found == set(PROGRAMS)
    # Symbolic links affect only the search for files, which is the same in all nodes.
    tested = ('pendubot', 'bridge') if options else PROGRAMS
    helps = sourced(' && echo ==== && '.join(f'"{programs / program}" --help' for program in tested)).split('====\n')
    for program, text in zip(tested, helps, strict=True):
        assert text.startswith('usage: '), text
        if program != 'virtual_board':
            named = Path(re.search(r'(?:commented parameter file|sample bag): (\S+)', text)[1])
            assert named.is_relative_to(tmp_path), f'{named} belongs to another installation'
            assert named.exists()
    assert (share / 'ament_index/resource_index/packages/pendubot_identification').exists()
    for folder in ('config', 'foxglove', 'launch', 'examples'):
        ours = {path.name for path in (ROOT / folder).iterdir() if path.is_file()}
        assert {path.name for path in (share / 'pendubot_identification' / folder).iterdir()} == ours
    version = sourced(f'"{programs / "pendubot"}" --version')
    if options:
        assert version.endswith('install the package again, with a C compiler)\n')
        return
    assert version.endswith('compiled kernel\n')
    bag = share / 'pendubot_identification/bags/paper_experiment'
    sourced(f'"{programs / "pendubot"}" identify "{bag}" --optimizer lsq --output result.yaml --report look')
    assert (tmp_path / 'result.yaml').is_file()
    assert (tmp_path / 'look' / 'report.html').is_file()


@pytest.mark.build
@pytest.mark.skipif(
    sys.version_info >= (3, 13), reason='numpy 1.26 has no wheel for this Python, nor has Jazzy this Python'
)
def test_bags_and_optimisers_work_with_the_numpy_of_jazzy(tmp_path):
    # Before numpy 2 the type of a product depends on the values, and overflows differ.
    pip = [sys.executable, '-m', 'pip', 'install', '--quiet', '--no-deps', '--no-compile']
    run([*pip, '--target', str(tmp_path), 'numpy==1.26.4'], ROOT, None)
    env = {**os.environ, 'PYTHONPATH': f'{tmp_path}:{os.environ.get("PYTHONPATH", "")}'}
    assert run([sys.executable, '-c', 'import numpy; print(numpy.__version__)'], ROOT, env) == '1.26.4\n'
    tests = 'test/recordings/test_joint_states.py', 'test/model/test_filter.py'
    run([sys.executable, '-m', 'pytest', '-q', '-p', 'no:cacheprovider', *tests], ROOT, env)
    (tmp_path / 'quick.yaml').write_text('{criterion: energy, runs: 2, generations: 300, model: viscous, hold: zero}')
    identify = ['identify', '--verbose', 'bags/paper_experiment@0:9', '--settings', str(tmp_path / 'quick.yaml')]
    output = run(
        [sys.executable, '-m', 'pendubot_identification.cli.main', *identify], ROOT, {**env, 'PENDUBOT_KERNEL': 'off'}
    )
    assert 'energy: MDE: ' in output
