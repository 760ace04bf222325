# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The commands of the documentation are executed; ros2 commands, links and names are compared with the code."""

import importlib
import re
import shlex
import shutil

import numpy as np
import pytest

from pendubot_identification import programs
from pendubot_identification.cli.main import main, parser
from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import HANGING
from pendubot_identification.recordings.bag_reader import read_trajectory
from test.conftest import RECORDINGS, ROOT
from test.recordings.bags import csv

PAGES = [
    ROOT / 'README.md',
    ROOT / 'CONTRIBUTING.md',
    ROOT / 'bags' / 'README.md',
    *sorted((ROOT / 'docs').glob('*.md')),
]
#: Pages whose links are checked, too.
BESIDE = [ROOT / 'firmware' / 'README.md', ROOT / 'test' / 'SAFETY.md']
PACKAGE = 'pendubot_identification'
#: Subcommands that need ROS or a browser.
LIVE = {'demo', 'studio'}
#: Options that shorten long commands.
QUICK = {'excite --design': ('--duration', '2'), 'reproduce': ('--only', 'table7', '--runs', '2')}
QUICK |= {'identify': ('--criterion', 'weak', '--model', 'viscous', '--optimizer', 'lsq', '--hold', 'zero')}
#: Topics and services that users of the design rely on.
SERVED = {'/joint_states', '/pendubot/effort_command', '/pendubot/params', '/pendubot/identification'}
SERVED |= {'/bridge/arm', '/bridge/disarm', '/bridge/confirm_zeros', '/balancer/start', '/balancer/stop'}
SERVED |= {'/identifier/identify', '/effort_controller/commands'}


def blocks(page):
    """Return the lines of a page's indented code blocks, without comments."""
    return [line.split(' #')[0].strip() for line in re.findall(r'^    (.*)', page.read_text(), re.MULTILINE)]


def commands(page):
    """Return the offline pendubot commands in a page's code blocks, except placeholders."""
    lines = [line for line in blocks(page) if re.match(r'pendubot \S', line)]
    return [line for line in lines if 'BAG' not in line and 'FILE' not in line and line.split()[1] not in LIVE]


def test_documented_commands_of_every_subcommand_work_in_one_folder(tmp_path, monkeypatch, capsys):
    """The folder has the sample bag and recordings with the names of the pages."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / 'bags', tmp_path / 'bags')
    assert main(['simulate', '--output', 'swing']) == 0
    motion = read_trajectory(tmp_path / 'swing').trajectory
    names = 't', 'shoulder', 'elbow', 'torque'
    (tmp_path / 'matlab.csv').write_text(csv(motion, names=names, convert=lambda q: np.degrees(q - HANGING)))
    shown = {command: page.name for page in PAGES for command in commands(page)}
    (subparsers,) = [action for action in parser()._actions if hasattr(action, 'choices') and action.choices]
    assert {command.split()[1] for command in shown} | LIVE >= set(subparsers.choices)
    for command, page in shown.items():
        quick = next((options for begin, options in QUICK.items() if command.startswith(f'pendubot {begin}')), ())
        quick = () if '--criterion' in command else quick
        assert main([*shlex.split(command)[1:], *quick]) == 0, f'{page}: {command}\n{capsys.readouterr().err}'


def known(kind, *words):
    """Return whether every name in a ros2 command exists."""
    assigned = {word.split(':=')[0] for word in words if ':=' in word and not word.startswith('__')}
    if kind == 'launch':
        from pendubot_identification.launching import COMMON, launch_file

        return words[0] == PACKAGE and assigned <= {*launch_file(words[1])['ARGUMENTS'], *COMMON}
    if kind == 'run':
        if words[1] in ('pendubot', 'virtual_board'):
            return words[0] == PACKAGE and not assigned
        node = getattr(importlib.import_module(f'{PACKAGE}.nodes.{words[1]}'), words[1].title())
        return hasattr(programs, words[1]) and assigned <= {setting.name for setting in node.SETTINGS}
    if kind in ('service', 'topic', 'action'):
        return words[1].removeprefix('/lab1') in SERVED
    return kind in ('bag', 'pkg', 'node', 'param', 'security', 'lifecycle')


@pytest.mark.ros
@pytest.mark.parametrize('page', [*PAGES, *sorted((ROOT / 'launch').glob('*.py'))], ids=lambda page: page.name)
def test_names_in_documented_ros2_commands_exist(page):
    for line in blocks(page) if page.suffix == '.md' else page.read_text().splitlines():
        command = re.sub(r"^alias \w+='(.*)'$", r'\1', line)
        if command.startswith('ros2 '):
            assert known(*shlex.split(command)[1:]), f'{page.name}: {line}'


def anchors(page):
    """Return GitHub's anchors of the headings of a page."""
    headings = re.findall(r'^#+ (.*)', re.sub(r'```.*?```', '', page.read_text(), flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r'[^\w -]', '', heading.lower()).replace(' ', '-') for heading in headings}


