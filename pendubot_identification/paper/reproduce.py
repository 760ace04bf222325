# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot reproduce``: the paper's tables and figures, beside what this package finds."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pendubot_identification.errors import UsageError

if TYPE_CHECKING:
    from pendubot_identification.files import OutputFolder
    from pendubot_identification.identify.identification import Identification
    from pendubot_identification.identify.settings import Settings
    from pendubot_identification.paper.paper_tables import Table
    from pendubot_identification.paper.trials import Outcome, Trial
    from pendubot_identification.recordings.datasets import Datasets

#: What can be asked for, and the experiment that it is made of.
PARTS = {
    'table4': 'competition',
    'figure1': 'competition',
    'table7': 'identification',
    'table8': 'identification',
    'dataset': 'identification',
    'fit': 'identification',
    'threshold': 'sweep',
    'operator': 'sweep',
    'dimensions': 'dimensions',
}
SAMPLE = 'bags/paper_experiment'
#: Length [s] of the simulations in the figure of the fit.
PIECE = 1.0

DESCRIPTION = """\
Reproduce the paper: its tables and figures from this package's own runs, each number beside the paper's, in one folder
with an index.md to read. It takes less than a minute.

  table4      errors of PSO, DE, HDE and MDE on four functions; where MDE is ahead; times
  figure1     their convergence
  table7      J of ten identifications on the sample bag     table8      the parameters
  dataset     the recording                                  fit         how the parameters explain it
  threshold   the sweep that the paper speaks of without showing it
  operator    its operator drawn per component against per vector
  dimensions  beyond the paper: 2, 10 and 30 dimensions, equal budgets, rank-sum tests

The same seed gives the same files, byte for byte; only times.md and times.csv differ, which hold measured times. An
interrupt keeps what is done.
"""


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser(
        'reproduce',
        help="reproduce the paper's tables and figures",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        '--only', type=_parts, default=tuple(PARTS), metavar='NAME[,NAME ...]', help='some of the above (default: all)'
    )
    parser.add_argument(
        '--runs',
        type=int,
        default=10,
        metavar='N',
        help='runs of a table, as in the paper (default %(default)s); how often an algorithm arrives is counted over '
        '10 N, the sweep takes 5 N',
    )
    parser.add_argument('--seed', type=int, default=1, help='of all random numbers (default %(default)s)')
    parser.add_argument(
        '--output', type=Path, default=Path('reproduction'), metavar='DIR', help='a new folder (default %(default)s)'
    )
    parser.add_argument('--force', action='store_true', help='write into an existing folder, over files of these names')
    parser.add_argument('--json', action='store_true', help='print the tables as JSON and nothing else')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the experiments, write, print."""
    from pendubot_identification.errors import PendubotError
    from pendubot_identification.files import OutputFolder
    from pendubot_identification.paper.trials import MOST_RUNS

    if not 1 <= args.runs <= MOST_RUNS:
        raise UsageError(f'{args.runs} runs were asked for; a number from 1 to {MOST_RUNS} is expected')
    if args.seed < 0:
        raise UsageError(f'the seed is {args.seed}; a whole number of at least 0 is expected')
    made = _Reproduction(OutputFolder(args.output, overwrite=args.force), args)
    try:
        made.everything()
    except KeyboardInterrupt:
        raise PendubotError(
            f'interrupted; what is done is kept in {args.output}: {", ".join(made.done) or "raw runs only"}. '
            'For the rest run it again with --only and another --output'
        ) from None
    finally:
        made.write_index()
    if args.json:
        print(json.dumps(made.data(), indent=2))
    else:
        print(f'{", ".join(made.done)}: read {args.output / "index.md"}')
    return 0


class _Reproduction:
    """Experiments in, files out; what is done is on the disk."""

    def __init__(self, folder: OutputFolder, args: argparse.Namespace) -> None:
        self._folder, self._seed, self._runs, self._only = folder, args.seed, args.runs, args.only
        self._quiet = args.json
        self._contents: list[Table | tuple[str, str]] = []
        self._raw: list[str] = []
        self.done: list[str] = []

    def everything(self) -> None:
        """Run the experiments that the chosen parts need."""
        for experiment in dict.fromkeys(PARTS[part] for part in PARTS if part in self._only):
            getattr(self, f'_{experiment}')()
            self.done += [part for part in PARTS if part in self._only and PARTS[part] == experiment]

    def write_index(self) -> None:
        """Write index.md of what there is."""
        from pendubot_identification import __version__
        from pendubot_identification.paper.reproduction import index

        only = '' if len(self._only) == len(PARTS) else f' --only {",".join(self._only)}'
        command = f'pendubot reproduce{only} --runs {self._runs} --seed {self._seed}'
        missing = [part for part in self._only if part not in self.done]
        self._folder.write('index.md', index(command, __version__, self._contents, self._raw, missing))

    def data(self) -> dict[str, Any]:
        """Return what ``--json`` prints."""
        from pendubot_identification import __version__

        return {
            'version': __version__,
            'seed': self._seed,
            'runs': self._runs,
            'output': str(self._folder.path),
            'tables': {entry.name: entry.data() for entry in self._contents if not isinstance(entry, tuple)},
            'figures': [entry[0] for entry in self._contents if isinstance(entry, tuple)],
            'raw': self._raw,
        }

    def _competition(self) -> None:
        from pendubot_identification.paper import paper_figures, paper_tables
        from pendubot_identification.paper.trials import competition

        outcomes = self._run_trials('competition', competition(self._seed, self._runs))
        if 'table4' in self._only:
            for table in paper_tables.table_4(outcomes, self._runs):
                self._add_table(table)
            times = paper_tables.times(outcomes)
            self._folder.write('times.md', times.markdown())
            self._folder.write('times.csv', times.csv())
        if 'figure1' in self._only:
            what = (
                'median of the best error so far, 10th to 90th percentile shaded, of all runs; a mark where '
                'the last run ends'
            )
            self._add_figure('figure1', f'Figure 1: {what}', paper_figures.convergence, outcomes)
            caption = f'Figure 1 over function values, which cost alike whoever asks for them: {what}'
            self._add_figure('figure1_evaluations', caption, paper_figures.convergence, outcomes, 'function values')

    def _identification(self) -> None:
        from pendubot_identification.identify.identification import identify
        from pendubot_identification.identify.settings import Settings
        from pendubot_identification.model.parameters import Parameters
        from pendubot_identification.paper import paper_figures, paper_tables
        from pendubot_identification.paper.explained import energy_balance, predicted
        from pendubot_identification.trajectories.long import held_parts

        data = _sample()
        training, validation = held_parts([*data.training, *data.validation])
        # At no spread a run stops early: every generation is taken, as in the paper.
        settings = Settings(('energy',), 'viscous', 'mde', mde={'spread': None}, runs=self._runs, seed=self._seed)
        with self._progress('identification') as bar:

            def tell(what: str, done: int, of: int, best: float) -> None:
                bar.total = of or None
                bar.update(done - bar.n)

            found = _plain(identify([training], [validation], settings, tell), data, settings)
        self._write_raw('identification', found)
        if 'table7' in self._only:
            self._add_table(paper_tables.table_7(found))
        if 'table8' in self._only:
            self._add_table(paper_tables.table_8(found))
        if 'dataset' in self._only:
            caption = 'The sample bag: the experiment of Section 4.4 on the virtual rig'
            self._add_figure('dataset', caption, paper_figures.data_set, training, validation)
        if 'fit' in self._only:
            theta = Parameters.from_vector(found['theta'])
            caption = (
                'The fit: both sides of the energy balance, cumulative from the start of each half; its residual; the '
                f'motion simulated with the identified parameters, {PIECE:g} s at a time'
            )
            balances = [energy_balance(motion, theta.vector()) for motion in (training, validation)]
            pieces = predicted(validation, theta, PIECE)
            self._add_figure('fit', caption, paper_figures.fit, training, validation, balances, pieces)

    def _sweep(self) -> None:
        from pendubot_identification.criteria.energy import energy_regression
        from pendubot_identification.criteria.quadratic import Quadratic
        from pendubot_identification.model.parameters import MODELS, default_bounds
        from pendubot_identification.paper import paper_figures, paper_tables
        from pendubot_identification.paper.trials import sweep
        from pendubot_identification.trajectories.long import held_parts

        regression = energy_regression(held_parts(_sample().training)[0])
        criterion = Quadratic.reduce(regression.phi, regression.y)
        trials = sweep(self._seed, self._runs, criterion, default_bounds().of(MODELS['viscous']))
        outcomes = self._run_trials('sweep', trials)
        if 'threshold' in self._only:
            self._add_table(paper_tables.threshold_table(outcomes))
            caption = 'The threshold: how fast MDE arrives, and how often'
            self._add_figure('threshold', caption, paper_figures.threshold, outcomes)
        if 'operator' in self._only:
            self._add_table(paper_tables.operator_table(outcomes))

    def _dimensions(self) -> None:
        from pendubot_identification.paper import paper_figures, paper_tables
        from pendubot_identification.paper.trials import dimensions

        outcomes = self._run_trials('dimensions', dimensions(self._seed, self._runs))
        counts, errors = paper_tables.dimensions_tables(outcomes)
        self._add_table(counts)
        caption = (
            'Beyond the paper: final errors with equal budgets; median and range of all runs; the line is the target'
        )
        self._add_figure('dimensions', caption, paper_figures.dimensions, outcomes)
        self._add_table(errors)

    def _run_trials(self, experiment: str, trials: Iterable[Trial]) -> list[Outcome]:
        """Return what came of the trials; what was done is written also after an interrupt."""
        from pendubot_identification.paper.trials import Outcome

        outcomes: list[Outcome] = []
        waiting = list(trials)
        try:
            with self._progress(experiment, len(waiting)) as bar:
                for trial in waiting:
                    begin = time.perf_counter()
                    result = trial.minimise()
                    outcomes.append(Outcome(trial, result, time.perf_counter() - begin))
                    bar.update()
        finally:
            complete = len(outcomes) == len(waiting)
            self._write_raw(experiment, {'complete': complete, 'trials': [outcome.data() for outcome in outcomes]})
        return outcomes

    def _progress(self, experiment: str, total: int | None = None) -> Any:
        """Return a bar that shows on a terminal, and nowhere else, what is being done."""
        from tqdm import tqdm

        return tqdm(desc=experiment, total=total, disable=True if self._quiet else None, leave=False)

    def _write_raw(self, experiment: str, data: dict[str, Any]) -> None:
        name = f'runs/{experiment}.json'
        self._folder.write(name, json.dumps({'seed': self._seed, 'runs': self._runs, **data}, indent=1) + '\n')
        self._raw.append(name)

    def _add_table(self, table: Table) -> None:
        self._folder.write(f'tables/{table.name}.md', table.markdown())
        self._folder.write(f'tables/{table.name}.csv', table.csv())
        self._contents.append(table)

    def _add_figure(self, name: str, caption: str, draw: Callable[..., Any], *arguments: Any) -> None:
        from pendubot_identification.report.style import rendered, style

        with style():
            files = rendered(draw(*arguments))
        for ending, content in files.items():
            self._folder.write(f'figures/{name}.{ending}', content)
        self._contents.append((name, caption))


def _sample() -> Datasets:
    from pendubot_identification.recordings.datasets import load_datasets
    from pendubot_identification.resources import resource

    return load_datasets([str(resource(SAMPLE))])


def _plain(result: Identification, data: Datasets, settings: Settings) -> dict[str, Any]:
    """Return the identification as plain data."""
    best, (mde, _) = result.best, settings.search('energy', 'viscous')
    assert best.runs is not None  # for the type checker; MDE was asked for
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


def _parts(text: str) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(name.strip() for name in text.split(',')))
    for name in names:
        if name not in PARTS:
            raise argparse.ArgumentTypeError(f'there is no {name!r}; name some of {", ".join(PARTS)}')
    return names
