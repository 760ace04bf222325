# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The paper's figures from what was found here, and those that it leaves out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from pendubot_identification.paper.explained import Balance
from pendubot_identification.paper.trials import ALGORITHMS, PER_VECTOR, TARGET, Outcome
from pendubot_identification.report.style import GREY, STYLES, legend_above, panels
from pendubot_identification.trajectories.trajectory import Trajectory

#: What lies between these percentiles of the runs is shaded.
SPREAD = (10, 90)
#: Errors below this are drawn as this.
LEAST = 1e-8
#: Of remarks.
DIM = '#555555'
#: An order that gives MDE the plainest line.
STYLE_OF = dict(zip((*reversed(ALGORITHMS), PER_VECTOR), STYLES, strict=True))


def convergence(outcomes: Sequence[Outcome], over: str = 'generations') -> Figure:
    """Return Figure 1: error against generations, as in the paper, or against ``function values``.

    Medians over the runs, shaded between percentiles; a run that has stopped keeps its last error.
    """
    figure, axes = panels(2, 2, 6.2, sharex=True)
    panel = dict(zip(dict.fromkeys(o.function for o in outcomes), axes.flat, strict=True))
    for o in outcomes:
        ax, result, style = panel[o.function], o.result, STYLE_OF[o.algorithm]
        at = np.unique(np.round(np.geomspace(1, len(result.history), 200)).astype(int)) - 1
        errors = np.percentile(result.history[at], [SPREAD[0], 50, SPREAD[1]], axis=1)
        low, median, high = np.maximum(errors, LEAST)
        x = at + 1 if over == 'generations' else result.at_start + at * result.per_generation
        ax.fill_between(x, low, high, color=style['color'], alpha=0.13, linewidth=0)
        ax.plot(x, median, label=o.algorithm, **{**style, 'marker': ''})
        ax.plot(x[-1:], median[-1:], **style)
    for function, ax in panel.items():
        ax.axhline(TARGET, color=GREY, linewidth=0.8)
        ax.set(title=function, xscale='log', yscale='log')
    for ax in axes[-1]:
        ax.set_xlabel('generations, the initial vectors included' if over == 'generations' else over)
    for ax in axes[:, 0]:
        ax.set_ylabel('error of the best vector')
    axes[0, 0].annotate(
        'target', (0.99, TARGET), (0, -2), xycoords=axes[0, 0].get_yaxis_transform(), textcoords='offset points',
        ha='right', va='top', color=DIM, fontsize=8,
    )  # fmt: skip
    legend_above(figure, axes[0, 0], len(ALGORITHMS))
    return figure


def threshold(outcomes: Sequence[Outcome]) -> Figure:
    """Return generations and arrivals of MDE over the threshold, per component and per vector."""
    figure, axes = panels(2, 2, 6.0, sharex=True, sharey='row')
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
        share.set(xlabel='threshold: probability of best/1 [1]', ylim=(-5, 105))
        for ax in (taken, share):
            ax.axvline(0.3, color=GREY, linewidth=0.8, zorder=0)
    axes[0, 0].set_ylabel('generations to the target, median')
    axes[1, 0].set_ylabel('runs that reach the target [%]')
    axes[1, 0].annotate("the paper's 0.3", (0.3, 0), (3, 3), textcoords='offset points', color=DIM, fontsize=8)
    legend_above(figure, axes[0, 0], len(problems))
    return figure


def dimensions(outcomes: Sequence[Outcome]) -> Figure:
    """Return the final errors in 2, 10 and 30 dimensions: median, and the range of all runs."""
    figure, axes = panels(2, 2, 6.2, sharex=True)
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
    for ax in axes[-1]:
        ax.set_xlabel('n, number of dimensions')
    for ax in axes[:, 0]:
        ax.set_ylabel('error at the end of a run')
    legend_above(figure, axes[0, 0], len(algorithms))
    return figure


