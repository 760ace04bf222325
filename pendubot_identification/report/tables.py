"""Results as text for a terminal. A result is the plain data of a result file, see DESIGN's schema 1."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

#: J of the paper's rig over 10 runs: training best, worst, average; validation average (its Table 7).
PAPER_TRAINING = (2.37e-3, 2.39e-3, 2.37e-3)
PAPER_VALIDATION_AVERAGE = 3.03e-3


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return aligned columns, the first to the left and the others to the right."""
    lines = [head, *rows]
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    return '\n'.join(
        '  '.join(cell.rjust(w) if k else cell.ljust(w) for k, (cell, w) in enumerate(zip(line, widths, strict=True)))
        for line in lines
    )


def parameter_table(result: Mapping[str, Any], truth: Mapping[str, float] | None = None) -> str:
    """Return a row a parameter: estimate, standard error, unit and, where known, the true value and the error."""
    head, rows = ['', 'estimate', 'std. error', 'unit'], []
    if truth is not None:
        head += ['true value', 'error']
    for name, entry in result['parameters'].items():
        value, error = entry['value'], entry['std_error']
        row = [name, f'{value:.6f}', 'on bound' if error is None else f'{error:.6f}', entry['unit']]
        if truth is not None:
            row += [f'{truth[name]:.6f}', f'{100 * (value / truth[name] - 1):+.1f} %']
        rows.append(row)
    return table(head, rows)


def criterion_table(result: Mapping[str, Any], *, beside_paper: bool = False) -> str:
    """Return J on training and validation: best, worst and average over the runs, beside the paper's if asked."""
    J = result['J']
    rows = [['training', *_spread(J['training_runs'])]]
    if beside_paper:
        rows.append(['  the paper, on its own rig', *(f'{value:.2e}' for value in PAPER_TRAINING)])
    if J['validation'] is not None:
        runs = J['validation_runs']
        rows.append(['validation', *(_spread(runs) if runs else ['', '', f'{J["validation"]:.3e}'])])
        if beside_paper:
            rows.append(['  the paper, on its own rig', '', '', f'{PAPER_VALIDATION_AVERAGE:.2e}'])
    return table([f'J [{J["unit"]}]', 'best', 'worst', 'average'], rows)


def summary(result: Mapping[str, Any]) -> str:
    """Return what was done, in a line or two, and every warning."""
    J, made_by = result['J'], result['made_by']
    condition = result['condition_number']
    first = f'exact least squares: J = {J["least_squares"]:.6e}; condition number {condition:.1f}'
    if made_by['optimizer'] != 'lsq':
        first += (
            f'; {J["runs_at_least_squares"]} of {made_by["runs"]} runs of {made_by["optimizer"].upper()} reached it '
            'to a relative 1e-6'
        )
    lines = [first]
    if J['validation'] is not None:
        lines.append(f'validation: {J["validation_method"]}')
    lines += [f'{result["level"]}: {warning}' for warning in result['warnings']]
    return '\n'.join(lines)


def whole(result: Mapping[str, Any]) -> str:
    """Return all that a terminal shows of a result."""
    sources = [f'{b["role"]}: {b["bag"]}, {b["samples"]} samples, {b["duration"]:.2f} s' for b in result['bags']]
    return '\n'.join([*sources, '', parameter_table(result), '', criterion_table(result), summary(result)])


def _spread(values: Sequence[float]) -> list[str]:
    return [f'{value:.3e}' for value in (min(values), max(values), sum(values) / len(values))]
