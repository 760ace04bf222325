# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The tables of the paper beside the results of this package, and additional tables."""

import csv
import io
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pendubot_identification.identification.estimate import Estimate
from pendubot_identification.model.parameters import NAMES, PAPER, UNITS
from pendubot_identification.optimizers.mde import MDESettings

from .competitors import FUNCTIONS
from .trials import ALGORITHMS, IDENTIFICATION, PER_VECTOR, TARGET, Outcome, rank_sum, ranks

Cell = str | int | float | None

#: Table 4 of the paper: best, worst, average and standard deviation of the errors of 10 runs, and time of a run [s].
TABLE_4 = {
    ('Sphere', 'PSO'): (2.30e-5, 0.0028, 8.06e-4, 8.35e-4, 0.1910),
    ('Sphere', 'DE'): (3.09e-6, 9.60e-6, 6.59e-6, 2.46e-6, 0.0763),
    ('Sphere', 'HDE'): (2.21e-8, 7.58e-6, 2.85e-6, 2.44e-6, 0.2091),
    ('Sphere', 'MDE'): (4.38e-7, 5.56e-6, 3.03e-6, 1.82e-6, 0.0837),
    ('Griewank', 'PSO'): (0.0081, 0.0811, 0.0461, 0.0260, 0.1961),
    ('Griewank', 'DE'): (2.41e-6, 0.0020, 5.48e-4, 6.44e-4, 0.1453),
    ('Griewank', 'HDE'): (7.76e-6, 2.91e-4, 7.19e-5, 1.06e-4, 0.5689),
    ('Griewank', 'MDE'): (1.55e-7, 7.48e-6, 2.56e-6, 2.83e-6, 0.3522),
    ('Ackley', 'PSO'): (0.0026, 0.1291, 0.0273, 0.0379, 0.2263),
    ('Ackley', 'DE'): (3.54e-5, 0.0012, 5.49e-4, 5.00e-4, 0.1791),
    ('Ackley', 'HDE'): (5.12e-7, 4.68e-4, 1.31e-4, 1.32e-4, 0.5263),
    ('Ackley', 'MDE'): (2.15e-6, 9.97e-6, 6.58e-6, 2.93e-6, 0.1797),
    ('Rastrigin', 'PSO'): (1.41e-5, 0.9950, 0.1159, 0.3116, 0.1455),
    ('Rastrigin', 'DE'): (8.64e-6, 0.5830, 0.0609, 0.1835, 0.1020),
    ('Rastrigin', 'HDE'): (1.50e-6, 2.89e-4, 4.99e-5, 8.79e-5, 0.2884),
    ('Rastrigin', 'MDE'): (2.22e-6, 8.88e-6, 4.87e-6, 2.28e-6, 0.1182),
}
AVERAGE, TIME = 2, 4
#: Table 7 of the paper, J of 10 runs: best, worst, average. Table 8 is :data:`.model.parameters.PAPER`.
TABLE_7 = {'training': (2.37e-3, 2.39e-3, 2.37e-3), 'validation': (None, None, 3.03e-3)}
STATISTICS: dict[str, Callable[[Any], Any]] = {
    'best': np.min,
    'worst': np.max,
    'average': np.mean,
    'standard deviation': lambda values: np.std(values, ddof=1) if len(values) > 1 else 0.0,
}
#: Significance level of a difference.
ALPHA = 0.01
FIRST = (
    'Order of two runs: a run that reaches the target is first; if both reach it, the run with fewer function '
    'evaluations; if neither does, the run with the lower error. Two-sided rank-sum test.'
)
_TARGET = f'{TARGET:.0e}'.replace('e-0', 'e-')
#: Threshold of MDE in the paper.
CHOSEN = 0.3


class Table(NamedTuple):
    """A table with its columns by name, and paragraphs of notes; ``name`` is the name of its files."""

    name: str
    title: str
    columns: Mapping[str, Sequence[Cell]]
    notes: Sequence[str] = ()

    @property
    def rows(self) -> list[tuple[Cell, ...]]:
        """The cells of each row."""
        return list(zip(*self.columns.values(), strict=True))

    def markdown(self) -> str:
        """Return title, table and notes, with numbers of three or four digits."""
        lines = [self.columns, ['---'] * len(self.columns), *(map(shown, row) for row in self.rows)]
        table = '\n'.join(f'| {" | ".join(line)} |' for line in lines)
        return '\n\n'.join([f'## {self.title}', table, *self.notes]) + '\n'

    def csv(self) -> str:
        """Return header and rows, with all digits."""
        file = io.StringIO()
        csv.writer(file, lineterminator='\n').writerows([self.columns, *self.rows])
        return file.getvalue()


