# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Which of many effects explain residuals: by F tests, and by what they explain of data that did not fit them.

Rows are residuals, linear in a model's parameters (the base) and in each effect's sizes (its columns).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .effects import Effect
from .estimate import FEWEST_RECORDINGS
from .significance import exceeded_by_chance

Array = NDArray[np.float64]

#: The level of significance of all effects that are tried together.
SIGNIFICANT = 0.001
#: One that changes P1 to P5 by more than this part of them is not identifiable beside them, unless nearly everything
#: is explained by it.
TOO_FAR, SURE = 0.5, 0.9
#: It must help more than this part of the recordings, or parts of the time, that are left out.
HELPED = 0.8
#: Of one or two recordings so many parts of the time are left out in turn.
FOLDS = 5
#: An effect that explains less than this part of what is unexplained is named, but not allowed for: on real rigs, of
#: which no effect explains most, many explain a little of the recordings at hand and spoil the prediction of others.
#: One or two recordings must have nearly all of it explained.
MOST, MOST_ALONE = 0.5, 0.9
#: One that explains less than this part must show in many rows: of few counts the errors of a joint that nearly stops
#: are alike for as long as it does, and a few such stops may look like friction.
LITTLE = 0.025
#: An effect of fewer columns is preferred where it explains less by no more than this; no more effects are named.
ALIKE, MOST_EFFECTS = 0.02, 3


@dataclass(frozen=True, slots=True)
class Choice:
    """An effect that was chosen.

    Attributes:
        number: of the effect.
        sizes: of its columns, shape (C,).
        share: of the squares of what was unexplained before, what it explains of data that did not fit it.
        moved: by how much P1 to P5 change beside it, shape (5,).
    """

    number: int
    sizes: Array
    share: float
    moved: Array


def select(
    effects: Sequence[Effect],
    base: Array,
    y: Array,
    candidates: Sequence[Array],
    folds: NDArray[np.intp],
    *,
    independent: float,
    pays: float,
    physical: Array,
) -> Iterator[Choice]:
    """Return, one after the other, the effects that are significant and pay on data that did not fit them.

    All that is asked of the data are products of columns, by fold.

    Args:
        effects: that are tried; of one name no more than one is chosen.
        base: the model's columns, those of P1 to P5 first, shape (N, ..., D).
        y: what is to be explained, shape (N, ...).
        candidates: each effect's columns, shapes (N, ..., C).
        folds: which rows are left out together, shape (N,).
        independent: how many of the residuals are.
        pays: the share of y's squares that the first effect must explain at least, and each later of what is left.
        physical: P1 to P5, shape (5,).
    """
    parts = [base, *candidates, y[..., None]]
    # Of one fold at a time: all columns beside each other would be as large again as all of them.
    rows = [folds == fold for fold in np.unique(folds)]
    of_fold = np.array([products(np.concatenate([part[own] for part in parts], axis=-1)) for own in rows])
    scale = np.sqrt(of_fold.sum(axis=0).diagonal())
    units = np.where(scale > 0, scale, 1.0)
    of_fold /= units * units[:, None]
    whole, size = of_fold.sum(axis=0), base.shape[-1]
    places = [list(range(*ends)) for ends in pairwise(size + np.cumsum([0, *(c.shape[-1] for c in candidates)]))]
    taken, named, left = list(range(size)), [0], [c for c in range(len(effects)) if scale[places[c]].all()]
    to_physical = scale[-1] / np.where(scale[:5] > 0, scale[:5], np.inf)
    before = _least(whole, taken)[:5] * to_physical

    def chance(effect: int) -> float:
        columns = np.concatenate([parts[k] for k in (*named, effect + 1, -1)], axis=-1)
        return _by_chance(columns / units[[*taken, *places[effect], -1]], len(places[effect]))

    for _ in range(MOST_EFFECTS):
        alone, left_out = squares(whole, taken), _left_out(of_fold, taken)
        found = []
        for c in left:
            freedom = independent - len(taken) - len(places[c])
            better = alone / max(squares(whole, taken + places[c]), np.finfo(float).tiny) - 1
            more = len(places[c])
            if freedom > 0 and exceeded_by_chance(better * freedom / more, more, freedom) * len(effects) < SIGNIFICANT:
                rest = _left_out(of_fold, taken + places[c])
                share = 1 - rest.sum() / left_out.sum()
                # Else it tells a recording from others, or one time from another.
                if (rest < left_out).mean() > HELPED and (share > LITTLE or chance(c) * len(effects) < SIGNIFICANT):
                    found.append((share, c))
        if not found or max(found)[0] < pays:
            return
        # Of those that explain nearly as much, the simplest, and of these the best.
        alike = [f for f in found if f[0] > max(found)[0] - ALIKE]
        share, best = min(alike, key=lambda f: (len(places[f[1]]), -f[0]))
        taken, named = taken + places[best], [*named, best + 1]
        left = [c for c in left if effects[c].name != effects[best].name]
        solution = _least(whole, taken)
        now = solution[:5] * to_physical
        if share < SURE and (np.abs(now - before) > TOO_FAR * np.abs(physical)).any():
            return
        yield Choice(best, solution[-len(places[best]) :] * scale[-1] / scale[places[best]], float(share), now - before)


