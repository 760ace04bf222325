# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot reproduce``: runs the experiments of the paper, and writes their results."""

import argparse
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from pendubot_identification import __version__
from pendubot_identification.criteria.energy import energy_regression
from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.errors import PendubotError, UsageError
from pendubot_identification.files import OutputFolder
from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.settings import Settings
from pendubot_identification.model.parameters import MODELS, default_bounds
from pendubot_identification.recordings.datasets import Datasets, load_datasets
from pendubot_identification.report.plots import GREY, rendered, style
from pendubot_identification.resources import resource

from . import paper_tables, trials
from .paper_tables import Table
from .trials import ALGORITHMS, TARGET, Outcome

SAMPLE = 'bags/paper_experiment'
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
HEAD = """\
# The paper, reproduced

N. S. Nguyen and D. K. Nguyen, *Parameter estimation of Pendubot model using modified differential evolution algorithm*,
2018, doi:10.1080/02286203.2018.1525938, compared with this package. Written by

    pendubot reproduce{only} --runs {runs} --seed {seed}

version {version}. The same command gives the same files, byte for byte; only times.md and times.csv differ, with
measured times. docs/paper.md of the package lists ambiguous or missing details of the paper, and the choices made.
"""


def run_reproduce(args: argparse.Namespace) -> int:
    """Run the experiments, write the results, and print their folder."""
    parts = [part for group in EXPERIMENTS for part in group]
    wanted = list(dict.fromkeys(name.strip() for name in args.only.split(','))) if args.only else parts
    if unknown := [name for name in wanted if name not in parts]:
        raise UsageError(f'there is no {unknown[0]!r}; name some of {", ".join(parts)}')
    if not 1 <= args.runs <= trials.MOST_RUNS:
        raise UsageError(f'--runs is {args.runs}; a number from 1 to {trials.MOST_RUNS} is expected')
    if args.seed < 0:
        raise UsageError(f'the seed is {args.seed}; a whole number of at least 0 is expected')
    folder, texts, done = OutputFolder(args.output, overwrite=args.force), list[str](), list[str]()
    try:
        for group, experiment in EXPERIMENTS.items():
            if selected := [part for part in group if part in wanted]:
                for part, files, text in experiment(args.seed, args.runs):
                    if part in wanted:
                        folder.write(files)
                        texts += [text] if text else []
                done += selected
    except KeyboardInterrupt:
        raise PendubotError(
            f'interrupted; finished parts in {args.output}: {", ".join(done) or "none"}. '
            'For the rest run it again with --only and another --output'
        ) from None
    finally:
        only = '' if len(wanted) == len(parts) else f' --only {",".join(wanted)}'
        if missing := [part for part in wanted if part not in done]:
            texts.insert(0, f'**Not finished:** {", ".join(missing)} are missing here.\n')
        head = HEAD.format(only=only, runs=args.runs, seed=args.seed, version=__version__)
        folder.write({'index.md': '\n'.join([head, *texts])})
    print(f'{", ".join(done)}: read {args.output / "index.md"}')
    return 0


#: The part of the reproduction, the files with their contents, and the text in index.md.
Output = tuple[str, Mapping[str, Any], str]


def _competition(seed: int, runs: int) -> Iterator[Output]:
    """Run four algorithms on four functions."""
    outcomes, seconds = _timed('competition', trials.competition(seed, runs))
    for table in paper_tables.table_4(outcomes, runs):
        yield _written('table4', table)
    times = paper_tables.times(outcomes, seconds)
    yield 'table4', {'times.md': times.markdown(), 'times.csv': times.csv()}, ''
    with style():
        files = rendered(_convergence(outcomes))
    caption = (
        'Figure 1: median of the best error so far of all runs, shaded from 10th to 90th percentile; the marker is at '
        'the end of the last run'
    )
    text = f'![{caption}](figures/figure1.png)\n\n{caption} ([SVG](figures/figure1.svg))\n'
    yield 'figure1', {f'figures/figure1.{ending}': content for ending, content in files.items()}, text


def _identification(seed: int, runs: int) -> Iterator[Output]:
    """Identify the sample bag with the paper's criterion and MDE."""
    data = _sample()
    # With spread 0, every run has all generations, as in the paper.
    settings = Settings(('energy',), 'viscous', 'mde', spread=0.0, runs=runs, seed=seed)
    with _progress('identification') as bar:

        def report(step: str, done: int, of: int, best: float) -> None:
            bar.total = of or None
            bar.update(done - bar.n)

        best = identify(data.training, data.validation, settings, report).best
    samples, (mde, _) = [source.samples for source in data.sources], settings.search('energy', 'viscous')
    yield _written('table7', paper_tables.table_7(best, mde, samples))
    yield _written('table8', paper_tables.table_8(best))


def _sweep(seed: int, runs: int) -> Iterator[Output]:
    """Run MDE with every threshold, per component and per vector."""
    regression = energy_regression(_sample().training[0])
    criterion, bounds = Quadratic.reduce(regression.phi, regression.y), default_bounds().of(MODELS['viscous'])
    outcomes, _ = _timed('sweep', trials.sweep(seed, runs, criterion, bounds))
    yield _written('threshold', paper_tables.threshold_table(outcomes))
    yield _written('operator', paper_tables.operator_table(outcomes))


#: The experiments by the parts that they give.
EXPERIMENTS = {
    ('table4', 'figure1'): _competition,
    ('table7', 'table8'): _identification,
    ('threshold', 'operator'): _sweep,
}


def _written(part: str, table: Table) -> Output:
    text = table.markdown()
    return part, {f'tables/{table.name}.md': text, f'tables/{table.name}.csv': table.csv()}, text


def _timed(experiment: str, outcomes: Iterable[Outcome]) -> tuple[list[Outcome], list[float]]:
    """Return the outcomes of an experiment and the time of each [s]."""
    done: list[Outcome] = []
    ends = [time.perf_counter()]
    with _progress(experiment) as bar:
        for outcome in outcomes:
            ends.append(time.perf_counter())
            done.append(outcome)
            bar.set_postfix_str(f'{outcome.algorithm} on {outcome.function}', refresh=False)
            bar.update()
    return done, np.diff(ends).tolist()


def _progress(experiment: str) -> Any:
    """Return a progress bar, which is visible only on a terminal."""
    return tqdm(desc=experiment, disable=None, leave=False)


def _sample() -> Datasets:
    return load_datasets([str(resource(SAMPLE))])


def _convergence(outcomes: Sequence[Outcome]) -> Figure:
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
