# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Plots and figures: the same arrays, the same bytes; long recordings, small files; every extreme is shown."""

import json
import math
from xml.etree import ElementTree

import hypothesis.extra.numpy as arrays
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.report import plots
from pendubot_identification.report.time_plot import Line, Panel, TimePlot, joined, thinned
from pendubot_identification.trajectories.trajectory import Trajectory
from test.identified import plain
from test.identified import result as typed
from test.report.pictures import every_picture, motion, residuals, simulation, unexplained_torque


def test_each_is_a_complete_SVG_and_PNG_with_nothing_from_elsewhere_and_always_the_same():
    for picture in every_picture():
        files = picture.files('svg', 'png')
        root = ElementTree.fromstring(files['svg'])
        assert root.tag.endswith('svg')
        assert files['png'].startswith(b'\x89PNG')
        links = {value for e in root.iter() for key, value in e.attrib.items() if key.endswith('href')}
        assert all(link.startswith(('#', 'data:')) for link in links)
        assert picture.files('svg')['svg'] == files['svg']


@given(arrays.arrays(float, st.tuples(st.integers(1, 400), st.integers(1, 3)), elements=st.floats(-1e6, 1e6)))
def test_thinned_lines_keep_what_can_be_seen(values):
    kept = thinned(values, 40)
    assert len(kept) <= max(40, 6 * values.shape[1]) or len(values) <= 40
    assert (np.diff(kept) > 0).all()
    np.testing.assert_array_equal(np.ptp(values[kept], axis=0), np.ptp(values, axis=0))


def test_an_hour_at_1_kHz_makes_small_figures():
    hour, timeline = motion(3_600_000, 0.001), plots.Timeline()
    for picture in (
        *plots.plot_recordings([hour], []),
        plots.draw_residuals(residuals(3_600_000, 0.001, channels=1), timeline)[0],
    ):
        assert all(len(content) < 400_000 for content in picture.files('svg', 'png').values())
        assert len(json.dumps(picture.content.data())) < 150_000


def test_recordings_of_one_bag_share_its_time_and_others_stand_behind_it():
    parts = [motion(name='a@0:3'), motion(name='b'), motion(name='a@3:', start=3.0)]
    timeline = plots.Timeline.of(parts)
    assert timeline.shifts == {'a': 0.0, 'b': pytest.approx(5.99)}
    plot = plots.plot_recordings(parts[:2], parts[2:])[0].content
    fitted = plots.plot_simulation(simulation(), timeline, validation=True)[0].content
    torque = plots.draw_unexplained_torque(*unexplained_torque(), timeline)[0].content
    for each in (plot, fitted, torque):
        assert [span.begin for span in each.spans if span.begin == span.end] == [pytest.approx(5.99)]
    assert plots.Timeline.of(parts[::2]).marks == []
    within = [(s.begin, s.end) for s in plot.spans if s.label]
    assert within == [(0, 2.99), (pytest.approx(5.99), pytest.approx(8.98)), (3, 5.99)]


def test_simulations_that_are_lost_are_drawn_as_far_as_they_go():
    states = np.zeros((201, 4, 3))
    states[100:] = np.nan
    states[80:100] = 1e300
    (picture,) = plots.plot_simulation(simulation(simulated=states), plots.Timeline(), validation=True)
    svg = picture.files('svg')['svg']
    assert b'inf' not in svg
    assert b'nan' not in svg


def test_no_correlations_where_everything_lies_on_a_bound():
    result = plain()
    result['criteria'][result['criterion']]['correlation'] = [[None] * 7] * 7
    assert plots.draw_correlation(typed(result)) == []


def test_pieces_are_one_line_with_gaps_where_time_always_ascends():
    """Also where a piece begins when the one before it ends, or is longer than what is shown of it."""
    t = np.linspace(0, 1, 5000)
    pieces = [np.sin(9 * t)[:, None], t[:, None], np.empty((0, 1))]
    joined_t, y = joined([t, t + 1, np.array([])], pieces, 400)
    assert (np.diff(joined_t) > 0).all()
    assert np.isnan(y).sum() == 1
    assert len(y) <= 402
    assert joined([], [])[0].shape == (0,)


def test_a_band_has_both_its_edges_on_the_page_and_in_the_static_figure():
    t = np.arange(3.0)
    lines = [Line('a', [np.full(3, 1e-5)], 'red', style='band', upper=[np.full(3, 3e-5)])]
    plot = TimePlot([Panel('a', 'kg m^2', [t], lines)])
    (panel,) = plot.data()['panels']
    assert panel['label'] == 'a [kg m²]'
    assert [panel['lines'][0][key][0] for key in ('y', 'upper')] == [1e-5, 3e-5]
    (axis,) = plot.figure().axes
    assert len(axis.collections) == 1


def test_a_swing_up_shows_both_links_from_upright_the_torque_and_its_limit(tmp_path):
    t = np.arange(200) * 0.01
    q = np.column_stack([np.linspace(-math.pi / 2, math.pi / 2, 200), np.zeros(200)])
    plots.draw_balance(tmp_path / 'a.svg', Trajectory(t, q, np.column_stack([np.sin(t), 0 * t])), 2.0)
    text = (tmp_path / 'a.svg').read_text()
    for words in ('[degrees]', 'link 1', 'link 2', '[N m]', 'time [s]'):
        assert f'<!-- {words}' in text or f'\n{words} -->' in text, words
