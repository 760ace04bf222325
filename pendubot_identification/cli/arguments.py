# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Subcommands and options of ``pendubot``: a function a subcommand, with its help as docstring.

The module of the same name runs it. Nothing heavy is imported here: ``--help`` needs no numpy.
"""

import argparse
import math
import os
from inspect import cleandoc
from pathlib import Path
from typing import Any, NoReturn

from pendubot_identification import __version__, kernel
from pendubot_identification.identification.options import APPLY_REMEDIES, DATA, EXPERT, HOW, SCOPE
from pendubot_identification.model import MODELS
from pendubot_identification.resources import resource
from pendubot_identification.setting import Setting, flag
from pendubot_identification.trajectories.conventions import CONVERSION, JOINTS, TOPIC

#: The levels from which on the exit status of ``identify`` is 3.
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
        epilog=f'sample bag: {resource("bags/paper_experiment")}\n{STATUS}',
    )
    top.add_argument('--version', action=_Version, nargs=0, help='say which version this is and whether it is compiled')
    top.set_defaults(debug=False)
    subparsers = top.add_subparsers(title='subcommands', metavar='SUBCOMMAND', required=True)
    for name, (define, words) in {
        'identify': (_identify, 'estimate parameters from recordings'),
        'track': (_track, 'follow parameters through long recordings'),
        'report': (_report, 'a page with figures from a result'),
        'compare': (_compare, 'results side by side'),
        'excite': (_excite, 'design an excitation'),
        'export': (_export, 'write a result for simulators, MATLAB, C, Python or a node'),
        'import': (_import, 'turn a file of CSV, MATLAB, Excel or Parquet into a bag'),
        'simulate': (_simulate, 'write a bag of the virtual rig'),
        'info': (_info, 'describe the content of a recording'),
        'repair': (_repair, 'write a closed copy of an unclosed, truncated or damaged bag'),
        'reproduce': (_reproduce, "reproduce the paper's tables and figures"),
        'studio': (_studio, 'the guided way: drop files into a page, and see the running rig'),
        'demo': (_demo, 'the complete chain on a virtual rig (needs ROS)'),
        'completion': (_completion, 'make a shell complete all this'),
        'help': (_help, 'describe pendubot or a subcommand'),
    }.items():
        description, *examples = cleandoc(define.__doc__ or '').split('\n\nExamples:')
        epilog = '\n'.join([*(f'examples:{text}' for text in examples), STATUS])
        made = subparsers.add_parser(name, help=words, description=description, epilog=epilog)
        made.set_defaults(subcommand=name, parser=made)
        define(made)
    for each in (top, *subparsers.choices.values()):
        # A default of False in a subcommand would undo a --debug before it.
        each.add_argument('--debug', action='store_true', default=argparse.SUPPRESS, help='show tracebacks')
    return top


class _Parser(argparse.ArgumentParser):
    """Keeps the lines of descriptions, and refuses wrong usage in one line."""

    def __init__(self, **how: Any) -> None:
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **how)

    def error(self, message: str) -> NoReturn:
        self.exit(2, f'{self.prog}: error: {message}; {self.prog} --help lists what there is\n')


class _Version(argparse.Action):
    """Looks for the compiled kernel only when it is asked for."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        print(f'{parser.prog} {__version__}, {kernel.description()}')
        parser.exit()


def _path(group: Any, name: str, metavar: str, help: str, **how: Any) -> None:
    group.add_argument(name, type=Path, metavar=metavar, help=help, **how)


def _number(group: Any, name: str, default: float, metavar: str, help: str) -> None:
    help += ' (default %(default)s)'
    group.add_argument(name, type=type(default), default=default, metavar=metavar, help=help)


def _switch(group: Any, name: str, help: str) -> None:
    group.add_argument(name, action='store_true', help=help)


def _force(group: Any, what: str = 'an existing file') -> None:
    _switch(group, '--force', f'overwrite {what}')


def _settings(group: Any, *settings: Setting, **metavars: str) -> None:
    """Add settings as options; the value of an option that is not given is None."""
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


def _reading(parser: Any, *, joints: bool = False) -> Any:
    """Add the options by which recordings are read, with ``joints`` those of bags, too; return their group."""
    group = parser.add_argument_group('how recordings are read', 'applied in this order, to each recording')
    names = {'columns': 't=NAME,...', 'torque_constant': 'K', 'gear': 'N', 'negate': 'q1,...', 'offset': 'q1=ANGLE,...'}
    names['joints'] = 'SHOULDER,ELBOW'
    _settings(group, *(each for each in CONVERSION if joints or each not in (TOPIC, JOINTS)), **names)
    words = (
        'take options from a YAML file, one of --save-settings, or a result; options given here override it. It alone '
        f'has {", ".join(option.name for option in EXPERT)} of identify, see config/identifier.yaml'
    )
    _path(group, '--settings', 'FILE', words)
    return group


