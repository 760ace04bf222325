# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Figures as files: the same every time, whole, and readable without colour."""

import itertools

import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb

from pendubot_identification.model.parameters import PAPER
from pendubot_identification.paper import paper_figures, trials
from pendubot_identification.paper.benchmark_functions import FUNCTIONS
from pendubot_identification.paper.explained import energy_balance, predicted
from pendubot_identification.report import style
from test.virtual import recording


@pytest.fixture(scope='module')
def drawn():
    """Every figure, drawn and laid out."""
    outcomes = {
        (f.name, algorithm): trials.compete(algorithm, f, 2, runs=3, evaluations=3000)
        for f in FUNCTIONS
        for algorithm in trials.SETTINGS
    }

    def made(algorithms, ns=(2,), thresholds=(None,)):
        for (name, algorithm), result in outcomes.items():
            for n, threshold in itertools.product(ns, thresholds):
                if algorithm in algorithms:
                    yield trials.Outcome(name, n, algorithm, threshold, 1, result)

    competition, dimensions = list(made(trials.ALGORITHMS)), list(made(trials.SETTINGS, ns=(2, 10, 30)))
    outcomes |= {(trials.IDENTIFICATION, name): outcomes['Sphere', name] for name in ('MDE', trials.PER_VECTOR)}
    sweep = list(made(('MDE', trials.PER_VECTOR), thresholds=(0.0, 0.3, 1.0)))
    training, validation = recording(300), recording(300, seed=2)
    validation = type(validation)(validation.t + 3, validation.q, validation.tau)
    balances = [energy_balance(half, PAPER.vector()) for half in (training, validation)]
    pieces = predicted(validation, PAPER, 1.0)
    with style.style():
        result = {
            'figure1': paper_figures.convergence(competition),
            'figure1_evaluations': paper_figures.convergence(competition, 'function values'),
            'threshold': paper_figures.threshold(sweep),
            'dimensions': paper_figures.dimensions(dimensions),
            'dataset': paper_figures.data_set(training, validation),
            'fit': paper_figures.fit(training, validation, balances, pieces),
        }
        for figure in result.values():
            FigureCanvasAgg(figure).draw()
    return result


def test_every_figure_names_its_axes_and_no_text_is_cut(drawn):
    for name, figure in drawn.items():
        frame = figure.bbox
        for text in _drawn_texts(figure):
            box = text.get_window_extent()
            inside = box.x0 >= -1 and box.y0 >= -1 and box.x1 <= frame.x1 + 1 and box.y1 <= frame.y1 + 1
            assert inside, f'{name}: {text.get_text()!r} is cut'
        rows, columns = figure.axes[0].get_gridspec().get_geometry()
        for k, ax in enumerate(figure.axes):
            if k % columns == 0:
                assert ax.get_ylabel(), f'{name}: a panel without a name for its ordinate'
            if k >= (rows - 1) * columns:
                assert ax.get_xlabel(), f'{name}: a panel without a name for its abscissa'


def _drawn_texts(figure):
    """Return titles, names, remarks, legends, and the labels of the ticks within the axes' limits."""
    ticks = figure.findobj(matplotlib.axis.Tick)
    labels = {label for tick in ticks for label in (tick.label1, tick.label2)}
    texts = [text for text in figure.findobj(matplotlib.text.Text) if text not in labels]
    for axis in figure.findobj(matplotlib.axis.Axis):
        low, high = sorted(axis.get_view_interval())
        texts += [tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high]
    return [text for text in texts if text.get_visible() and text.get_text().strip()]


def test_files_are_the_same_every_time_and_say_nothing_of_when():
    halves = recording(300), recording(300, seed=2)
    with style.style():
        first, again = (style.rendered(paper_figures.data_set(*halves)) for _ in range(2))
    assert first == again
    assert first['png'].startswith(b'\x89PNG')
    assert b'<svg' in first['svg']
    assert b'dc:date' not in first['svg']
    assert b'Software' not in first['png'][:300]


def test_the_users_own_style_is_neither_used_nor_changed():
    with matplotlib.rc_context({'axes.facecolor': 'red', 'font.size': 30}):
        with style.style():
            assert matplotlib.rcParams['axes.facecolor'] != 'red'
            assert matplotlib.rcParams['font.size'] == 9
        assert matplotlib.rcParams['axes.facecolor'] == 'red'


def test_curves_differ_without_colour():
    lines, markers = ({str(one[key]) for one in style.STYLES} for key in ('linestyle', 'marker'))
    assert len(lines) == len(markers) == len(style.STYLES)
    grey = [np.dot(to_rgb(one['color']), (0.299, 0.587, 0.114)) for one in style.STYLES]
    assert min(abs(a - b) for a, b in itertools.combinations(grey, 2)) > 0.04
