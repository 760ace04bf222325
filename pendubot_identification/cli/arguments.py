# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Subcommands and options of ``pendubot``: one function per subcommand, whose docstring is the help text.

The module of the same name runs a subcommand. This module does not import numpy, so that ``--help`` is fast.
"""

import argparse
import math
import os
from inspect import cleandoc
from pathlib import Path
from typing import Any, NoReturn

from pendubot_identification import __version__, kernel
from pendubot_identification import identification as estimation
from pendubot_identification.errors import PendubotError
from pendubot_identification.model import MODELS
from pendubot_identification.resources import resource
from pendubot_identification.setting import Setting, flag
from pendubot_identification.trajectories.conventions import CONVERSION, JOINTS, TOPIC

#: Choices for the lowest level at which ``identify`` exits with status 3.
FAILING = {'warn': 1, 'error': 2, 'never': 3}
#: Formats of ``export``.
FORMATS = ('mjcf', 'urdf', 'yaml', 'm', 'h', 'py')
STATUS = 'exit status: 0 success, 1 a failure explained in one line, 2 wrong usage, 3 a result of level ERROR'
WINDOW, RESULT, EXCITER = 'BAG[@START:END]', 'RESULT.yaml', 'EXCITER.yaml'
JSON, FIGURES = 'print JSON and nothing else', 'add the figures of the report as SVG and PNG'


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    top = _Parser(
        prog='pendubot',
        description='Identify the parameters of a pendubot from its recordings, without ROS.',
        epilog=_sample_bag() + STATUS,
    )
    top.add_argument('--version', action=_Version, nargs=0, help='print the version and the kind of the kernel')
    top.set_defaults(debug=False)
    subparsers = top.add_subparsers(title='subcommands', metavar='SUBCOMMAND', required=True)
    for name, (define, words) in {
        'identify': (_identify, 'estimate parameters from recordings'),
        'track': (_track, 'track parameters through long recordings'),
        'report': (_report, 'write a page with figures of a result'),
        'compare': (_compare, 'compare results'),
        'excite': (_excite, 'design an excitation'),
        'export': (_export, 'write a result for simulators, MATLAB, C, Python or a node'),
        'import': (_import, 'turn a file of CSV, MATLAB, Excel or Parquet into a bag'),
        'simulate': (_simulate, 'write a bag of the virtual rig'),
        'info': (_info, 'describe the content of a recording'),
        'repair': (_repair, 'write a closed copy of an unclosed, truncated or damaged bag'),
        'reproduce': (_reproduce, "reproduce the paper's tables and figures"),
        'studio': (_studio, 'identify in a browser page'),
        'demo': (_demo, 'run the complete chain on a virtual rig (needs ROS)'),
        'completion': (_completion, 'print a completion script for a shell'),
        'help': (_help, 'describe pendubot or a subcommand'),
    }.items():
        description, *examples = cleandoc(define.__doc__ or '').split('\n\nExamples:')
        epilog = '\n'.join([*(f'examples:{text}' for text in examples), STATUS])
        subparser = subparsers.add_parser(name, help=words, description=description, epilog=epilog)
        subparser.set_defaults(subcommand=name, parser=subparser)
        define(subparser)
    for each in (top, *subparsers.choices.values()):
        # A default of False in a subcommand would override a --debug before it.
        each.add_argument('--debug', action='store_true', default=argparse.SUPPRESS, help='show tracebacks')
    return top


def _sample_bag() -> str:
    """Return a line with the path of the sample bag; empty if it was removed."""
    try:
        return f'sample bag: {resource("bags/paper_experiment")}\n'
    except PendubotError:
        return ''


class _Parser(argparse.ArgumentParser):
    """A parser that keeps the line breaks of descriptions, and reports wrong usage in one line."""

    def __init__(self, **options: Any) -> None:
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **options)

    def error(self, message: str) -> NoReturn:
        self.exit(2, f'{self.prog}: error: {message}; see {self.prog} --help\n')


class _Version(argparse.Action):
    """Prints the version, and loads the compiled kernel only for that."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(f'{parser.prog} {__version__}, {kernel.description()}')
        parser.exit()


