# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The plans of the launch files: programs, parameters, and refusals before any start.

test_launched.py executes the plans with the real launch library, which is in no registry of packages.
"""

import importlib
import re
import runpy
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest
import yaml

from pendubot_identification import launching
from pendubot_identification.errors import ParameterError, PendubotError
from pendubot_identification.formats.export import export
from pendubot_identification.model.parameters import BALANCE
from pendubot_identification.results.result import read_result
from test.conftest import ROOT, SAMPLE
from test.identified import written

PACKAGE = 'pendubot_identification'
PROGRAMS = 'bridge', 'recorder', 'exciter', 'player', 'identifier', 'virtual_board'
#: Programs of other packages with the same names.
OTHERS = 'robot_state_publisher', 'rviz2', 'plotjuggler'
RANGE, PROFILES = launching.RANGE, launching.PROFILES
BAG = str(SAMPLE)
#: Required arguments of each launch file.
NEEDED = {'rig': {}, 'virtual': {}, 'view': {}, 'identification': {}, 'replay': {'bag': BAG}, 'control': {}}
#: Programs and packages of ros2_control.
CONTROL = 'ros2_control_node', 'spawner'
HARDWARE = 'joint_state_topic_hardware_interface'


INSTALLED = [(PACKAGE, program) for program in PROGRAMS] + [(other, other) for other in OTHERS]
INSTALLED += [('controller_manager', program) for program in CONTROL]
INSTALLED += [(package, 'library') for package in ('joint_state_broadcaster', HARDWARE)]


@pytest.fixture(autouse=True)
def packages(tmp_path, monkeypatch):
    """The folder of the installed programs, which a test may remove."""
    folder, index = tmp_path / 'prefix' / 'lib', tmp_path / 'prefix/share/ament_index/resource_index/packages'
    index.mkdir(parents=True)
    for package, program in INSTALLED:
        (folder / package).mkdir(parents=True, exist_ok=True)
        (folder / package / program).touch(0o755)
        (index / package).touch()
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path / 'prefix'))
    return folder


@pytest.fixture
def unset(monkeypatch):
    """Remove the variables that select the participating machines."""
    for variable in (RANGE, *PROFILES):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(launching, 'COMMON', runpy.run_module(launching.__name__)['COMMON'])


def launch(name, above='', **given):
    """Return the programs by name that a launch file starts with these arguments below a namespace."""
    file = launching.launch_file(f'{name}.launch.py')
    known = {**file['ARGUMENTS'], **launching.COMMON}
    texts = {argument: str(default) for argument, (default, _) in known.items()} | {'ros_namespace': above}
    words = [f'{argument}:={value}' for argument, value in given.items()]
    planned = launching.plan(file['ARGUMENTS'], file['start'], texts | given, words, list(known))
    known = {'name': None, 'on_exit': None}
    return {each.get('name') or each['executable']: SimpleNamespace(**known | each) for each in planned}


def files_and_values(program):
    """Return the parameters of a program: its files, and the values that take precedence over them."""
    files = [each for each in program.parameters if isinstance(each, str)]
    typed = [each for each in program.parameters if isinstance(each, dict)]
    assert list(program.parameters) == [*files, *typed]
    return files, {name: value for each in typed for name, value in each.items()}


@pytest.mark.ros
@pytest.mark.usefixtures('unset')
@pytest.mark.parametrize(
    ('name', 'programs'),
    [
        ('rig', ['bridge', 'recorder', 'exciter', 'robot_state_publisher']),
        ('virtual', ['virtual_board', 'bridge', 'recorder', 'exciter', 'robot_state_publisher']),
        ('identification', ['identifier']),
        ('replay', ['player', 'robot_state_publisher']),
        ('control', ['bridge', 'recorder', 'robot_state_publisher', *CONTROL]),
    ],
)
def test_a_launch_file_starts_programs_with_existing_parameters_on_this_machine_in_one_namespace(name, programs):
    started = launch(name, **NEEDED[name])
    assert list(started) == programs
    for program in {*programs} & {*PROGRAMS} - {'virtual_board'}:
        files, values = files_and_values(started[program])
        module = importlib.import_module(f'{PACKAGE}.nodes.{program}')
        assert set(values) <= {setting.name for setting in getattr(module, program.title()).SETTINGS}
        assert files in ([], [str(ROOT / 'config' / f'{program}.yaml')])
        assert started[program].name == program, 'the file must apply to this node'
    assert {(each.namespace, each.additional_env[RANGE]) for each in started.values()} == {('', 'LOCALHOST')}
    started = launch(name, namespace='lab1', discovery='SUBNET', **NEEDED[name]).values()
    assert {(each.namespace, each.additional_env[RANGE]) for each in started} == {('/lab1', 'SUBNET')}


@pytest.mark.usefixtures('unset')
@pytest.mark.parametrize('name', NEEDED)
def test_other_machines_are_excluded_except_on_request_or_with_a_users_profile(monkeypatch, name):
    """A profile of Fast DDS excludes them; test_network.py tests its effect."""

    def profiles(**arguments):
        started = launch(name, **NEEDED[name], **arguments).values()
        (set_,) = {tuple(each.additional_env.get(variable) for variable in PROFILES) for each in started}
        return set_

    assert profiles() == (str(ROOT / 'config' / 'this_machine.xml'),) * 2
    assert profiles(discovery='SUBNET') == (None, None)
    for variable in PROFILES:
        monkeypatch.setenv(variable, '/mine.xml')
        assert profiles() == profiles(discovery='SUBNET') == (None, None)
        monkeypatch.delenv(variable)


@pytest.mark.parametrize(
    ('name', 'arguments', 'missing', 'message'),
    [
        ('rig', {'amplitude': 'nan'}, None, 'amplitude is nan; a number is expected'),
        ('rig', {'amplitude': '0'}, None, 'amplitude_min -0 is not below amplitude_max 0; give the smaller torque'),
        ('rig', {'duration': '-1'}, None, 'duration is -1.0; a number from 0 to 86400 s is expected'),
        ('rig', {'seed': '-1'}, None, 'seed is -1; a whole number from 0 to 2147483647 is expected'),
        ('rig', {'namespace': 'lab/2'}, None, 'namespace is /lab/2; names of letters, digits and _, without'),
        ('rig', {'arm': ''}, None, 'arm is empty; true or false is expected'),
        ('rig', {'discovery': 'MOON'}, None, 'discovery is MOON; one of LOCALHOST, SUBNET, SYSTEM_DEFAULT is expected'),
        ('rig', {'bridge': '/no.yaml'}, None, 'bridge is /no.yaml, and there is no such file; name a'),
        ('rig', {'amplitud': '0.05'}, None, 'this launch has no argument amplitud; is amplitude meant? --show-args'),
        ('virtual', {'l2': '-1'}, None, 'the length l2 is -1 m; a number above 0 is expected'),
        ('replay', {'bag': '~/no'}, None, f'there is no bag {Path.home()}/no; give a bag folder'),
        ('replay', {'bag': ''}, None, 'bag is empty; give the folder of a bag'),
        ('identification', {'bags': f"['{BAG}', '~/no@0:9']"}, None, f'there is no bag {Path.home()}/no; give'),
        ('identification', {'bags': "['a"}, None, 'bags is [\'a; a text, or a list of texts such as "[\'a\''),
        ('control', {'controllers': '/no.yaml'}, None, 'controllers is /no.yaml, and there is no such file; name a'),
        ('control', {'view': 'false'}, None, 'controller_manager needs the description of the rig; leave view out'),
        ('rig', {}, 'exciter', 'exciter is not installed; build'),
        ('virtual', {}, OTHERS[0], 'robot-state-publisher, or set view:=false'),
        ('replay', {'rviz': 'true', 'bag': BAG}, OTHERS[1], 'ros-$ROS_DISTRO-rviz2, or set rviz:=false'),
    ],
)  # fmt: skip
def test_invalid_arguments_and_missing_programs_are_refused(packages, name, arguments, missing, message):
    """Otherwise earlier programs would keep running: an exciter would arm and move the rig."""
    if missing:
        (packages / (missing if missing in OTHERS else PACKAGE) / missing).unlink()
    with pytest.raises(PendubotError, match=re.escape(message)):
        launch(name, **arguments)
    if missing in OTHERS:
        assert launch(name, **arguments, view='false'), 'an unused program must not be required'


@pytest.mark.parametrize(
    ('argument', 'program', 'above', 'namespace', 'place'),
    [
        ('bridge', 'bridge', '', '', ''),
        ('excitation', 'exciter', '', 'lab1', '/lab1'),
        ('excitation', 'exciter', '', '/lab1/', '/lab1'),
        # A relative namespace is below that of the including file.
        ('bridge', 'bridge', '/hall', '', '/hall'),
        ('excitation', 'exciter', '/hall', 'lab1', '/hall/lab1'),
        ('bridge', 'bridge', '/hall', '/lab1', '/lab1'),
    ],
)
def test_a_parameter_file_without_parameters_for_the_node_is_refused(
    tmp_path, argument, program, above, namespace, place
):
    """Otherwise a rig would move with the defaults instead of the file's limits; see test_config.py."""
    file, node = tmp_path / 'mine.yaml', f'{place}/{program}'
    given = {'above': above, 'namespace': namespace, argument: str(file)}
    for name in (node, f'/**/{program}'):
        file.write_text(yaml.safe_dump({name: {'ros__parameters': {'seed': 1}}}))
        started = launch('rig', **given)[program]
        assert (started.namespace, str(file) in started.parameters) == (place, True)
    file.write_text(yaml.safe_dump({f'/lab2/{program}': {'ros__parameters': {'seed': 1}}}))
    message = f'{file} has no effect: it contains parameters of /lab2/{program}, and none of {node}; name {node}'
    with pytest.raises(ParameterError, match=re.escape(f'{message} in it, or /**/{program} for')):
        launch('rig', **given)
    file.write_text(f'{node}: {{ros__parameters: [')
    with pytest.raises(ParameterError, match=f'{file} is no YAML file; a parameter file of {node} is expected'):
        launch('rig', **given)


