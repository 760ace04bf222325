# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What scripts and notebooks import from ``pendubot_identification`` itself: the command line's work on arrays.

>>> from pendubot_identification import identify, read, simulate
>>> found = identify('bags/paper_experiment', criterion='weak')
>>> found.pendubot, found.std_error, found.warnings
"""

from __future__ import annotations

import hashlib
import html
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import ParameterError, PendubotError
from .files import OutputFolder
from .formats.export import MEANINGS, export
from .identify.options import OPTIONS
from .level import Level
from .model import dynamics, simulation
from .model.parameters import SPECIFICATIONS, Parameters, default_bounds
from .model.simulation import HANGING
from .recordings.source import Source
from .results.result import Parameter, PartialResult, Result
from .results.result_file import read_complete_result, read_parameters, write_result
from .trajectories.conventions import CONVERSION
from .trajectories.conversion import Conversion
from .trajectories.trajectory import Trajectory

if TYPE_CHECKING:
    from pandas import DataFrame

Array = NDArray[np.float64]
File = str | Path

#: Positions [rad] when both links stand upright.
UPRIGHT = (math.pi / 2, 0.0)
accelerations = dynamics.accelerations


def read(
    path: File,
    *,
    topic: str = '/joint_states',
    joint_names: Sequence[str] = ('shoulder', 'elbow'),
    **reading: Any,
) -> Trajectory:
    """Read a motion from a bag or a file with columns (.csv, .mat, .xlsx, .parquet), also of ``FILE@START:END``.

    Args:
        path: of the recording.
        topic: of a bag, with its JointStates.
        joint_names: of a bag, the names of shoulder and elbow.
        reading: what its numbers mean: columns (by quantity, what a file calls t [s], q1, q2, tau1 [N m], tau2, dq1,
            dq2), degrees=True, zero='hanging', elbow='absolute', negate='q2', time_unit='ms',
            torque_constant=0.05 [N m/A], ...: options of the command line, - written as _.

    Raises:
        PendubotError: it cannot be read, is no motion, or is too long to be taken at once: give a window of it.
    """
    from .recordings.bag_reader import BagWindow, read_trajectory
    from .recordings.datasets import require_files

    window, how = BagWindow.parse(str(path)), Conversion.of(reading)
    require_files(how, [window.path])
    recorded = read_trajectory(window, topic=topic, joint_names=joint_names, conversion=how)
    if recorded.note:
        warnings.warn(recorded.note, stacklevel=2)
    return recorded.trajectory


def identify(
    *recordings: Trajectory | File,
    validate: Sequence[Trajectory | File] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    topic: str = '/joint_states',
    joint_names: Sequence[str] = ('shoulder', 'elbow'),
    **options: Any,
) -> Identified:
    """Estimate the parameters of a rig, as ``pendubot identify`` does, which says more of each option.

    Args:
        recordings: bags or files with columns, each ``BAG[@START:END]``, or motions. Of one without a window the first
            half estimates and the second validates.
        validate: what only judges.
        bounds: by name, where a parameter is searched, such as ``{'P1': (0, 0.5)}``; equal ends hold it.
        topic: of bags, with their JointStates.
        joint_names: of bags, the names of shoulder and elbow.
        options: criterion (``'weak'``, or several), model, optimizer, hold, delay (``0.004`` or ``(0, 0.02)`` s),
            sliding, smoothing, start, link_length, seed, ...: those of the command line, - written as _; for bags and
            files also those of :func:`read`.

    Raises:
        PendubotError: what was given makes no sense, or determines no parameters.
    """
    from .identify.pipeline import identify as estimate
    from .identify.settings import Settings
    from .results.assemble import assemble_result

    reading = Conversion.of({o.name: options.pop(o.name) for o in CONVERSION if o.name in options})
    if unknown := options.keys() - {option.name for option in OPTIONS}:
        names = ', '.join(option.name for option in (*OPTIONS, *CONVERSION))
        raise ParameterError(f'there is no option {min(unknown)!r}; the options are {names}')
    if isinstance(criteria := options.get('criterion'), str):
        options['criterion'] = tuple(name.strip() for name in criteria.split(','))
    if isinstance(delay := options.get('delay'), (int, float)):
        options['delay'] = (delay, delay)
    if isinstance(start := options.get('start'), (str, Path)):
        options['start'] = read_parameters(Path(start))
    box = default_bounds()
    for name, (low, high) in (bounds or {}).items():
        box = box.replaced(name, low, high)
    settings = Settings.of(bounds=box, reading=reading, **options)
    training, validation, sources, notes = _divided(recordings, validate, topic, joint_names, reading)
    found = estimate(training, validation, settings, notes=notes)
    return Identified(assemble_result(found, sources), (training, validation))


def _divided(
    recordings: Sequence[Trajectory | File],
    validate: Sequence[Trajectory | File],
    topic: str,
    joints: Sequence[str],
    reading: Conversion,
) -> tuple[Sequence[Any], Sequence[Any], Sequence[Source], Sequence[str]]:
    """Return the motions that estimate, those that validate, where they came from, and what is to be said of that."""
    given = [*recordings, *validate]
    if all(isinstance(each, (str, Path)) for each in given) and recordings:
        from .recordings.datasets import load_datasets

        names = [str(each) for each in recordings], [str(each) for each in validate]
        data = load_datasets(*names, topic=topic, joint_names=joints, conversion=reading)
        return data.training, data.validation, data.sources, data.notes
    if not recordings or not all(isinstance(each, Trajectory) for each in given):
        kinds = ', '.join(dict.fromkeys(type(each).__name__ for each in given)) or 'nothing'
        raise ParameterError(f'{kinds} was given; names of bags, or motions as read() returns them, are expected')
    if words := reading.words():
        raise ParameterError(f'{", ".join(words)} say how files are read, and motions are read already; leave them out')
    training, validation = (
        [r for r in recordings if isinstance(r, Trajectory)],
        [r for r in validate if isinstance(r, Trajectory)],
    )
    if len(training) == 1 and not validation:
        (whole,) = training
        training, validation = [whole[: len(whole) // 2]], [whole[len(whole) // 2 :]]
    roles = [('training', each) for each in training] + [('validation', each) for each in validation]
    return training, validation, [_source(role, each) for role, each in roles], ()


def _source(role: str, motion: Trajectory) -> Source:
    content = hashlib.sha256(
        b''.join(np.ascontiguousarray(each).tobytes() for each in (motion.t, motion.q, motion.tau))
    )
    return Source(f'{motion.name} (from memory)', role, len(motion), motion.duration, content.hexdigest(), True)


def simulate(
    pendubot: Parameters,
    t: ArrayLike,
    tau: ArrayLike = 0.0,
    q: tuple[float, float] = HANGING,
    qd: tuple[float, float] = (0.0, 0.0),
) -> Trajectory:
    """Return the motion of a rig at the times t [s], shape (N,), from q [rad] and qd [rad/s] on.

    Args:
        pendubot: the rig.
        t: increasing.
        tau: the torque [N m] from each time until the next: of the shoulder, a number or shape (N,), or of both joints,
            shape (N, 2).
        q: where it begins.
        qd: how fast.

    Raises:
        PendubotError: the parameters are not physical, or the motion is too fast to be followed.
    """
    times, torques = np.asarray(t, dtype=float), np.asarray(tau, dtype=float)
    if torques.ndim == 0:
        torques = np.full(times.shape, torques)
    if torques.ndim == 1:
        torques = np.column_stack([torques, np.zeros_like(torques)])
    if times.ndim != 1 or torques.shape != (len(times), 2):
        raise ParameterError(
            f't has shape {times.shape} and tau {torques.shape}; (N,), and a number, (N,) or (N, 2) are expected'
        )
    return simulation.simulate(pendubot, times, torques, q, qd)


class Pendubot(Parameters):
    """A rig by its parameters, P1 to b2 and what else its model has, with what follows from them.

    q, qd and tau are of shoulder and elbow: q1 [rad] from the horizontal, q2 relative to link 1, qd [rad/s], tau [N m].
    """

    __slots__ = ()

    @classmethod
    def load(cls, path: File) -> Pendubot:
        """Return the rig of a result file, also of one by hand.

        Raises:
            PendubotError: it cannot be read.
        """
        return cls(**asdict(read_parameters(Path(path))))

    @property
    def theta(self) -> Array:
        """The parameters as a vector, as many as :attr:`model` has."""
        return self.vector()

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return M(q) [kg m^2], shape (2, 2)."""
        return dynamics.mass_matrix(self.theta, q)

    def bias(self, q: ArrayLike, qd: ArrayLike) -> Array:
        """Return V(q, qd) qd + G(q) [N m], shape (2,): what Coriolis forces and gravity ask for, without friction."""
        free = replace(self, b1=0.0, b2=0.0, Fc1=0.0, Fc2=0.0, Fs1=0.0, Fs2=0.0, k1=0.0, k2=0.0)
        result: Array = -self.mass_matrix(q) @ free.acceleration(q, qd)
        return result

    def acceleration(self, q: ArrayLike, qd: ArrayLike, tau: ArrayLike = (0.0, 0.0)) -> Array:
        """Return q'' [rad/s^2] under all friction, shape (..., 2), of arrays (..., 2)."""
        return dynamics.forward_dynamics(self.theta, q, qd, tau)

    def energy(self, q: ArrayLike, qd: ArrayLike) -> Array:
        """Return the total energy [J], shape (...), of arrays (..., 2); 0 at rest with both links horizontal."""
        return dynamics.energy(self.theta, q, qd)

    def linearised(self) -> tuple[Array, Array]:
        """Return A, shape (4, 4), and B, shape (4, 1), of x' = A x + B tau upright; x is q - UPRIGHT, then qd.

        tau is the shoulder's. Dry friction is left out, whose slope at rest describes no motion of any size.
        """
        from .control.linear_control import linearise

        A, B = linearise(self)
        return A, B[:, :1]

    def simulate(
        self,
        t: ArrayLike,
        tau: ArrayLike = 0.0,
        q: tuple[float, float] = HANGING,
        qd: tuple[float, float] = (0.0, 0.0),
    ) -> Trajectory:
        """Return its motion, see :func:`simulate`."""
        return simulate(self, t, tau, q, qd)

    def export(self, format: str, *, link_length: float | None = None, torque_limit: float | None = None) -> str:
        """Return the text of a file: mjcf, urdf, yaml, m, h or py, as ``pendubot export`` writes it.

        Raises:
            PendubotError: there is no such format, or no real masses give these parameters.
        """
        given = {s.name: Parameter(value=v, unit=s.unit) for s, v in zip(SPECIFICATIONS, self.theta, strict=False)}
        return export(PartialResult(parameters=given), format, link_length, torque_limit)[0]