def _path(group: Any, name: str, metavar: str, help: str, **options: Any) -> None:
    group.add_argument(name, type=Path, metavar=metavar, help=help, **options)


def _number(group: Any, name: str, default: float, metavar: str, help: str) -> None:
    help += ' (default %(default)s)'
    group.add_argument(name, type=type(default), default=default, metavar=metavar, help=help)


def _switch(group: Any, name: str, help: str) -> None:
    group.add_argument(name, action='store_true', help=help)


def _force(group: Any, target: str = 'an existing file') -> None:
    _switch(group, '--force', f'overwrite {target}')


def _settings(group: Any, *settings: Setting, **metavars: str) -> None:
    """Add settings as options; the value of an absent option is None."""
    for setting in settings:
        words, default = setting.help(), setting.default
        if isinstance(default, bool):
            group.add_argument(flag(setting.name), action='store_const', const=True, help=words)
            continue
        if not setting.optional:
            words += f' (default {":".join(map(str, default)) if isinstance(default, tuple) else default})'
        group.add_argument(
            flag(setting.name),
            type=str if setting.read else type(default),
            choices=None if setting.read else setting.choices or None,
            metavar=metavars.get(setting.name, setting.unit.upper() or None),
            help=words,
        )


def _reading(parser: Any, *, joints: bool = False) -> None:
    """Add the options for the conversion of recordings, with ``joints`` also for bags."""
    group = parser.add_argument_group('conversion of recordings', 'applied in this order to each recording')
    names = {'columns': 't=NAME,...', 'torque_constant': 'K', 'gear': 'N', 'negate': 'q1,...', 'offset': 'q1=ANGLE,...'}
    names['joints'] = 'SHOULDER,ELBOW'
    _settings(group, *(each for each in CONVERSION if joints or each not in (TOPIC, JOINTS)), **names)
    words = (
        'YAML file with options, or a result for its conversion; options given here override it. Only here: '
        f'{", ".join(option.name for option in estimation.EXPERT_OPTIONS)} of identify, see config/identifier.yaml'
    )
    _path(group, '--settings', 'FILE', words)


def _outputs(parser: Any, content: str) -> Any:
    """Add the options for the result, and return their group."""
    group = parser.add_argument_group('output')
    _path(group, '--output', RESULT, f'file for {content}')
    _path(group, '--report', 'DIR', 'folder for a page with figures, report.html, and the result')
    _switch(group, '--figures', FIGURES)
    _force(group, 'an existing result or report')
    _switch(group, '--json', JSON)
    return group


