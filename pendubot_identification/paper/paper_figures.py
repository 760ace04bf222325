# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The figures of the paper from the results of this package, and further figures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray

from pendubot_identification.criteria.energy import energy_regression
from pendubot_identification.model.parameters import Parameters
from pendubot_identification.model.simulation import simulate
from pendubot_identification.report.style import GREY
from pendubot_identification.trajectories.signals import SMOOTHING, differentiate, resample
from pendubot_identification.trajectories.trajectory import Trajectory

from .trials import ALGORITHMS, PER_VECTOR, TARGET, Outcome

Array = NDArray[np.float64]

#: Colour, line and marker of several curves, which differ in hue (also for the colour-blind), in lightness, and in the
#: line itself.
STYLES: tuple[dict[str, Any], ...] = (
    {'color': '#000000', 'linestyle': '-', 'marker': 'o'},
    {'color': '#0060ad', 'linestyle': '--', 'marker': 's'},
    {'color': '#d55e00', 'linestyle': '-.', 'marker': '^'},
    {'color': '#009e73', 'linestyle': (0, (1, 1)), 'marker': 'D'},
    {'color': '#e69f00', 'linestyle': (0, (5, 1, 1, 1, 1, 1)), 'marker': 'v'},
)
#: MDE has the plainest line.
STYLE_OF = dict(zip((*reversed(ALGORITHMS), PER_VECTOR), STYLES, strict=True))
MEASURED = {'color': '#000000', 'linewidth': 2.2, 'alpha': 0.45}
#: Width of a figure that fills a page, and height of a legend above all panels [inch].
WIDTH, LEGEND = 8.0, 0.32
#: Smaller errors are drawn as this one.
LEAST = 1e-8
#: Number of parameters in the energy, P1 to P5; the others are friction.
INERTIAL = 5
#: Length [s] of the simulations in the figure of the fit.
PIECE = 1.0


def convergence(outcomes: Sequence[Outcome], over: str = 'generations') -> Figure:
    """Return Figure 1: error over generations, as in the paper, or over ``function values``.

    Medians over the runs, shaded from the 10th to the 90th percentile; a run that has stopped keeps its last error.
    """
    figure, axes = _panels(2, 2, 6.2, sharex=True)
    panel = dict(zip(dict.fromkeys(o.function for o in outcomes), axes.flat, strict=True))
    for o in outcomes:
        ax, result, style = panel[o.function], o.result, STYLE_OF[o.algorithm]
        at = np.unique(np.round(np.geomspace(1, len(result.history), 200)).astype(int)) - 1
        errors = np.percentile(result.history[at], [10, 50, 90], axis=1)
        low, median, high = np.maximum(errors, LEAST)
        x = at + 1 if over == 'generations' else result.at_start + at * result.per_generation
        ax.fill_between(x, low, high, color=style['color'], alpha=0.13, linewidth=0)
        ax.plot(x, median, label=o.algorithm, **{**style, 'marker': ''})
        ax.plot(x[-1:], median[-1:], **style)
    for function, ax in panel.items():
        ax.axhline(TARGET, color=GREY, linewidth=0.8)
        ax.set(title=function, xscale='log', yscale='log')
    across = 'generations, the initial vectors included' if over == 'generations' else over
    _label(axes, across, 'error of the best vector')
    edge = axes[0, 0].get_yaxis_transform()
    _remark(axes[0, 0], 'target', (0.99, TARGET), (0, -2), xycoords=edge, ha='right', va='top')
    _legend_above(figure, axes[0, 0], len(ALGORITHMS))
    return figure


