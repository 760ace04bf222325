# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The layers of the design, and what the package needs installed; ``make lint`` has style and types."""

import ast
import re
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from test.conftest import ROOT

#: What has another name on PyPI, or a rosdep key other than python3-NAME.
PYPI = {'serial': 'pyserial', 'yaml': 'PyYAML'}
ROSDEP = {'mcap': 'mcap-ros2-support', 'rosbags': 'python3-rosbags-pip', 'urdf_parser_py': 'urdfdom_py'}
#: Of no rosdep key: the tests that import it are skipped.
NO_ROSDEP = {
    'casadi',
    'h5py',
    'mujoco',
    'mypy',
    'nbclient',
    'nbformat',
    'openpyxl',
    'pandas',
    'pandas-stubs',
    'pendubot_interfaces',
    'pinocchio',
    'axe_playwright_python',
    'playwright',
    'pyarrow',
    'shtab',
    'swarmops',
}
#: Imported where it is installed; who asks for it elsewhere is told how to install it.
OPTIONAL = {'aiohttp', 'h5py', 'openpyxl', 'pandas', 'pendubot_interfaces', 'pyarrow', 'shtab'}
#: What mcap brings along under its key.
BROUGHT = {'lz4', 'zstandard'}


def test_the_layers_hold_and_an_import_of_ros_in_a_criterion_would_be_found(tmp_path):
    """The contracts, on a copy of the package with that one fault: it alone is found."""
    if not (linter := Path(sys.executable).with_name('lint-imports')).exists():
        pytest.skip('lint-imports is not installed beside Python; make test brings it')
    shutil.copytree(ROOT / 'pendubot_identification', tmp_path / 'pendubot_identification')
    shutil.copy(ROOT / 'pyproject.toml', tmp_path)
    (tmp_path / 'pendubot_identification' / 'criteria' / 'faulty.py').write_text('import rclpy\n')
    found = subprocess.run([linter, '--no-cache'], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert found.returncode == 1
    assert 'Contracts: 4 kept, 1 broken.' in found.stdout, found.stdout
    assert re.findall(r'- +(\S+ -> \S+)', found.stdout) == ['pendubot_identification.criteria.faulty -> rclpy']


def imported(folder):
    """The packages, but for Python's own and ours, that are imported there, needed or not; benchmarks' peers apart."""
    found = set()
    for path in (path for path in (ROOT / folder).rglob('*.py') if 'benchmark' not in path.parts):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.split('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                found.add(node.module.split('.')[0])
            elif isinstance(node, ast.Call) and ast.unparse(node.func) == 'pytest.importorskip':
                found |= {argument.value for argument in node.args if isinstance(argument, ast.Constant)}
    return found - {*sys.stdlib_module_names, *BROUGHT, 'pendubot_identification', 'benchmarks', 'test'}


def test_tests_of_what_rosdep_does_not_bring_are_skipped_without_it():
    """``colcon test`` has the dependencies of package.xml alone, and one import that fails ends all tests."""
    unguarded = set()
    for path in (ROOT / 'test').rglob('*.py'):
        tree = ast.parse(path.read_text())
        tried = {id(node) for block in ast.walk(tree) if isinstance(block, ast.Try) for node in ast.walk(block)}
        for node in (node for node in ast.walk(tree) if id(node) not in tried):
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = [node.module or ''] if isinstance(node, ast.ImportFrom) else [each.name for each in node.names]
                needed = {name.split('.')[0] for name in names} & (NO_ROSDEP | OPTIONAL)
                unguarded |= {(path, name) for name in needed if f"importorskip('{name}')" not in ast.unparse(tree)}
    assert not unguarded


def required(argument):
    """What setup.py gives this argument of setup(), the versions taken off."""
    keywords = (node for node in ast.walk(ast.parse((ROOT / 'setup.py').read_text())) if isinstance(node, ast.keyword))
    value = ast.literal_eval(next(keyword.value for keyword in keywords if keyword.arg == argument))
    requirements = value['test'] if isinstance(value, dict) else value
    return {re.match(r'[\w-]+', requirement)[0] for requirement in requirements}


def test_package_xml_and_setup_py_name_what_is_imported():
    """What colcon and rosdep, or pip, do not bring is missing on the user's machine."""
    package = ElementTree.parse(ROOT / 'package.xml').getroot()
    assert 'python3-markupsafe' not in {each.text for each in package.iter()}, 'rosdep has no such key'
    code = (imported('pendubot_identification') | imported('launch')) - OPTIONAL
    tests = imported('test') - code - NO_ROSDEP - OPTIONAL
    for names, kind, argument in ((code, 'exec', 'install_requires'), (tests, 'test', 'extras_require')):
        keys, on_pypi = {each.text for each in package.iter(f'{kind}_depend')}, required(argument)
        for name in names - {'markupsafe'}:  # python3-jinja2 brings it; it has no rosdep key
            key = {name, f'python3-{name}', ROSDEP.get(name)} & keys
            assert key, f'package.xml does not name {name}'
            # What is keyed by its own name is ROS's.
            assert key == {name} or PYPI.get(name, name) in on_pypi, f'setup.py does not name {name}'
