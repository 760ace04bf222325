# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The declared dependencies."""

import ast
import re
import sys
from xml.etree import ElementTree

from test.conftest import ROOT

#: Modules with another name on PyPI, or a rosdep key other than python3-NAME.
PYPI = {'serial': 'pyserial', 'yaml': 'PyYAML'}
ROSDEP = {'mcap': 'mcap-ros2-support', 'rosbags': 'python3-rosbags-pip', 'urdf_parser_py': 'urdfdom_py'}
#: Optional dependencies; a message names the command that installs them.
OPTIONAL = {'aiohttp', 'openpyxl', 'pandas', 'pendubot_interfaces', 'pyarrow', 'argcomplete'}
#: Dependencies of mcap, without a rosdep key of their own.
OF_MCAP = {'zstandard'}


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