def _outputs(parser: Any, what: str) -> Any:
    """Add the options for the result, and return their group."""
    group = parser.add_argument_group('output')
    _path(group, '--output', RESULT, f'write {what} here')
    _path(group, '--report', 'DIR', 'write a page with figures, report.html, and the result there')
    _switch(group, '--figures', FIGURES)
    _force(group, 'an existing result or report')
    _switch(group, '--json', JSON)
    return group


def _identify(parser: Any) -> None:
    """Estimate the parameters of a rig from its recordings and write them to a result file.

    BAG is a bag, closed or not, or a file with columns (see pendubot import --help). @START:END selects seconds from
    the first sample. Of one bag without a window the first half estimates and the second validates, as in the paper.
    With a window, the rest of the bag validates, except parts shorter than a second. Several bags without windows all
    estimate, and each is predicted from the others. A window lasts at most ten minutes, or three minutes with more than
    200 000 samples; of a longer recording the message names the informative windows.

    Three criteria can be minimised. The likelihood is the default. MDE minimises the paper's energy in every
    identification; its answer stands beside the published one:
      energy      the paper's: the work done equals the energy gained. Quadratic
      weak        the equations of motion times smooth test functions, integrated. Quadratic
      likelihood  innovations of Kalman filters, then prediction errors. Starts from weak
    Four models, each with all parameters of the one before it:
      viscous     P1 to P5, b1, b2: the paper's
      coulomb     and Coulomb friction, Fc1 Fc2
      rotor       and the inertia of the elbow's rotor, J2
      geared      and Stribeck friction and friction under load, Fs1 Fs2 k1 k2

    Examples:
      pendubot identify swing --criterion energy --model viscous --spread 0   as in the paper, all 4000 generations
      pendubot identify swing@0:9 --validate swing@9:18           windows of your own
      pendubot identify a b c --validate d --output result.yaml   several recordings pooled
      pendubot identify swing --hold linear --delay 0:0.02        a torque that was measured, and late
      pendubot identify swing --delay=-0.02:0.02                  a negative number needs the =
      pendubot identify run.mat --columns q1=th1,q2=th2,tau1=u --degrees --zero hanging   your own
      pendubot identify run.csv --apply-remedies                  read as its faults require; the result says how
      pendubot identify swing --settings lab.yaml                 options by name, such as "model: viscous"
      pendubot identify swing --check                             is it good enough? Fits nothing
    """
    parser.add_argument('bags', nargs='+', metavar=WINDOW, help='recordings that estimate')
    parser.add_argument('--validate', nargs='+', default=[], metavar=WINDOW, help='recordings that only validate')
    what = parser.add_argument_group('what is minimised')
    _settings(what, *SCOPE, criterion='NAME[,NAME ...]')
    words = 'search interval of a parameter, such as P1=0:0.5, or its value if it is known; may be repeated'
    what.add_argument('--bounds', '--fix', action='append', default=[], metavar='NAME=LOW:HIGH', help=words)
    _settings(parser.add_argument_group('how the data are taken'), *DATA, APPLY_REMEDIES, delay='LOW:HIGH')
    _settings(parser.add_argument_group('how it is minimised'), *HOW, start=RESULT)
    _path(_reading(parser, joints=True), '--save-settings', 'FILE', 'keep the options of this group in a file')
    output = _outputs(parser, 'the result')
    words = 'the level of the result from which on the exit status is 3 (default %(default)s)'
    output.add_argument('--fail-on', default='error', choices=FAILING, help=words)
    _switch(output, '--verbose', 'print all tables and remarks')
    _switch(parser, '--check', 'only check the recordings: stamps, gaps, limits, conventions and excitation')


