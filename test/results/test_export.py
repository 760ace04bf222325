# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Exports, read back by whoever would use them: a C compiler, MATLAB's syntax, JSON, ROS parameter files."""

import json
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import yaml

from pendubot_identification.identify.result import Given, Parameter, plain
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import NAMES
from pendubot_identification.results.export import FORMATS
from test.identified import identified, made


@pytest.fixture(scope='module')
def result():
    return made(('weak',))


@pytest.fixture(scope='module')
def theta():
    return identified(('weak',)).best.theta


def evaluated(script):
    """A script of assignments to fields of one struct, as MATLAB evaluates it; refuses anything else."""
    struct = {}
    for line in script.splitlines():
        code = line.split('%')[0].strip()
        if not code:
            continue
        name, value = re.fullmatch(r'pendubot\.([A-Za-z]\w*) = (.*);', code).groups()
        if value.startswith('{'):
            struct[name] = re.findall(r"'([^']*)'", value)
        elif value.startswith('['):
            struct[name] = [float(v) for v in value.strip('[]').split()]
        else:
            struct[name] = float(value)
    return struct


def test_matlab_makes_a_struct_with_every_digit(result, theta):
    struct = evaluated(FORMATS['matlab'](result))
    np.testing.assert_array_equal(struct['theta'], theta)
    np.testing.assert_array_equal([struct[name] for name in struct['names']], theta)
    assert tuple(struct['names']) == NAMES[:7]
    assert struct['std_error'] == [entry.std_error for entry in result.parameters.values()]


@pytest.mark.skipif(shutil.which('gcc') is None, reason='needs a C compiler')
@pytest.mark.parametrize('standard', ['-std=c89', '-std=c17'])
def test_c_compiles_without_a_warning_and_keeps_every_digit(result, theta, tmp_path, standard):
    result = replace(result, bags=[replace(result.bags[0], bag='odd */ name /* of\na bag')])
    (tmp_path / 'pendubot.h').write_text(FORMATS['c'](result))
    (tmp_path / 'main.c').write_text(
        '#include <stdio.h>\n#include "pendubot.h"\n#include "pendubot.h"\n'
        'int main(void) {\n  double theta[PENDUBOT_COUNT] = PENDUBOT_THETA;\n  int k;\n'
        '  for (k = 0; k < PENDUBOT_COUNT; ++k) printf("%.17g\\n", theta[k]);\n'
        '  return theta[0] == PENDUBOT_P1 ? 0 : 1;\n}\n'
    )
    flags = [standard, '-Wall', '-Wextra', '-pedantic', '-Werror']
    subprocess.run(['gcc', *flags, 'main.c', '-o', 'main'], cwd=tmp_path, check=True)
    run = subprocess.run([tmp_path / 'main'], capture_output=True, text=True, check=True)
    np.testing.assert_array_equal([float(line) for line in run.stdout.split()], theta)


def test_json_is_the_whole_result(result):
    assert json.loads(FORMATS['json'](result)) == plain(result)


def test_yaml_holds_the_parameters_of_a_node(result, theta):
    parameters = yaml.safe_load(FORMATS['yaml'](result))['/**']['ros__parameters']
    assert list(parameters) == list(NAMES[:7])
    np.testing.assert_array_equal(list(parameters.values()), theta)


@pytest.mark.ros
def test_a_node_of_any_name_loads_the_yaml(result, theta, tmp_path):
    import rclpy
    from rclpy.node import Node

    path = tmp_path / 'parameters.yaml'
    path.write_text(FORMATS['yaml'](result))
    context = rclpy.Context()
    rclpy.init(context=context)
    node = Node('some_controller', context=context, cli_args=['--ros-args', '--params-file', str(path)])
    try:
        read = [node.declare_parameter(name, 0.0).value for name in NAMES[:7]]
    finally:
        node.destroy_node()
        context.try_shutdown()
    np.testing.assert_array_equal(read, theta)


@pytest.mark.parametrize('name', ['yaml', 'matlab', 'c'])
def test_units_level_warnings_and_provenance_stand_in_it(result, name):
    doubtful = replace(
        result, level=Level.WARN, warnings=['poorly determined: the standard error of b2'], not_covered={'b2': 'so'}
    )
    text = FORMATS[name](doubtful)
    for expected in (
        'b2 is not covered by the level: so',
        'kg m^2',
        'N m s/rad',
        'level: WARN',
        'warning: poorly determined',
        'criterion weak',
        'swing@0:4',
    ):
        assert expected in text


@pytest.mark.parametrize('name', [name for name in FORMATS if name != 'json'])
def test_a_file_by_hand_with_nothing_but_values_is_enough(name):
    text = FORMATS[name](Given(parameters={n: Parameter(value=0.5) for n in NAMES[:7]}))
    assert '0.5' in text
    assert 'not known' in text


def test_what_a_hand_left_out_is_0_in_its_own_place():
    """Whatever the order in which the hand wrote."""
    size, left_out = 14, {'Fs2', 'k2'}
    theta = {name: 0.5 + k for k, name in enumerate(NAMES[:size])} | dict.fromkeys(left_out, 0.0)
    given = {name: Parameter(value=value) for name, value in reversed(theta.items()) if name not in left_out}
    result = Given(parameters=given)
    struct = evaluated(FORMATS['matlab'](result))
    assert (struct['theta'], struct['names']) == (list(theta.values()), list(theta))
    assert yaml.safe_load(FORMATS['yaml'](result))['/**']['ros__parameters'] == theta
    header = FORMATS['c'](result)
    macros = dict(re.findall(r'#define PENDUBOT_(\w+) \((.*?)\)', header))
    assert f'#define PENDUBOT_COUNT {size}\n' in header
    (names,) = re.findall(r'#define PENDUBOT_THETA {(.*)}', header)
    assert [float(macros[name.removeprefix('PENDUBOT_')]) for name in names.split(', ')] == list(theta.values())