def _identify(parser: Any) -> None:
    """Estimate the parameters of a rig from its recordings and write them to a result file.

    BAG is a bag, closed or not, or a file with columns (see pendubot import --help). @START:END selects seconds from
    the first sample. In one bag without a window, the first half is training data and the second half validation data,
    as in the paper. With a window, the rest of the bag validates, except parts shorter than a second. Several bags
    without windows are all training data, and each is predicted from the others. A window lasts at most ten minutes, or
    three minutes with more than 200 000 samples; pendubot track lists the informative windows of a longer recording.

    Three criteria can be minimised; likelihood is the default. MDE minimises the paper's energy in every
    identification, as a comparison with the selected criterion:
      energy      the paper's: the work done equals the energy gained. Quadratic
      weak        the equations of motion times smooth test functions, integrated. Quadratic
      likelihood  innovations of Kalman filters, then prediction errors. Starts from weak
    Four models, each with all parameters of the previous model:
      viscous     P1 to P5, b1, b2: the paper's
      coulomb     and Coulomb friction, Fc1 Fc2
      rotor       and the inertia of the elbow's rotor, J2
      geared      and Stribeck friction and friction under load, Fs1 Fs2 k1 k2

    Examples:
      pendubot identify swing --criterion energy --model viscous --spread 0   as in the paper, all 4000 generations
      pendubot identify swing@0:9 --validate swing@9:18           windows of your own
      pendubot identify a b c --validate d --output result.yaml   several recordings pooled
      pendubot identify swing --hold linear --delay 0:0.02        a measured torque with a delay
      pendubot identify swing --delay=-0.02:0.02                  a negative number needs the =
      pendubot identify run.mat --columns q1=th1,q2=th2,tau1=u --degrees --zero hanging   your own
      pendubot identify run.csv --apply-remedies                  correct detected faults; the result lists them
      pendubot identify swing --settings lab.yaml                 options by name, such as "model: viscous"
      pendubot identify swing --check                             check the data without an identification
    """
    parser.add_argument('bags', nargs='+', metavar=WINDOW, help='training recordings')
    parser.add_argument('--validate', nargs='+', default=[], metavar=WINDOW, help='validation recordings')
    estimator = parser.add_argument_group('criterion and model')
    _settings(estimator, *estimation.CRITERION_OPTIONS, criterion='NAME[,NAME ...]')
    words = 'search interval of a parameter, such as P1=0:0.5, or its value if it is known; may be repeated'
    estimator.add_argument('--bounds', '--fix', action='append', default=[], metavar='NAME=LOW:HIGH', help=words)
    _settings(parser.add_argument_group('data'), *estimation.DATA_OPTIONS, estimation.APPLY_REMEDIES, delay='LOW:HIGH')
    _settings(parser.add_argument_group('optimisation'), *estimation.OPTIMISATION_OPTIONS, start=RESULT)
    _reading(parser, joints=True)
    output = _outputs(parser, 'the result')
    words = 'lowest level of the result for exit status 3 (default %(default)s)'
    output.add_argument('--fail-on', default='error', choices=FAILING, help=words)
    _switch(output, '--verbose', 'print all tables and remarks')
    _switch(parser, '--check', 'check only the recordings: stamps, gaps, limits, conventions and excitation')


def _track(parser: Any) -> None:
    """Track the parameters of a rig through recordings of any length, in their order as if they were one. Print the
    newest values with intervals, and every change with its time. Memory does not grow with the length.

    Friction may drift; inertias and weights change only in steps, such as a payload. A disturbance, such as a push by
    hand, is ignored. The last lines are the informative windows, with the most motion between two changes.

    Examples:
      pendubot track morning.csv evening.csv           two recordings of one rig in their order
      pendubot track day --output now.yaml --report look   the newest parameters, and a page, look/report.html
    """
    parser.add_argument('bags', nargs='+', metavar=WINDOW, help='recordings in chronological order')
    _path(parser, '--start', RESULT, 'parameters, delay and model at the start')
    parser.add_argument('--model', choices=list(MODELS), help='default: the model of --start, else coulomb')
    _reading(parser, joints=True)
    _outputs(parser, 'the newest parameters')


def _report(parser: Any) -> None:
    """Write a report of a result: one HTML page, which needs no network. It reads the bags in the result again. If a
    bag has been moved or changed, the report states that and omits the figures that need it.

    Examples:
      pendubot report result.yaml --reference last_week.yaml      last week's parameters beside these
      pendubot report result.yaml --bags ~/recordings --output there
    """
    _path(parser, 'result', RESULT, 'a result of pendubot identify')
    _path(parser, '--output', 'DIR', 'folder of the report (default: RESULT_report beside the result)')
    _path(parser, '--bags', 'FOLDER', 'present folder of the bags (default: as in the result)')
    _switch(parser, '--figures', FIGURES)
    _path(parser, '--reference', RESULT, 'reference parameters: an earlier result, or a file by hand')
    _force(parser, 'files in a folder that is not empty')