def _track(parser: Any) -> None:
    """Follow the parameters of a rig through recordings of any length, one after the other as if they were one: their
    newest values with intervals, and every change with its time. Memory does not grow with the length.

    Friction may drift; inertias and weights change only in steps, such as a payload. A disturbance, such as a push by
    hand, is ignored. Last come the informative windows: those with most motion between two changes.

    Examples:
      pendubot track morning.csv evening.csv           two recordings of one rig, one after the other
      pendubot track day --output now.yaml --report look   the newest parameters, and a page, look/report.html
    """
    parser.add_argument('bags', nargs='+', metavar=WINDOW, help='recordings, in the order of time')
    _path(parser, '--start', RESULT, 'parameters, delay and model at the start')
    parser.add_argument('--model', choices=list(MODELS), help='default: the model of --start, else coulomb')
    _reading(parser, joints=True)
    _outputs(parser, 'the newest parameters')


def _report(parser: Any) -> None:
    """Make a report of a result: one HTML page, which needs no network. The bags that the result names are read again.
    If one has been moved or changed, the report says so and leaves out the figures that need it.

    Examples:
      pendubot report result.yaml --reference last_week.yaml      last week's parameters beside these
      pendubot report result.yaml --bags ~/recordings --output there
    """
    _path(parser, 'result', RESULT, 'a file that pendubot identify wrote')
    _path(parser, '--output', 'DIR', 'folder of the report (default: RESULT_report beside the result)')
    _path(parser, '--bags', 'FOLDER', 'where the bags lie now (default: where the result says)')
    _switch(parser, '--figures', FIGURES)
    _path(parser, '--reference', RESULT, 'parameters shown beside the estimated ones: an earlier result, or by hand')
    _force(parser, 'files in a folder that is not empty')


def _compare(parser: Any) -> None:
    """Set results side by side: every parameter with its standard error and its difference from the first result in
    standard errors of both, t. p is the probability of so large a t by chance (Welch's t test). A p far below 0.05
    shows a change of the rig, or standard errors that are too small for an unmodelled effect.

    With --on BAG each result simulates the motion of a bag, again and again from a measured state. Parameters that
    differ may predict equally well; then the difference does not matter to a controller.

    Examples:
      pendubot compare monday.yaml friday.yaml --on swing@9:18    on motion that neither was estimated from
    """
    _path(parser, 'results', RESULT, 'two or more results', nargs='+')
    parser.add_argument('--on', metavar=WINDOW, help='a recording whose motion each of them predicts')
    _reading(parser, joints=True)
    _switch(parser, '--json', JSON)


def _excite(parser: Any) -> None:
    """Design an excitation, or predict the motion of a given one. A design is the pulse train whose motion is most
    informative (D-optimal: the smallest confidence ellipsoid), simulated from hanging at rest with the parameters as
    they are known now, within limits of torque, speed and angles. It is written as a parameter file of the exciter.

    Examples:
      pendubot excite --design --torque 1 --speed 20 --from result.yaml --output exciter.yaml
      pendubot excite --design --torque 1 --speed 20 --angle 1.5 6.3               cables: a quarter turn, one turn
      pendubot excite --check exciter.yaml --from result.yaml                      its motion and its information

    then: ros2 run pendubot_identification exciter --ros-args --params-file exciter.yaml
    A rig differs from its estimate: watch the first run, with a hand at the emergency stop.
    """
    what = parser.add_mutually_exclusive_group(required=True)
    _switch(what, '--design', 'search the most informative pulse train')
    _path(what, '--check', EXCITER, 'predict the motion of this one')
    words = "the rig's parameters as known now: a result of pendubot identify (default: the paper's rig)"
    _path(parser, '--from', RESULT, words, dest='estimate')
    limits = parser.add_argument_group('limits', 'a design keeps them; --check compares with those that are given')
    limits.add_argument('--torque', type=float, metavar='NM', help='greatest torque, either way [N m]')
    limits.add_argument('--speed', type=float, metavar='RAD_S', help='greatest speed of either joint [rad/s]')
    words = 'greatest angle of each joint from hanging, either way [rad]; 6.28 is a turn (default: no limit)'
    default, names = (math.inf, math.inf), ('SHOULDER', 'ELBOW')
    limits.add_argument('--angle', type=float, nargs=2, default=default, metavar=names, help=words)
    how = parser.add_argument_group('how it is recorded')
    _number(how, '--duration', 18.0, 'S', 'of the excitation')
    _number(how, '--rate', 100.0, 'HZ', 'sampling rate')
    _number(how, '--counts', 4000, 'N', 'encoder counts per turn')
    _path(parser, '--output', EXCITER, "write the exciter's parameter file here")
    _force(parser)