def shown(cell: Cell) -> str:
    """Return a cell as text, such as 0.0461, 3.03e-6 or 34."""
    if cell is None:
        return ''
    if not isinstance(cell, float):
        return str(cell)
    if not math.isfinite(cell):
        return '–'
    if cell and not 1e-3 <= abs(cell) < 1e5:
        mantissa, exponent = f'{cell:.2e}'.split('e')
        return f'{mantissa}e{int(exponent)}'
    return f'{cell:.4g}' if abs(cell) < 1000 else f'{cell:.0f}'


def table_4(outcomes: Sequence[Outcome], runs: int) -> list[Table]:
    """Return Table 4, the comparison of MDE with each other algorithm, and its generations beside the paper's times."""
    many = len(outcomes[0].result.value)
    values = [o.result.value for o in outcomes]
    columns: dict[str, list[Any]] = _named(outcomes)
    for k, (name, statistic) in enumerate(STATISTICS.items()):
        columns[name] = [statistic(errors[:runs]) for errors in values]
        columns[f'{name}, paper'] = [TABLE_4[o.function, o.algorithm][k] for o in outcomes]
    columns |= {
        f'reached, of {runs}': [_reached(errors[:runs]) for errors in values],
        f'reached, of {many}': [_reached(errors) for errors in values],
        'average of all': [errors.mean() for errors in values],
        'function values': [o.result.evaluations.mean() for o in outcomes],
        'generations': [o.result.generations.mean() for o in outcomes],
    }
    notes = [
        f'Errors at the end of {runs} runs each, n = {outcomes[0].n}; a run stops when it reaches {_TARGET}. '
        f'The last four columns are of {many} runs, which include the first {runs}. A run that never reaches '
        f'{_TARGET} counts with its whole length. The function values do not include the gradient that HDE computes in '
        'every generation.',
        'Times are in times.md: only they differ from one reproduction to the next.',
    ]
    return [Table('table4', 'Table 4: errors', columns, notes), _claims(outcomes, runs), _pace(outcomes)]


def _claims(outcomes: Sequence[Outcome], runs: int) -> Table:
    """Return the order of MDE and each other algorithm by the averages of the paper and of this package."""
    by_name = {(o.function, o.algorithm): o for o in outcomes}
    many = len(outcomes[0].result.value)
    pairs = [(by_name[f.name, 'MDE'], by_name[f.name, other]) for f in FUNCTIONS for other in ALGORITHMS[:-1]]
    paper = [TABLE_4[o.function, o.algorithm][AVERAGE] / TABLE_4[o.function, 'MDE'][AVERAGE] for _, o in pairs]
    columns: dict[str, list[Any]] = {
        'function': [o.function for _, o in pairs],
        'against': [o.algorithm for _, o in pairs],
        "average over MDE's, paper": paper,
    }
    for count, order in ((runs, 'order as in the paper?'), (many, 'order again')):
        averages = [(mde.result.value[:count].mean(), o.result.value[:count].mean()) for mde, o in pairs]
        columns[f'{count} runs'] = [theirs / ours for ours, theirs in averages]
        columns[order] = [_order_agrees(ratio, *both) for ratio, both in zip(paper, averages, strict=True)]
    columns[f'MDE reached, of {many}'] = [_reached(mde.result.value) for mde, _ in pairs]
    columns['the other'] = [_reached(o.result.value) for _, o in pairs]
    columns |= _against(pairs)
    notes = [
        'A ratio above 1: the other algorithm has the larger error. If both averages are below the target, all runs '
        'have reached it, and their order is meaningless.',
        f'{FIRST} {many} runs each; a difference is significant at p < {ALPHA:g}.',
    ]
    return Table('table4_order', 'Table 4: is MDE ahead?', columns, notes)


