# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The import contracts and the declared dependencies; ``make lint`` checks style and types."""

import ast
import re
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from test.conftest import ROOT

#: Modules with another name on PyPI, or a rosdep key other than python3-NAME.
PYPI = {'serial': 'pyserial', 'yaml': 'PyYAML'}
ROSDEP = {'mcap': 'mcap-ros2-support', 'rosbags': 'python3-rosbags-pip', 'urdf_parser_py': 'urdfdom_py'}
#: Optional dependencies; a message names the command that installs them.
OPTIONAL = {'aiohttp', 'openpyxl', 'pandas', 'pendubot_interfaces', 'pyarrow', 'argcomplete'}
#: Dependencies of mcap, without a rosdep key of their own.
OF_MCAP = {'zstandard'}


def test_import_contracts_hold_and_detect_an_import_of_ros_in_a_criterion(tmp_path):
    """The contracts are checked on a copy of the package with that one fault."""
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
    """Return the packages that a folder imports and needs, except the standard library, ours and OF_MCAP.

    Imports in a try statement, for types alone, and in a test file with importorskip, need no package.
    """
    found = set()
    for path in (path for path in (ROOT / folder).rglob('*.py') if 'benchmark' not in path.parts):
        text = path.read_text()
        tree = ast.parse(text)
        tried = [node for node in ast.walk(tree) if isinstance(node, ast.Try)]
        branches = [node for node in ast.walk(tree) if isinstance(node, ast.If)]
        typed = [branch for branch in branches if ast.unparse(branch.test) == 'TYPE_CHECKING']
        without = {id(node) for block in tried + typed for node in ast.walk(block)}
        for node in (node for node in ast.walk(tree) if id(node) not in without):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module]
            packages = {name.split('.')[0] for name in names}
            found |= {name for name in packages if f"importorskip('{name}')" not in text}
    return found - {*sys.stdlib_module_names, *OF_MCAP, 'pendubot_identification', 'benchmarks', 'test'}


def required(argument):
    """Return an argument of setup() in setup.py, without versions."""
    keywords = (node for node in ast.walk(ast.parse((ROOT / 'setup.py').read_text())) if isinstance(node, ast.keyword))
    value = ast.literal_eval(next(keyword.value for keyword in keywords if keyword.arg == argument))
    requirements = value['test'] if isinstance(value, dict) else value
    return {re.match(r'[\w-]+', requirement)[0] for requirement in requirements}


def test_package_xml_and_setup_py_declare_every_imported_package():
    """``colcon test`` has only the dependencies of package.xml, and one failed import ends all tests."""
    package = ElementTree.parse(ROOT / 'package.xml').getroot()
    assert 'python3-markupsafe' not in {each.text for each in package.iter()}, 'rosdep has no such key'
    code = (imported('pendubot_identification') | imported('launch')) - OPTIONAL
    tests = imported('test') - code
    for names, kind, argument in ((code, 'exec', 'install_requires'), (tests, 'test', 'extras_require')):
        keys, on_pypi = {each.text for each in package.iter(f'{kind}_depend')}, required(argument)
        for name in names - {'markupsafe'}:  # a dependency of python3-jinja2, without a rosdep key
            key = {name, f'python3-{name}', ROSDEP.get(name)} & keys
            assert key, f'package.xml does not name {name}: declare it, or skip the tests without it by importorskip'
            # Packages whose key is their name belong to ROS.
            assert key == {name} or PYPI.get(name, name) in on_pypi, f'setup.py does not name {name}'
