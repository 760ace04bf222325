"""The launch file against stand-ins for the launch library, which no registry of Python packages has."""

import ast
import importlib.util
import sys
from types import ModuleType
from unittest.mock import MagicMock

import pytest

from test.conftest import ROOT

LAUNCH = ROOT / 'launch' / 'rig.launch.py'
LIBRARY = (
    *('launch', 'launch.actions', 'launch.conditions', 'launch.event_handlers', 'launch.events'),
    *('launch.substitutions', 'launch_ros', 'launch_ros.actions', 'launch_ros.parameter_descriptions'),
    'launch_ros.substitutions',
)


@pytest.fixture
def started(monkeypatch):
    """What the launch file would start: a list of the keyword arguments of its nodes."""
    nodes = []
    for name in LIBRARY:
        module = ModuleType(name)
        module.__getattr__ = lambda _: MagicMock()
        monkeypatch.setitem(sys.modules, name, module)
    sys.modules['launch_ros.actions'].Node = lambda **arguments: nodes.append(arguments) or MagicMock()
    specification = importlib.util.spec_from_file_location('rig_launch', LAUNCH)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    module.generate_launch_description()
    return nodes


@pytest.mark.ros
def test_starts_the_programs_with_parameters_that_they_have(started):
    from pendubot_identification.nodes.bridge import Bridge
    from pendubot_identification.nodes.exciter import Exciter
    from pendubot_identification.nodes.recorder import Recorder

    assert [node['executable'] for node in started] == ['exciter', 'virtual_board', 'bridge', 'recorder']
    for node_class in (Bridge, Exciter, Recorder):
        (node,) = [n for n in started if n['executable'] == node_class.PROGRAM]
        known = {setting.name for setting in node_class.SETTINGS}
        assert set(node['parameters'][1]) <= known
        assert node['name'] == node_class.PROGRAM, 'a parameter file is addressed to the node of this name'


def test_every_argument_is_described_and_used():
    tree = ast.parse(LAUNCH.read_text())
    arguments = next(
        ast.literal_eval(s.value)
        for s in tree.body
        if isinstance(s, ast.Assign) and getattr(s.targets[0], 'id', '') == 'ARGUMENTS'
    )
    for name, (_, description) in arguments.items():
        assert description
        assert LAUNCH.read_text().count(f"value['{name}']") >= 1
