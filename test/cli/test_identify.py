# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The subcommand identify: output, files and exit status."""

import json
import os

import numpy as np
import pytest
import yaml

from pendubot_identification.model.parameters import NAMES, PAPER
from test.cli.conftest import FAST
from test.processes import small_disk

SEVEN = NAMES[:7]
WEAK = ('--criterion', 'weak', '--model', 'viscous', '--optimizer', 'lsq', '--hold', 'zero')


def test_mde_and_the_energy_criterion_reproduce_the_papers_method(inputs):
    """Each of ten runs of MDE reaches the exact minimum of the 1800 samples."""
    result = yaml.safe_load((inputs / 'result.yaml').read_text())
    assert (result['criterion'], result['model'], list(result['criteria'])) == ('energy', 'viscous', ['energy'])
    assert [b['samples'] for b in result['bags']] == [900, 900]
    mde = {'runs': 10, 'population': 30, 'generations': 4000, 'per_component': True, 'spread': 1e-9}
    assert result['criteria']['energy']['mde'] == mde
    assert max(result['J']['training_runs']) <= result['J']['least_squares'] * (1 + 1e-6)
    np.testing.assert_allclose(result['parameters']['P4']['value'], PAPER.P4, rtol=0.1)


def test_by_default_the_likelihood_is_selected_and_the_papers_estimate_is_kept(run, inputs, tmp_path):
    output = tmp_path / 'result.yaml'
    status, out, err = run('identify', inputs / 'swing', '--output', output)
    assert (status, err) == (0, ''), 'no progress without a terminal'
    result = yaml.safe_load(output.read_text())
    assert list(result['criteria']) == ['energy', 'likelihood']
    assert (result['criterion'], result['model'], result['level']) == ('likelihood', 'viscous', 'OK')
    theta = [result['parameters'][name]['value'] for name in SEVEN]
    np.testing.assert_allclose(theta, PAPER.vector(), rtol=0.02)
    papers = yaml.safe_load((inputs / 'result.yaml').read_text())['parameters']
    assert result['criteria']['energy']['parameters'] == papers, 'a second criterion must not change the first'
    assert all(f'\n{name} [' in out for name in SEVEN)
    assert out.rstrip().endswith(f'written to {output}')


def test_options_come_from_the_line_and_a_settings_file_and_json_prints_the_result_alone(run, inputs, tmp_path):
    """The line takes precedence; the file may have names with _ or - and values of any YAML type."""
    lab = {'hold': 'zero', 'smoothing': 0.03, 'runs': 3, 'generations': '400', 'per-vector': True, 'sliding': 0.3}
    (tmp_path / 'lab.yaml').write_text(yaml.safe_dump(lab))
    options = {'criterion': 'weak,energy', 'hold': 'linear', 'delay': '-0.02:0.004', 'link-length': 0.3, 'seed': 4}
    options |= {'link-mass': 0.3, 'model': 'viscous', 'settings': tmp_path / 'lab.yaml'}
    words = [f'--{name}={value}' for name, value in options.items()]
    command = ('identify', inputs / 'swing', *words, '--bounds', 'P1=0:0.5', '--bounds=P2=0:0.25', '--json')
    status, out, err = run(*command)
    assert (status, err) == (0, '')
    result = json.loads(out)
    used = {'criteria': ['weak', 'energy'], 'hold': 'linear', 'delays': [-0.02, 0.004], 'link_length': 0.3, 'seed': 4}
    used |= {'model': 'viscous', 'smoothing': 0.03, 'sliding_window': 0.3, 'optimizer': 'auto', 'start': None}
    used |= {'link_mass': 0.3}
    assert result['made_by'].items() >= used.items()
    assert result['made_by']['upper_bounds'][:2] == [0.5, 0.25]
    mde = {'runs': 3, 'generations': 400, 'per_component': False}
    assert result['criteria']['energy']['mde'].items() >= mde.items()
    assert any('as on a link 1 of 0.03' in warning for warning in result['warnings'])
    assert run(*command)[1] == out, 'the same seed must give the same result'
    assert run(*command, '--fail-on', 'warn')[0] == 3


def test_an_interval_in_a_settings_file_is_no_number_of_base_60(run, inputs, tmp_path):
    (tmp_path / 'lab.yaml').write_text('delay: 0:0.02\n')
    command = ('identify', f'{inputs / "swing"}@0:4', *WEAK, '--settings', tmp_path / 'lab.yaml', '--json')
    assert json.loads(run(*command)[1])['made_by']['delays'] == [0.0, 0.02]