def _compare(parser: Any) -> None:
    """Compare results: every parameter with its standard error and its difference t from the first result, in standard
    errors of both. p is the probability of an at least equal t by chance (Welch's t test). A p far below 0.05 shows a
    change of the rig, or standard errors that are too small for an unmodelled effect.

    With --on BAG each result simulates the motion of a bag, repeatedly from a measured state. Different parameters may
    predict equally well; then the difference is irrelevant to a controller.

    Examples:
      pendubot compare monday.yaml friday.yaml --on swing@9:18    on validation data of both
    """
    _path(parser, 'results', RESULT, 'two or more results', nargs='+')
    parser.add_argument('--on', metavar=WINDOW, help='recording whose motion every result predicts')
    _reading(parser, joints=True)
    _switch(parser, '--json', JSON)


def _excite(parser: Any) -> None:
    """Design an excitation, or predict the motion under a given excitation. A design is the most informative pulse
    train (D-optimal: the smallest confidence ellipsoid) within limits of torque, speed and angles. Its motion is
    simulated from hanging at rest with the present parameters. --output writes a parameter file of the exciter.

    Examples:
      pendubot excite --design --torque 1 --speed 20 --from result.yaml --output exciter.yaml
      pendubot excite --design --torque 1 --speed 20 --angle 1.5 6.3               cables: a quarter turn, one turn
      pendubot excite --check exciter.yaml --from result.yaml                      its motion and its information

    then: ros2 run pendubot_identification exciter --ros-args --params-file exciter.yaml
    A rig differs from its estimate: watch the first run, with a hand at the emergency stop.
    """
    task = parser.add_mutually_exclusive_group(required=True)
    _switch(task, '--design', 'search the most informative pulse train')
    _path(task, '--check', EXCITER, 'predict the motion under this pulse train')
    words = "present parameters of the rig: a result of pendubot identify (default: the paper's rig)"
    _path(parser, '--from', RESULT, words, dest='estimate')
    limits = parser.add_argument_group('limits', 'a design satisfies them; --check compares the motion with them')
    limits.add_argument('--torque', type=float, metavar='NM', help='largest torque in either direction [N m]')
    limits.add_argument('--speed', type=float, metavar='RAD_S', help='largest speed of either joint [rad/s]')
    words = 'largest angle of each joint from hanging, in either direction [rad] (default: no limit)'
    default, names = (math.inf, math.inf), ('SHOULDER', 'ELBOW')
    limits.add_argument('--angle', type=float, nargs=2, default=default, metavar=names, help=words)
    recording = parser.add_argument_group('recording')
    _number(recording, '--duration', 18.0, 'S', 'length of the excitation')
    _number(recording, '--rate', 100.0, 'HZ', 'sampling rate')
    _number(recording, '--counts', 4000, 'N', 'encoder counts per turn')
    _path(parser, '--output', EXCITER, "file for the exciter's parameters")
    _force(parser)


