# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The layers of the design, the style and the types, held by the tools themselves."""

import ast
import re
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from test.conftest import ROOT

BIN = Path(sys.executable).parent


def run(*command, cwd=ROOT):
    if not (BIN / command[0]).exists():
        pytest.skip(f'{command[0]} is not installed beside Python; make test brings it')
    return subprocess.run([str(BIN / command[0]), *command[1:]], cwd=cwd, capture_output=True, text=True, timeout=300)


@pytest.mark.parametrize(
    'command', [('lint-imports', '--no-cache'), ('ruff', 'check', '.'), ('ruff', 'format', '--check', '.'), ('mypy',)]
)
def test_the_tools_find_nothing(command):
    result = run(*command)
    assert result.returncode == 0, result.stdout + result.stderr


def test_an_import_of_ros_in_a_criterion_would_be_found(tmp_path):
    """The contract is able to fail: the same check on a copy of the package that breaks it."""
    shutil.copytree(ROOT / 'pendubot_identification', tmp_path / 'pendubot_identification')
    shutil.copy(ROOT / 'pyproject.toml', tmp_path)
    module = tmp_path / 'pendubot_identification' / 'criteria' / 'energy.py'
    module.write_text(module.read_text() + '\nimport rclpy\n')
    result = run('lint-imports', '--no-cache', cwd=tmp_path)
    assert result.returncode == 1
    assert 'pendubot_identification.criteria.energy -> rclpy' in result.stdout.replace('  ', ' ')


#: What is imported from PyPI: its name there, and its rosdep key, if it has one; all else are ROS packages.
PYPI = {
    **{
        name: (name, f'python3-{name}')
        for name in ('hypothesis', 'matplotlib', 'numpy', 'pytest', 'scipy', 'sympy', 'tqdm')
    },
    'mcap': ('mcap', 'mcap-ros2-support'),
    'rosbags': ('rosbags', 'python3-rosbags-pip'),
    'serial': ('pyserial', 'python3-serial'),
    'swarmops': ('swarmops', None),
    'urdf_parser_py': ('urdf_parser_py', 'urdfdom_py'),
    'yaml': ('PyYAML', 'python3-yaml'),
}
#: What launch files start and are started with, and what pytest is told to use: no import shows these.
STARTED, PLUGINS = {'robot_state_publisher', 'ros2launch', 'rviz2'}, {'pytest-timeout'}


#: What mcap brings along, under its key.
BROUGHT = {'lz4', 'zstandard'}


def imported(folder):
    """The packages, but for Python's own and ours, that are imported there, needed or not; benchmarks' peers apart."""
    found = set()
    for path in (path for path in (ROOT / folder).rglob('*.py') if 'benchmark' not in path.parts):
        for node in ast.walk(ast.parse(path.read_text())):
            modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            modules += [node.module] if isinstance(node, ast.ImportFrom) and node.level == 0 else []
            if isinstance(node, ast.Call) and ast.unparse(node.func) == 'pytest.importorskip':
                modules += [node.args[0].value] if isinstance(node.args[0], ast.Constant) else []
            found |= {module.split('.')[0] for module in modules}
    return found - {*sys.stdlib_module_names, *BROUGHT, 'pendubot_identification', 'test'}


def required(argument):
    """What setup.py gives this argument of setup(), the versions taken off."""
    keywords = (node for node in ast.walk(ast.parse((ROOT / 'setup.py').read_text())) if isinstance(node, ast.keyword))
    return ast.literal_eval(next(keyword.value for keyword in keywords if keyword.arg == argument))


def names(requirements):
    return sorted(re.match(r'[\w-]+', requirement)[0] for requirement in requirements)


def test_package_xml_and_setup_py_name_what_is_imported_and_nothing_twice():
    """What colcon and rosdep, or pip, do not bring is missing on the user's machine."""
    depends = [(e.tag, e.text) for e in ElementTree.parse(ROOT / 'package.xml').getroot() if e.tag.endswith('depend')]
    keys = [key for _, key in depends]
    assert len(set(keys)) == len(keys)
    code = imported('pendubot_identification') | imported('launch')
    tests = imported('test') - code
    assert {key for tag, key in depends if tag == 'exec_depend'} == {
        PYPI[name][1] if name in PYPI else name for name in code
    } | STARTED
    assert {key for tag, key in depends if tag == 'test_depend'} == {
        PYPI[name][1] for name in tests if PYPI[name][1]
    } | {f'python3-{name}' for name in PLUGINS}
    assert names(required('install_requires')) == sorted({PYPI[name][0] for name in code & set(PYPI)} | {'setuptools'})
    for_tests = names(required('extras_require')['test'])
    assert len(set(for_tests)) == len(for_tests)
    assert {PYPI[name][0] for name in tests} | PLUGINS <= set(for_tests)
