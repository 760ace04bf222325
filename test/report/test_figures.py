# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Figures: the same arrays, the same bytes; long recordings, small files; nothing is lost that can be seen."""

import functools
import json
from xml.etree import ElementTree

import hypothesis.extra.numpy as arrays
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.identify.result import Given, Parameter
from pendubot_identification.report import figures, time_plot
from pendubot_identification.results.figure_data import Excitation, Residuals, Simulation, UnexplainedTorque
from pendubot_identification.trajectories.trajectory import Trajectory
from test.identified import made, plain
from test.identified import result as typed


def motion(samples=300, interval=0.01, name='swing', start=0.0):
    t = start + np.arange(samples) * interval
    q = np.column_stack([np.sin(t), np.cos(3 * t)])
    return Trajectory(t, q, np.column_stack([np.sign(np.sin(9 * t)), 0 * t]), name=name)


def simulation(**changes):
    m = motion()
    t = np.arange(3) + np.linspace(0, 1, 50)[:, None]
    values = {'name': 'swing', 't': m.t, 'measured': np.vstack([m.q.T, m.q.T]), 'ahead': 1.0, 'simulated_t': t}
    values |= {'simulated': np.zeros((50, 4, 3)), 'complete': True}
    return Simulation(**values | changes)


def left(samples=300, interval=0.01, overlap=0.3, channels=3):
    t = np.arange(samples) * interval
    values = np.sin(t[:, None] * np.arange(1, channels + 1))
    lags = np.arange(100) * interval
    names = tuple('abcd'[:channels])
    flat = np.ones((100, channels))
    return Residuals('weak', 'N m', names, ((t, values), (t, values)), interval, overlap, lags, flat, 0.1)


def unexplained_torque():
    t = 0.02 * np.arange(200)
    torque = np.column_stack([np.sin(7 * t), np.zeros_like(t)])
    seen = {'its angle [rad]': np.concatenate([torque, torque]), 'its speed [rad/s]': np.zeros((400, 2))}
    return UnexplainedTorque(('a', 'b'), (0.0, -0.15), (t, t), (torque, torque), np.full(2, 0.1), seen)


@functools.cache
def every_picture():
    result = made(optimizer='mde', criteria=('energy',))
    energy = result.criteria['energy']
    by_hand = Given(parameters={'P1': Parameter(value=0.0022), 'Fc1': Parameter(value=0.1)})
    return [
        figures.draw_recordings([motion()], [motion(start=3.0)]),
        figures.draw_simulation(simulation(), validation=True),
        *figures.draw_residuals(left()),
        *figures.draw_unexplained_torque(unexplained_torque()),
        figures.draw_convergence('energy', energy.J.least_squares, energy.convergence),
        figures.draw_parameters(result, (by_hand, 'by hand')),
        figures.draw_correlation(result),
        figures.draw_excitation(list(result.parameters), Excitation(np.ones((7, 3)), np.ones((7, 3)), np.ones(3))),
    ]


def test_each_is_a_whole_SVG_and_PNG_with_nothing_from_elsewhere():
    for picture in every_picture():
        root = ElementTree.fromstring(picture.svg)
        assert root.tag.endswith('svg')
        assert (f'{picture.size[0]}pt', f'{picture.size[1]}pt') == (root.get('width'), root.get('height'))
        assert picture.png.startswith(b'\x89PNG')
        links = {value for e in root.iter() for key, value in e.attrib.items() if key.endswith('href')}
        assert all(link.startswith(('#', 'data:')) for link in links)


@given(arrays.arrays(float, st.integers(0, 500), elements=st.floats(-1e6, 1e6)), st.integers(1, 60))
def test_an_envelope_keeps_what_can_be_seen(y, pairs):
    t = np.arange(float(len(y)))
    kept_t, kept_y = time_plot.envelope(t, y, 2 * pairs)
    assert len(kept_t) <= max(2 * pairs, 0)
    assert (np.diff(kept_t) >= 0).all()
    assert (y[kept_t.astype(int)] == kept_y).all(), 'points of the line itself'
    if len(y):
        assert (kept_y.min(), kept_y.max()) == (y.min(), y.max())


def test_an_hour_at_1_kHz_makes_small_figures():
    hour = motion(3_600_000, 0.001)
    for picture in (figures.draw_recordings([hour], []), *figures.draw_residuals(left(3_600_000, 0.001, channels=1))):
        assert len(picture.svg) < 400_000
        assert len(picture.png) < 400_000
        assert picture.plot is None or len(json.dumps(picture.plot.data())) < 150_000


def test_recordings_of_one_bag_share_its_time_and_others_stand_behind_it():
    parts = [motion(name='a@0:3'), motion(name='b'), motion(name='a@3:', start=3.0)]
    at = figures.timeline(parts)
    assert at.shift == {'a': 0.0, 'b': pytest.approx(5.99)}
    plot = figures.draw_recordings(parts[:2], parts[2:]).plot
    others = [
        figures.draw_simulation(simulation(), at, validation=True),
        figures.draw_unexplained_torque(unexplained_torque(), at)[0],
    ]
    assert all(each.boundaries == [0.0, pytest.approx(5.99)] for each in (plot, *(other.plot for other in others)))
    assert figures.timeline(parts[::2]).begins == ()
    assert [(s.begin, s.end) for s in plot.spans] == [(0, 2.99), (pytest.approx(5.99), pytest.approx(8.98)), (3, 5.99)]


def test_simulations_that_are_lost_are_drawn_as_far_as_they_go():
    states = np.zeros((50, 4, 3))
    states[25:] = np.nan
    states[20:25] = 1e300
    picture = figures.draw_simulation(simulation(simulated=states), validation=True)
    assert 'inf' not in picture.svg
    assert 'nan' not in picture.svg


def test_no_correlations_where_everything_lies_on_a_bound():
    result = plain()
    result['criteria'][result['criterion']]['correlation'] = [[None] * 7] * 7
    assert figures.draw_correlation(typed(result)) is None


def test_pieces_are_one_line_with_gaps_where_time_always_ascends():
    """Also where a piece begins when the one before it ends, or is longer than what is shown of it."""
    t = np.linspace(0, 1, 5000)
    joined_t, y = time_plot.joined([(t, np.sin(9 * t)), (t + 1, t), (np.array([]), np.array([]))], 400)
    assert (np.diff(joined_t) > 0).all()
    assert np.isnan(y).sum() == 1
    assert len(y) <= 402
    assert time_plot.joined([])[0].shape == (0,)


@pytest.mark.parametrize(('largest', 'label'), [(3e-5, 'a [10⁻⁵ kg m²]'), (0.02, 'a [kg m²]'), (0.0, 'a [kg m²]')])
def test_small_values_are_shown_in_powers_of_ten_that_their_label_says(largest, label):
    """A band has both its edges."""
    t = np.arange(3.0)
    edge = [(t, np.full(3, largest / 3))]
    lines = [time_plot.Line('a', edge, 'red', style='band', upper=[(t, np.full(3, largest))])]
    plot = time_plot.TimePlot([time_plot.Panel('a', 'kg m^2', lines)])
    (panel,) = plot.data()['panels']
    assert panel['label'] == label
    power = 1e-5 if largest == 3e-5 else 1
    assert [panel['lines'][0][key][0] for key in ('y', 'upper')] == pytest.approx(
        [largest / 3 / power, largest / power], rel=1e-5
    )
    _, axes = figures._panels(2, 1)
    plot.draw(axes)
    assert axes[0].get_ylabel() == label
    assert len(axes[0].collections) == 1
