# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The start and the output of the command line: few imports, no ROS, short texts, progress bar, and completion."""

import fcntl
import json
import os
import pty
import re
import select
import shutil
import signal
import struct
import subprocess
import sys
import termios
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pendubot_identification import __version__
from pendubot_identification.cli.terminal import LINES, brief
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import NAMES, UNITS
from pendubot_identification.results.result import Parameter, read_complete_result
from test.cli.conftest import FAST
from test.conftest import ROOT, SAMPLE

PATIENCE = 60  #: Timeout [s] of every program.
PENDUBOT = sys.executable, '-m', 'pendubot_identification.cli.main'
sentences = st.lists(st.text('abc de', min_size=5, max_size=400).map(lambda text: f'x{text}'), max_size=12)


def in_a_terminal(*arguments, **environment):
    """Run a program in a new pseudo-terminal; return its output."""
    child, terminal = pty.fork()
    if child == 0:
        fcntl.ioctl(0, termios.TIOCSWINSZ, struct.pack('HHHH', 24, 80, 0, 0))
        env = {**os.environ, 'TERM': 'xterm', 'COLUMNS': '80', **environment}
        os.execvpe(arguments[0], list(map(str, arguments)), env)
    output = b''
    with suppress(OSError):  # the other end was closed
        while select.select([terminal], [], [], PATIENCE)[0]:
            output += os.read(terminal, 65536)
    os.close(terminal)
    os.waitpid(child, 0)
    return output.decode()


@pytest.fixture(scope='module')
def result(inputs):
    return read_complete_result(inputs / 'result.yaml')


@given(sentences, sentences, sentences, st.sampled_from(Level), st.integers(0, 4), st.booleans())
@settings(deadline=None, max_examples=40)
def test_any_result_fits_on_thirty_lines(result, warnings, advice, consequences, level, files, large):
    parameters = {n: Parameter(value=0.1, std_error=0.01, unit=u) for n, u in zip(NAMES, UNITS, strict=True)}
    found = replace(result, warnings=warnings, advice=advice, consequences=consequences, level=level)
    found = replace(found, parameters=parameters) if large else found
    lines = brief(found, files).splitlines()
    assert len(lines) + files <= LINES == 30
    assert all(any(line.startswith(f'{name} [') for line in lines) for name in found.parameters)
    assert any(line.startswith(f'{level.name}: ') for line in lines)


def test_a_brief_text_has_complete_remarks(result):
    text = ' '.join(brief(replace(result, warnings=[f'{k}: {"word " * 40}end' for k in range(9)]), 2).split())
    assert text.count(' end') > 1
    assert text.count('word') == 40 * text.count(' end')


def test_verbose_shows_the_complete_result(run, inputs, tmp_path):
    status, short, _ = run('identify', inputs / 'swing', *FAST)
    again, long, _ = run('identify', inputs / 'swing', *FAST, '--verbose', '--output', tmp_path / 'r.yaml')
    assert status == again
    assert len(short.splitlines()) <= LINES < len(long.splitlines())
    assert 'condition number' in long
    assert ('not saved: add --output' in short, 'not saved' in long) == (True, False)


def test_a_terminal_shows_progress_time_and_best_value_but_not_with_json(tmp_path):
    """The run is long, without the kernel and without early convergence, to show progress on any machine."""
    (tmp_path / 'long.yaml').write_text('{runs: 2, generations: 3000}')
    command = (*PENDUBOT, 'identify', SAMPLE, '--criterion', 'energy', '--model', 'viscous', '--optimizer', 'mde')
    drawn = in_a_terminal(
        *command, '--spread', '0', '--settings', tmp_path / 'long.yaml', COLUMNS='120', PENDUBOT_KERNEL='off'
    )
    bars = re.findall(r'energy: MDE .*? (\d+)/3000, J = (\S+) \[[\d:]+, [\d:?]+ left\]', drawn)
    assert len(bars) > 2
    done, best = [int(n) for n, _ in bars], [float(J) for _, J in bars]
    assert done == sorted(done)
    assert best == sorted(best, reverse=True)
    assert 'MDE' not in drawn.rsplit('\r', 1)[-1].split('\n')[0], 'the bar must be removed at the end'
    assert json.loads(in_a_terminal(*PENDUBOT, 'identify', SAMPLE, *FAST, '--json'))['criterion'] == 'energy'


def test_a_closed_output_causes_no_error(tmp_path):
    (tmp_path / 'run.csv').write_text('t,q1,q2,tau1\n0,0,0,0\n0.01,0,0,0\n')
    program = f'exec {sys.executable} -c "from pendubot_identification.programs import pendubot; exit(pendubot())"'
    for command, out in ((f'info {SAMPLE} >&-', b''), ('import run.csv --output bag 2>&-', b'bag: 2 samples')):
        ended = subprocess.run(f'{program} {command}', shell=True, capture_output=True, timeout=PATIENCE, cwd=tmp_path)
        assert (ended.returncode, ended.stdout[:14], ended.stderr) == (0, out, b''), command


