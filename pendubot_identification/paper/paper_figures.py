# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Figure 1 of the paper with the results of this package."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from pendubot_identification.report.plots import GREY

from .trials import ALGORITHMS, TARGET, Outcome

#: Colour, line style and marker of each algorithm, distinguishable also by colour-blind readers and in greyscale.
STYLES = {
    'MDE': ('#000000', '-', 'o'),
    'HDE': ('#0060ad', '--', 's'),
    'DE': ('#d55e00', '-.', '^'),
    'PSO': ('#009e73', (0, (1, 1)), 'D'),
}
#: Smallest error in the figure; smaller errors are clipped to it.
LEAST = 1e-8
#: Height of the legend above all panels [inch].
LEGEND = 0.32


def convergence(outcomes: Sequence[Outcome]) -> Figure:
    """Return the figure of the error over generations: median over the runs, shaded from 10th to 90th percentile.

    A stopped run keeps its last error.
    """
    figure = Figure(figsize=(8.0, 6.2), layout='constrained')
    axes = figure.subplots(2, 2, sharex=True)
    panel = dict(zip(dict.fromkeys(o.function for o in outcomes), axes.flat, strict=True))
    for o in outcomes:
        ax, history, (color, line, marker) = panel[o.function], o.result.history, STYLES[o.algorithm]
        k = np.unique(np.round(np.geomspace(1, len(history), 200)).astype(int))
        low, median, high = np.maximum(np.percentile(history[k - 1], [10, 50, 90], axis=1), LEAST)
        ax.fill_between(k, low, high, color=color, alpha=0.13, linewidth=0)
        ax.plot(k, median, color=color, linestyle=line, label=o.algorithm)
        ax.plot(k[-1:], median[-1:], color=color, marker=marker)
    for function, ax in panel.items():
        ax.axhline(TARGET, color=GREY, linewidth=0.8)
        ax.set(title=function, xscale='log', yscale='log')
    for ax in axes[1]:
        ax.set_xlabel('generations, the initial vectors included')
    for ax in axes[:, 0]:
        ax.set_ylabel('error of the best vector')
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc='upper center', ncols=len(ALGORITHMS))
    # matplotlib before 3.7 (Ubuntu 24.04) does not reserve space for the legend.
    figure.set_layout_engine('constrained', rect=(0, 0, 1, 1 - LEGEND / figure.get_figheight()))
    return figure