def test_a_parameter_file_of_the_exciter_with_an_invalid_value_is_refused(tmp_path):
    file = tmp_path / 'mine.yaml'
    file.write_text('/**/exciter: {ros__parameters: {width: 2.0}}')
    with pytest.raises(ParameterError, match=f'{file}: width is 2.0; a number from 0.001 to 1 is expected'):
        launch('rig', excitation=str(file))


#: A user's parameter file.
MINE = '~/mine.yaml'
TRAIN = {'duration': 10.0, 'amplitude_min': -0.5, 'amplitude_max': 0.5, 'seed': 3}
IDENTIFIED = {'criterion': '', 'model': 'auto', 'output': '', 'force': False, 'autostart': True}


@pytest.mark.parametrize(
    ('name', 'arguments', 'program', 'file', 'values'),
    [
        ('rig', {}, 'bridge', None, {}),
        ('rig', {'port': '7', 'baud': '115200'}, 'bridge', None, {'port': '7', 'baud': 115200}),
        # The file's torque limit applies; with a virtual board its port does not, where a real rig may be.
        ('rig', {'bridge': MINE}, 'bridge', MINE, {}),
        ('rig', {'bridge': MINE, 'virtual': 'true'}, 'bridge', MINE,
         {'port': '/tmp/pendubot', 'confirm_zeros': False}),
        ('virtual', {'port': '/tmp/x', 'patient': 'true'}, 'bridge', None, {'port': '/tmp/x', 'confirm_zeros': False}),
        # The exciter requires a recorder.
        ('rig', {'amplitude': '0.5', 'duration': '10', 'seed': '3', 'arm': 'true'}, 'exciter', None,
         {'arm': True, 'recorded': True, **TRAIN}),
        ('rig', {'amplitude': '0.5', 'excitation': MINE}, 'exciter', MINE, {'arm': False, 'recorded': True}),
        ('rig', {'autostart': 'false'}, 'bridge', None, {'autostart': False}),
        ('rig', {'autostart': 'false'}, 'recorder', None, {'output': '', 'autostart': False}),
        # Bags are a text, even of digits, or a list of texts.
        ('identification', {'bags': '12', 'validate': "['12@0:9', 'b']"}, 'identifier', None,
         IDENTIFIED | {'bags': ['12'], 'validate': ['12@0:9', 'b']}),
        ('identification', {'bags': '[]', 'autostart': 'false'}, 'identifier', None,
         IDENTIFIED | {'bags': [''], 'validate': [''], 'autostart': False}),
    ],
)  # fmt: skip
def test_arguments_take_precedence_over_the_parameter_file(
    tmp_path, monkeypatch, name, arguments, program, file, values
):
    monkeypatch.setenv('HOME', str(tmp_path))
    monkeypatch.chdir(tmp_path)
    for bag in ('12', 'b'):
        Path(bag).mkdir()
    (tmp_path / 'mine.yaml').write_text(yaml.safe_dump({program: {'ros__parameters': {'seed': 1}}}))
    started = launch(name, **arguments)
    expected = str(tmp_path / 'mine.yaml' if file else ROOT / 'config' / f'{program}.yaml')
    assert files_and_values(started[program]) == ([expected], values)
    if 'virtual_board' in started:
        patient = ('--patient',) * (arguments.get('patient') == 'true')
        assert started['virtual_board'].arguments == ('--link', values['port'], *patient)