def folds_of(recording: NDArray[np.intp]) -> NDArray[np.intp]:
    """Return what is left out together, by the number of each row's recording, shape (N,): it or a part of the time."""
    several = len(np.unique(recording)) >= FEWEST_RECORDINGS
    return recording if several else np.arange(len(recording)) * FOLDS // max(len(recording), 1)


def most_of(recordings: int) -> float:
    """Return the part of what is unexplained that an effect must explain in so many recordings to be allowed for."""
    return MOST if recordings >= FEWEST_RECORDINGS else MOST_ALONE


def products(columns: Array) -> Array:
    """Return the products of all pairs of columns, shape (D, D), of columns of shape (N, ..., D)."""
    flat = columns.reshape(-1, columns.shape[-1])
    return np.asarray(flat.T @ flat)


def squares(products: Array, which: list[int]) -> float:
    """Return the sum of squares that some columns leave of the last one, by the products of all."""
    x = np.append(_least(products, which), -1.0)
    return float(x @ products[np.ix_([*which, -1], [*which, -1])] @ x)


def solved(phi: Array, y: Array) -> Array:
    """Return the least-squares solution, columns scaled to one; ``phi`` of shape (N, ..., D), ``y`` (N, ...)."""
    flat = phi.reshape(-1, phi.shape[-1])
    scale = np.linalg.norm(flat, axis=0)
    scale[scale == 0] = 1.0
    return np.asarray(np.linalg.lstsq(flat / scale, y.ravel(), rcond=1e-9)[0] / scale)


def _least(products: Array, which: list[int]) -> Array:
    """Return the least-squares solution of some columns by products of all, the last one being y."""
    return np.asarray(np.linalg.lstsq(products[np.ix_(which, which)], products[which, -1], rcond=1e-12)[0])


def _by_chance(columns: Array, more: int) -> float:
    """Return how likely an effect explains so much by chance, whatever the errors within a row have in common.

    Wald's test with the variance by rows (White 1980, Liang and Zeger 1986), as an F test. Columns are those that are
    taken, the ``more`` of the effect, and what is to be explained.
    """
    rows, unknowns, of_all = len(columns), columns.shape[-1] - 1, products(columns)
    if rows <= unknowns:
        return 1.0
    taken, effect = slice(unknowns - more), slice(unknowns - more, unknowns)
    imitated = np.linalg.lstsq(of_all[taken, taken], of_all[taken, effect], rcond=1e-12)[0]
    own, solution = columns[..., effect] - columns[..., taken] @ imitated, _least(of_all, list(range(unknowns)))
    left = columns[..., -1] - columns[..., :-1] @ solution
    told, by_row = products(own) @ solution[effect], (own * left[..., None]).reshape(rows, -1, more).sum(axis=1)
    size = float(told @ np.linalg.lstsq(products(by_row) * rows / (rows - unknowns), told, rcond=1e-12)[0])
    return exceeded_by_chance(size / more * (rows - more) / rows, more, rows - more)


def _left_out(of_fold: Array, which: list[int]) -> Array:
    """Return the sum of squares that is left of each fold by what the others are explained with, shape (F,)."""
    whole, left = of_fold.sum(axis=0), []
    for of_one in of_fold:
        x = np.append(_least(whole - of_one, which), -1.0)
        left.append(float(x @ of_one[np.ix_([*which, -1], [*which, -1])] @ x))
    return np.array(left)
