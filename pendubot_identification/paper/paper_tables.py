"""The paper's tables beside what was found here, and those that it leaves out, as Markdown and as CSV.

A record is what :meth:`.paper.trials.Trial.data` returns; records of one experiment come as a list.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pendubot_identification.model.parameters import NAMES, PAPER, UNITS
from pendubot_identification.paper.benchmark_functions import FUNCTIONS
from pendubot_identification.paper.trials import (
    ALGORITHMS,
    BUDGET,
    IDENTIFICATION,
    PER_VECTOR,
    TARGET,
    rank_sum,
    ranks,
)

from .published import TABLE_4, TRAINING, VALIDATION_AVERAGE

Record = Mapping[str, Any]
Cell = str | int | float | None

#: Below this p two algorithms are said to differ.
ALPHA = 0.01
#: What the test between two algorithms tells, and how.
AGAINST = ('MDE first in pairs', 'p', 'first')
FIRST = (
    'Who is first: a run that reaches the target comes before one that does not; of two that reach it, the one '
    'with fewer '
    'function values comes first; of two that do not, the one with the lower error. Two-sided rank-sum test.'
)
_TARGET = f'{TARGET:.0e}'.replace('e-0', 'e-')
#: The threshold that the paper chose.
CHOSEN = 0.3


@dataclass(frozen=True, slots=True)
class Table:
    """A table that a person and a program can read.

    Attributes:
        name: of its files.
        title: what it is.
        head: names of the columns.
        rows: one cell a column.
        notes: paragraphs below it.
    """

    name: str
    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    notes: Sequence[str] = ()

    def markdown(self) -> str:
        """Return title, table and notes, numbers rounded to three or four digits."""
        lines = [f'## {self.title}', '', _row(self.head), _row(['---'] * len(self.head))]
        lines += [_row(map(shown, row)) for row in self.rows]
        for note in self.notes:
            lines += ['', note]
        return '\n'.join(lines) + '\n'

    def data(self) -> dict[str, Any]:
        """Return all of it as plain data; a number that is none becomes None."""
        rows = [[None if isinstance(c, float) and not math.isfinite(c) else c for c in row] for row in self.rows]
        return {'title': self.title, 'head': list(self.head), 'rows': rows, 'notes': list(self.notes)}

    def csv(self) -> str:
        """Return head and rows, numbers in full."""
        file = io.StringIO()
        writer = csv.writer(file, lineterminator='\n')
        writer.writerow(self.head)
        writer.writerows(self.rows)
        return file.getvalue()


def shown(cell: Cell) -> str:
    """Return a cell for a reader: 0.0461, 3.03e-6, 34."""
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


def table_4(records: Sequence[Record], runs: int) -> list[Table]:
    """Return Table 4, what it says of MDE, and how MDE's generations stand to each other."""
    many = len(records[0]['runs'])
    head = ['function', 'algorithm']
    for what in ('best', 'worst', 'average', 'standard deviation'):
        head += [what, f'{what}, paper']
    head += [f'reached, of {runs}', f'reached, of {many}', 'average of all', 'function values', 'generations']
    rows: list[list[Cell]] = []
    for record in records:
        values, paper = _values(record), TABLE_4[record['function'], record['algorithm']]
        row: list[Cell] = [record['function'], record['algorithm']]
        for ours, theirs in zip(_statistics(values[:runs]), paper[:4], strict=True):
            row += [ours, theirs]
        row += [_reached(values[:runs]), _reached(values), float(values.mean())]
        row += [_mean(record, key) for key in ('evaluations', 'generations')]
        rows.append(row)
    notes = [
        f'Errors at the end of {runs} runs each, n = {records[0]["n"]}; a run that reaches {_TARGET} stops there. '
        'The last '
        f'four columns are of {many} runs, the first {runs} among them: averages, in which a run that never reaches '
        f'{_TARGET} counts with all that it took. Not among the function values is the gradient that HDE takes in '
        'every '
        'generation.',
        'Times are in times.md: they alone differ from one reproduction to the next.',
    ]
    return [Table('table4', 'Table 4: errors', head, rows, notes), _claims(records, runs), _pace(records)]