def test_the_view_describes_the_rig_and_starts_viewers_on_request(tmp_path):
    def described(**arguments):
        (only,) = launch('view', **arguments).values()
        assert all(relative == topic.lstrip('/') for topic, relative in only.remappings)
        return files_and_values(only)[1]['robot_description']

    assert '<mass' not in described()
    rig = written(tmp_path / 'rig.yaml', BALANCE)
    assert described(parameters=str(rig)) == export(read_result(rig), 'urdf')[0]
    started = launch('view', rviz='true', plotjuggler='true')
    assert tuple(started) == OTHERS
    assert all(Path(started[name].arguments[1]).is_file() for name in OTHERS[1:])


def test_a_replay_with_parameters_shows_the_identified_rig_as_a_ghost(tmp_path):
    rig = str(written(tmp_path / 'rig.yaml', BALANCE))
    started = launch('replay', bag=BAG, parameters=rig)
    assert list(started) == ['player', 'robot_state_publisher', 'ghost_state_publisher']
    assert files_and_values(started['player'])[1]['ghost'] == rig
    ghost = started['ghost_state_publisher']
    assert ghost.executable == 'robot_state_publisher'
    remapped = {('joint_states', 'ghost/joint_states'), ('robot_description', 'ghost/robot_description')}
    remapped |= {('/ghost/robot_description', 'ghost/robot_description')}  # for RViz in a namespace
    assert remapped < set(ghost.remappings)
    robots = [files_and_values(started[name])[1]['robot_description'] for name in list(started)[1:]]
    measured, simulated = ({link.get('name') for link in ElementTree.fromstring(each).iter('link')} for each in robots)
    assert measured & simulated - {None} == {'base_link'}, 'both must have the same base frame'
    display = yaml.safe_load((ROOT / 'config' / 'pendubot.rviz').read_text())['Visualization Manager']['Displays']
    assert '/ghost/robot_description' in [each.get('Description Topic', {}).get('Value') for each in display]


