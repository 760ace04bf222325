# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The static figures of a report. The same arrays give the same SVG, byte for byte."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pendubot_identification.results.result import Convergence, Result

from .figure_data import Array, Residuals, UnexplainedTorque
from .plots import COLOURS, MEASURED, SIMULATED, Picture
from .style import SMALL, WIDTH, style
from .time_plot import in_powers, scaled, thinned

#: Number of bins for means of unexplained torque; torques above OUTLYING times their median are left out.
BINS, OUTLYING = 24, 8.0
drawn = style(SMALL)


@drawn
def draw_whiteness(residuals: Residuals) -> Picture:
    """Draw the autocorrelation and the histogram of a criterion's residuals."""
    everything = np.concatenate([values for _, _, values in residuals.parts])
    sizes = np.sqrt((everything**2).mean(axis=0))
    bins = np.linspace(-4, 4, 41)
    figure, (correlation, histogram) = _panels(2.2, 1, 2)
    shown = 1 + thinned(residuals.autocorrelation[1:])
    for k in range(len(residuals.names)):
        correlation.plot(residuals.lags[shown], residuals.autocorrelation[shown, k], color=COLOURS[k])
        counts, _ = np.histogram(everything[:, k] / (sizes[k] or 1.0), bins, density=True)
        histogram.stairs(counts, bins, color=COLOURS[k])
    histogram.plot(bins, np.exp(-(bins**2) / 2) / np.sqrt(2 * np.pi), color=MEASURED, linestyle=':')
    correlation.axhspan(-residuals.band, residuals.band, color='#bbbbbb', alpha=0.6, linewidth=0)
    correlation.axvspan(0, min(residuals.overlap, residuals.lags[-1]), color='#eeeeee', zorder=0, linewidth=0)
    correlation.set(xlim=(0, residuals.lags[-1]), ylim=(-1.05, 1.05), xlabel='lag [s]', title='autocorrelation')
    histogram.set(xlabel='in its root mean square', title='histogram', yticks=[])
    return Picture(f'whiteness_{residuals.criterion}', figure, {'cumulative': residuals.cumulative})


@drawn
def draw_torque_means(left: UnexplainedTorque) -> Picture:
    """Draw the means of the unexplained torque against the motion."""
    torque = np.concatenate(left.torque)
    figure, axes = _panels(2.6, 2, len(left.abscissas), sharey='row')
    usual = np.abs(torque) < OUTLYING * np.median(np.abs(torque), axis=0) + np.finfo(float).tiny
    for k, (joint, row) in enumerate(zip(('shoulder', 'elbow'), axes.reshape(2, -1), strict=True)):
        kept = torque[usual[:, k], k]
        power = scaled(float(np.abs(kept).max(initial=0.0)))
        row[0].set_ylabel(f'{joint}\n[{in_powers("N m", power)}]')
        for axis, (name, values) in zip(row, left.abscissas.items(), strict=True):
            x = values[usual[:, k], k]
            edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))
            if len(edges) > 2:
                counts, _ = np.histogram(x, edges)
                sums, _ = np.histogram(x, edges, weights=kept)
                axis.plot((edges[1:] + edges[:-1]) / 2, sums / np.maximum(counts, 1) / 10.0**power, color=COLOURS[k])
                axis.axhline(0, color='#bbbbbb', linewidth=0.6, zorder=0)
            if k == 1:
                axis.set_xlabel(name)
    return Picture('torque_means', figure)


@drawn
def draw_convergence(criterion: str, least: float, convergence: Convergence) -> list[Picture]:
    """Draw the distance of the best value of each run of MDE from the exact minimum ``least``, by generation."""
    generations = np.array(convergence.generations) + 1.0
    best = np.array(convergence.best, dtype=float)
    figure, (axis,) = _panels(3.0, 1)
    axis.loglog(generations, np.maximum(best / least - 1, 1e-14).T, color=COLOURS[0], linewidth=0.8, alpha=0.8)
    axis.set(xlabel='generation', ylabel='best J / exact minimum - 1')
    axis.axhline(1e-6, color=SIMULATED, linestyle='--', label='counts as found')
    axis.legend(loc='lower left', bbox_to_anchor=(0, 1.0), borderaxespad=0.2)
    return [Picture(f'convergence_{criterion}', figure)]


@drawn
def draw_correlation(result: Result) -> list[Picture]:
    """Draw the correlation matrix of the selected estimate, if it has one."""
    names = list(result.parameters)
    matrix = np.array(result.criteria[result.criterion].correlation, dtype=float)
    if not np.isfinite(matrix).any():
        return []
    few = len(names) < 11
    figure, (axis,) = _panels(4.6, 1)
    axis.imshow(matrix, cmap='RdBu_r', vmin=-1, vmax=1)
    for row, column in np.argwhere(np.isfinite(matrix)):
        value = matrix[row, column]
        shown = f'{value:.2f}'.replace('0.', '.').replace('1.00', '1').replace('-.00', '.00')
        colour = 'white' if abs(value) > 0.6 else 'black'
        axis.text(column, row, shown, ha='center', va='center', fontsize=8 if few else 6, color=colour)
    axis.set_xticks(range(len(names)), names)
    axis.set_yticks(range(len(names)), names)
    axis.tick_params(length=0, labelsize=8 if few else 7)
    axis.grid(False)
    return [Picture('correlation', figure)]


@drawn
def draw_excitation(names: Sequence[str], terms: Array, own: Array, residual: Array) -> Picture:
    """Draw the effect of each parameter in the equation of each joint, and its part that no other can imitate.

    The arrays are those of :func:`.figure_data.excitation`.
    """
    figure, axes = _panels(1.4 + 0.26 * len(names), 1, 2, sharey=True)
    places = np.arange(len(names))
    for k, (axis, joint) in enumerate(zip(axes, ('shoulder', 'elbow'), strict=True)):
        largest = max(terms[:, k].max(), residual[k]) or 1.0
        least = 10.0 ** np.floor(np.log10(max(min(residual[k], largest * 1e-3), largest * 1e-7, 1e-300)) - 0.5)
        for values, label, how in ((terms, 'all it does', {'alpha': 0.35}), (own, 'it alone', {'height': 0.45})):
            width = np.maximum(values[:, k] - least, 0)
            axis.barh(places, width, left=least, color=COLOURS[0], label=label, **how)
        axis.axvline(max(residual[k], least), color=SIMULATED, linestyle='--', label='unexplained')
        axis.set(xscale='log', xlim=(least, 2 * largest), title=f"{joint}'s equation", xlabel='root mean square [N m]')
        axis.set_yticks(places, names)
        axis.grid(False, axis='y')
    axes[0].invert_yaxis()
    figure.legend(*axes[0].get_legend_handles_labels(), loc='lower center', ncols=3, bbox_to_anchor=(0.5, 1.0))
    return Picture('excitation', figure)


def _panels(height: float, rows: int, columns: int = 1, **shared: Any) -> tuple[Figure, NDArray[Any]]:
    """Return a figure, ``height`` inches high, and its axes, row by row."""
    figure = Figure(figsize=(WIDTH, height), layout='constrained')
    return figure, figure.subplots(rows, columns, squeeze=False, **shared).ravel()
