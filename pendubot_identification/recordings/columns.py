# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Recognises the columns of a file by their names and units: in English, German, French, Spanish and Chinese."""

from __future__ import annotations

import re
import unicodedata

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
#: The option that reads a unit; an empty one needs none.
UNITS: dict[str, dict[str, str]] = {
    **{unit: {} for unit in ('s', 'sec', 'rad', 'nm', 'n m', 'n*m', 'n·m')},
    **{unit: {'time_unit': unit} for unit in ('ms', 'us', 'ns')},
    'µs': {'time_unit': 'us'},
    **{unit: {'degrees': 'true'} for unit in ('deg', 'degree', 'degrees', 'grad', '°')},
    **{unit: {'torque_unit': 'mNm'} for unit in ('mnm', 'mn m', 'mn·m')},
    **{unit: {'torque_unit': 'Ncm'} for unit in ('ncm', 'n cm')},
}
#: Names and units of a motor current, which is no torque.
_CURRENT = re.compile(r'i|i[1mq]|amps?|amperes?|.*(current|strom|courant|corriente|电流)\d?')


def split(column: str) -> tuple[str, str]:
    """Return the name of a column and its unit, empty if there is none: q1 [deg], tau (mNm), t_ms, angle/deg."""
    match = re.fullmatch(r'(.*?)\s*[\[(]\s*([^\])]*)[\])]\s*|(.*\S)\s*[_/]\s*([^\W_]+|°)', column.strip())
    if match and match[1]:
        return match[1], match[2].strip()
    if match and match[3] and (match[4].lower() in UNITS or match[4] in ('A', 'mA')):
        return match[3], match[4]
    return column.strip(), ''


def unit_of(word: str) -> str:
    """Return a unit as it is written, if it is one that is known; else an empty text."""
    return word if word.lower() in UNITS or word in ('A', 'mA') else ''


def quantity_of(column: str) -> str:
    """Return the quantity that a column holds by its usual name; empty if it has none."""
    plain = unicodedata.normalize('NFKD', split(column)[0].lower())
    return _QUANTITY.get(re.sub(r'[\s_\-.]|[\u0300-\u036f]', '', plain), '')


def is_current(column: str, unit: str = '') -> bool:
    """Tell whether a column holds a motor current, by its name or unit."""
    name, own = split(column)
    plain = re.sub(r'[\s_\-.]', '', name.lower())
    return (unit or own) in ('A', 'mA') or _CURRENT.fullmatch(plain) is not None