def _export(parser: Any) -> None:
    """Write the published parameters of a result in another format, with all digits:
      mjcf    the rig for MuJoCo
      urdf    the rig for RViz, Gazebo, Pinocchio, Drake, MATLAB ...; fix its base_link to the world
      yaml    parameters P1, P2, ... for --params-file of a controller node, whatever its name
      m       a MATLAB or Octave script with a struct: pendubot.P1, ..., pendubot.theta, pendubot.std_error, and
              the model: pendubot.mass_matrix(q), bias(q, v), friction(v, tau), acceleration(q, v, tau) ...
      h       a C header: PENDUBOT_P1, ..., PENDUBOT_THETA, and the model: pendubot_acceleration(q, v, tau, a) ...
      py      a standalone Python module: P1, ..., THETA, and the model: acceleration(q, v, tau) ...
    Comments contain units, meanings, level, warnings and the origin of the numbers.

    Simulators need masses, but the motion determines only P1 to P5. The export contains one rig with the same motion,
    and states that choice. Unphysical parameters are refused.

    Examples:
      pendubot export result.yaml --output pendubot.xml              the suffix selects the format; .xml is mjcf
      pendubot export result.yaml --output pendubot.urdf --revolute   one coordinate per joint in Pinocchio
      pendubot export result.yaml --format h > pendubot.h
    """
    _path(parser, 'result', RESULT, 'a result of pendubot identify, or parameters by hand')
    words = "default: by the output's suffix"
    parser.add_argument('--format', choices=FORMATS, help=words)
    _path(parser, '--output', 'FILE', 'output file (default: print the text)')
    simulators = parser.add_argument_group('for mjcf and urdf')
    words = 'measured length of link 1, from joint to joint (default: P3 / P5)'
    simulators.add_argument('--link-length', type=float, metavar='M', help=words)
    simulators.add_argument('--torque-limit', type=float, metavar='NM', help='limit of the motor (default: none)')
    _switch(simulators, '--revolute', 'urdf: revolute joints, with limits of 1000 rad, instead of continuous joints')
    _force(parser)


def _import(parser: Any) -> None:
    """Convert a file with columns to a bag with the topic /joint_states, as from the recorder. identify, track, info
    and compare read such files directly; only ROS needs a bag.

    A file is text (.csv .txt .tsv), MATLAB (.mat), numpy (.npz), Excel (.xlsx) or .parquet. Its default columns are
    t [s], q1, q2 (angles of shoulder and elbow, [rad]) and tau1 (torque at the shoulder, [N m]). Optional columns are
    tau2 (torque at the elbow, else 0) and dq1, dq2 (velocities, [rad/s]). The torque of a row is applied from that row
    until the next.

    Examples:
      pendubot import run.mat --output run --columns t=time,q1=th1,q2=th2,tau1=u --degrees --zero hanging
      pendubot import other.mat --output other --settings result.yaml   the conversion of that result
    """
    _path(parser, 'file', 'FILE', 'file with columns')
    _path(parser, '--output', 'BAG', 'folder of the new bag', required=True)
    _reading(parser)
    _force(parser, 'a bag of that name')


def _simulate(parser: Any) -> None:
    """Write a bag of the simulated rig (with the parameters of the paper or a result) under the paper's pulse train,
    with encoder quantization, much faster than real time and without ROS. The same options give the same bag.

    Examples:
      pendubot simulate --output swing --samples 900 --seed 7
      pendubot simulate --output designed --excitation exciter.yaml --parameters rig.yaml
    """
    _path(parser, '--output', 'BAG', 'folder of the new bag', required=True)
    _number(parser, '--samples', 1800, 'N', 'length of the recording')
    _number(parser, '--rate', 100.0, 'HZ', 'sampling rate')
    _number(parser, '--counts', 4000, 'N', 'encoder counts per turn, 0: exact')
    pulses = parser.add_mutually_exclusive_group()
    pulses.add_argument('--seed', type=int, help="seed of the torques of the paper's pulse train (default 1)")
    words = 'other pulses: parameter file of the exciter, from pendubot excite, or like config/exciter.yaml'
    _path(pulses, '--excitation', EXCITER, words)
    words = "parameters of the rig, friction and rotor included: a result (default: the paper's)"
    _path(parser, '--parameters', RESULT, words)
    _force(parser, 'an existing bag')


def _info(parser: Any) -> None:
    """Describe the content of a bag from its .mcap files: whether it was closed, damage, and for each topic
      jitter     deviation of an interval from the median interval, 99th percentile
      gaps       intervals longer than 1.5 median intervals, number of missing messages, start of the first gap
      latency    from the stamp to the recorder: median and maximum
      stamps     number of repeated and backward stamps
      lost       messages that the recorder numbered and that are missing
    Intervals are differences of header.stamp, or of the log time if a type has no stamp or it was never set.

    For a file with columns (see pendubot import --help) describe the converted columns, their ranges, and first and
    last values.
    """
    _path(parser, 'bag', 'BAG', 'a bag folder or a .mcap file, closed or not, or a file with columns')
    _reading(parser)
    _switch(parser, '--json', JSON)