def _claims(records: Sequence[Record], runs: int) -> Table:
    """Return where the paper's averages have MDE ahead, and whether ours do."""
    found = {(r['function'], r['algorithm']): r for r in records}
    many = len(records[0]['runs'])
    rows: list[list[Cell]] = []
    for f in FUNCTIONS:
        mde = found[f.name, 'MDE']
        for other in ALGORITHMS[:-1]:
            versus = found[f.name, other]
            paper = TABLE_4[f.name, other].average / TABLE_4[f.name, 'MDE'].average
            row: list[Cell] = [f.name, other, paper]
            for count in (runs, many):
                ours = [float(_values(r)[:count].mean()) for r in (mde, versus)]
                row += [ours[1] / ours[0], _agreement(paper, *ours)]
            rows.append([*row, _reached(_values(mde)), _reached(_values(versus)), *_against(mde, versus)])
    head = ['function', 'against', "average over MDE's, paper", f'{runs} runs', 'order as in the paper?']
    head += [f'{many} runs', 'order again', f'MDE reached, of {many}', 'the other', *AGAINST]
    notes = [
        'Above 1, the other one errs more than MDE. Where both averages are below the target, all runs have '
        'reached it, '
        'and which is lower only says who overshot more.',
        f'{FIRST} Over {many} runs each; said to differ at p < {ALPHA:g}.',
    ]
    return Table('table4_order', 'Table 4: is MDE ahead?', head, rows, notes)


def _agreement(paper: float, mde: float, other: float) -> str:
    if max(mde, other) <= TARGET:
        return 'both reach the target'
    if (paper >= 1) == (other >= mde):
        return 'yes'
    return 'no'


def _pace(records: Sequence[Record]) -> Table:
    """Return the generations that MDE takes on each function against the paper's times."""
    rows: list[list[Cell]] = []
    mde = [r for r in records if r['algorithm'] == 'MDE']
    taken = [_generations(r) for r in mde]
    for record, generations in zip(mde, taken, strict=True):
        time = TABLE_4[record['function'], 'MDE'].time
        rows.append(
            [record['function'], generations, generations / taken[0], time, time / TABLE_4['Sphere', 'MDE'].time]
        )
    head = ['function', 'generations', "over Sphere's", 'time, paper [s]', "time over Sphere's"]
    note = 'Average over the runs that reach the target. This is what n = 2 was inferred from: other n do not fit.'
    return Table('table4_pace', "MDE's pace against the paper's times", head, rows, [note])


def times(records: Sequence[Record], seconds: Sequence[float]) -> Table:
    """Return the time of a run; all runs of a trial are advanced together, so it is their time over their number."""
    rows: list[list[Cell]] = []
    for record, spent in zip(records, seconds, strict=True):
        each = spent / len(record['runs'])
        rows.append(
            [record['function'], record['algorithm'], each, TABLE_4[record['function'], record['algorithm']].time]
        )
    note = (
        f'{len(records[0]["runs"])} runs are advanced as one array; the time of one is theirs over their number. '
        'These numbers are measured and differ from one reproduction to the next.'
    )
    return Table('times', 'Table 4: time of a run', ['function', 'algorithm', 'here [s]', 'paper [s]'], rows, [note])


def table_7(found: Record) -> Table:
    """Return J over the runs of the identification beside the paper's."""
    rows: list[list[Cell]] = []
    papers: tuple[tuple[float | None, ...], ...] = (TRAINING, (None, None, VALIDATION_AVERAGE))
    for which, paper in zip(('training', 'validation'), papers, strict=True):
        best, worst, average, deviation = _statistics(np.array(found[f'J_{which}']))
        row: list[Cell] = [which]
        for ours, theirs in zip((best, worst, average), paper, strict=True):
            row += [ours, theirs]
        rows.append([*row, deviation])
    head = [
        'J [J^2]',
        'best',
        'best, paper',
        'worst',
        'worst, paper',
        'average',
        'average, paper',
        'standard deviation',
    ]
    notes = [
        f'{len(found["J_training"])} runs of MDE, {found["population"]} vectors, {found["generations"]} '
        'generations, on the '
        f'sample bag: {found["samples"][0]} samples estimate, {found["samples"][1]} validate. The exact least J '
        'on training '
        f'is {found["J_exact"]:.6e}; {found["reached"]} runs reached it to a relative 1e-6.',
        "The paper's J is of its own rig, whose recordings were never published. The sample bag is of a virtual "
        'rig with '
        'the parameters of its Table 8, without any model error. So the sizes of the two are no test of either; what '
        'can be compared is whether the runs agree, and validation with training.',
    ]
    return Table('table7', 'Table 7: J of the identification', head, rows, notes)