@dataclass(frozen=True, repr=False)
class Identified:
    """What an identification found.

    Attributes:
        result: all of it, entry by entry as in a result file.
        motions: what estimated and what validated; None of a loaded result.
    """

    result: Result
    motions: tuple[Sequence[Trajectory], Sequence[Trajectory]] | None = None

    @classmethod
    def load(cls, path: File) -> Identified:
        """Return what a result file holds.

        Raises:
            PendubotError: it is no file of an identification.
        """
        return cls(read_complete_result(Path(path)))

    @property
    def pendubot(self) -> Pendubot:
        """The rig."""
        return Pendubot(**asdict(self.result.theta))

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the parameters that were estimated: D of them."""
        return tuple(self.result.parameters)

    @property
    def theta(self) -> Array:
        """Their values, shape (D,)."""
        return np.array([entry.value for entry in self.result.parameters.values()])

    @property
    def std_error(self) -> Array:
        """Their standard errors, shape (D,); NaN where they are not known."""
        return np.array([entry.std_error for entry in self.result.parameters.values()], dtype=float)

    @property
    def intervals(self) -> Array:
        """Their 95 % intervals, shape (D, 2); NaN where they are not known."""
        return np.array([entry.interval for entry in self.result.parameters.values()], dtype=float)

    @property
    def covariance(self) -> Array:
        """Their covariance, shape (D, D); NaN where it is not known."""
        return np.array(self.result.covariance, dtype=float)

    @property
    def level(self) -> Level:
        """How far to trust them."""
        return self.result.level

    @property
    def warnings(self) -> list[str]:
        """Why, in sentences."""
        return self.result.warnings

    def frame(self) -> DataFrame:
        """Return a row a parameter: value, std_error, low, high, unit, meaning.

        Raises:
            PendubotError: pandas is not installed.
        """
        try:
            from pandas import DataFrame
        except ImportError as error:
            raise PendubotError('a frame needs pandas, which is not installed: pip install pandas') from error
        low, high = self.intervals.T
        units, meaning = zip(*(MEANINGS[name] for name in self.names), strict=True)
        columns = {'value': self.theta, 'std_error': self.std_error, 'low': low, 'high': high}
        return DataFrame({**columns, 'unit': units, 'meaning': meaning}, index=list(self.names))

    def save(self, path: File, *, overwrite: bool = False) -> None:
        """Write the result file.

        Raises:
            PendubotError: it exists already, or cannot be written.
        """
        write_result(Path(path), self.result, overwrite=overwrite)

    def report(self, folder: File, *, overwrite: bool = False, figures: bool = False) -> Path:
        """Write a page with figures, these also as SVG and PNG if asked for, and the result; return where the page is.

        Raises:
            PendubotError: the folder holds something already, or cannot be written.
        """
        from .report.folder import write_report

        with OutputFolder(Path(folder), overwrite=overwrite) as made:
            return write_report(made, self.result, self.motions, None, (), lambda *_: None, static=figures)

    def export(self, format: str, *, link_length: float | None = None, torque_limit: float | None = None) -> str:
        """Return the text of a file, see :meth:`Pendubot.export`; it also says where the numbers come from."""
        return export(self.result, format, link_length, torque_limit)[0]

    def __repr__(self) -> str:
        values = ', '.join(f'{name}={value:.6g}' for name, value in zip(self.names, self.theta, strict=True))
        return f'<Identified {self.level.name}: {values}>'

    def __str__(self) -> str:
        from .report.tables import summary

        return summary(self.result)

    def _repr_html_(self) -> str:
        """Return what a notebook shows: verdict, parameters with their intervals, errors of simulation."""
        from .report.tables import parameter_table, prediction_table, verdict

        said = [f'{self.level.name}: {sentence}' for sentence in self.warnings or [verdict(self.result)]]
        paragraphs = ''.join(f'<p>{html.escape(sentence)}</p>' for sentence in said)
        return f'{paragraphs}{parameter_table(self.result).html()}{prediction_table(self.result).html()}'
