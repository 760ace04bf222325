# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The Python interface, imported from ``pendubot_identification`` itself.

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
from .level import Level
from .model import dynamics, simulation
from .model.parameters import SPECIFICATIONS, Parameters
from .model.simulation import HANGING
from .recordings.source import Source
from .results.result import Parameter, PartialResult, Result
from .results.result_file import read_complete_result, read_parameters, write_result
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
        path: the recording.
        topic: of the JointStates in a bag.
        joint_names: shoulder and elbow in a bag.
        reading: options of the command line for units, signs and zeros, such as degrees=True, zero='hanging',
            time_unit='ms' or columns={'q1': 'theta1'}.

    Raises:
        PendubotError: the recording cannot be read, or is too long to be read at once.
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
    bounds: Mapping[str, float | tuple[float, float]] | None = None,
    topic: str = '/joint_states',
    joint_names: Sequence[str] = ('shoulder', 'elbow'),
    **options: Any,
) -> Identified:
    """Estimate the parameters of a rig, like ``pendubot identify``, whose help describes each option.

    Args:
        recordings: bags or files with columns, each ``BAG[@START:END]``, or motions. Of a single one without a window
            the first half estimates and the second validates.
        validate: recordings that only validate.
        bounds: search intervals by name, such as ``{'P1': (0, 0.5)}``; a single number fixes a parameter.
        topic: of the JointStates in bags.
        joint_names: shoulder and elbow in bags.
        options: those of the command line, such as criterion (``'weak'``, or several), model, delay (``0.004`` or
            ``(0, 0.02)`` s) and seed; for bags and files also those of :func:`read`.

    Raises:
        PendubotError: an argument is invalid, or the recordings determine no parameters.
    """
    from .identify.pipeline import identify as estimate
    from .results.assemble import assemble_result
    from .results.options import bounds_of, settings_of

    settings = settings_of(options, bounds_of(bounds or {}))
    training, validation, sources, notes = _divided(recordings, validate, topic, joint_names, settings.reading)
    found = estimate(training, validation, settings, notes=notes)
    return Identified(assemble_result(found, sources), (training, validation))


def _divided(
    recordings: Sequence[Trajectory | File],
    validate: Sequence[Trajectory | File],
    topic: str,
    joints: Sequence[str],
    reading: Conversion,
) -> tuple[Sequence[Any], Sequence[Any], Sequence[Source], Sequence[str]]:
    """Return the motions for training and for validation, their sources, and notes for the user."""
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
    training, validation = ([each for each in side if isinstance(each, Trajectory)] for side in (recordings, validate))
    if len(training) == 1 and not validation:
        (motion,) = training
        training, validation = [motion[: len(motion) // 2]], [motion[len(motion) // 2 :]]
    roles = [('training', each) for each in training] + [('validation', each) for each in validation]
    return training, validation, [_source(role, each) for role, each in roles], ()


def _source(role: str, motion: Trajectory) -> Source:
    content = b''.join(np.ascontiguousarray(each).tobytes() for each in (motion.t, motion.q, motion.tau))
    digest = hashlib.sha256(content).hexdigest()
    return Source(f'{motion.name} (from memory)', role, len(motion), motion.duration, digest, True)


def simulate(
    pendubot: Parameters,
    t: ArrayLike,
    tau: ArrayLike = 0.0,
    q: tuple[float, float] = HANGING,
    qd: tuple[float, float] = (0.0, 0.0),
) -> Trajectory:
    """Return the simulated motion of a rig at increasing times t [s], shape (N,), from q [rad] and qd [rad/s] on.

    ``tau`` is the torque [N m] from each time until the next: of the shoulder, a number or shape (N,), or of both
    joints, shape (N, 2).

    Raises:
        PendubotError: the parameters are not physical, or the motion is too fast for the simulation.
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
    """The parameters of a rig and its equations of motion.

    q, qd and tau are of shoulder and elbow: q1 [rad] from the horizontal, q2 relative to link 1, qd [rad/s], tau [N m].
    """

    __slots__ = ()

    @classmethod
    def load(cls, path: File) -> Pendubot:
        """Return the rig of a result file, or of a file with parameters by hand.

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
        """Return the torque of Coriolis forces and gravity, V(q, qd) qd + G(q) [N m], shape (2,)."""
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

        tau is the shoulder's. Dry friction, which is not linear, is left out.
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
        """Return the text that ``pendubot export`` writes in a format: mjcf, urdf, yaml, m, h or py.

        Raises:
            PendubotError: there is no such format, or no real masses give these parameters.
        """
        given = {s.name: Parameter(value=v, unit=s.unit) for s, v in zip(SPECIFICATIONS, self.theta, strict=False)}
        return export(PartialResult(parameters=given), format, link_length, torque_limit)[0]


@dataclass(frozen=True, repr=False)
class Identified:
    """The result of an identification.

    Attributes:
        result: the entries of its file.
        motions: for training and for validation; None of a loaded result.
    """

    result: Result
    motions: tuple[Sequence[Trajectory], Sequence[Trajectory]] | None = None

    @classmethod
    def load(cls, path: File) -> Identified:
        """Return the result of a file.

        Raises:
            PendubotError: it is not the file of an identification.
        """
        return cls(read_complete_result(Path(path)))

    @property
    def pendubot(self) -> Pendubot:
        """The rig."""
        return Pendubot(**asdict(self.result.theta))

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the D estimated parameters."""
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
        """The level of the result."""
        return self.result.level

    @property
    def warnings(self) -> list[str]:
        """The warnings, a sentence each."""
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
        """Return the text of a file, see :meth:`Pendubot.export`, with the origin of the numbers."""
        return export(self.result, format, link_length, torque_limit)[0]

    def __repr__(self) -> str:
        values = ', '.join(f'{name}={value:.6g}' for name, value in zip(self.names, self.theta, strict=True))
        return f'<Identified {self.level.name}: {values}>'

    def __str__(self) -> str:
        from .report.tables import summary

        return summary(self.result)

    def _repr_html_(self) -> str:
        """Return level, parameters with their intervals, and prediction errors for a notebook."""
        from .report.tables import parameter_table, prediction_table, verdict

        said = [f'{self.level.name}: {sentence}' for sentence in self.warnings or [verdict(self.result)]]
        paragraphs = ''.join(f'<p>{html.escape(sentence)}</p>' for sentence in said)
        return f'{paragraphs}{parameter_table(self.result).html()}{prediction_table(self.result).html()}'
