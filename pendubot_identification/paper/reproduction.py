# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot reproduce``: the experiments of the paper, and the files with their results."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Collection, Iterable
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from pendubot_identification import __version__
from pendubot_identification.criteria.energy import energy_regression
from pendubot_identification.criteria.quadratic import Quadratic
from pendubot_identification.errors import PendubotError, UsageError
from pendubot_identification.files import OutputFolder
from pendubot_identification.identify.pipeline import identify
from pendubot_identification.identify.settings import Settings
from pendubot_identification.model.parameters import MODELS, Parameters, default_bounds
from pendubot_identification.recordings.datasets import Datasets, load_datasets
from pendubot_identification.report.style import rendered, style
from pendubot_identification.resources import resource

from . import paper_figures, paper_tables, trials
from .paper_tables import Table

#: The parts by the method of :class:`Reproduction` that makes them.
EXPERIMENTS = {
    'competition': ('table4', 'figure1'),
    'identification': ('table7', 'table8', 'dataset', 'fit'),
    'sweep': ('threshold', 'operator'),
    'dimensions': ('dimensions',),
}
PARTS = tuple(part for parts in EXPERIMENTS.values() for part in parts)
SAMPLE = 'bags/paper_experiment'
HEAD = """\
# The paper, reproduced

N. S. Nguyen and D. K. Nguyen, *Parameter estimation of Pendubot model using modified differential evolution algorithm*,
2018, doi:10.1080/02286203.2018.1525938, held against this package. Made by

    pendubot reproduce{only} --runs {runs} --seed {seed}

version {version}. The same command gives the same files, byte for byte; times.md and times.csv alone hold measured
times, and those differ. What in the paper is ambiguous or lost, and what was chosen instead, is in docs/paper.md of the
package.
"""


def run(args: argparse.Namespace) -> int:
    """Run the experiments, write, print."""
    wanted = tuple(dict.fromkeys(name.strip() for name in args.only.split(','))) if args.only else PARTS
    if unknown := [name for name in wanted if name not in PARTS]:
        raise UsageError(f'there is no {unknown[0]!r}; name some of {", ".join(PARTS)}')
    if not 1 <= args.runs <= trials.MOST_RUNS:
        raise UsageError(f'{args.runs} runs were asked for; a number from 1 to {trials.MOST_RUNS} is expected')
    if args.seed < 0:
        raise UsageError(f'the seed is {args.seed}; a whole number of at least 0 is expected')
    made = Reproduction(OutputFolder(args.output, overwrite=args.force), wanted, args.seed, args.runs, quiet=args.json)
    done: list[str] = []
    try:
        for experiment, parts in EXPERIMENTS.items():
            if here := [part for part in parts if part in wanted]:
                getattr(made, experiment)()
                done += here
    except KeyboardInterrupt:
        raise PendubotError(
            f'interrupted; what is done is kept in {args.output}: {", ".join(done) or "raw runs only"}. '
            'For the rest run it again with --only and another --output'
        ) from None
    finally:
        only = '' if len(wanted) == len(PARTS) else f' --only {",".join(wanted)}'
        made.write_index(only, [part for part in wanted if part not in done])
    print(json.dumps(made.data(), indent=2) if args.json else f'{", ".join(done)}: read {args.output / "index.md"}')
    return 0


