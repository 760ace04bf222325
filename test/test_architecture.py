# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The layers of the design, the style and the types, held by the tools themselves."""

import ast
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from test.conftest import ROOT

BIN = Path(sys.executable).parent


def run(*command):
    return subprocess.run([str(BIN / command[0]), *command[1:]], cwd=ROOT, capture_output=True, text=True, timeout=300)


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
    result = subprocess.run(
        [str(BIN / 'lint-imports'), '--no-cache'], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert result.returncode == 1
    assert 'pendubot_identification.criteria.energy -> rclpy' in result.stdout.replace('  ', ' ')


def test_package_xml_names_every_dependency_and_no_other():
    """Under its rosdep key; what colcon and rosdep do not bring is missing on the user's machine."""
    keys = {'numpy': 'python3-numpy', 'scipy': 'python3-scipy', 'serial': 'python3-serial', 'tqdm': 'python3-tqdm'}
    keys |= {'yaml': 'python3-yaml', 'mcap': 'mcap-ros2-support', 'rosbags': 'python3-rosbags-pip'}
    keys |= {'matplotlib': 'python3-matplotlib'}
    keys |= {'lz4': keys['mcap'], 'zstandard': keys['mcap']}  # which brings both
    imported = set()
    for path in [*(ROOT / 'pendubot_identification').rglob('*.py'), *(ROOT / 'launch').glob('*.py')]:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ''] if isinstance(node, ast.ImportFrom) and node.level == 0 else []
            imported |= {name.split('.')[0] for name in names}
    imported -= {*sys.stdlib_module_names, 'pendubot_identification'}
    declared = {e.text for e in ElementTree.parse(ROOT / 'package.xml').iter('exec_depend')}
    # Launch files also start what they do not import; see test_launch.
    assert declared == {keys.get(name, name) for name in imported} | {'robot_state_publisher'}
