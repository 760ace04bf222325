"""Differential evolution, rand/1/bin (Storn and Price 1997), as MDE without its novelties; and HDE, with a gradient."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.model.parameters import Bounds
from pendubot_identification.optimizers.mde import MDE, MDESettings
from pendubot_identification.optimizers.optimizer import Found, Objective

Array = NDArray[np.float64]


def classic(
    population: int = 18,
    weight: float = 0.6714,
    crossover: float = 0.5026,
    generations: int = 4000,
    target: float | None = None,
) -> MDESettings:
    """Return what makes :class:`.mde.MDE` plain DE: one F, one CR, always rand/1, partners drawn once a vector.

    The defaults are the paper's Table 3: Pedersen's for 10 dimensions and 20 000 function values (Good parameters for
    differential evolution, HL1002, 2010).
    """
    return MDESettings(
        population, generations, 0.0, (weight, weight), (crossover, crossover), per_component=False, target=target
    )


class HDE(MDE):
    """DE with a gradient step of the best vector in every generation (the paper's Table 3, after its reference 29).

    The step is one more trial: x_best - rate gradient(x_best), drawn back into the box, takes the best one's place
    where it is at least as good. So a generation asks for NP + 1 function values and one gradient.

    Args:
        bounds: the search box, of dimension D.
        gradient: of the function: (..., D) in, (..., D) out.
        settings: as :func:`classic` makes them.
        rate: the learning rate.
        runs: number of independent runs.
        seed: same seed, same result.
    """

    def __init__(
        self,
        bounds: Bounds,
        gradient: Callable[[Array], Array],
        settings: MDESettings | None = None,
        *,
        rate: float = 0.01,
        runs: int = 10,
        seed: int = 1,
    ) -> None:
        super().__init__(bounds, settings or classic(), runs=runs, seed=seed)
        population = self.settings.population
        self._found = Found(runs, len(bounds.lower), population, population + 1)
        self._gradient, self._rate = gradient, rate
        self._step: Array | None = None

    def ask(self) -> Array:
        """Return the points to evaluate: the initial population, shape (runs, NP, D), then (active runs, NP + 1, D)."""
        trials = super().ask()
        if self.generation == 0:
            return trials
        best = self._leaders()
        self._step = np.clip(best - self._rate * self._gradient(best), self.bounds.lower, self.bounds.upper)
        return np.concatenate([trials, self._step[:, None]], axis=1)

    def leap(self, objective: Objective) -> bool:
        """Return False: the compiled kernel knows no gradients."""
        return False

    def tell(self, values: Array) -> None:
        """Take the values of the points asked for: first the step's, then those of the trials."""
        if self._step is not None:
            rows, best = np.arange(len(values)), self._values.argmin(axis=1)
            better = values[:, -1] <= self._values[rows, best]
            self._values[rows[better], best[better]] = values[better, -1]
            self._targets[:, rows[better], best[better]] = self._step[better].T
            values, self._step = values[:, :-1], None
        super().tell(values)