@pytest.mark.parametrize(('criterion', 'tolerance'), [('energy', 1e-4), ('weak', 0.05), ('likelihood', 1e-3)])
def test_a_parameter_is_fixed_at_a_value_and_the_others_are_optimal(run, inputs, criterion, tolerance):
    """Parameters fixed at their optimum do not change the others, except through the weights of weak."""
    command = ('identify', f'{inputs / "swing"}@0:4', '--criterion', criterion, '--model', 'viscous', '--hold', 'zero')
    command += ('--json',) if criterion == 'energy' else ('--json', '--delay', '0')

    def identified(*options):
        return json.loads(run(*command, *options)[1])

    best = {name: entry['value'] for name, entry in identified('--optimizer', 'lsq')['parameters'].items()}
    start = ('--start', inputs / 'result.yaml') if criterion == 'likelihood' else ()
    fixed = identified('--fix', f'P3={best["P3"]!r}', '--fix', f'b2={best["b2"]!r}', *start)
    for name, entry in fixed['parameters'].items():
        assert entry['fixed'] == (name in ('P3', 'b2'))
        assert entry['value'] == pytest.approx(best[name], rel=1e-12 if entry['fixed'] else tolerance)
        assert (entry['std_error'] == 0, entry['on_bound']) == (entry['fixed'], False)
    if start:
        papers = yaml.safe_load((inputs / 'result.yaml').read_text())['parameters']
        assert fixed['made_by']['start'][:7] == [papers[name]['value'] for name in SEVEN]


def test_a_fault_is_named_with_a_remedy_and_the_result_is_still_written(run, inputs, tmp_path):
    output = tmp_path / 'result.yaml'
    command = ('identify', inputs / 'swing', *WEAK, '--negate', 'tau1,tau2')
    status, out, err = run(*command, '--output', output)
    assert (status, err) == (3, '')
    data = yaml.safe_load(output.read_text())
    (fault,), (warning,) = data['faults'], data['warnings']
    assert fault['found'].endswith('the effort has the wrong sign')
    assert fault['found'] in warning
    assert fault['remedy'] in warning
    assert data['level'] == 'ERROR'
    # The terminal shows one fault, and the number of its consequences.
    assert f'ERROR: {" ".join(warning.split())}' in ' '.join(out.split())
    assert data['consequences']
    assert 'more follow from that' in out
    assert run(*command, '--fail-on', 'never')[0] == 0


@pytest.mark.parametrize(
    ('arguments', 'training', 'validation'),
    [
        (['sim'], [900], [900]),
        (['sim@5:9'], [400], [500, 900]),
        (['sim@:9', '--validate', 'sim@12:'], [900], [600]),
        (['sim@0:6', 'sim@12:'], [600, 600], [600]),
        (['sim', 'sim'], [1800, 1800], []),
        (['sim@3:', 'sim@3:9'], [1500, 600], [300]),
    ],
)
def test_windows_divide_a_bag_as_documented(run, in_inputs, arguments, training, validation):
    status, out, _ = run('identify', *arguments, '--json', *FAST)
    assert status == 0
    result = json.loads(out)
    used = {role: [b['samples'] for b in result['bags'] if b['role'] == role] for role in ('training', 'validation')}
    assert used == {'training': training, 'validation': validation}
    twice = sum(training + validation) > 1800
    assert any('share samples: they count twice' in warning for warning in result['warnings']) == twice


def test_a_remainder_too_short_for_validation_causes_no_failure(run, tmp_path):
    """0.2 s at 500 Hz are shorter than the support of a test function."""
    fast = tmp_path / 'fast'
    assert run('simulate', '--output', fast, '--rate', '500', '--samples', '3000')[0] == 0
    for window, rest in (('0.2:4', [f'{fast}@4:']), ('0.2:5.8', [])):
        status, out, _ = run('identify', f'{fast}@{window}', *WEAK, '--delay', '0', '--json')
        assert (status, [b['bag'] for b in json.loads(out)['bags']]) == (0, [f'{fast}@{window}', *rest])


def test_the_name_of_a_recording_may_be_no_text(run, in_inputs, tmp_path):
    """Archives of other systems have names in Latin-1."""
    bag = tmp_path / os.fsdecode(b'Versuch \xfc')
    bag.symlink_to(in_inputs / 'swing')
    status, _, err = run('identify', bag, *FAST, '--output', tmp_path / 'result.yaml')
    assert (status, err) == (0, '')
    assert run('export', tmp_path / 'result.yaml', '--format', 'yaml')[0] == 0
    assert '\\udcfc' in (tmp_path / 'result.yaml').read_text()


def test_a_result_that_cannot_be_written_is_still_printed(run, inputs, tmp_path):
    output = tmp_path / 'result.yaml'
    with small_disk(0):
        status, out, err = run('identify', inputs / 'swing', *FAST, '--output', output, '--json')
    assert (status, err) == (1, f'pendubot: {output} cannot be written (File too large); choose another folder\n')
    assert list(json.loads(out)['parameters']) == list(SEVEN)
    assert not list(tmp_path.iterdir())