def threshold(outcomes: Sequence[Outcome]) -> Figure:
    """Return the generations and the success rate of MDE over the threshold, per component and per vector."""
    figure, axes = _panels(2, 2, 6.0, sharex=True, sharey='row')
    problems = list(dict.fromkeys(o.function for o in outcomes))
    titles = {'MDE': 'operator per component', PER_VECTOR: 'operator per vector'}
    for (taken, share), (algorithm, title) in zip(axes.T, titles.items(), strict=True):
        for problem, style in zip(problems, STYLES, strict=True):
            mine = [o for o in outcomes if (o.function, o.algorithm) == (problem, algorithm)]
            at = [o.threshold for o in mine]
            arrived = [o.result.generations[o.arrived] for o in mine]
            taken.plot(at, [np.median(runs) if len(runs) else np.nan for runs in arrived], label=problem, **style)
            share.plot(at, [100 * o.arrived.mean() for o in mine], **style)
        taken.set(title=title, yscale='log')
        share.set(ylim=(-5, 105))
        for ax in (taken, share):
            ax.axvline(0.3, color=GREY, linewidth=0.8, zorder=0)
    rows = 'generations to the target, median', 'runs that reach the target [%]'
    _label(axes, 'threshold: probability of best/1 [1]', *rows)
    _remark(axes[1, 0], "the paper's 0.3", (0.3, 0), (3, 3))
    _legend_above(figure, axes[0, 0], len(problems))
    return figure


def dimensions(outcomes: Sequence[Outcome]) -> Figure:
    """Return the final errors in 2, 10 and 30 dimensions: median, and the range of all runs."""
    figure, axes = _panels(2, 2, 6.2, sharex=True)
    functions, sizes, algorithms = (
        list(dict.fromkeys(getattr(o, name) for o in outcomes)) for name in ('function', 'n', 'algorithm')
    )
    for ax, function in zip(axes.flat, functions, strict=True):
        for k, algorithm in enumerate(algorithms):
            mine = [o for o in outcomes if (o.function, o.algorithm) == (function, algorithm)]
            errors = [np.maximum(o.result.value, LEAST) for o in mine]
            median, low, high = (np.array([f(e) for e in errors]) for f in (np.median, np.min, np.max))
            x = np.arange(len(sizes)) + 0.15 * (k - (len(algorithms) - 1) / 2)
            style = {**STYLE_OF[algorithm], 'linestyle': 'none'}
            bars = ax.errorbar(x, median, [median - low, high - median], label=algorithm, capsize=2, **style)
            bars[2][0].set_linewidth(1)
        ax.axhline(TARGET, color=GREY, linewidth=0.8, zorder=0)
        ax.set(title=function, yscale='log', xticks=range(len(sizes)), xticklabels=map(str, sizes))
        ax.yaxis.set_major_locator(LogLocator(numticks=8))
        ax.grid(visible=False, axis='x')
    _label(axes, 'n, number of dimensions', 'error at the end of a run')
    _legend_above(figure, axes[0, 0], len(algorithms))
    return figure


def data_set(training: Trajectory, validation: Trajectory) -> Figure:
    """Return the torque and the positions of a recording, with its halves for training and validation."""
    figure, axes = _panels(3, 1, 5.4, sharex=True)
    start = training.t[0]
    for motion in (training, validation):
        t = motion.t - start
        axes[0, 0].step(t, motion.tau[:, 0], where='post', color='#000000', linewidth=0.8)
        for joint in range(2):
            axes[1 + joint, 0].plot(t, np.degrees(motion.q[:, joint]), color='#000000', linewidth=1)
    _label(
        axes,
        'time [s]',
        *('torque at the\nshoulder [N m]', 'shoulder q1,\nfrom horizontal [°]', 'elbow q2,\nrelative [°]'),
    )
    _halves(axes[:, 0], training, validation)
    figure.align_ylabels()
    return figure


