# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The figures of a report: arrays in, SVG and PNG out. The same arrays give the same SVG, byte for byte."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from pendubot_identification.identify.evidence import Excitation, Residuals, Simulation
from pendubot_identification.identify.result import Convergence, CriterionValue, Given, Result
from pendubot_identification.trajectories.trajectory import Trajectory

from .style import rendered, style

Array = NDArray[np.float64]

#: Of every figure [inch]: wide enough for a column on a screen, and legible when a telephone shows it.
WIDTH = 5.2
#: Points that a line may have, two for each of half as many intervals of time.
MOST_POINTS = 2000
MEASURED, SIMULATED, ESTIMATION, VALIDATION = '#1a1a1a', '#d55e00', '#56b4e9', '#e69f00'
#: Colours that can be told apart by everyone (Okabe and Ito).
COLOURS = ('#0072b2', '#d55e00', '#009e73', '#cc79a7')
#: Of figures that are smaller than a page.
STYLE = {
    'axes.titlesize': 9,
    'legend.fontsize': 8,
    'lines.linewidth': 1.0,
    'figure.constrained_layout.w_pad': 0.09,
}
STATE_LABELS = ('q1 [rad]', 'q2 [rad]', "q1' [rad/s]", "q2' [rad/s]")


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure, and what is said of it.

    Attributes:
        name: of its files.
        title: in a few words.
        shows: what is drawn, in a sentence or two.
        good: what a good one looks like, in one sentence.
        svg: the figure.
        png: the same for programs that show no SVG.
    """

    name: str
    title: str
    shows: str
    good: str
    svg: str
    png: bytes


def draw_recordings(training: Sequence[Trajectory], validation: Sequence[Trajectory]) -> Picture:
    """Draw the torque and both angles, and which part estimates and which validates."""
    places = _placed([*training, *validation])
    driven = any(m.tau[:, 1].any() for m in (*training, *validation))

    def draw(figure: Figure) -> None:
        axes = figure.subplots(3, 1, sharex=True)
        for colour, motions, start in (
            (ESTIMATION, training, 0),
            (VALIDATION, validation, len(training)),
        ):
            for motion, place in zip(motions, places[start:], strict=False):
                t = motion.t + place
                for axis in axes:
                    axis.axvspan(t[0], t[-1], color=colour, alpha=0.18, linewidth=0)
                axes[0].plot(*envelope(t, motion.tau[:, 0]), color=MEASURED, linewidth=0.8)
                if driven:
                    axes[0].plot(*envelope(t, motion.tau[:, 1]), color=COLOURS[0], linewidth=0.8)
                for axis, angle in zip(axes[1:], motion.q.T, strict=True):
                    axis.plot(*envelope(t, angle), color=MEASURED)
        label = 'tau1 [N m]' if not driven else 'tau1, tau2 [N m]'
        for axis, text in zip(axes, (label, *STATE_LABELS[:2]), strict=True):
            axis.set_ylabel(text)
        axes[-1].set_xlabel('time [s]')
        kinds = [Patch(color=ESTIMATION, alpha=0.4, label='estimates')]
        kinds += [Patch(color=VALIDATION, alpha=0.4, label='validates')] if validation else []
        _legend(axes[0], kinds)

    several = len({_recording(m) for m in (*training, *validation)}) > 1
    return _picture(
        'recordings',
        'The data',
        ('Torque at the shoulder (black) and elbow (blue)' if driven else 'Torque at the shoulder')
        + ', angle of link 1 from the horizontal (hanging: minus a quarter turn) and angle of link 2 relative to it.'
        + (' The recordings stand one after the other, in the order of the list at the foot.' if several else ''),
        'Good data have both joints moving all the time, at changing speeds, in both windows; nothing is cut off '
        'flat at a limit, and hanging at rest reads as it should.',
        4.2,
        draw,
    )


def draw_simulation(simulation: Simulation, *, validation: bool) -> Picture:
    """Draw what was measured and what was simulated from measured states on."""
    t, pieces = simulation.simulated_t, simulation.simulated

    def draw(figure: Figure) -> None:
        axes = figure.subplots(4, 1, sharex=True)
        for k, axis in enumerate(axes):
            measured = simulation.measured[k]
            axis.plot(*envelope(simulation.t, measured), color=MEASURED, linewidth=1.6)
            middle, reach = (measured.max() + measured.min()) / 2, 0.75 * np.ptp(measured) + 1e-3
            # What has left the figure by far would only make its lines long.
            near = np.where(np.abs(pieces[:, k] - middle) < 20 * reach, pieces[:, k], np.nan)
            for piece, at in zip(near.T, t.T, strict=True):
                axis.plot(*envelope(at, piece), color=SIMULATED)
            axis.plot(t[0], pieces[0, k], '.', color=SIMULATED, markersize=4)
            axis.set_ylim(middle - reach, middle + reach)
            axis.set_ylabel(STATE_LABELS[k])
        axes[-1].set_xlabel('time [s]')
        lines = [axes[0].lines[0], axes[0].lines[1]]
        _legend(axes[0], lines, ['measured', 'simulated'])

    part = '' if simulation.whole else f'This is the part that is predicted worst, of {simulation.name}. '
    unseen = 'data that no parameter was estimated from' if validation else 'the very data that were fitted'
    warning = (
        ''
        if validation
        else 'There are no validation data: this figure shows that the model can follow, not that it predicts. '
    )
    return _picture(
        'simulation',
        'Measured against simulated motion',
        f'{warning}The published parameters, simulated over {simulation.ahead:.3g} s at a time from the measured state '
        f'at each dot on, with nothing but the torque, on {unseen}. Measured velocities are differences of smoothed '
        f'angles. {part}',
        'A good model keeps the coloured lines on the black ones from dot to dot, in all four panels; where they '
        'part, the distance is what a controller would not know.',
        5.6,
        draw,
    )


def draw_residuals(residuals: Residuals) -> Picture:
    """Draw a criterion's residuals over time, their autocorrelation, and their histogram."""
    places, shown = _one_after_the_other([t for t, _ in residuals.parts]), residuals.autocorrelation[1:]

    def draw(figure: Figure) -> None:
        top, bottom = figure.subfigures(2, 1)
        over_time, (correlation, histogram) = top.subplots(), bottom.subplots(1, 2)
        everything = np.concatenate([values for _, values in residuals.parts])
        sizes = np.sqrt((everything**2).mean(axis=0))
        bins = np.linspace(-4, 4, 41)
        for k, name in enumerate(residuals.names):
            colour = COLOURS[k]
            for place, (t, values) in zip(places, residuals.parts, strict=True):
                over_time.plot(*envelope(t + place, values[:, k]), color=colour, linewidth=0.7, label=name)
            correlation.plot(*envelope(residuals.lags[1:], shown[:, k]), color=colour)
            counts, _ = np.histogram(everything[:, k] / (sizes[k] or 1.0), bins, density=True)
            histogram.stairs(counts, bins, color=colour)
        normal = np.exp(-(bins**2) / 2) / np.sqrt(2 * np.pi)
        histogram.plot(bins, normal, color=MEASURED, linestyle=':', label='normal')
        correlation.axhspan(-residuals.band, residuals.band, color='#bbbbbb', alpha=0.6, linewidth=0)
        correlation.axvspan(0, min(residuals.shared, residuals.lags[-1]), color='#eeeeee', zorder=0, linewidth=0)
        correlation.set_xlim(0, residuals.lags[-1])
        correlation.set_ylim(-1.05, 1.05)
        correlation.set_xlabel('lag [s]')
        correlation.set_title('autocorrelation')
        histogram.set_xlabel('in its root mean square')
        histogram.set_title('histogram')
        histogram.set_yticks([])
        over_time.set_ylabel(f'[{residuals.unit}]')
        over_time.set_xlabel('time [s]')
        _legend(over_time, over_time.lines[:: len(places)], residuals.names)

    made = {
        'energy': 'What the energy balance leaves, from the beginning of the window on.'
        if np.isinf(residuals.shared)
        else 'What the energy balance of each sliding window leaves.',
        'weak': "What the balances of the shoulder's momentum, the elbow's and of energy leave under each bump.",
        'trajectory': 'Errors of the four states, simulated over half a second at a time, in their standard '
        'deviations.',
    }[residuals.criterion]
    good = (
        'Good residuals are small, without drift, steps or bursts, inside the dark grey band as soon as the light grey '
        'part ends, and spread like the dotted curve; a pattern in them is something that the model does not hold.'
    )
    if np.isinf(residuals.shared):
        good = (
            'Good residuals are small and come back to zero; each holds all data before it, so that they are never '
            'white, and a drift or a step stays: it is energy that the model does not account for.'
        )
    return _picture(
        f'residuals_{residuals.criterion}',
        f'Residuals of {residuals.criterion}',
        f'{made} All on training data. The dark grey band holds 95 % of the autocorrelations of white noise; in the '
        'light grey part neighbours share data and always are correlated. Dotted: a normal distribution.',
        good,
        4.4,
        draw,
    )


