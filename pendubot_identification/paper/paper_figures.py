# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Figure 1 of the paper from the results of this package."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from pendubot_identification.report.style import GREY

from .trials import ALGORITHMS, TARGET, Outcome

#: Colour, line and marker of each algorithm, which differ in hue (also for the colour-blind), in lightness, and in the
#: line itself.
STYLES = {
    'MDE': ('#000000', '-', 'o'),
    'HDE': ('#0060ad', '--', 's'),
    'DE': ('#d55e00', '-.', '^'),
    'PSO': ('#009e73', (0, (1, 1)), 'D'),
}
#: Smaller errors are drawn as this one.
LEAST = 1e-8
#: Height of the legend above all panels [inch].
LEGEND = 0.32


def convergence(outcomes: Sequence[Outcome]) -> Figure:
    """Return the error over generations: medians over the runs, shaded from the 10th to the 90th percentile.

    A run that has stopped keeps its last error.
    """
    figure = Figure(figsize=(8.0, 6.2), layout='constrained')
    axes = figure.subplots(2, 2, sharex=True)
    panel = dict(zip(dict.fromkeys(o.function for o in outcomes), axes.flat, strict=True))
    for o in outcomes:
        ax, history, (color, line, marker) = panel[o.function], o.result.history, STYLES[o.algorithm]
        at = np.unique(np.round(np.geomspace(1, len(history), 200)).astype(int))
        low, median, high = np.maximum(np.percentile(history[at - 1], [10, 50, 90], axis=1), LEAST)
        ax.fill_between(at, low, high, color=color, alpha=0.13, linewidth=0)
        ax.plot(at, median, color=color, linestyle=line, label=o.algorithm)
        ax.plot(at[-1:], median[-1:], color=color, marker=marker)
    for function, ax in panel.items():
        ax.axhline(TARGET, color=GREY, linewidth=0.8)
        ax.set(title=function, xscale='log', yscale='log')
    for ax in axes[1]:
        ax.set_xlabel('generations, the initial vectors included')
    for ax in axes[:, 0]:
        ax.set_ylabel('error of the best vector')
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc='upper center', ncols=len(ALGORITHMS))
    # matplotlib before 3.7 (Ubuntu 24.04) does not leave space for the legend by itself.
    figure.set_layout_engine('constrained', rect=(0, 0, 1, 1 - LEGEND / figure.get_figheight()))
    return figure