@pytest.mark.parametrize('page', [*PAGES, *BESIDE], ids=lambda page: str(page.relative_to(ROOT)))
def test_targets_of_links_and_named_modules_exist(page):
    prose = re.sub(r'```.*?```', '', page.read_text(), flags=re.DOTALL)
    if page not in BESIDE:
        for path in re.findall(r'`((?:[a-z]+/)*\w+\.(?:py|c))`', prose):
            assert list((ROOT / PACKAGE).rglob(path)), f'{page.name} names {path}'
    for target in re.findall(r'\]\(([^)]+)\)', prose):
        if not target.startswith('http'):
            path, _, anchor = target.partition('#')
            found = page.parent / path if path else page
            assert found.exists(), f'{page.name} links to {target}'
            assert not anchor or anchor in anchors(found), f'{page.name} links to {target}'


def test_functions_in_the_walks_through_the_code_exist():
    page = (ROOT / 'docs' / 'development.md').read_text()
    (walks,) = re.findall(r'^## Two walks\n(.*?)^## ', page, re.MULTILINE | re.DOTALL)
    code = [path.read_text() for path in (ROOT / PACKAGE).rglob('*.py')]
    named = re.findall(r'`(?:(\w+)\.)?([a-zA-Z_]\w*)`', walks)
    assert named
    for owner, name in named:
        defined = re.compile(rf'^\s*(?:(?:async )?def|class) {name}\b|^    {name}: ', re.MULTILINE)
        owned = [text for text in code if not owner or re.search(rf'^class {owner}\b', text, re.MULTILINE)]
        assert any(map(defined.search, owned)), f'there is no {owner}.{name}'


def test_pages_named_in_files_exist():
    files = [path for folder in (PACKAGE, 'config', 'launch', 'test') for path in (ROOT / folder).rglob('*.*')]
    files = [path for path in files if path.suffix not in ('.so', '.pyc')]
    files += [ROOT / 'Makefile', ROOT / 'CHANGELOG.rst', *PAGES]
    named = {name for path in files for name in re.findall(rb'\bdocs/[\w-]+\.(?:md|svg|png)\b', path.read_bytes())}
    assert named
    assert not [name for name in named if not (ROOT / name.decode()).exists()]


def test_every_message_of_the_troubleshooting_page_is_in_the_code():
    paths = [*(ROOT / PACKAGE).rglob('*.py'), *(ROOT / 'launch').glob('*.py')]
    # Join string literals on several lines.
    code = '\n'.join(re.sub(r"""['"]\s*\n\s*f?['"]""", '', path.read_text()) for path in paths)
    rows = re.findall(r'^\| (.*?) \|', (ROOT / 'docs' / 'troubleshooting.md').read_text(), re.MULTILINE)
    symptoms = [quoted for row in rows for quoted in re.findall(r'`([^`]+ [^`]+)`', row)]
    assert symptoms
    for symptom in symptoms:
        parts = [part.strip() for part in symptom.split('…')]
        assert re.search('.*'.join(map(re.escape, parts)), code), f'no message contains: {symptom}'


def test_the_tests_of_the_safety_statements_exist():
    named = re.findall(r'`([\w/]+\.py)::(\w+)`', (ROOT / 'test' / 'SAFETY.md').read_text())
    assert len(named) > 30
    for file, name in named:
        source = (ROOT if file.startswith('benchmarks') else ROOT / 'test') / file
        assert re.search(rf'^def {name}\(', source.read_text(), re.MULTILINE), f'{file}::{name}'


def test_the_python_example_of_the_page_identifies_the_sample_bag(tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    page = (ROOT / 'docs' / 'getting-started.md').read_text()
    (code,) = re.findall(r'```python\n(.*?)```', page, re.DOTALL)
    exec(code, names := {})
    np.testing.assert_allclose(names['rig'].theta[:7], PAPER.vector(), rtol=0.05)
    assert len(names['again']) == len(names['motion'])


@pytest.mark.ros
def test_the_example_controller_receives_earlier_latched_messages(ros):
    from diagnostic_msgs.msg import DiagnosticArray
    from std_msgs.msg import Float64MultiArray

    from pendubot_identification.level import Level
    from pendubot_identification.nodes.messages import LATCHED, parameters_message, status_message
    from test.identified import made
    from test.processes import Program

    result = made(('weak',))
    node = ros.create_node('identifier_of_the_example')
    status = node.create_publisher(DiagnosticArray, '/pendubot/identification', LATCHED)
    params = node.create_publisher(Float64MultiArray, '/pendubot/params', LATCHED)
    status.publish(status_message(node, 'identification', Level.WARN, 'so so', {}))
    params.publish(parameters_message(result.theta.vector(result.model)))
    try:
        with Program(ROOT / 'examples' / 'controller.py') as controller:
            for _ in range(3):  # two topics, so in any order
                controller.wait_for('[controller]:')
            assert 'level 1: so so' in controller.output
            assert repr(result.parameters['P1'].value) in controller.output
            assert f'to hold link 1 horizontal takes {9.81 * result.theta.P4:.4f} N m' in controller.output
            assert controller.stop() in (0, -2, 130), controller.output
    finally:
        node.destroy_node()


@pytest.mark.recordings
def test_no_real_recording_is_copied_into_the_repository():
    sizes = {path.stat().st_size for path in RECORDINGS.glob('*.csv')}
    ours = [path for path in ROOT.rglob('*.csv') if '.venv' not in path.parts]
    assert not [path for path in ours if path.stat().st_size in sizes]