def draw_convergence(criterion: str, J: CriterionValue, convergence: Convergence) -> Picture:
    """Draw the best value of each run of MDE after each generation."""
    generations = np.array(convergence.generations) + 1.0
    best = np.array(convergence.best, dtype=float)
    least = J.least_squares

    def draw(figure: Figure) -> None:
        axis = figure.subplots()
        values = best if least is None else np.maximum(best / least - 1, 1e-14)
        axis.loglog(generations, values.T, color=COLOURS[0], linewidth=0.8, alpha=0.8)
        if least is not None:
            axis.axhline(1e-6, color=SIMULATED, linestyle='--', label='counts as found')
            _legend(axis, [axis.lines[-1]])
        axis.set_xlabel('generation')
        axis.set_ylabel('best value' if least is None else 'best J / exact minimum - 1')

    good = (
        'A good search ends below the dashed line in every run: then the parameters are those of the exact minimum, '
        'and chance had no part in them.'
        if least is not None
        else 'A good search falls and then stays level; with several runs, all end at the same value.'
    )
    return _picture(
        f'convergence_{criterion}',
        f'Convergence of MDE on {criterion}',
        'One line for each independent run of modified differential evolution: how far its best parameters are above '
        'the exact minimum.'
        if least is not None
        else 'The bounded error of the best parameters of each run of modified differential evolution, from which '
        'Levenberg-Marquardt went on.',
        good,
        3.0,
        draw,
    )