def test_controllers_use_the_rig_as_hardware_and_their_commands_are_recorded(packages, tmp_path):
    started = launch('control', virtual='true', namespace='lab1', controller="['mine', 'other']")
    assert list(started) == ['virtual_board', 'bridge', 'recorder', 'robot_state_publisher', *CONTROL]
    robot = ElementTree.fromstring(files_and_values(started['robot_state_publisher'])[1]['robot_description'])
    joints = {joint.get('name') for joint in robot.findall('joint')}
    hardware = robot.find('ros2_control')
    assert {joint.get('name') for joint in hardware.findall('joint')} <= joints
    assert [each.get('name') for each in hardware.findall('joint/command_interface')] == ['effort']
    topics = {each.get('name'): each.text for each in hardware.findall('hardware/param')}
    assert topics['joint_states_topic'] == 'joint_states'
    assert files_and_values(started['recorder'])[1]['topics'] == ['joint_states', topics['joint_commands_topic']]
    file = str(ROOT / 'config' / 'controllers.yaml')
    assert started['spawner'].arguments == ('joint_state_broadcaster', 'mine', 'other', '--param-file', file)
    assert started['ros2_control_node'].parameters == (file,)
    manager = yaml.safe_load(Path(file).read_text())['/**/controller_manager']['ros__parameters']
    assert {name for name, value in manager.items() if isinstance(value, dict)} == {
        'joint_state_broadcaster',
        'effort_controller',
    }
    index = packages.parent / 'share/ament_index/resource_index/packages'
    (index / HARDWARE).unlink()
    with pytest.raises(PendubotError, match=f'{HARDWARE} is not installed; sudo apt install'):
        launch('control')


@pytest.mark.parametrize('name', NEEDED)
def test_with_a_keystore_every_program_of_the_policy_starts_in_its_enclave(monkeypatch, name):
    view = {'rviz': 'true', 'plotjuggler': 'true'} if name == 'view' else {}
    monkeypatch.delenv('ROS_SECURITY_KEYSTORE', raising=False)
    assert not [each for each in launch(name, **NEEDED[name], **view).values() if hasattr(each, 'ros_arguments')]
    monkeypatch.setenv('ROS_SECURITY_KEYSTORE', '/keys')
    (enclaves,) = ElementTree.parse(ROOT / 'config' / 'sros2_policy.xml').getroot()
    known = {enclave.get('path') for enclave in enclaves}
    for program, each in launch(name, **NEEDED[name], **view).items():
        if program not in CONTROL:
            option, enclave = each.ros_arguments
            assert option == '--enclave'
            assert enclave in known
            assert enclave == f'/pendubot/{"viewer" if program in OTHERS else program}'
