# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The experiments that ``pendubot reproduce`` runs, and the files that come of them."""

from __future__ import annotations

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
from pendubot_identification.files import OutputFolder
from pendubot_identification.identify.pipeline import identify
from pendubot_identification.identify.settings import Settings
from pendubot_identification.model.parameters import MODELS, Parameters, default_bounds
from pendubot_identification.recordings.datasets import Datasets, load_datasets
from pendubot_identification.report.style import rendered, style
from pendubot_identification.resources import resource
from pendubot_identification.trajectories.trajectory import Trajectory

from . import paper_figures, paper_tables, trials
from .paper_tables import Table

SAMPLE = 'bags/paper_experiment'
HEAD = """\
# The paper, reproduced

N. S. Nguyen and D. K. Nguyen, *Parameter estimation of Pendubot model using modified differential evolution algorithm*,
2018, doi:10.1080/02286203.2018.1525938, held against this package. Made by

    pendubot reproduce{only} --runs {runs} --seed {seed}

version {version}. The same command gives the same files, byte for byte; times.md and times.csv alone hold measured
times, and those differ. What in the paper is ambiguous or lost, and what was chosen instead, is in docs/paper.md of the
package."""


class Reproduction:
    """The experiments, a method each, which write the parts that are wanted: what is done is on the disk.

    A table has so many ``runs``; ``quiet``: show no progress, not even on a terminal.
    """

    def __init__(self, folder: OutputFolder, wanted: Collection[str], seed: int, runs: int, *, quiet: bool) -> None:
        self._folder, self._wanted, self._seed, self._runs, self._quiet = folder, wanted, seed, runs, quiet
        #: Tables, and figures as (name, caption), in the order in which they stand in index.md.
        self._contents: list[Table | tuple[str, str]] = []
        self._raw: list[str] = []

    def competition(self) -> None:
        """Run four algorithms on four functions."""
        outcomes, seconds = self._run('competition', trials.competition(self._seed, self._runs))
        self._add_tables(*paper_tables.table_4(outcomes, self._runs))
        if 'table4' in self._wanted:
            times = paper_tables.times(outcomes, seconds)
            self._folder.write('times.md', times.markdown())
            self._folder.write('times.csv', times.csv())
        what = (
            'median of the best error so far, 10th to 90th percentile shaded, of all runs; a mark where the last run '
            'ends'
        )
        over = f'Figure 1 over function values, which cost alike whoever asks for them: {what}'
        self._add_figure('figure1', f'Figure 1: {what}', paper_figures.convergence, outcomes)
        self._add_figure('figure1_evaluations', over, paper_figures.convergence, outcomes, 'function values')

    def identification(self) -> None:
        """Identify the sample bag by the paper's criterion and MDE."""
        data = _sample()
        halves = [*data.training, *data.validation]
        found = self._identify(data, *halves)
        self._write_raw('identification', found)
        self._add_tables(paper_tables.table_7(found), paper_tables.table_8(found))
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
        """Write index.md: how all was made, ``only`` being the option as given, all parts, and which are missing."""
        parts = [HEAD.format(only=only, runs=self._runs, seed=self._seed, version=__version__) + '\n']
        if missing:
            parts.append(f'**Not finished:** {", ".join(missing)} are missing here.\n')
        for entry in self._contents:
            if isinstance(entry, Table):
                parts.append(entry.markdown())
            else:
                name, caption = entry
                parts.append(f'![{caption}](figures/{name}.png)\n\n{caption} ([SVG](figures/{name}.svg))\n')
        files = ', '.join(f'[{name}]({name})' for name in self._raw)
        parts.append(f'## Raw runs\n\nSeeds and every run: {files}. Tables as CSV and Markdown: `tables/`.\n')
        self._folder.write('index.md', '\n'.join(parts))

    def data(self) -> dict[str, Any]:
        """Return what ``--json`` prints."""
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
        """Return what came of an experiment, and what each part took [s]; an interrupt writes what is done, too."""
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

    def _identify(self, data: Datasets, training: Trajectory, validation: Trajectory) -> dict[str, Any]:
        """Return the identification in the paper's settings as plain data."""
        # At no spread a run stops early: every generation is taken, as in the paper.
        settings = Settings(('energy',), 'viscous', 'mde', spread=0.0, runs=self._runs, seed=self._seed)
        with self._progress('identification') as bar:

            def tell(what: str, done: int, of: int, best: float) -> None:
                bar.total = of or None
                bar.update(done - bar.n)

            best = identify([training], [validation], settings, tell).best
        assert best.runs is not None  # for the type checker; MDE was asked for
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
        """Return a bar that shows on a terminal, and nowhere else, what is being done."""
        return tqdm(desc=experiment, disable=True if self._quiet else None, leave=False)

    def _write_raw(self, experiment: str, data: dict[str, Any]) -> None:
        name = f'runs/{experiment}.json'
        self._folder.write(name, json.dumps({'seed': self._seed, 'runs': self._runs, **data}, indent=1) + '\n')
        self._raw.append(name)

    def _wants(self, name: str) -> bool:
        """Whether a table or figure belongs to the parts that are wanted: figure1_evaluations belongs to figure1."""
        return name.partition('_')[0] in self._wanted

    def _add_tables(self, *tables: Table) -> None:
        for table in tables:
            if self._wants(table.name):
                self._folder.write(f'tables/{table.name}.md', table.markdown())
                self._folder.write(f'tables/{table.name}.csv', table.csv())
                self._contents.append(table)

    def _add_figure(self, name: str, caption: str, draw: Callable[..., Figure], *arguments: Any) -> None:
        if self._wants(name):
            with style():
                files = rendered(draw(*arguments))
            for ending, content in files.items():
                self._folder.write(f'figures/{name}.{ending}', content)
            self._contents.append((name, caption))


def _sample() -> Datasets:
    return load_datasets([str(resource(SAMPLE))])
