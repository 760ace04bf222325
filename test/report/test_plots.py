# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Plots and figures: their numbers, and small files for long recordings."""

import functools
import json
import math
from dataclasses import replace

import hypothesis.extra.numpy as arrays
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.criteria.prediction_error import STEP
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.settings import Settings
from pendubot_identification.level import NORMAL_95
from pendubot_identification.model.rollout import roll
from pendubot_identification.report import plots
from pendubot_identification.report.time_plot import Line, TimePlot, panel, thinned
from pendubot_identification.results.computation import assemble_result
from pendubot_identification.trajectories.trajectory import Trajectory
from test.identified import SOURCE, made, plain, swing
from test.identified import result as typed
from test.virtual import recording


def motion(samples=300, interval=0.01, name='swing', start=0.0):
    t = start + np.arange(samples) * interval
    q = np.column_stack([np.sin(t), np.cos(3 * t)])
    return Trajectory(t, q, np.column_stack([np.sign(np.sin(9 * t)), 0 * t]), name=name)


def pictures(result, training, validation=()):
    groups = plots.Prepared.of(result, training, validation).pictures()
    return {picture.name: picture for _, draw in groups for picture in draw()}


@functools.cache
def every_picture():
    """Return the pictures of a result by MDE with its recordings."""
    result = made(optimizer='mde', criteria=('energy',))
    return list(pictures(result, [swing()[:400]], [swing()[400:800]]).values())


def lines(picture):
    """Return the drawn values, with five digits: for each panel an array with a row for each line."""
    return [np.array([line['y'] for line in panel['lines']], dtype=float) for panel in picture.content.panels]


def test_innovations_are_white_with_unit_variance():
    result = made()
    drawn = pictures(result, [swing()[:400]])
    (innovations,) = drawn['residuals_likelihood'].content.panels
    assert innovations['label'] == '[standard deviations]'
    np.testing.assert_allclose(np.diff(innovations['t']), 0.05, rtol=1e-3)
    np.testing.assert_allclose((lines(drawn['residuals_likelihood'])[0] ** 2).mean(axis=1), 1, atol=0.35)
    correlation, _ = drawn['whiteness_likelihood'].content.axes
    band = NORMAL_95 / math.sqrt(len(innovations['t']))
    assert all((np.abs(curve.get_ydata()[1:]) < 1.5 * band).mean() > 0.85 for curve in correlation.lines)


def test_residuals_agree_with_J_on_the_motion_that_each_criterion_reads():
    """Of a rig with wrong zeros and a constant torque, which only likelihood estimates."""
    exact = recording()
    motion = replace(exact, q=exact.q + np.radians([0.6, -0.4]), tau=exact.tau - [0.01, 0])
    result = assemble_result(identify([motion], [], Settings(('weak', 'likelihood'), 'viscous')), [SOURCE])
    assert [(effect.name, effect.accepted) for effect in result.effects] == [('offset', True)]
    drawn = pictures(result, [motion])
    for criterion in ('energy', 'weak'):
        (found,), J = lines(drawn[f'residuals_{criterion}']), result.criteria[criterion].J
        assert found.size == J.residuals
        np.testing.assert_allclose((found**2).mean(), J.training, rtol=1e-4)
    (innovations,), torques = lines(drawn['residuals_likelihood']), lines(drawn['torque_left'])
    assert (np.abs(innovations.mean(axis=1)) < 0.4).all()
    # With the errors of the zeros, 0.002 N m of the shoulder.
    assert all(np.sqrt((torque**2).mean()) < 3e-4 for torque in torques)


