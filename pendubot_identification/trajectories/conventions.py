# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The settings of the conversion of a recording: names, defaults and help, for the command line and ROS.

This module imports no numpy, so that ``--help`` is fast.
"""

import math
import re
from collections.abc import Mapping
from typing import Any

from pendubot_identification.errors import ParameterError
from pendubot_identification.setting import Setting, words

#: Required and optional columns of a motion.
REQUIRED = ('t', 'q1', 'q2', 'tau1')
OPTIONAL = ('tau2', 'dq1', 'dq2')
#: Default joint names of a bag.
JOINT_NAMES = ('shoulder', 'elbow')


def current_name(shoulder: str) -> str:
    """Return the name of the JointState entry whose effort is the measured motor current [A]."""
    return f'{shoulder}_current'


def _pairs(option: str, value: Any) -> dict[str, str]:
    """Return the pairs of ``q1=NAME,q2=NAME``, or raise ParameterError."""
    if isinstance(value, Mapping):
        return {str(name): str(text) for name, text in value.items()}
    named: dict[str, str] = {}
    example = 't=NAME,q1=NAME,...' if option == 'columns' else 'q1=0.1,tau1=0.05,...'
    # A column name may contain a comma.
    for part in words(value if isinstance(value, (list, tuple)) else re.split(r',(?=\s*\w+\s*=)', str(value))):
        name, _, text = (word.strip() for word in part.partition('='))
        if not (name and text) or name in named:
            raise ParameterError(f'--{option} {part!r} is not understood; {example} is expected, each once')
        named[name] = text
    return named


def _amount(name: str, text: str) -> float:
    number, degrees = text.removesuffix('deg'), text.endswith('deg') and name.startswith('q')
    try:
        amount = float(number if degrees else text)
    except ValueError:
        amount = math.nan
    if not math.isfinite(amount):
        raise ParameterError(f'--offset {name}={text} is not understood; a number is expected, such as q1=5deg')
    return math.radians(amount) if degrees else amount


#: Values of the units, in seconds and in N m.
TIME_UNITS = {'s': 1.0, 'ms': 1e-3, 'us': 1e-6, 'ns': 1e-9}
TORQUE_UNITS = {'Nm': 1.0, 'mNm': 1e-3, 'Ncm': 1e-2, 'kgfcm': 0.0980665, 'ozfin': 0.00706155}

TOPIC = Setting('topic', '/joint_states', 'topic of a bag')
JOINTS = Setting('joints', ','.join(JOINT_NAMES), 'joint names in a bag', read=lambda value: tuple(words(value)))
#: Options in the order of application; the first ones apply only to bags, or only to files with columns.
CONVERSION = (
    TOPIC,
    JOINTS,
    Setting(
        'columns',
        '',
        f'names of the columns in a file: t=NAME,q1=NAME,... for {", ".join(REQUIRED)} and, if present, '
        f'{", ".join(OPTIONAL)}',
        optional=True,
        read=lambda value: _pairs('columns', value),
    ),
    Setting('skip_rows', 0, 'lines above the column names of a text file or a sheet', '', 0, 100_000),
    Setting('sheet', '', 'name of the sheet of an Excel file; by default the first', optional=True),
    Setting('encoding', '', 'encoding of a text file; by default UTF-8, UTF-16, or else Windows-1252', optional=True),
    Setting('decimal', 'point', 'decimal separator of a text file', choices=('point', 'comma')),
    Setting('time_unit', 's', "the unit of a file's times, except of dates", choices=tuple(TIME_UNITS)),
    Setting('skip_missing', False, 'leave out samples with a missing or non-numeric value, and rows of another length'),
    Setting('unwrap', False, 'angles were wrapped into one turn; make them continuous'),
    Setting('degrees', False, 'angles are in degrees, velocities in degrees per second'),
    Setting('torque_unit', 'Nm', 'the unit of torques', choices=tuple(TORQUE_UNITS)),
    Setting(
        'swap',
        'nothing',
        'exchange the joints: positions and efforts, or one of these',
        choices=('nothing', 'joints', 'positions', 'efforts'),
    ),
    Setting(
        'torque_constant',
        0.0,
        "the shoulder's torque is this constant times a measured current [A]: in a bag, the effort of the entry "
        'SHOULDER_current; in a file with columns, tau1. hold gives the current between samples. With another '
        'torque_unit the constant is in that unit per ampere. By default, or with 0, the torque is the commanded '
        'effort',
        'N m/A',
        0.0,
        1e6,
        optional=True,
    ),
    Setting(
        'gear',
        1.0,
        'motor turns per turn of the shoulder; the torque constant of the motor is multiplied by this ratio',
        minimum=1e-3,
        maximum=1e4,
    ),
    Setting(
        'negate',
        '',
        'quantities to negate, of q1,q2,tau1,tau2; a velocity is negated with its angle',
        optional=True,
        read=lambda value: tuple(words(value)),
    ),
    Setting(
        'elbow',
        'relative',
        'whether q2 is the angle to link 1, or measured from the same zero as q1',
        choices=('relative', 'absolute'),
    ),
    Setting(
        'zero',
        'horizontal',
        'where q1 is zero: with link 1 horizontal, or hanging straight down',
        choices=('horizontal', 'hanging'),
    ),
    Setting(
        'offset',
        '',
        'subtracted last: q1=0.1,q2=5deg,tau1=0.05, in rad or deg, and in N m',
        optional=True,
        read=lambda value: {name: _amount(name, text) for name, text in _pairs('offset', value).items()},
    ),
)
OF_FILES = ('columns', 'skip_rows', 'sheet', 'encoding', 'decimal', 'time_unit')
