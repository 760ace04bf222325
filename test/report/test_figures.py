# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Figures: the same arrays, the same bytes; long recordings, small files; nothing is lost that can be seen."""

import re
from xml.etree import ElementTree

import hypothesis.extra.numpy as arrays
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.identify.evidence import Excitation, Residuals, Simulation
from pendubot_identification.identify.result import Given, Parameter
from pendubot_identification.report import figures
from pendubot_identification.trajectories.trajectory import Trajectory
from test.identified import made, plain, result


def motion(samples=300, interval=0.01, name='swing', start=0.0):
    t = start + np.arange(samples) * interval
    q = np.column_stack([np.sin(t), np.cos(3 * t)])
    return Trajectory(t, q, np.column_stack([np.sign(np.sin(9 * t)), 0 * t]), name=name)


def simulation(**changes):
    m = motion()
    t = np.arange(3) + np.linspace(0, 1, 50)[:, None]
    values = {'name': 'swing', 't': m.t, 'measured': np.vstack([m.q.T, m.q.T]), 'ahead': 1.0, 'simulated_t': t}
    values |= {'simulated': np.zeros((50, 4, 3)), 'whole': True}
    return Simulation(**values | changes)


def left(samples=300, interval=0.01, shared=0.3, channels=3):
    t = np.arange(samples) * interval
    values = np.sin(t[:, None] * np.arange(1, channels + 1))
    lags = np.arange(100) * interval
    names = tuple('abcd'[:channels])
    flat = np.ones((100, channels))
    return Residuals('weak', 'N m', names, ((t, values), (t, values)), interval, shared, lags, flat, 0.1)


@pytest.fixture(scope='module')
def pictures():
    return list(every_picture())


def every_picture():
    found = made(optimizer='mde', criteria=('energy',))
    yield figures.draw_recordings([motion()], [motion(start=3.0)])
    yield figures.draw_simulation(simulation(), validation=True)
    yield figures.draw_residuals(left())
    yield figures.draw_convergence('energy', (energy := found.criteria['energy']).J, energy.convergence)
    yield figures.draw_parameters(found, made(), 'reference')
    yield figures.draw_correlation(found)
    yield figures.draw_excitation(list(found.parameters), Excitation(np.ones((7, 3)), np.ones((7, 3)), np.ones(3)))


def test_the_same_arrays_give_the_same_bytes(pictures):
    again = [figures.draw_recordings([motion()], [motion(start=3.0)]), figures.draw_residuals(left())]
    for picture in again:
        before = next(p for p in pictures if p.name == picture.name)
        assert (picture.svg, picture.png) == (before.svg, before.png)
    assert len({p.name for p in pictures}) == len(pictures)


def test_each_is_whole_and_says_what_good_looks_like(pictures):
    for picture in pictures:
        root = ElementTree.fromstring(picture.svg)
        assert root.tag.endswith('svg')
        assert picture.png.startswith(b'\x89PNG')
        assert re.search(r'\b[Gg]ood\b', picture.good), picture.name
        assert picture.good.count('. ') == 0, 'one sentence'
        assert 'one after the other' not in picture.shows, 'there is but one recording'
        links = {value for e in root.iter() for key, value in e.attrib.items() if key.endswith('href')}
        assert all(link.startswith(('#', 'data:')) for link in links), 'nothing from elsewhere'


@given(arrays.arrays(float, st.integers(0, 500), elements=st.floats(-1e6, 1e6)), st.integers(1, 60))
def test_an_envelope_keeps_what_can_be_seen(y, pairs):
    t = np.arange(float(len(y)))
    kept_t, kept_y = figures.envelope(t, y, 2 * pairs)
    assert len(kept_t) <= max(2 * pairs, 0)
    assert (np.diff(kept_t) >= 0).all()
    assert (y[kept_t.astype(int)] == kept_y).all(), 'points of the line itself'
    if len(y):
        assert (kept_y.min(), kept_y.max()) == (y.min(), y.max())


def test_an_hour_at_1_kHz_makes_small_figures():
    hour = motion(3_600_000, 0.001)
    for picture in (figures.draw_recordings([hour], []), figures.draw_residuals(left(3_600_000, 0.001, channels=1))):
        assert len(picture.svg) < 400_000
        assert len(picture.png) < 400_000


def test_the_windows_are_marked_where_they_are():
    """Recordings of one bag share its time; others stand behind it."""
    picture = figures.draw_recordings([motion(name='a@0:3'), motion(name='b')], [motion(name='a@3:6', start=3.0)])
    assert 'one after the other' in picture.shows
    assert figures._placed([motion(name='a@0:3'), motion(name='b'), motion(name='a@3:6', start=3.0)]) == [
        0.0,
        pytest.approx(5.99),
        0.0,
    ]


def test_without_validation_data_it_says_what_is_shown_instead():
    picture = figures.draw_simulation(simulation(), validation=False)
    assert 'There are no validation data' in picture.shows
    assert 'the very data that were fitted' in picture.shows
    assert 'over 1 s at a time' in picture.shows


def test_simulations_that_are_lost_are_drawn_as_far_as_they_go():
    states = np.zeros((50, 4, 3))
    states[25:] = np.nan
    states[20:25] = 1e300
    picture = figures.draw_simulation(simulation(simulated=states), validation=True)
    assert 'inf' not in picture.svg
    assert 'nan' not in picture.svg


def test_parameters_of_a_hand_written_reference_and_of_a_larger_model():
    by_hand = Given(parameters={'P1': Parameter(value=0.0022), 'Fc1': Parameter(value=0.1)})
    assert '; black: reference.' in figures.draw_parameters(made(), by_hand, 'reference').shows


def test_no_correlations_where_everything_lies_on_a_bound():
    data = plain()
    data['criteria'][data['criterion']]['correlation'] = [[None] * 7] * 7
    assert figures.draw_correlation(result(data)) is None
