# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""colcon, from PyPI, builds and installs the package, and every program runs from there."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from test.conftest import ROOT

PROGRAMS = ('pendubot', 'bridge', 'recorder', 'player', 'identifier', 'exciter', 'balancer', 'virtual_board')
PARTS = (
    *('package.xml', 'setup.py', 'setup.cfg', 'pyproject.toml', 'README.md', 'LICENSE'),
    *('resource', 'config', 'launch', 'bags', 'pendubot_identification'),
)


@pytest.mark.build
@pytest.mark.ros
@pytest.mark.parametrize('options', [[], ['--symlink-install']], ids=['copied', 'symlinked'])
def test_colcon_builds_and_every_program_runs_from_there(tmp_path, options):
    source = tmp_path / 'src' / 'pendubot_identification'
    source.mkdir(parents=True)
    for part in PARTS:
        copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy
        copy(ROOT / part, source / part)
    env = {**os.environ, 'PATH': f'{Path(sys.executable).parent}:{os.environ["PATH"]}'}
    built = subprocess.run(
        ['colcon', 'build', *options], cwd=tmp_path, env=env, capture_output=True, text=True, timeout=300
    )
    assert built.returncode == 0, built.stdout + built.stderr

    programs = tmp_path / 'install' / 'pendubot_identification' / 'lib' / 'pendubot_identification'

    def sourced(command):
        return subprocess.run(
            ['bash', '-c', f'source "{tmp_path}/install/setup.bash" && {command}'],
            cwd=tmp_path,
            env=env,
            capture_output=True,
            text=True,
            timeout=120,
        )

    found = {path.name for path in programs.iterdir() if os.access(path, os.X_OK)}
    assert found == set(PROGRAMS), 'what ros2 run finds'
    for program in PROGRAMS:
        answer = sourced(f'"{programs / program}" --help')
        assert answer.returncode == 0, answer.stderr
        assert answer.stdout.startswith('usage: '), answer.stdout
        if program not in ('pendubot', 'virtual_board'):
            named = answer.stdout.split('commented parameter file: ')[1].split()[0]
            assert Path(named).is_relative_to(tmp_path), f'{named} is of another install'
            assert Path(named).is_file()
    sample = Path(sourced(f'"{programs / "pendubot"}" --help').stdout.split('sample bag: ')[1].split()[0])
    assert sample.is_relative_to(tmp_path)
    look = '--output result.yaml --report look'
    result = sourced(f'"{programs / "pendubot"}" identify "{sample}" --optimizer lsq {look}')
    assert result.returncode == 0, result.stderr
    assert (tmp_path / 'result.yaml').is_file()
    assert (tmp_path / 'look' / 'report.html').is_file(), 'the page needs its template'
    assert sourced(f'"{programs / "pendubot"}" --version').stdout.endswith('compiled kernel\n')
    share = tmp_path / 'install' / 'pendubot_identification' / 'share'
    assert (share / 'ament_index/resource_index/packages/pendubot_identification').exists()
    installed = share / 'pendubot_identification'
    for folder in ('config', 'launch'):
        ours = {path.name for path in (ROOT / folder).iterdir() if path.is_file()}
        assert {path.name for path in (installed / folder).iterdir()} == ours
    python = f'"{sys.executable}" -c "from pendubot_identification.results import robot_description as r; '
    described = sourced(python + 'print(r.robot_description(0.2, 0.3)); print(r.__file__)"')
    assert '<robot name="pendubot">' in described.stdout, described.stderr
    assert Path(described.stdout.splitlines()[-1]).is_relative_to(tmp_path)


def test_without_a_compiler_the_package_builds_and_says_that_it_goes_by_numpy(tmp_path):
    for part in PARTS:
        copy = shutil.copytree if (ROOT / part).is_dir() else shutil.copy
        copy(ROOT / part, tmp_path / part)
    for built in (tmp_path / 'pendubot_identification' / 'model').glob('*.so'):
        built.unlink()
    env = {**os.environ, 'CC': 'no-such-compiler', 'PENDUBOT_KERNEL': 'on'}
    build = [sys.executable, 'setup.py', '--quiet', 'build', '--build-lib', 'out']
    built = subprocess.run(build, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=120)
    assert built.returncode == 0, built.stderr
    said = subprocess.run(
        [
            sys.executable,
            '-c',
            'from pendubot_identification.model import kernel as k; print(k.__file__, k.description())',
        ],
        cwd=tmp_path / 'out',
        env=env,
        capture_output=True,
        text=True,
        timeout=60,
    ).stdout
    assert said.startswith(str(tmp_path))
    assert said.endswith('numpy (no compiled kernel: there was no C compiler)\n')


@pytest.mark.build
@pytest.mark.skipif(
    sys.version_info >= (3, 13), reason='numpy 1.26 has no wheel for this Python, nor has Jazzy this Python'
)
def test_bags_and_optimisers_work_with_the_numpy_of_jazzy(tmp_path):
    # Before numpy 2 the type of a product depended on the values: what overflows there does not do so here.
    pip = [sys.executable, '-m', 'pip', '--disable-pip-version-check', 'install', '--quiet', '--no-deps']
    subprocess.run([*pip, '--target', str(tmp_path), 'numpy==1.26.4'], check=True, timeout=300)
    env = {**os.environ, 'PYTHONPATH': f'{tmp_path}:{os.environ.get("PYTHONPATH", "")}'}
    version = [sys.executable, '-c', 'import numpy; print(numpy.__version__)']
    assert subprocess.run(version, env=env, capture_output=True, text=True, check=True).stdout == '1.26.4\n'
    parts = (
        'recordings/test_joint_states.py',
        'recordings/test_bag_reader.py',
        'recordings/test_long_bag.py',
        'optimizers',
    )
    tests = [sys.executable, '-m', 'pytest', '-q', '-p', 'no:cacheprovider', *(f'test/{part}' for part in parts)]
    done = subprocess.run(tests, cwd=ROOT, env=env, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout
