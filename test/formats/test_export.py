# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Exports, read back by their users: a C compiler, Octave, Python and ROS nodes."""

import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import yaml

from pendubot_identification.formats.export import FORMATS, export
from pendubot_identification.level import Level
from pendubot_identification.model.dynamics import forward_dynamics, mass_matrix
from pendubot_identification.model.parameters import MODELS, NAMES
from pendubot_identification.results.result import Parameter, PartialResult
from test.identified import SOURCE, identified, made
from test.test_config import started


@pytest.fixture(scope='module')
def result():
    return made(('weak',))


@pytest.fixture(scope='module')
def theta():
    return identified(('weak',)).best.theta


def written(name, result):
    return export(result, name)[0]


def evaluated(script):
    """Return the fields of a MATLAB script's struct, each a list of names or numbers."""
    fields = re.findall(r'^pendubot\.(\w+) = (.*?);', script.partition('% The model')[0], re.MULTILINE)
    return {name: re.findall("'(.*?)'", value) or [*map(float, value.strip('[]').split())] for name, value in fields}


@pytest.mark.ros
def test_a_ros_node_of_any_name_loads_the_parameter_file(result, theta, tmp_path):
    path = tmp_path / 'parameters.yaml'
    path.write_text(written('yaml', result))
    with started('some_controller', '/', path) as node:
        read = [node.declare_parameter(name, 0.0).value for name in NAMES[:7]]
    np.testing.assert_array_equal(read, theta)


@pytest.mark.parametrize('name', FORMATS)
def test_every_format_contains_units_level_warnings_and_provenance(result, name):
    warned = replace(
        result, level=Level.WARN, warnings=['poorly determined: the standard error of b2'], not_covered={'b2': 'so'}
    )
    text = written(name, warned)
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


@pytest.mark.parametrize(
    ('delay', 'remark'), [(3e-7, 'none'), (0.001, 'left out'), (0.003, 'motor'), (-0.003, 'left out')]
)
def test_a_significant_delay_is_exported_to_mujoco_or_mentioned(result, delay, remark):
    late = replace(result, effort=replace(result.effort, delay=delay))
    text, sentence = written('mjcf', late), 'this model does not contain the input delay'
    assert (f'the input delay of {delay:g} s' in text) == ('input delay' in text) == (remark != 'none')
    assert ('delay="0.003" nsample="3"' in text) == ('the motor has the input delay' in text) == (remark == 'motor')
    assert (sentence in text) == (remark == 'left out')
    assert (sentence in written('urdf', late)) == (remark != 'none')


def test_every_digit_is_exported_omitted_parameters_are_0_and_the_order_is_that_of_theta():
    size, omitted = 14, {'Fs2', 'k2'}
    theta = {name: 0.5 + k / 7 for k, name in enumerate(NAMES[:size])} | dict.fromkeys(omitted, 0.0)
    given = {
        name: Parameter(value=value, std_error=value / 300)
        for name, value in reversed(theta.items())
        if name not in omitted
    }
    result = PartialResult(parameters=given)
    struct = evaluated(written('m', result))
    assert (struct['theta'], struct['names']) == (list(theta.values()), list(theta))
    np.testing.assert_array_equal(np.ravel([struct[name] for name in theta]), list(theta.values()))
    np.testing.assert_array_equal(struct['std_error'], [value / 300 or np.nan for value in theta.values()])
    assert yaml.safe_load(written('yaml', result))['/**']['ros__parameters'] == theta
    header = written('h', result)
    macros = dict(re.findall(r'#define PENDUBOT_(\w+) \((.*?)\)', header))
    assert f'#define PENDUBOT_COUNT {size}\n' in header
    (names,) = re.findall(r'#define PENDUBOT_THETA {(.*)}', header)
    assert [float(macros[name.removeprefix('PENDUBOT_')]) for name in names.split(', ')] == list(theta.values())


MAIN = """
#include <stdio.h>
#include "pendubot.h"
int main(void) {
  double q[2], v[2], tau[2], M[2][2], h[2], f[2], a[2];
  while (scanf("%lf %lf %lf %lf %lf %lf", q, q + 1, v, v + 1, tau, tau + 1) == 6) {
    pendubot_mass_matrix(q, M); pendubot_bias(q, v, h); pendubot_friction(v, tau, f);
    pendubot_acceleration(q, v, tau, a);
    printf("%.17g %.17g %.17g %.17g ", M[0][0], M[0][1], M[1][0], M[1][1]);
    printf("%.17g %.17g %.17g %.17g %.17g %.17g\\n", h[0], h[1], f[0], f[1], a[0], a[1]);
  }
  return 0;
}
"""


def by_c(text, points, folder):
    (folder / 'pendubot.h').write_text(text)
    (folder / 'main.c').write_text(MAIN)
    flags = ['-std=c99', '-Wall', '-Wextra', '-pedantic', '-Werror']
    subprocess.run(['gcc', *flags, 'main.c', '-o', 'main', '-lm'], cwd=folder, check=True)
    given = '\n'.join(' '.join(map(repr, row)) for row in points.tolist())
    return subprocess.run([folder / 'main'], input=given, capture_output=True, text=True, check=True).stdout


def by_octave(text, points, folder):
    (folder / 'parameters_of_a_pendubot.m').write_text(text)
    rows = '; '.join(' '.join(map(repr, row)) for row in points.tolist())
    script = f"""parameters_of_a_pendubot;
for x = [{rows}]'
  q = x(1:2); v = x(3:4); tau = x(5:6); M = pendubot.mass_matrix(q)';
  d = pendubot.derivative(x(1:4), tau);
  assert(d(1:2), v);
  printf('%.17g ', M(:), pendubot.bias(q, v), pendubot.friction(v, tau), d(3:4)); printf('\\n');
end
"""
    command = ['octave', '--no-gui', '--norc', '--eval', script]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout


def by_python(text, points, folder):
    module, lines = {}, []
    exec(compile(text, 'pendubot.py', 'exec'), module)
    for row in points.tolist():
        q, v, tau = row[:2], row[2:4], row[4:]
        (a, b), (c, d) = module['mass_matrix'](q)
        found = a, b, c, d, *module['bias'](q, v), *module['friction'](v, tau), *module['acceleration'](q, v, tau)
        lines.append(' '.join(map(repr, found)))
    return '\n'.join(lines)


@pytest.mark.parametrize('model', MODELS)
@pytest.mark.parametrize(
    ('name', 'evaluate', 'needed'), [('h', by_c, 'gcc'), ('m', by_octave, 'octave'), ('py', by_python, 'python3')]
)
def test_exported_equations_agree_with_the_dynamics_in_every_language(name, evaluate, needed, model, tmp_path):
    if shutil.which(needed) is None:
        pytest.skip(f'needs {needed}')
    rng = np.random.default_rng(3)
    theta = (np.array([22, 4, 1, 224, 33, 66, 1, 50, 20, 3, 30, 10, 3000, 2000]) * 1e-4)[: MODELS[model]]
    values = {n: Parameter(value=float(v)) for n, v in zip(NAMES, theta, strict=False)}
    given = PartialResult(parameters=values, bags=[replace(SOURCE, bag='odd */ name /* of\na bag')])
    points = rng.normal(size=(20, 6)) * [3, 3, 0.3, 0.3, 1, 1]
    lines = evaluate(written(name, given), points, tmp_path).splitlines()
    frictionless = np.append(theta[:5], [0.0, 0.0, 0.0, 0.0, *theta[9:10]])
    for line, (q, v, tau) in zip(lines, points.reshape(-1, 3, 2), strict=True):
        M, h, f, a = np.split(np.array(line.split(), float), [4, 6, 8])
        exact = mass_matrix(theta, q)
        np.testing.assert_allclose(M.reshape(2, 2), exact, rtol=1e-12)
        np.testing.assert_allclose(a, forward_dynamics(theta, q, v, tau), rtol=1e-9)
        bias = -exact @ forward_dynamics(frictionless, q, v, [0, 0])
        np.testing.assert_allclose(h, bias, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(exact @ a, tau - h - f, rtol=1e-9, atol=1e-12)


def test_the_python_module_accepts_symbols():
    """The argument ``lib`` may be sympy, casadi or jax.numpy."""
    import sympy

    given = PartialResult(parameters={n: Parameter(value=0.5 - 0.05 * k) for k, n in enumerate(NAMES[:9])})
    exec(compile(written('py', given), 'pendubot.py', 'exec'), module := {})
    symbols = sympy.symbols('q1 q2 v1 v2 tau1 tau2')
    at = dict(zip(symbols, (0.3, -1.2, 0.01, -0.2, 0.4, 0.1), strict=True))
    q, v, tau = symbols[:2], symbols[2:4], symbols[4:]
    values = [float(a.subs(at)) for a in module['acceleration'](q, v, tau, sympy)]
    numbers = [at[s] for s in symbols]
    np.testing.assert_allclose(values, module['acceleration'](numbers[:2], numbers[2:4], numbers[4:]), rtol=1e-12)