def test_the_simulation_is_a_rollout_from_measured_states_with_the_recorded_torque():
    result = made()
    prepared = plots.Prepared.of(result, [swing()[:400]], [swing()[400:800]])
    (picture,) = prepared.simulation()
    assert picture.about == {'validation': True, 'ahead': 1.0, 'part': ''}
    t, steps = np.array(picture.content.panels[0]['t']), round(1 / STEP)
    states = prepared.validating[0].states(t)
    tau, change = prepared.validating[0].torques(t - result.effort.delay)
    begins = np.arange(0, states.shape[1] - 1, steps)
    torques, changes = (np.stack([each[b : b + steps].T for b in begins], axis=2) for each in (tau, change))
    expected = roll(result.theta.vector(), states[:, begins], torques, STEP, changes)
    for k, (measured, simulated, dots) in enumerate(lines(picture)[:4]):
        np.testing.assert_allclose(measured, states[k], atol=1e-3)
        assert np.flatnonzero(np.isfinite(dots)).tolist() == begins.tolist()
        for n, begin in enumerate(begins):
            shown = simulated[begin : begin + steps - 1]
            np.testing.assert_allclose(shown, expected[: steps - 1, k, n], atol=1e-3)
            errors = lines(picture)[4 + k // 2][k % 2][begin : begin + steps - 1]
            np.testing.assert_allclose(errors, shown - states[k, begin : begin + steps - 1], atol=1e-3)


def test_the_part_of_long_recordings_with_the_largest_error_is_shown():
    good = recording(4000, name='b')
    # For 2 s the recorded torque differs from the acting torque.
    tau = good.tau + np.outer((good.t > 25) & (good.t < 27), [0.05, 0.0])
    first = recording(800, seed=2, name='a')
    (picture,) = plots.Prepared.of(made(), [first, replace(good, tau=tau)], []).simulation()
    assert picture.about == {'validation': False, 'ahead': 1.0, 'part': 'b'}
    t = np.array(picture.content.panels[0]['t']) - first.t[-1]
    assert t[0] < 25 < 27 < t[-1] <= t[0] + plots.SHOWN


def test_a_recording_that_is_too_short_for_a_simulation_is_named():
    result = made()
    late = replace(result, effort=replace(result.effort, delay=0.25))
    short = replace(swing()[400:451], name='short')
    with pytest.raises(TrajectoryError, match='short: it is too short for a simulation with a delay of'):
        plots.Prepared.of(late, [swing()[:400]], [short]).simulation()


@pytest.mark.filterwarnings('error')
def test_a_diverging_simulation_is_drawn_while_finite_and_gives_no_warning():
    result = plain()
    for parameters in (result['parameters'], result['criteria'][result['criterion']]['parameters']):
        parameters['b1']['value'] = parameters['b2']['value'] = -10.0
    (picture,) = plots.Prepared.of(typed(result), [swing()[:400]], []).simulation()
    assert np.isnan(lines(picture)[0][1]).sum() > 10
    svg = picture.files('svg')['svg']
    assert b'inf' not in svg
    assert b'nan' not in svg


@given(arrays.arrays(float, st.tuples(st.integers(1, 400), st.integers(1, 3)), elements=st.floats(-1e6, 1e6)))
def test_thinned_lines_keep_their_extremes(values):
    kept = thinned(values, 40)
    assert len(kept) <= max(40, 6 * values.shape[1]) or len(values) <= 40
    assert (np.diff(kept) > 0).all()
    np.testing.assert_array_equal(np.ptp(values[kept], axis=0), np.ptp(values, axis=0))


def test_a_long_recording_at_1_kHz_gives_small_files():
    long = motion(400_000, 0.001)
    plot = TimePlot([panel('q', 'rad', [long.t], [Line('', [q], 'red') for q in long.q.T])])
    picture = plots.Picture('long', plot)
    assert all(len(content) < 400_000 for content in picture.files('svg', 'png').values())
    assert len(json.dumps(plot._asdict())) < 150_000


def test_parts_of_one_bag_share_its_time_axis_and_other_bags_follow_after_a_gap():
    parts = [motion(name='a@0:3'), motion(name='b'), motion(name='a@3:', start=3.0)]
    drawn = pictures(made(('weak',)), parts[:2], parts[2:])
    for name in ('recordings', 'simulation', 'torque_left', 'residuals_weak'):
        marks = [span.begin for span in drawn[name].content.spans if span.begin == span.end]
        assert marks == [pytest.approx(5.99)], name
    within = [(s.begin, s.end) for s in drawn['recordings'].content.spans if s.label]
    assert within == [(0, 2.99), (pytest.approx(5.99), pytest.approx(8.98)), (3, 5.99)]
    assert drawn['recordings'].about['recordings'] == ['a', 'b']
    t, ((q1,), *_) = drawn['recordings'].content.panels[1]['t'], lines(drawn['recordings'])[1:]
    assert (np.diff(t) > 0).all()
    assert np.isnan(q1).sum() == 2