def data_set(training: Trajectory, validation: Trajectory) -> Figure:
    """Return the recording: torque and positions, the half that estimates and the half that validates."""
    figure, axes = panels(3, 1, 5.4, sharex=True)
    start = training.t[0]
    for motion in (training, validation):
        t = motion.t - start
        axes[0, 0].step(t, motion.tau[:, 0], where='post', color='#000000', linewidth=0.8)
        for joint in range(2):
            axes[1 + joint, 0].plot(t, np.degrees(motion.q[:, joint]), color='#000000', linewidth=1)
    labels = ('torque at the\nshoulder [N m]', 'shoulder q1,\nfrom horizontal [°]', 'elbow q2,\nrelative [°]')
    for ax, label in zip(axes[:, 0], labels, strict=True):
        ax.set_ylabel(label)
        _halves(ax, start, training, validation, named=ax is axes[0, 0])
    axes[-1, 0].set_xlabel('time [s]')
    figure.align_ylabels()
    return figure


def fit(
    training: Trajectory, validation: Trajectory, balances: Sequence[Balance], pieces: Sequence[Trajectory]
) -> Figure:
    """Return how the identified parameters explain the recording.

    Args:
        training: the half that estimates.
        validation: the half that judges.
        balances: the energy balance of each half.
        pieces: motions simulated from the validation half's measured states.
    """
    figure, axes = panels(4, 1, 7.4)
    start = training.t[0]
    for k, balance in enumerate(balances):
        t = balance.t - start
        labels = ('energy received: work less friction', 'energy gained') if k == 0 else (None, None)
        axes[0, 0].plot(t, 1e3 * balance.received, label=labels[0], color='#000000', linewidth=2.2, alpha=0.45)
        axes[0, 0].plot(t, 1e3 * balance.gained, label=labels[1], **{**STYLES[1], 'marker': ''})
        axes[1, 0].plot(t, 1e3 * (balance.received - balance.gained), color='#000000', linewidth=1)
    axes[0, 0].set_ylabel('energy [mJ]')
    axes[1, 0].set_ylabel('residual ε [mJ]')
    for ax in axes[:2, 0]:
        ax.set_xlabel('time [s]')
        _halves(ax, start, training, validation, named=ax is axes[0, 0])
    axes[0, 0].legend(loc='upper center', bbox_to_anchor=(0.5, 1.42), ncols=2)
    every = pieces[1].t[0] - pieces[0].t[0] if len(pieces) > 1 else pieces[0].duration
    for joint, ax in enumerate(axes[2:, 0]):
        t = validation.t - start
        ax.plot(t, np.degrees(validation.q[:, joint]), label='measured', color='#000000', linewidth=2.2, alpha=0.45)
        for piece in pieces:
            label = f'simulated, every {every:.2g} s from the measured state' if piece is pieces[0] else None
            ax.plot(piece.t - start, np.degrees(piece.q[:, joint]), label=label, **{**STYLES[1], 'marker': ''})
        ax.set(ylabel=f'q{joint + 1} [°]', xlabel='time [s] (validation)', xlim=(t[0], t[-1]))
    axes[2, 0].legend(loc='upper center', bbox_to_anchor=(0.5, 1.42), ncols=2)
    figure.align_ylabels()
    return figure


def _halves(ax: Any, start: float, training: Trajectory, validation: Trajectory, named: bool) -> None:
    """Show where a recording's first half ends and, above, say which half is which."""
    ax.set_xlim(0, validation.t[-1] - start)
    border = (training.t[-1] + validation.t[0]) / 2 - start
    ax.axvline(border, color=GREY, linewidth=1)
    for text, side, shift in (('training', 'right', -4), ('validation', 'left', 4)) if named else ():
        ax.annotate(
            text, (border, 1), (shift, 1), xycoords=ax.get_xaxis_transform(), textcoords='offset points', ha=side,
            va='bottom', color=DIM, fontsize=8,
        )  # fmt: skip