def fit(training: Trajectory, validation: Trajectory, parameters: Parameters) -> Figure:
    """Return the energy balance of a recording with identified parameters, and its motion simulated in pieces."""
    figure, axes = _panels(4, 1, 7.4)
    start = training.t[0]
    for k, motion in enumerate((training, validation)):
        t, gained, received = energy_balance(motion, parameters.vector())
        labels = ('energy received: work less friction', 'energy gained') if k == 0 else (None, None)
        axes[0, 0].plot(t - start, 1e3 * received, label=labels[0], **MEASURED)
        axes[0, 0].plot(t - start, 1e3 * gained, label=labels[1], **{**STYLES[1], 'marker': ''})
        axes[1, 0].plot(t - start, 1e3 * (received - gained), color='#000000', linewidth=1)
    axes[0, 0].set_ylabel('energy [mJ]')
    axes[1, 0].set_ylabel('residual ε [mJ]')
    for ax in axes[:2, 0]:
        ax.set_xlabel('time [s]')
    _halves(axes[:2, 0], training, validation)
    pieces = predicted(validation, parameters, PIECE)
    every = pieces[1].t[0] - pieces[0].t[0] if len(pieces) > 1 else pieces[0].duration
    for joint, ax in enumerate(axes[2:, 0]):
        t = validation.t - start
        ax.plot(t, np.degrees(validation.q[:, joint]), label='measured', **MEASURED)
        for piece in pieces:
            label = f'simulated, every {every:.2g} s from the measured state' if piece is pieces[0] else None
            ax.plot(piece.t - start, np.degrees(piece.q[:, joint]), label=label, **{**STYLES[1], 'marker': ''})
        ax.set(ylabel=f'q{joint + 1} [°]', xlabel='time [s] (validation)', xlim=(t[0], t[-1]))
    for ax in (axes[0, 0], axes[2, 0]):
        ax.legend(loc='upper center', bbox_to_anchor=(0.5, 1.42), ncols=2)
    figure.align_ylabels()
    return figure


def energy_balance(trajectory: Trajectory, theta: Array) -> tuple[Array, Array, Array]:
    """Return time [s] and both sides of equation (6) of the paper, theta of shape (7,), each of shape (N,).

    The sides are E(t) - E(0) [J], and the work of the torque less the work of friction [J].
    """
    made = energy_regression(trajectory)
    gained, friction = made.phi[:, :INERTIAL] @ theta[:INERTIAL], made.phi[:, INERTIAL:] @ theta[INERTIAL:]
    return made.t, gained, made.y - friction


def predicted(trajectory: Trajectory, parameters: Parameters, length: float) -> list[Trajectory]:
    """Return simulations of pieces of a recording, ``length`` [s] long, each from the measured state."""
    motion = resample(trajectory)
    q, qd = differentiate(motion.q, motion.interval, SMOOTHING)
    step = max(2, round(length / motion.interval))
    pieces = []
    for k in range(0, len(motion) - 1, step):
        part = slice(k, min(k + step, len(motion)))
        start = (float(q[k, 0]), float(q[k, 1])), (float(qd[k, 0]), float(qd[k, 1]))
        pieces.append(simulate(parameters, motion.t[part], motion.tau[part], *start))
    return pieces


def _panels(rows: int, columns: int, height: float, **shared: Any) -> tuple[Figure, Any]:
    """Return a figure of some height [inch], and its axes, shape (rows, columns)."""
    figure = Figure(figsize=(WIDTH, height), layout='constrained')
    return figure, figure.subplots(rows, columns, squeeze=False, **shared)


def _label(axes: Any, across: str, *up: str) -> None:
    """Label the abscissas of the last row, and the ordinates of the first column."""
    for ax in axes[-1]:
        ax.set_xlabel(across)
    for ax, label in zip(axes[:, 0], up * (len(axes) // len(up)), strict=True):
        ax.set_ylabel(label)


def _remark(ax: Any, text: str, at: Any, shift: tuple[int, int], **how: Any) -> None:
    ax.annotate(text, at, shift, textcoords='offset points', color='#555555', fontsize=8, **how)


def _legend_above(figure: Figure, axes: Any, columns: int) -> None:
    """Put the legend of one panel above all of them."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc='upper center', ncols=columns)
    # matplotlib before 3.7 (Ubuntu 24.04) does not leave space for the legend by itself.
    figure.set_layout_engine('constrained', rect=(0, 0, 1, 1 - LEGEND / figure.get_figheight()))


def _halves(panels: Any, training: Trajectory, validation: Trajectory) -> None:
    """Mark the end of the first half of a recording, and label the halves above the first panel."""
    start = training.t[0]
    border = (training.t[-1] + validation.t[0]) / 2 - start
    for ax in panels:
        ax.set_xlim(0, validation.t[-1] - start)
        ax.axvline(border, color=GREY, linewidth=1)
    top = panels[0].get_xaxis_transform()
    for text, side, shift in (('training', 'right', -4), ('validation', 'left', 4)):
        _remark(panels[0], text, (border, 1), (shift, 1), xycoords=top, ha=side, va='bottom')