def _export(parser: Any) -> None:
    """Write the published parameters of a result, every digit of them, in another format:
      mjcf    the rig for MuJoCo
      urdf    the rig for RViz, Gazebo, Pinocchio, Drake, MATLAB ...; fix its base_link to the world
      yaml    parameters P1, P2, ... for --params-file of a controller node, whatever its name
      m       a MATLAB or Octave script that makes a struct: pendubot.P1, ..., pendubot.theta, pendubot.std_error, and
              the model: pendubot.mass_matrix(q), bias(q, v), friction(v, tau), acceleration(q, v, tau) ...
      h       a C header: PENDUBOT_P1, ..., PENDUBOT_THETA, and the model: pendubot_acceleration(q, v, tau, a) ...
      py      a Python module that needs no other: P1, ..., THETA, and the model: acceleration(q, v, tau) ...
    Units, meanings, level, warnings and the origin of the numbers stand in comments.

    Simulators need masses, and the motion determines P1 to P5 alone. One rig with the same motion is written; the file
    states the choice. Parameters that no real masses give are refused.

    Examples:
      pendubot export result.yaml --output pendubot.xml              the suffix selects the format; .xml is mjcf
      pendubot export result.yaml --output pendubot.urdf --revolute   one coordinate a joint in Pinocchio
      pendubot export result.yaml --format h > pendubot.h
    """
    _path(parser, 'result', RESULT, 'a result of pendubot identify, or parameters by hand')
    words = "default: by the output's suffix"
    parser.add_argument('--format', choices=FORMATS, help=words)
    _path(parser, '--output', 'FILE', 'write it here (default: print it)')
    simulators = parser.add_argument_group('for mjcf and urdf')
    words = 'of link 1, from joint to joint, measured (default: P3 / P5)'
    simulators.add_argument('--link-length', type=float, metavar='M', help=words)
    simulators.add_argument('--torque-limit', type=float, metavar='NM', help="the motor's (default: none)")
    _switch(simulators, '--revolute', 'urdf: joints revolute, with limits of 1000 rad, instead of continuous')
    _force(parser)


def _import(parser: Any) -> None:
    """Turn a file with columns into a bag with the topic /joint_states, as the recorder writes it. identify, track,
    info and compare read such files themselves; a bag is for ROS.

    A file is text (.csv .txt .tsv), MATLAB's (.mat), numpy's (.npz), Excel's (.xlsx) or .parquet. Its columns are by
    default t [s], q1, q2 (angles of shoulder and elbow, [rad]), tau1 (torque at the shoulder, [N m]) and, if they are
    there, tau2 (torque at the elbow, else 0), dq1, dq2 (velocities, [rad/s]). The torque of a row is applied from that
    row until the next.

    Examples:
      pendubot import run.mat --output run --columns t=time,q1=th1,q2=th2,tau1=u --degrees --zero hanging
      pendubot import other.mat --output other --settings lab.yaml      as kept by --save-settings lab.yaml
    """
    _path(parser, 'file', 'FILE', 'the file with columns')
    _path(parser, '--output', 'BAG', 'the folder of the new bag', required=True)
    _reading(parser)
    _force(parser, 'a bag of that name')


def _simulate(parser: Any) -> None:
    """Write a bag of the virtual rig (the paper's parameters, or those of a result) under the paper's pulse train, as
    its encoders would have read it, much faster than real time and without ROS. The same options give the same bag.

    Examples:
      pendubot simulate --output swing --samples 900 --seed 7
      pendubot simulate --output designed --excitation exciter.yaml --parameters rig.yaml
    """
    _path(parser, '--output', 'BAG', 'the folder of the new bag', required=True)
    _number(parser, '--samples', 1800, 'N', 'length of the recording')
    _number(parser, '--rate', 100.0, 'HZ', 'sampling rate')
    _number(parser, '--counts', 4000, 'N', 'encoder counts per turn, 0: exact')
    pulses = parser.add_mutually_exclusive_group()
    pulses.add_argument('--seed', type=int, help="of the torques of the paper's pulse train (default 1)")
    words = "other pulses: the exciter's parameter file, as pendubot excite writes it, or like config/exciter.yaml"
    _path(pulses, '--excitation', EXCITER, words)
    words = "the rig's, friction and rotor included: a result of pendubot identify (default: the paper's)"
    _path(parser, '--parameters', RESULT, words)
    _force(parser, 'an existing bag')