def _repair(parser: Any) -> None:
    """Write a closed copy of an unclosed, truncated or damaged bag, and print the number of saved messages. The copy
    has an index and a metadata.yaml, and ros2 bag, rosbags and mcap read it. It contains the messages of every intact
    chunk. The original is unchanged.

    Examples:
      pendubot repair swing                      into swing_repaired
      pendubot repair swing --output complete
    """
    _path(parser, 'bag', 'BAG', 'a bag folder or a .mcap file, closed or not')
    _path(parser, '--output', 'BAG', 'folder of the copy (default: BAG_repaired)')
    _force(parser, 'an existing bag with the name of the copy')
    _switch(parser, '--json', JSON)


def _reproduce(parser: Any) -> None:
    """Reproduce the paper: its tables and Figure 1 from runs of this package, each number beside the paper's, in one
    folder with an index.md. It takes less than a minute.

      table4      errors of PSO, DE, HDE and MDE on four functions; whether MDE is ahead; times
      figure1     their convergence
      table7      J of ten identifications on the sample bag     table8      the parameters
      threshold   the sweep of the threshold, which the paper mentions
      operator    operator of MDE drawn per component or per vector

    The same seed gives the same files, byte for byte; only times.md and times.csv differ, with measured times. An
    interrupt keeps the finished parts.
    """
    parser.add_argument('--only', metavar='NAME[,NAME ...]', help='some of the above (default: all)')
    _number(parser, '--runs', 10, 'N', 'runs of a table; success rates are from 10 N runs, the sweep from 5 N')
    _number(parser, '--seed', 1, 'SEED', 'seed of all random numbers')
    _path(parser, '--output', 'DIR', 'new folder (default %(default)s)', default=Path('reproduction'))
    _force(parser, 'files in a folder that is not empty')


def _demo(parser: Any) -> None:
    """Run the complete chain on the virtual rig: a virtual board on a pseudo-terminal, the bridge, the exciter and the
    recorder in separate processes; then the identifier on the recorded bag; then a subscriber that joins late and
    receives the parameters. Needs ROS 2 (rclpy). It always uses an empty ROS domain on this computer only, independent
    of ROS_DOMAIN_ID and similar variables, and reaches no real rig.
    """
    _path(parser, '--output', 'DIR', 'new folder for bag and result (default: a temporary folder)')


def _studio(parser: Any) -> None:
    """Open a browser page for the identification of recordings. The server answers only browsers on this computer with
    the token in the address, and loads nothing from a network. Files stay in a private folder, which is deleted when
    the page or the studio is closed.

    Examples:
      pendubot studio swing run.csv       with recordings
    """
    parser.add_argument('files', nargs='*', metavar='BAG', help='initial recordings')
    _number(parser, '--port', 0, 'PORT', 'port of the address; 0: any free port')
    _switch(parser, '--no-browser', 'print the address without opening a browser')


def _completion(parser: Any) -> None:
    """Print a shell script for the completion of subcommands, options, their choices and file names
    (pip install argcomplete).

      bash   eval "$(pendubot completion bash)"      in ~/.bashrc; zsh alike in ~/.zshrc
      fish   pendubot completion fish > ~/.config/fish/completions/pendubot.fish
    """
    default, words = Path(os.environ.get('SHELL') or 'bash').name, 'the shell (default: $SHELL)'
    parser.add_argument('shell', nargs='?', choices=('bash', 'zsh', 'fish'), default=default, help=words)


def _help(parser: Any) -> None:
    """Describe pendubot or one of its subcommands."""
    parser.add_argument('command', nargs='?', metavar='SUBCOMMAND', help='a subcommand, such as identify')