def table_8(found: Record) -> Table:
    """Return the parameters beside the paper's, which are the virtual rig's truth."""
    rows: list[list[Cell]] = []
    for k, truth in enumerate(PAPER.vector()):
        value, error = found['theta'][k], found['std_error'][k]
        rows.append([NAMES[k], UNITS[k], float(truth), value, 100 * (value / float(truth) - 1), error])
    head = ['', 'unit', "paper's Table 8 = truth of the virtual rig", 'best run', 'error [%]', 'standard error']
    note = (
        "Of the run with the lowest J. The errors are those of the paper's criterion at 100 samples a second, "
        'not of the '
        'optimiser, which finds the least J. Criteria that do better on the same recording: docs/criteria.md.'
    )
    return Table('table8', 'Table 8: parameters', head, rows, [note])


def threshold_table(records: Sequence[Record]) -> Table:
    """Return generations and arrivals of MDE for every threshold."""
    problems = list(dict.fromkeys(r['function'] for r in records))
    found = {(r['function'], r['algorithm'], r['threshold']): r for r in records}
    rows: list[list[Cell]] = []
    for algorithm in ('MDE', PER_VECTOR):
        for threshold in sorted({r['threshold'] for r in records}):
            row: list[Cell] = ['component' if algorithm == 'MDE' else 'vector', threshold]
            for problem in problems:
                record = found[problem, algorithm, threshold]
                row += [_median_generations(record), _share(record)]
            rows.append(row)
    head = ['operator per', 'threshold']
    for problem in problems:
        head += [problem, f'{problem}, reached']
    counts = {problem: len(found[problem, 'MDE', CHOSEN]['runs']) for problem in problems}
    notes = [
        'Median generations of the runs that reach the target, and how many do: '
        + ', '.join(f'{count} runs on {problem}' for problem, count in counts.items())
        + f'. The threshold is the probability of best/1; the paper chose {CHOSEN:g} by trial and error and shows '
        'no trials. '
        f"{IDENTIFICATION}: the paper's J on the sample bag, to a relative 1e-6 of its least value.",
        *_threshold_findings(found, problems),
    ]
    return Table('threshold', 'The threshold', head, rows, notes)


def _threshold_findings(found: Mapping[tuple[str, str, float], Record], problems: Sequence[str]) -> list[str]:
    """Return in a sentence which thresholds are the quickest among those that arrive as often as any."""
    best = []
    for problem in problems:
        mine = {t: r for (p, a, t), r in found.items() if p == problem and a == 'MDE'}
        most = max(_reached_by_reason(r) for r in mine.values())
        good = {t: _median_generations(r) for t, r in mine.items() if _reached_by_reason(r) == most}
        quickest = min(good, key=lambda t: good[t])
        best.append(
            f'{problem} {quickest:g} ({good[quickest]:.0f} generations; {CHOSEN:g}: '
            f'{_median_generations(mine[CHOSEN]):.0f}, {_share(mine[CHOSEN])})'
        )
    return ['Quickest among the thresholds that arrive most often, per component: ' + '; '.join(best) + '.']


def operator_table(records: Sequence[Record]) -> Table:
    """Return MDE with its operator drawn per component, as in the pseudocode, against per vector, as in the text."""
    found = {(r['function'], r['algorithm']): r for r in records if r['threshold'] == CHOSEN}
    rows: list[list[Cell]] = []
    for problem in dict.fromkeys(r['function'] for r in records):
        component, vector = found[problem, 'MDE'], found[problem, PER_VECTOR]
        row: list[Cell] = [problem, component['n']]
        for record in (component, vector):
            row += [_median_generations(record), _share(record)]
        row.append(_median_generations(component) / _median_generations(vector))
        keys = [np.where(_arrived(r), _column(r, 'generations'), np.inf) for r in (component, vector)]
        row.append(rank_sum(*keys)[0])
        rows.append(row)
    head = ['problem', 'n', 'per component: generations', 'reached', 'per vector: generations', 'reached, per vector']
    head += ['component over vector', 'p']
    note = (
        f"Threshold {CHOSEN:g}. The paper's pseudocode draws operator and partners anew for every component, its text "
        'once a vector. Median generations of the runs that reach the target; p of the rank-sum test of the '
        'generations, '
        'runs that do not reach it last.'
    )
    return Table('operator', 'The operator: drawn per component or per vector', head, rows, [note])