def test_without_the_sample_bag_everything_else_works(tmp_path):
    shutil.copytree(ROOT / 'pendubot_identification', tmp_path / 'pendubot_identification')
    ended = subprocess.run([*PENDUBOT, '--help'], cwd=tmp_path, capture_output=True, text=True, timeout=PATIENCE)
    assert (ended.returncode, ended.stderr) == (0, '')
    assert 'sample bag' not in ended.stdout


def test_help_is_equivalent_to_the_option(run):
    assert run('help') == run('--help')
    for command in re.findall(r'^    (\w+) ', run('--help')[1], re.MULTILINE):
        assert run('help', command) == run(command, '--help')


def test_completion_without_argcomplete_gives_the_command_to_install_it(run, monkeypatch):
    monkeypatch.setitem(sys.modules, 'argcomplete', None)
    status, _, err = run('completion', 'bash')
    assert (status, err.strip().endswith('pip install argcomplete')) == (1, True)


def test_a_shell_completes_subcommands_options_choices_and_files(run, tmp_path):
    pytest.importorskip('argcomplete')
    for shell in ('zsh', 'fish', 'bash'):
        status, script, _ = run('completion', shell)
        assert (status, 'pendubot' in script) == (0, True)
    (tmp_path / 'motion.mat').touch()
    typed = {'ident': 'identify', 'identify --skip-m': '--skip-missing', 'identify --zero ha': 'hanging'}
    env = {**os.environ, 'PATH': f'{Path(sys.executable).parent}:{os.environ["PATH"]}'}
    for words, expected in (typed | {'identify mot': 'motion.mat'}).items():
        line = f'COMP_LINE="pendubot {words}"; COMP_POINT=${{#COMP_LINE}}; _python_argcomplete pendubot'
        program = ['bash', '-c', f'{script}\n{line}; echo ${{COMPREPLY[@]}}']
        done = subprocess.run(program, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=PATIENCE)
        assert done.stdout.split() == [expected], words


CHILD = """
import json, sys
from pendubot_identification.cli.main import main
try:
    main(sys.argv[1:])
except SystemExit:
    pass
print(json.dumps(sorted({name.split('.')[0] for name in sys.modules})), file=sys.stderr)
"""


def child(*arguments, **options):
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, **options)


INTERRUPTED = """
import os, signal, sys
module = sys.argv.pop(1)
class Interrupt:
    def find_spec(name, *_):
        if name == module:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupt)
from pendubot_identification.programs import pendubot
pendubot()
"""


@pytest.mark.parametrize('module', ['pendubot_identification.cli.arguments', 'numpy'])
def test_an_interrupt_during_the_imports_ends_the_program_without_a_traceback(module):
    ended = child('-c', INTERRUPTED, module, 'info', SAMPLE)
    assert (ended.returncode, ended.stdout, ended.stderr) == (-signal.SIGINT, '', '')


@pytest.mark.parametrize(
    ('arguments', 'unwanted', 'shown'),
    [
        (
            ['identify', '--help'],
            {'numpy', 'mcap', 'rosbags', 'yaml', 'scipy', 'matplotlib', 'tqdm', 'jinja2'},
            'usage',
        ),
        (['info', SAMPLE], {'scipy', 'matplotlib', 'tqdm', 'jinja2'}, 'messages'),
        (['identify', SAMPLE, *FAST, '--verbose'], {'matplotlib', 'jinja2'}, r'\xb1'),
    ],
)
def test_unneeded_modules_are_not_imported_and_an_ascii_terminal_shows_all_signs(arguments, unwanted, shown):
    ended = child('-c', CHILD, *arguments, env={**os.environ, 'PYTHONIOENCODING': 'ascii'}, check=True)
    modules = {*json.loads(ended.stderr)}
    assert shown in ended.stdout
    assert ('numpy' in modules) == ('numpy' not in unwanted)
    assert not modules & {*unwanted, 'rclpy'}


def test_version_shows_whether_the_kernel_is_used():
    command = ('-m', 'pendubot_identification.cli.main', '--version')
    version = child(*command, env={'PENDUBOT_KERNEL': 'off'}, check=True).stdout
    assert version == f'pendubot {__version__}, numpy (the compiled kernel is switched off by PENDUBOT_KERNEL)\n'


def test_a_kernel_of_an_earlier_version_is_named():
    program = 'from pendubot_identification import kernel; kernel.VERSION -= 1; print(kernel.description())'
    assert 'no compiled kernel of this version: install the package again' in child('-c', program, check=True).stdout


@pytest.mark.parametrize(('given', 'threads'), [('3', 3), ('many', 0)])
def test_the_variable_pendubot_threads_limits_the_kernel(given, threads):
    command = ('-c', 'import pendubot_identification.kernel as kernel; print(kernel.threads)')
    assert int(child(*command, env={**os.environ, 'PENDUBOT_THREADS': given}, check=True).stdout) == threads


def test_the_demo_without_ros_reports_it_and_leaves_no_folder(tmp_path):
    for output in ((), ('--output', tmp_path / 'demo')):
        env = {**os.environ, 'TMPDIR': str(tmp_path)}
        ended = child('-c', 'import sys; sys.modules["rclpy"] = None\n' + CHILD, 'demo', *output, env=env)
        assert 'the demo needs ROS 2' in ended.stderr
        assert 'Traceback' not in ended.stderr
        assert not [*tmp_path.iterdir()]