def _order_agrees(paper: float, mde: float, other: float) -> str:
    if max(mde, other) <= TARGET:
        return 'both reach the target'
    return 'yes' if (paper >= 1) == (other >= mde) else 'no'


def _pace(outcomes: Sequence[Outcome]) -> Table:
    """Return the generations of MDE on each function beside the paper's times."""
    mde = [o for o in outcomes if o.algorithm == 'MDE']
    times = np.array([TABLE_4[o.function, 'MDE'][TIME] for o in mde])
    taken = np.array([_of_arrived(o, np.mean) for o in mde])
    columns: dict[str, Any] = {
        'function': [o.function for o in mde],
        'generations': taken,
        "over Sphere's": taken / taken[0],
        'time, paper [s]': times,
        "time over Sphere's": times / times[0],
    }
    note = 'Average over the runs that reach the target. n = 2 was inferred from this ratio: other n do not fit.'
    return Table('table4_pace', "MDE's pace against the paper's times", columns, [note])


def times(outcomes: Sequence[Outcome], seconds: Sequence[float]) -> Table:
    """Return the time of a run, which is the time of all runs of an algorithm over their number."""
    many = len(outcomes[0].result.value)
    columns = _named(outcomes) | {
        'here [s]': [spent / many for spent in seconds],
        'paper [s]': [TABLE_4[o.function, o.algorithm][TIME] for o in outcomes],
    }
    note = (
        f'{many} runs advance as one array; the time of a run is their time divided by their number. These numbers are '
        'measured and differ from one reproduction to the next.'
    )
    return Table('times', 'Table 4: time of a run', columns, [note])


def table_7(estimate: Estimate, mde: MDESettings, samples: Sequence[int]) -> Table:
    """Return J of the runs of the identification beside the paper's J."""
    J = {'training': estimate.J_runs, 'validation': estimate.J_validation_runs}
    columns: dict[str, Any] = {'J [J^2]': list(TABLE_7)}
    for k, (name, statistic) in enumerate(STATISTICS.items()):
        columns[name] = [statistic(J[role]) for role in TABLE_7]
        if name != 'standard deviation':
            columns[f'{name}, paper'] = [paper[k] for paper in TABLE_7.values()]
    notes = [
        f'{len(estimate.J_runs)} runs of MDE, {mde.population} vectors, {mde.generations} generations, on the sample '
        f'bag: {samples[0]} training samples, {samples[1]} validation samples. The exact minimum of J on the training '
        f'data is {estimate.J_exact:.6e}; {estimate.runs_at_minimum} runs reached it to a relative 1e-6.',
        "The paper's J belongs to its own rig, whose recordings were never published. The sample bag is from a virtual "
        'rig with the parameters of Table 8, without any model error. So the two values of J cannot be compared, only '
        'the agreement of the runs, and the ratio of validation and training.',
    ]
    return Table('table7', 'Table 7: J of the identification', columns, notes)


def table_8(estimate: Estimate) -> Table:
    """Return the estimated parameters beside the paper's, which are the true parameters of the virtual rig."""
    truth = PAPER.vector()
    columns: dict[str, Any] = {
        '': NAMES[: len(truth)],
        'unit': UNITS[: len(truth)],
        "paper's Table 8 = truth of the virtual rig": truth,
        'best run': estimate.theta,
        'error [%]': 100 * (estimate.theta / truth - 1),
        'standard error': estimate.std_error,
    }
    note = (
        "From the run with the lowest J. The paper's criterion at 100 samples a second causes the errors, not the "
        'optimiser, which finds the minimum of J. More accurate criteria on the same recording: docs/method.md.'
    )
    return Table('table8', 'Table 8: parameters', columns, [note])


