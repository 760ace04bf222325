"""What an identification is asked for."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .errors import ParameterError
from .mde import MDESettings
from .parameters import Bounds, default_bounds
from .signals import SMOOTHING

CRITERIA = ('energy',)
MODELS = ('viscous',)
OPTIMIZERS = ('mde', 'lsq')


@dataclass(frozen=True, slots=True)
class Settings:
    """What is minimised, and how.

    Attributes:
        criterion: ``energy``, the paper's.
        model: ``viscous``, the paper's seven parameters.
        optimizer: ``mde``, or ``lsq``: the exact bounded least-squares answer alone.
        sliding: length [s] of the energy balance's sliding window; None: cumulative.
        smoothing: the differentiator's window [s].
        mde: population, generations and the rest.
        runs: independent runs of MDE.
        seed: of its random numbers.
        bounds: the search box.

    Raises:
        ParameterError: a name that is not known, or a number that makes no sense.
    """

    criterion: str = 'energy'
    model: str = 'viscous'
    optimizer: str = 'mde'
    sliding: float | None = None
    smoothing: float = SMOOTHING
    mde: MDESettings = field(default_factory=MDESettings)
    runs: int = 10
    seed: int = 1
    bounds: Bounds = field(default_factory=default_bounds)

    def __post_init__(self) -> None:
        for kind, chosen, known in (
            ('criterion', self.criterion, CRITERIA),
            ('model', self.model, MODELS),
            ('optimizer', self.optimizer, OPTIMIZERS),
        ):
            if chosen not in known:
                raise ParameterError(f'there is no {kind} {chosen!r}; choose one of {", ".join(known)}')
        if self.sliding is not None and not (np.isfinite(self.sliding) and self.sliding > 0):
            raise ParameterError(f'the sliding window is {self.sliding:g} s; a time above 0 is expected')
        if not (np.isfinite(self.smoothing) and self.smoothing >= 0):
            raise ParameterError(f'the smoothing window is {self.smoothing:g} s; 0 or a time above 0 is expected')