def draw_parameters(result: Result, reference: Result | Given | None, reference_name: str) -> Picture:
    """Draw every parameter with its 95 % interval: the published one, each criterion's, and a reference's."""
    published = result.criterion
    rows = [(f'{published}, published', result.parameters, COLOURS[1])]
    rows += [(n, e.parameters, COLOURS[0]) for n, e in result.criteria.items() if n != published]
    rows += [(reference_name, reference.parameters, MEASURED)] if reference is not None else []
    names = list(result.parameters)
    lines = -(-len(names) // 2)

    def draw(figure: Figure) -> None:
        axes = figure.subplots(lines, 2, sharey=True, squeeze=False).ravel()
        for axis, name in zip(axes, names, strict=False):
            for k, (_, parameters, colour) in enumerate(rows):
                entry = parameters.get(name)
                if entry is None:
                    continue
                low, high = entry.interval
                if low is not None and high is not None:
                    axis.plot([low, high], [k, k], color=colour, linewidth=2.5, alpha=0.5, solid_capstyle='butt')
                axis.plot(entry.value, k, 'o', color=colour, markersize=4)
            axis.set_title(f'{name} [{result.parameters[name].unit}]')
            axis.set_yticks(range(len(rows)), [label for label, _, _ in rows])
            axis.set_ylim(len(rows) - 0.5, -0.5)
            axis.xaxis.set_major_locator(MaxNLocator(3))
            axis.ticklabel_format(axis='x', style='sci', scilimits=(-2, 3), useOffset=False)
        for axis in axes[len(names) :]:
            axis.set_visible(False)

    return _picture(
        'parameters',
        'Parameters and their 95 % intervals',
        'Each criterion estimates the same parameters in its own way'
        + (f'; black: {reference_name}.' if reference is not None else '.')
        + ' Bars are 95 % intervals; of a dot alone it is too short to be seen, or not known.',
        'Good intervals are short and overlap'
        + (', the published one with the black one first of all' if reference is not None else '')
        + '; where criteria disagree, the residuals tell which of them is bent.',
        0.55 + lines * (0.62 + 0.17 * len(rows)),
        draw,
    )


def draw_correlation(result: Result) -> Picture | None:
    """Draw the correlation matrix of the published estimate; None where it has none."""
    names = list(result.parameters)
    matrix = np.array(result.criteria[result.criterion].correlation, dtype=float)
    if not np.isfinite(matrix).any():
        return None

    def draw(figure: Figure) -> None:
        axis = figure.subplots()
        axis.imshow(matrix, cmap='RdBu_r', vmin=-1, vmax=1)
        for row, column in np.argwhere(np.isfinite(matrix)):
            value = matrix[row, column]
            axis.text(
                column,
                row,
                f'{value:.2f}'.replace('0.', '.').replace('1.00', '1').replace('-.00', '.00'),
                ha='center',
                va='center',
                fontsize=8 if len(names) < 11 else 6,
                color='white' if abs(value) > 0.6 else 'black',
            )
        axis.set_xticks(range(len(names)), names)
        axis.set_yticks(range(len(names)), names)
        axis.tick_params(length=0, labelsize=8 if len(names) < 11 else 7)
        axis.grid(False)

    return _picture(
        'correlation',
        'Which parameters are told apart',
        'Correlations of the errors of the published estimate, by the information in the motion. Empty rows are '
        'parameters on a bound.',
        'Good is pale off the diagonal; a deep colour near plus or minus one says that the motion tells only a '
        'combination of the two parameters, so that both may be wrong together and predict well nevertheless.',
        4.6,
        draw,
    )


def draw_excitation(names: Sequence[str], excitation: Excitation) -> Picture:
    """Draw what each parameter does in the equation of each joint, and what no other could do in its place."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots(1, 2, sharey=True)
        at = np.arange(len(names))
        for k, (axis, joint) in enumerate(zip(axes, ('shoulder', 'elbow'), strict=True)):
            term, own, residual = excitation.term[:, k], excitation.own[:, k], excitation.residual[k]
            largest = max(term.max(), residual)
            least = 10.0 ** np.floor(np.log10(max(min(residual, largest * 1e-3), largest * 1e-7, 1e-300)) - 0.5)
            axis.barh(at, np.maximum(term - least, 0), left=least, color=COLOURS[0], alpha=0.35, label='all it does')
            axis.barh(at, np.maximum(own - least, 0), left=least, height=0.45, color=COLOURS[0], label='it alone')
            axis.axvline(max(residual, least), color=SIMULATED, linestyle='--', label='unexplained')
            axis.set_xscale('log')
            axis.set_xlim(least, 2 * largest)
            axis.set_title(f"{joint}'s equation")
            axis.set_xlabel('root mean square [N m]')
            axis.set_yticks(at, names)
            axis.grid(False, axis='y')
        axes[0].invert_yaxis()
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc='lower center', ncols=3, bbox_to_anchor=(0.5, 1.0))

    return _picture(
        'excitation',
        'What the motion excites',
        "How large each parameter's part is in the two equations of motion, under the bumps of the weak criterion on "
        'training data: in pale all of it, in dark what no combination of the other parameters could do '
        'instead. A parameter that was found to be zero has no bar.',
        'Good excitation brings every dark bar well beyond the dashed line in at least one of the equations; a '
        'parameter whose bars all end before it is drowned, and one that is pale but not dark cannot be told from '
        'others: move that joint faster, or through more of its turn.',
        1.4 + 0.26 * len(names),
        draw,
    )


def envelope(t: Array, y: Array, most: int = MOST_POINTS) -> tuple[Array, Array]:
    """Return a line of at most ``most`` points that covers what the line through all points covers.

    Of each interval of time the lowest and the highest point are kept, in their order; lines that are short already
    stay as they are.

    Args:
        t: shape (N,).
        y: shape (N,).
        most: points to return.
    """
    if len(t) <= most:
        return t, y
    edges = np.linspace(0, len(t), most // 2 + 1).astype(int)
    kept = []
    for low, high in itertools.pairwise(edges):
        part = np.nan_to_num(y[low:high])
        kept += sorted((low + int(part.argmin()), low + int(part.argmax())))
    return t[kept], y[kept]


def _picture(name: str, title: str, shows: str, good: str, height: float, draw: Callable[[Figure], None]) -> Picture:
    with style(STYLE):
        figure = Figure(figsize=(WIDTH, height), layout='constrained')
        draw(figure)
        files = rendered(figure, bbox_inches='tight')
    return Picture(name, title, shows.strip(), good, files['svg'].decode(), files['png'])


def _legend(axis: Axes, handles: Sequence[Any], labels: Sequence[str] | None = None) -> None:
    """Put a legend above an axis, where it covers nothing."""
    texts = [handle.get_label() for handle in handles] if labels is None else labels
    axis.legend(handles, texts, loc='lower left', bbox_to_anchor=(0, 1.0), ncols=4, borderaxespad=0.2)


def _recording(motion: Trajectory) -> str:
    """Return the name of the bag that a motion is a window of."""
    return motion.name.rpartition('@')[0] or motion.name


def _placed(motions: Sequence[Trajectory]) -> list[float]:
    """Return what to add to each motion's times [s] so that different recordings stand one after the other."""
    ends: dict[str, float] = {}
    for motion in motions:
        ends[_recording(motion)] = max(ends.get(_recording(motion), 0.0), float(motion.t[-1]))
    begins = dict(zip(ends, np.cumsum([0.0, *ends.values()]), strict=False))
    return [float(begins[_recording(motion)]) for motion in motions]


def _one_after_the_other(times: Sequence[Array]) -> list[float]:
    """Return what to add to each recording's times [s]: 0 to the first, the others behind it."""
    places, end = [], None
    for t in times:
        places.append(0.0 if end is None else end - float(t[0]))
        end = float(t[-1]) + places[-1]
    return places