def threshold_table(outcomes: Sequence[Outcome]) -> Table:
    """Return the generations and the success rate of MDE for every threshold."""
    problems = list(dict.fromkeys(o.function for o in outcomes))
    by_setting = {(o.function, o.algorithm, o.threshold or 0.0): o for o in outcomes}
    thresholds = sorted({threshold for _, _, threshold in by_setting})
    rows = [(algorithm, threshold) for algorithm in ('MDE', PER_VECTOR) for threshold in thresholds]
    columns: dict[str, list[Any]] = {
        'operator per': ['component' if algorithm == 'MDE' else 'vector' for algorithm, _ in rows],
        'threshold': [threshold for _, threshold in rows],
    }
    quickest = []
    for problem in problems:
        selected = {(operator, t): by_setting[problem, operator, t] for operator, t in rows}
        medians = {row: _of_arrived(outcome, np.median) for row, outcome in selected.items()}
        columns[problem] = list(medians.values())
        columns[f'{problem}, reached'] = list(map(_fraction, selected.values()))
        arrivals = {t: selected['MDE', t].arrived.sum() for t in thresholds}
        best = min((t for t in thresholds if arrivals[t] == max(arrivals.values())), key=lambda t: medians['MDE', t])
        chosen = f'{CHOSEN:g}: {medians["MDE", CHOSEN]:.0f}, {_fraction(selected["MDE", CHOSEN])}'
        quickest.append(f'{problem} {best:g} ({medians["MDE", best]:.0f} generations; {chosen})')
    counts = (f'{len(by_setting[problem, "MDE", CHOSEN].arrived)} runs on {problem}' for problem in problems)
    notes = [
        f'Median generations of the runs that reach the target, and their number: {", ".join(counts)}. The threshold '
        f'is the probability of best/1; the paper chose {CHOSEN:g} by trial and error and shows no trials. '
        f"{IDENTIFICATION}: the paper's J on the sample bag, to a relative 1e-6 of its minimum.",
        f'Fastest among the thresholds with the highest success rate, per component: {"; ".join(quickest)}.',
    ]
    return Table('threshold', 'The threshold', columns, notes)


def operator_table(outcomes: Sequence[Outcome]) -> Table:
    """Return a comparison of MDE's operator drawn per component (paper's pseudocode) and per vector (paper's text)."""
    component, vector = (
        [o for o in outcomes if o.threshold == CHOSEN and o.algorithm == algorithm] for algorithm in ('MDE', PER_VECTOR)
    )
    medians = np.array([[_of_arrived(o, np.median) for o in group] for group in (component, vector)])
    last = ([np.where(o.arrived, o.result.generations, np.inf) for o in group] for group in (component, vector))
    columns: dict[str, Any] = {
        'problem': [o.function for o in component],
        'n': [o.n for o in component],
        'per component: generations': medians[0],
        'reached': list(map(_fraction, component)),
        'per vector: generations': medians[1],
        'reached, per vector': list(map(_fraction, vector)),
        'component over vector': medians[0] / medians[1],
        'p': [rank_sum(*both)[0] for both in zip(*last, strict=True)],
    }
    note = (
        f"Threshold {CHOSEN:g}. The paper's pseudocode draws operator and partners for every component, its text once "
        'per vector. Median generations of the runs that reach the target; p of the rank-sum test of the generations, '
        'in which runs that do not reach it rank last.'
    )
    return Table('operator', 'The operator: drawn per component or per vector', columns, [note])


def _named(outcomes: Sequence[Outcome]) -> dict[str, list[Any]]:
    return {'function': [o.function for o in outcomes], 'algorithm': [o.algorithm for o in outcomes]}


def _against(pairs: Sequence[tuple[Outcome, Outcome]]) -> dict[str, list[Any]]:
    """Return the fraction of pairs of runs in which MDE is first, p, and the verdict."""
    cells: list[tuple[Cell, Cell, Cell]] = []
    for mde, other in pairs:
        p, ahead = rank_sum(*ranks([mde.result, other.result]))
        verdict = 'no difference' if not p < ALPHA else 'MDE' if ahead > 0.5 else other.algorithm
        cells.append((ahead, p, verdict))
    return {name: [row[k] for row in cells] for k, name in enumerate(('MDE first in pairs', 'p', 'first'))}


def _reached(values: Any) -> int:
    return int((values <= TARGET).sum())


def _fraction(o: Outcome) -> str:
    return f'{o.arrived.sum()}/{len(o.arrived)}'


def _of_arrived(o: Outcome, statistic: Any) -> float:
    """Return a statistic of the generations of the runs that reach the target; NaN without such runs."""
    return float(statistic(o.result.generations[o.arrived])) if o.arrived.any() else math.nan