class Reproduction:
    """The experiments, a method each; each writes its wanted parts as soon as they are made.

    ``runs`` are those of a table; ``quiet`` hides the progress.
    """

    def __init__(self, folder: OutputFolder, wanted: Collection[str], seed: int, runs: int, *, quiet: bool) -> None:
        self._folder, self._wanted, self._seed, self._runs, self._quiet = folder, wanted, seed, runs, quiet
        #: Tables, and figures as (name, caption), in the order of index.md.
        self._contents: list[Table | tuple[str, str]] = []
        self._raw: list[str] = []

    def competition(self) -> None:
        """Run four algorithms on four functions."""
        outcomes, seconds = self._run('competition', trials.competition(self._seed, self._runs))
        self._add_tables(*paper_tables.table_4(outcomes, self._runs))
        if 'table4' in self._wanted:
            times = paper_tables.times(outcomes, seconds)
            self._folder.write({'times.md': times.markdown(), 'times.csv': times.csv()})
        what = (
            'median of the best error so far, 10th to 90th percentile shaded, of all runs; a mark where the last run '
            'ends'
        )
        over = f'Figure 1 over function values, whose cost is the same for all: {what}'
        self._add_figure('figure1', f'Figure 1: {what}', paper_figures.convergence, outcomes)
        self._add_figure('figure1_evaluations', over, paper_figures.convergence, outcomes, 'function values')

    def identification(self) -> None:
        """Identify the sample bag by the paper's criterion and MDE."""
        data = _sample()
        found = self._identify(data)
        self._write_raw('identification', found)
        self._add_tables(paper_tables.table_7(found), paper_tables.table_8(found))
        halves = *data.training, *data.validation
        caption = 'The sample bag: the experiment of Section 4.4 on the virtual rig'
        self._add_figure('dataset', caption, paper_figures.data_set, *halves)
        caption = (
            'The fit: both sides of the energy balance, cumulative from the start of each half; its residual; the '
            f'motion simulated with the identified parameters, {paper_figures.PIECE:g} s at a time'
        )
        self._add_figure('fit', caption, paper_figures.fit, *halves, Parameters.from_vector(found['theta']))

    def sweep(self) -> None:
        """Run MDE with every threshold, per component and per vector."""
        regression = energy_regression(_sample().training[0])
        criterion, bounds = Quadratic.reduce(regression.phi, regression.y), default_bounds().of(MODELS['viscous'])
        outcomes, _ = self._run('sweep', trials.sweep(self._seed, self._runs, criterion, bounds))
        self._add_tables(paper_tables.threshold_table(outcomes))
        caption = 'The threshold: how fast MDE arrives, and how often'
        self._add_figure('threshold', caption, paper_figures.threshold, outcomes)
        self._add_tables(paper_tables.operator_table(outcomes))

    def dimensions(self) -> None:
        """Run all algorithms with equal budgets in 2, 10 and 30 dimensions."""
        outcomes, _ = self._run('dimensions', trials.dimensions(self._seed, self._runs))
        counts, errors = paper_tables.dimensions_tables(outcomes)
        caption = (
            'Beyond the paper: final errors with equal budgets; median and range of all runs; the line is the target'
        )
        self._add_tables(counts)
        self._add_figure('dimensions', caption, paper_figures.dimensions, outcomes)
        self._add_tables(errors)

    def write_index(self, only: str, missing: Collection[str]) -> None:
        """Write index.md with all parts; ``only`` is the option as given, ``missing`` are parts that are not made."""
        texts = [HEAD.format(only=only, runs=self._runs, seed=self._seed, version=__version__)]
        if missing:
            texts.append(f'**Not finished:** {", ".join(missing)} are missing here.\n')
        for entry in self._contents:
            if isinstance(entry, Table):
                texts.append(entry.markdown())
            else:
                name, caption = entry
                texts.append(f'![{caption}](figures/{name}.png)\n\n{caption} ([SVG](figures/{name}.svg))\n')
        files = ', '.join(f'[{name}]({name})' for name in self._raw)
        texts.append(f'## Raw runs\n\nSeeds and every run: {files}. Tables as CSV and Markdown: `tables/`.\n')
        self._folder.write({'index.md': '\n'.join(texts)})

    def data(self) -> dict[str, Any]:
        """Return the tables and the names of the other files, for ``--json``."""
        return {
            'version': __version__,
            'seed': self._seed,
            'runs': self._runs,
            'output': str(self._folder.path),
            'tables': {entry.name: entry.data() for entry in self._contents if isinstance(entry, Table)},
            'figures': [entry[0] for entry in self._contents if not isinstance(entry, Table)],
            'raw': self._raw,
        }

    def _run(self, experiment: str, outcomes: Iterable[trials.Outcome]) -> tuple[list[trials.Outcome], list[float]]:
        """Return the outcomes of an experiment and the time of each [s]; an interrupt, too, writes the raw runs."""
        done: list[trials.Outcome] = []
        ends, complete = [time.perf_counter()], False
        try:
            with self._progress(experiment) as bar:
                for outcome in outcomes:
                    ends.append(time.perf_counter())
                    done.append(outcome)
                    bar.set_postfix_str(f'{outcome.algorithm} on {outcome.function}', refresh=False)
                    bar.update()
            complete = True
        finally:
            self._write_raw(experiment, {'complete': complete, 'trials': [outcome.data() for outcome in done]})
        return done, np.diff(ends).tolist()

    def _identify(self, data: Datasets) -> dict[str, Any]:
        """Return the identification with the paper's settings as plain data."""
        # Without a spread, every run takes all generations, as in the paper.
        settings = Settings(('energy',), 'viscous', 'mde', spread=0.0, runs=self._runs, seed=self._seed)
        with self._progress('identification') as bar:

            def report(what: str, done: int, of: int, best: float) -> None:
                bar.total = of or None
                bar.update(done - bar.n)

            best = identify(data.training, data.validation, settings, report).best
        assert best.runs is not None  # MDE was asked for
        mde, _ = settings.search('energy', 'viscous')
        return {
            'bag': SAMPLE,
            'sha256': data.sources[0].sha256,
            'samples': [source.samples for source in data.sources],
            'population': mde.population,
            'generations': mde.generations,
            'J_training': best.J_runs.tolist(),
            'J_validation': best.J_validation_runs.tolist(),
            'J_exact': best.J_exact,
            'reached': best.runs_at_minimum,
            'theta': best.theta.tolist(),
            'std_error': best.std_error.tolist(),
            'theta_runs': best.runs.x.tolist(),
            'generations_runs': best.runs.generations.tolist(),
            'warnings': list(best.warnings),
        }

    def _progress(self, experiment: str) -> Any:
        """Return a progress bar, which shows on a terminal only."""
        return tqdm(desc=experiment, disable=True if self._quiet else None, leave=False)

    def _write_raw(self, experiment: str, data: dict[str, Any]) -> None:
        name = f'runs/{experiment}.json'
        text = json.dumps({'seed': self._seed, 'runs': self._runs, **data}, indent=1) + '\n'
        self._folder.write({name: text})
        self._raw.append(name)

    def _wants(self, name: str) -> bool:
        """Return whether a table or figure belongs to a wanted part, such as figure1_evaluations to figure1."""
        return name.partition('_')[0] in self._wanted

    def _add_tables(self, *tables: Table) -> None:
        for table in tables:
            if self._wants(table.name):
                name = f'tables/{table.name}'
                self._folder.write({f'{name}.md': table.markdown(), f'{name}.csv': table.csv()})
                self._contents.append(table)

    def _add_figure(self, name: str, caption: str, draw: Callable[..., Figure], *arguments: Any) -> None:
        if self._wants(name):
            with style():
                files = rendered(draw(*arguments))
            self._folder.write({f'figures/{name}.{ending}': content for ending, content in files.items()})
            self._contents.append((name, caption))


def _sample() -> Datasets:
    return load_datasets([str(resource(SAMPLE))])
