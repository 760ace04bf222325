# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Recognises the columns of a file by their names and units: in English, German, French, Spanish and Chinese."""

import re
import unicodedata

from pendubot_identification.trajectories.conventions import TIME_UNITS, TORQUE_UNITS

#: Usual names of each quantity, without units, accents, spaces, hyphens and underscores.
NAMES = {
    't': 't time times timestamp stamp sec seconds tout elapsed zeit zeitstempel sekunden temps tiempo 时间 時間',
    'q1': 'q1 theta1 th1 phi1 alpha shoulder shoulderangle angle1 angleshoulder pos1 position1 winkel1 schulter '
    'schulterwinkel winkelschulter epaule angleepaule hombro angulohombro angulo1 肩 肩关节 肩关节角度 肩角',
    'q2': 'q2 theta2 th2 phi2 beta elbow elbowangle angle2 angleelbow pos2 position2 winkel2 ellbogen ellbogenwinkel '
    'winkelellbogen ellenbogen ellenbogenwinkel winkelellenbogen coude anglecoude codo angulocodo angulo2 '
    '肘 肘关节 肘关节角度 肘角',
    'tau1': 'tau1 tau torque torque1 u u1 effort effort1 shouldertorque motortorque drehmoment drehmoment1 moment '
    'motormoment couple couple1 couplemoteur par parmotor 力矩 扭矩 转矩 电机力矩',
}
_QUANTITY = {name: quantity for quantity, names in NAMES.items() for name in names.split()}
#: Option and its value by unit, in lower case without spaces.
UNITS = {
    **{unit.lower(): ('time_unit', unit) for unit in TIME_UNITS},
    **{unit.lower(): ('torque_unit', unit) for unit in TORQUE_UNITS},
    **dict.fromkeys(('deg', 'degree', 'degrees', 'grad', '°', '度'), ('degrees', 'true')),
    **dict.fromkeys(('rad', 'radian', 'radians', '弧度'), ('degrees', 'false')),
    **dict.fromkeys(('sec', 'second', 'seconds', 'sekunden', '秒'), ('time_unit', 's')),
    **dict.fromkeys(('msec', 'millis', 'milliseconds'), ('time_unit', 'ms')),
    **dict.fromkeys(('µs', 'usec', 'micros', 'microseconds'), ('time_unit', 'us')),
}
CURRENT_UNITS = 'A', 'mA'
#: Names and units of a motor current, which is no torque.
_CURRENT = re.compile(
    r'i|i[1mq]|imotor|(motor)?(amps?|amperes?)|.*(current|strom|courant|corriente|intensite|intensidad|电流)\d?'
)


def split(column: str) -> tuple[str, str]:
    """Split a column's title such as q1 [deg], tau (mNm), t_ms or angle/deg into name and unit, perhaps empty."""
    match = re.fullmatch(r'(.*?)\s*[\[(]\s*([^\])]*)[\])]\s*|(.*\S)\s*[_/]\s*([^\W_]+|°)', column.strip())
    if match and match[1]:
        return match[1], match[2].strip()
    if match and match[3] and is_unit(match[4]):
        return match[3], match[4]
    return column.strip(), ''


def option_of(unit: str) -> tuple[str, str] | None:
    """Return the option and its value for a unit such as mN m or deg; None for an unknown unit."""
    return UNITS.get(re.sub(r'[\s*·]', '', unit.lower()))


def is_unit(word: str) -> bool:
    """Return whether a word is a known unit."""
    return option_of(word) is not None or word in CURRENT_UNITS


def quantity_of(column: str) -> str:
    """Return the quantity of a column by its usual name, or an empty text."""
    return _QUANTITY.get(_plain(split(column)[0]), '')


def is_current(column: str, unit: str = '') -> bool:
    """Return whether a column holds a motor current, by its name or unit."""
    name, suffix = split(column)
    return (unit or suffix or name) in CURRENT_UNITS or _CURRENT.fullmatch(_plain(name)) is not None


def _plain(name: str) -> str:
    return re.sub(r'[\s_\-.]|[\u0300-\u036f]', '', unicodedata.normalize('NFKD', name.lower()))