def _info(parser: Any) -> None:
    """Describe the content of a bag from its .mcap files: whether it was closed, damage, and of each topic
      jitter     deviation of an interval from the median interval, 99th percentile
      gaps       intervals longer than 1.5 median intervals, how many messages would fill them, start of the first
      latency    from the stamp to the recorder: median and maximum
      stamps     number that repeat or run back
      lost       messages that the recorder numbered and that are missing
    Intervals are those of header.stamp, or of the log time if a type has none or it was never set.

    Of a file with columns (see pendubot import --help): the columns as they are read, their ranges, and first and last
    values.
    """
    _path(parser, 'bag', 'BAG', 'a bag folder or a .mcap file, closed or not, or a file with columns')
    _reading(parser)
    _switch(parser, '--json', JSON)


def _repair(parser: Any) -> None:
    """Write a closed copy of an unclosed, truncated or damaged bag, and print the number of saved messages. The copy
    has an index and a metadata.yaml, and ros2 bag, rosbags and mcap read it. It holds every intact message, also those
    after a damaged part. The original is only read.

    Examples:
      pendubot repair swing                      into swing_repaired
      pendubot repair swing --output whole
    """
    _path(parser, 'bag', 'BAG', 'a bag folder or a .mcap file, closed or not')
    _path(parser, '--output', 'BAG', 'the folder of the copy (default: BAG_repaired)')
    _force(parser, 'a bag of the name of the copy')
    _switch(parser, '--json', JSON)


def _reproduce(parser: Any) -> None:
    """Reproduce the paper: its tables and Figure 1 from this package's own runs, each number beside the paper's, in one
    folder with an index.md to read. It takes less than a minute.

      table4      errors of PSO, DE, HDE and MDE on four functions; whether MDE is ahead; times
      figure1     their convergence
      table7      J of ten identifications on the sample bag     table8      the parameters
      threshold   the sweep of the threshold, which the paper mentions
      operator    its operator drawn per component against per vector
      dimensions  beyond the paper: 2, 10 and 30 dimensions, equal budgets, rank-sum tests

    The same seed gives the same files, byte for byte; only times.md and times.csv differ, which hold measured times. An
    interrupt keeps the finished parts.
    """
    parser.add_argument('--only', metavar='NAME[,NAME ...]', help='some of the above (default: all)')
    _number(parser, '--runs', 10, 'N', 'runs of a table; frequencies are counted over 10 N runs, the sweep takes 5 N')
    _number(parser, '--seed', 1, 'SEED', 'of all random numbers')
    _path(parser, '--output', 'DIR', 'a new folder (default %(default)s)', default=Path('reproduction'))
    _force(parser, 'files in a folder that is not empty')


def _demo(parser: Any) -> None:
    """Run the complete job on the virtual rig: a virtual board on a pseudo-terminal, the bridge, the exciter and the
    recorder in processes of their own; then the identifier on the recorded bag; then a subscriber that joins late and
    receives the parameters. Needs ROS 2 (rclpy). Whatever ROS_DOMAIN_ID and the like say, it uses an empty ROS domain
    on this computer alone, and reaches no real rig.
    """
    _path(parser, '--output', 'DIR', 'new folder for bag and result (default: a temporary one)')
    _switch(parser, '--balance', 'instead: identify another virtual rig, swing it up, balance it, and draw that')


def _studio(parser: Any) -> None:
    """Open a page in the browser that leads from recordings to parameters. Where ROS is, it also shows the running rig,
    read-only. Only browsers on this computer that know the token in the address are answered, and nothing comes from a
    network. Files stay in a private folder, which is deleted with the page or with the studio.

    Examples:
      pendubot studio swing run.csv       with recordings
    """
    parser.add_argument('files', nargs='*', metavar='BAG', help='recordings to begin with')
    _number(parser, '--port', 0, 'PORT', 'of the address; 0: any free one')
    _switch(parser, '--no-browser', 'only print the address')


def _completion(parser: Any) -> None:
    """Print a script with which a shell completes subcommands, options, their choices and the names of files
    (pip install shtab). Make it again after an update.

      bash   pendubot completion bash > ~/.local/share/bash-completion/completions/pendubot
      zsh    pendubot completion zsh > ~/.zfunc/_pendubot     with fpath+=~/.zfunc before compinit in ~/.zshrc
      fish   pendubot completion fish > ~/.config/fish/completions/pendubot.fish
    """
    default, words = Path(os.environ.get('SHELL') or 'bash').name, 'which one (default: that of $SHELL)'
    parser.add_argument('shell', nargs='?', choices=('bash', 'zsh', 'fish'), default=default, help=words)


def _help(parser: Any) -> None:
    """Describe pendubot or one of its subcommands."""
    parser.add_argument('command', nargs='?', metavar='SUBCOMMAND', help='such as identify')