def dimensions_tables(records: Sequence[Record]) -> list[Table]:
    """Return who is first in 2, 10 and 30 dimensions with equal budgets, and the errors behind it."""
    rows: list[list[Cell]] = []
    verdicts: dict[tuple[int, str], list[Cell]] = {}
    found = {(r['n'], r['function'], r['algorithm']): r for r in records}
    for (n, function, algorithm), record in found.items():
        values = _values(record)
        row: list[Cell] = [n, function, algorithm, float(values.min()), float(np.median(values)), float(values.max())]
        row += [_share(record), _mean(record, 'evaluations')]
        against: list[Cell] = [None, None, None]
        if algorithm != 'MDE':
            against = _against(found[n, function, 'MDE'], record)
            verdicts.setdefault((n, algorithm), []).append(against[-1])
        rows.append([*row, *against])
    counts: list[list[Cell]] = [
        [n, other, said.count('MDE'), said.count(other), said.count('no difference')]
        for (n, other), said in verdicts.items()
    ]
    head = ['n', 'function', 'algorithm', 'best', 'median', 'worst', 'reached', 'function values', *AGAINST]
    note = (
        f'On how many of the {len(FUNCTIONS)} functions who is first. Everyone has {BUDGET} n function values a run, '
        f'{len(records[0]["runs"])} runs; settings of Table 3 otherwise. {FIRST} Said to differ at p < {ALPHA:g}: of '
        f'{sum(map(len, verdicts.values()))} such tests one may err by chance.'
    )
    return [
        Table(
            'dimensions',
            'Beyond the paper: who is first in 2, 10 and 30 dimensions, with equal budgets',
            ['n', 'MDE against', 'MDE first', 'the other first', 'no difference'],
            counts,
            [note],
        ),
        Table('dimensions_errors', 'The errors behind it', head, rows),
    ]


def _against(mde: Record, other: Record) -> list[Cell]:
    """Return how often MDE is first in a pair of runs, p, and what that says: the cells below :data:`AGAINST`."""
    first, second = ranks([(_values(r), _column(r, 'evaluations')) for r in (mde, other)])
    p, ahead = rank_sum(first, second)
    verdict = 'no difference' if not p < ALPHA else 'MDE' if ahead > 0.5 else str(other['algorithm'])
    return [ahead, p, verdict]


def _row(cells: Iterable[str]) -> str:
    return '| ' + ' | '.join(cells) + ' |'


def _column(record: Record, key: str) -> Any:
    return np.array([run[key] for run in record['runs']], dtype=float)


def _values(record: Record) -> Any:
    return _column(record, 'value')


def _mean(record: Record, key: str) -> float:
    return float(_column(record, key).mean())


def _statistics(values: Any) -> tuple[float, float, float, float]:
    deviation = values.std(ddof=1) if len(values) > 1 else 0.0
    return float(values.min()), float(values.max()), float(values.mean()), float(deviation)


def _reached(values: Any) -> int:
    return int((values <= TARGET).sum())


def _arrived(record: Record) -> Any:
    return np.array([run['stopped_by'] == 'target' for run in record['runs']])


def _reached_by_reason(record: Record) -> int:
    return int(_arrived(record).sum())


def _share(record: Record) -> str:
    return f'{_reached_by_reason(record)}/{len(record["runs"])}'


def _generations(record: Record) -> float:
    """Return the average of the runs that reach the target; NaN without any."""
    taken = _column(record, 'generations')[_arrived(record)]
    return float(taken.mean()) if len(taken) else math.nan


def _median_generations(record: Record) -> float:
    taken = _column(record, 'generations')[_arrived(record)]
    return float(np.median(taken)) if len(taken) else math.nan
