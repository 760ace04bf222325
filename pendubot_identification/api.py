# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The Python interface, imported from ``pendubot_identification`` itself.

>>> from pendubot_identification import identify, read, simulate
>>> found = identify('bags/paper_experiment', criterion='weak')  # or a DataFrame, or t=, q= and tau=
>>> found.pendubot, found.std_error, found.warnings
"""

from __future__ import annotations

import hashlib
import html
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from inspect import cleandoc
from pathlib import Path
from textwrap import fill
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from pendubot_identification.arrays import Array

from .errors import ParameterError, PendubotError
from .files import OutputFolder, write_atomically
from .formats.export import MEANINGS, export, format_of
from .identification import APPLY_REMEDIES, OPTIONS
from .identification.estimate import Progress
from .level import Level
from .model import dynamics, simulation
from .model.parameters import SPECIFICATIONS, Parameters
from .model.simulation import HANGING
from .recordings.bag_reader import BagWindow, RecordedTrajectory, read_trajectory
from .recordings.datasets import Datasets, divided, load_datasets, windows_of
from .recordings.survey import Inspection, inspect_recording
from .recordings.table_reader import TableReader, are_dates, numbers_of
from .recordings.tables import of_frame
from .results import comparison
from .results.checks import Finding, check_recordings
from .results.provenance import IN_MEMORY, command
from .results.provenance import recordings as read_recordings
from .results.result import Parameter, PartialResult, Result, read_complete_result, read_result, result_text
from .setting import Setting
from .trajectories.conventions import CONVERSION, JOINTS
from .trajectories.conversion import Conversion
from .trajectories.trajectory import Trajectory

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

F = TypeVar('F', bound=Callable[..., Any])
#: A float, an array, or an expression.
Term = TypeVar('Term', bound=Any)
File = str | Path
Criterion = Literal['energy', 'weak', 'likelihood']
Model = Literal['auto', 'viscous', 'coulomb', 'rotor', 'geared']
TimeUnit = Literal['s', 'ms', 'us', 'ns']
TorqueUnit = Literal['Nm', 'mNm', 'Ncm', 'kgfcm', 'ozfin']
Swap = Literal['nothing', 'joints', 'positions', 'efforts']
Quantity = Literal['q1', 'q2', 'tau1', 'tau2']
Plot = Literal['simulation', 'recordings', 'torque']

KINDS = (
    'only names of bags or files, or only DataFrames and motions as read() returns them, each an argument of its own, '
    'or t, q and tau are expected'
)
#: Positions [rad] when both links stand upright.
UPRIGHT = (math.pi / 2, 0.0)


def _describing(*settings: Setting) -> Callable[[F], F]:
    """Add the help texts of options, as in ``--help``, to the docstring of a function with arguments of their names."""

    def describe(function: F) -> F:
        lines = (f'    {"joint_names" if each is JOINTS else each.name}: {each.help()}.' for each in settings)
        wrapped = (fill(line, 120, subsequent_indent=' ' * 8) for line in lines)
        function.__doc__ = '\n'.join([cleandoc(function.__doc__ or ''), '\nOther Parameters:', *wrapped])
        return function

    return describe


@_describing(*CONVERSION)
def read(  # noqa: D417
    source: File | DataFrame,
    *,
    topic: str = '/joint_states',
    joint_names: Sequence[str] = ('shoulder', 'elbow'),
    columns: Mapping[str, str] | None = None,
    skip_rows: int = 0,
    sheet: str | None = None,
    encoding: str | None = None,
    decimal: Literal['point', 'comma'] = 'point',
    time_unit: TimeUnit = 's',
    skip_missing: bool = False,
    unwrap: bool = False,
    degrees: bool = False,
    torque_unit: TorqueUnit = 'Nm',
    swap: Swap = 'nothing',
    torque_constant: float | None = None,
    gear: float = 1.0,
    negate: Quantity | Sequence[Quantity] = (),
    elbow: Literal['relative', 'absolute'] = 'relative',
    zero: Literal['horizontal', 'hanging'] = 'horizontal',
    offset: Mapping[Quantity, float | str] | None = None,
) -> Trajectory:
    """Read a motion from a bag, a file with columns (.csv, .mat, .xlsx, .parquet), or a DataFrame.

    Args:
        source: a path, also ``FILE@START:END`` in seconds, or a DataFrame with the columns t, q1, q2, tau1 and, if
            present, tau2, dq1, dq2. An index with a name is a column, too.

    Raises:
        FileNotFoundError: there is no such recording (also a PendubotError).
        PendubotError: the recording cannot be read, or is too long to be read at once.
    """
    conversion = Conversion.of(_options(locals(), CONVERSION))
    if isinstance(source, (str, Path)):
        (window,) = windows_of([str(source)], conversion)
        recorded = read_trajectory(window, conversion)
    else:
        recorded = _in_memory(source, conversion)
    if recorded.note:
        warnings.warn(recorded.note, stacklevel=2)
    return recorded.trajectory


@_describing(*OPTIONS, APPLY_REMEDIES, *CONVERSION)
def identify(  # noqa: D417
    *recordings: Trajectory | File | DataFrame,
    t: ArrayLike | None = None,
    q: ArrayLike | None = None,
    tau: ArrayLike | None = None,
    qd: ArrayLike | None = None,
    validate: Sequence[Trajectory | File | DataFrame] = (),
    bounds: Mapping[str, float | tuple[float, float]] | Sequence[str] | None = None,
    criterion: Criterion | Sequence[Criterion] = 'likelihood',
    model: Model = 'auto',
    hold: Literal['auto', 'zero', 'linear'] = 'auto',
    delay: float | tuple[float, float] = (-0.1, 0.1),
    sliding: float | None = None,
    link_length: float | None = None,
    link_mass: float | None = None,
    optimizer: Literal['auto', 'mde', 'lsq'] = 'auto',
    start: File | Parameters | None = None,
    seed: int = 1,
    spread: float | None = None,
    smoothing: float | None = None,
    runs: int | None = None,
    population: int | None = None,
    generations: int | None = None,
    per_vector: bool = False,
    apply_remedies: bool = False,
    progress: Progress | None = None,
    topic: str = '/joint_states',
    joint_names: Sequence[str] = ('shoulder', 'elbow'),
    columns: Mapping[str, str] | None = None,
    skip_rows: int = 0,
    sheet: str | None = None,
    encoding: str | None = None,
    decimal: Literal['point', 'comma'] = 'point',
    time_unit: TimeUnit = 's',
    skip_missing: bool = False,
    unwrap: bool = False,
    degrees: bool = False,
    torque_unit: TorqueUnit = 'Nm',
    swap: Swap = 'nothing',
    torque_constant: float | None = None,
    gear: float = 1.0,
    negate: Quantity | Sequence[Quantity] = (),
    elbow: Literal['relative', 'absolute'] = 'relative',
    zero: Literal['horizontal', 'hanging'] = 'horizontal',
    offset: Mapping[Quantity, float | str] | None = None,
) -> Identified:
    """Estimate the parameters of a rig, like ``pendubot identify``.

    The arguments of :func:`read` apply to all recordings except a :class:`Trajectory`, which is already converted.

    Args:
        recordings: bags or files with columns, each ``BAG[@START:END]``, or DataFrames or motions. The first half of a
            single one without a window is for training, the second for validation.
        t: times [s], shape (N,), of arrays in the place of recordings.
        q: positions [rad] of shoulder and elbow, shape (N, 2).
        tau: torque [N m] from each time until the next, shape (N,) of the shoulder or (N, 2) of both joints.
        qd: velocities [rad/s], shape (N, 2), if measured.
        validate: recordings for validation only.
        bounds: search intervals by name, such as ``{'P1': (0, 0.5)}``, or as texts, such as ``['P1=0:0.5']``; a single
            number fixes a parameter.
        progress: called with the activity, its completed steps, their total number (0: unknown), and the best J.

    Raises:
        FileNotFoundError: there is no such recording (also a PendubotError).
        PendubotError: an argument is invalid, or the recordings determine no parameters.
    """
    from .results.computation import identify_recordings
    from .results.options import bounds_of, settings_of

    settings = settings_of(_options(locals(), (*OPTIONS, *CONVERSION)), bounds_of(bounds or {}))
    arrays = _Arrays(t, q, tau, qd)
    given = [name for name, values in arrays._asdict().items() if values is not None]
    if recordings and given:
        raise ParameterError('both recordings and arrays were given; give either recordings or t, q and tau')
    if given and (missing := [name for name in ('t', 'q', 'tau') if name not in given]):
        raise ParameterError(f'{" and ".join(missing)} is missing; t, q and tau are expected together')
    training: Sequence[object] = recordings or ([arrays] if given else ())
    validation = _several(validate)
    words = settings.reading.words()
    if words and any(isinstance(each, Trajectory) for each in (*training, *validation)):
        raise ParameterError(f'{", ".join(words)} convert files, and a Trajectory is already converted; leave them out')

    load = partial(_load, training, validation)
    result, data = identify_recordings(load, settings, progress, apply_remedies=apply_remedies)
    return Identified(result, (data.training, data.validation))


def describe(source: File, **options: object) -> Inspection:
    """Inspect a recording with the options of :func:`read`: columns or topics, samples, or why it is unreadable.

    Raises:
        PendubotError: an option is invalid, or the source is no name.
    """
    if not isinstance(source, (str, Path)):
        raise ParameterError(f'{type(source).__name__} was given; the name of a bag or file is expected')
    conversion = Conversion.of(_options(options))
    (window,) = windows_of([str(source)], conversion)
    return inspect_recording(window, conversion)


def check(*recordings: File, validate: Sequence[File] = (), **options: object) -> list[Finding]:
    """Check recordings with the options of :func:`identify`, without a fit, and return the findings.

    Raises:
        PendubotError: an option is invalid.
    """
    from .results.options import settings_of

    return check_recordings(partial(_load, recordings, _several(validate)), settings_of(_options(options)))


def _options(arguments: Mapping[str, object], options: Sequence[Setting] | None = None) -> dict[str, object]:
    """Return arguments that are not None, by the names of their options; with ``options``, only these."""
    given = {
        'joints' if name == 'joint_names' else name: value for name, value in arguments.items() if value is not None
    }
    return given if options is None else {each.name: given[each.name] for each in options if each.name in given}


def _several(recordings: object) -> Sequence[object]:
    """Return recordings as a sequence; a single recording becomes a list."""
    return recordings if isinstance(recordings, (list, tuple)) else [recordings]


def _load(recordings: Sequence[object], validate: Sequence[object], conversion: Conversion) -> Datasets:
    """Return the motions for training and for validation."""
    if not recordings:
        raise ParameterError(f'nothing was given; {KINDS}')
    if all(isinstance(each, (str, Path)) for each in (*recordings, *validate)):
        return load_datasets([str(each) for each in recordings], [str(each) for each in validate], conversion)
    training, validation = ([_in_memory(each, conversion) for each in side] for side in (recordings, validate))
    return divided(training, validation)


class _Arrays(NamedTuple):
    """The arguments of :func:`identify` for a motion in arrays."""

    t: ArrayLike | None
    q: ArrayLike | None
    tau: ArrayLike | None
    qd: ArrayLike | None


def _in_memory(recording: Any, conversion: Conversion) -> RecordedTrajectory:
    """Return the motion of a DataFrame or of arrays, converted, or a motion itself. May raise ParameterError."""
    note = taken_as = ''
    if isinstance(recording, Trajectory):
        motion = conversion.motion(recording.t, recording.q, recording.tau, recording.qd, recording.name)
    elif isinstance(recording, _Arrays):
        numbers = {name: _numbers(name, each) for name, each in recording._asdict().items() if each is not None}
        t, q, tau, qd = numbers['t'], numbers['q'], numbers['tau'], numbers.get('qd')
        for name, rows in (('q', q), ('qd', qd)):
            if rows is not None and (t.ndim != 1 or rows.shape != (len(t), 2)):
                raise ParameterError(f't has shape {t.shape} and {name} {rows.shape}; (N,) and (N, 2) are expected')
        second = 1.0 if are_dates(recording.t) else conversion.seconds
        motion = conversion.motion((t - t[:1]) * second, q, _torques(t, tau), qd, 'arrays')
    elif not (hasattr(recording, 'iloc') and hasattr(recording, 'columns')):
        raise ParameterError(f'{type(recording).__name__} was given; {KINDS}')
    else:
        reader = TableReader(Path('DataFrame'), conversion, of_frame(recording))
        motion, note, taken_as = reader.motion, reader.note, reader.taken_as
    content = b''.join(np.ascontiguousarray(each).tobytes() for each in (motion.t, motion.q, motion.tau))
    # An @ would begin the window of a file.
    window = BagWindow(Path(motion.name.replace('@', ' at ') + IN_MEMORY))
    return RecordedTrajectory(motion, window, hashlib.sha256(content).hexdigest(), True, note, taken_as)


def _numbers(name: str, values: ArrayLike) -> Array:
    """Return an argument as an array of numbers, NaN if masked; dates and durations in seconds."""
    try:
        array = np.asarray(values)
        if are_dates(array):
            array = numbers_of(array)
        masked = isinstance(values, np.ma.MaskedArray) and np.ma.getmaskarray(values)
        return np.where(masked, math.nan, array.astype(float))
    except (TypeError, ValueError) as error:
        raise ParameterError(f'{name} cannot be read: {error}; numbers are expected') from None


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
    if not isinstance(pendubot, Parameters):
        raise ParameterError(f'{type(pendubot).__name__} was given; a Pendubot is expected, such as found.pendubot')
    times = _numbers('t', t)
    return simulation.simulate(pendubot, times, _torques(times, tau), q, qd)


def accelerations(
    theta: Sequence[Term | float] | Array,
    q1: Term,
    q2: Term,
    v1: Term,
    v2: Term,
    tau1: Term | float,
    tau2: Term | float,
    lib: ModuleType = np,
) -> tuple[Term, Term]:
    """Return q1'', q2'' [rad/s^2]: the equations of motion, with the inverse of M(q) written out.

    ``theta`` is a sequence of D numbers, arrays or expressions; arrays broadcast. ``lib`` has their functions: numpy,
    math for floats, casadi, or jax.numpy.
    """
    return dynamics.accelerations(theta, (q1, q2, v1, v2), (tau1, tau2), lib)


def _torques(t: Array, tau: ArrayLike) -> Array:
    """Return the torques of both joints [N m], shape (N, 2), at times t, shape (N,)."""
    torques = _numbers('tau', tau)
    if torques.ndim == 0:
        torques = np.full(t.shape, torques)
    if torques.ndim == 1:
        torques = np.column_stack([torques, np.zeros_like(torques)])
    if t.ndim != 1 or torques.shape != (len(t), 2):
        raise ParameterError(
            f't has shape {t.shape} and tau {torques.shape}; (N,), and a number, (N,) or (N, 2) are expected'
        )
    return torques


def compare(results: Mapping[str, Identified]) -> DataFrame:
    """Return the parameters of results side by side, with one row for each parameter.

    The columns of each result, by its name, are value, std_error, t (the difference from the first result in standard
    errors of both) and p (its two-sided probability by Welch's test). ``attrs['notes']`` has remarks.

    Raises:
        PendubotError: a value is no result, or pandas is not installed.
    """
    if not isinstance(results, Mapping) or not all(isinstance(each, Identified) for each in results.values()):
        raise ParameterError("results of identify() by their names are expected, such as {'first': found}")
    found = comparison.compare({name: each.result for name, each in results.items()})
    rows, columns = found['parameters'], {'value': 'value', 'std_error': 'std_error', 't': 'apart', 'p': 'p'}
    cells = {
        (name, column): np.array([row[key][k] for row in rows.values()], dtype=float)
        for k, name in enumerate(results)
        for column, key in columns.items()
    }
    frame = _frame(cells, list(rows))
    frame.attrs['notes'] = found['notes']
    return frame


def _frame(columns: Mapping[Any, Any], index: Sequence[str]) -> DataFrame:
    try:
        from pandas import DataFrame
    except ImportError as error:
        raise PendubotError('a frame needs pandas, which is not installed: pip install pandas') from error
    frame: DataFrame = DataFrame(columns, index=list(index))
    return frame


def _export(  # noqa: D417
    self: Pendubot | Identified,
    path: File,
    *,
    link_length: float | None = None,
    torque_limit: float | None = None,
    revolute: bool = False,
    overwrite: bool = False,
) -> Path:
    """Write a file for another program; its suffix selects the format, as with ``pendubot export``.

    Args:
        path: with the suffix .xml (MJCF), .urdf, .yaml, .m, .h or .py.
        link_length: for simulators, measured length of link 1 [m]; None: P3 / P5.
        torque_limit: for simulators, the motor's torque limit [N m].
        revolute: for URDF, joints of the type revolute instead of continuous.
        overwrite: replace an existing file.

    Raises:
        PendubotError: the suffix names no format, no real masses give these parameters, or the file exists.
    """
    if isinstance(self, Identified):
        result: PartialResult = self.result
    else:
        pairs = zip(SPECIFICATIONS, self.theta.tolist(), strict=False)
        result = PartialResult(parameters={s.name: Parameter(value=value, unit=s.unit) for s, value in pairs})
    text, _ = export(result, format_of(Path(path)), link_length, torque_limit, revolute=revolute)
    write_atomically(Path(path), text, overwrite=overwrite)
    return Path(path)


class Pendubot(Parameters):
    """The parameters of a rig and its equations of motion.

    q, qd and tau are of shoulder and elbow: q1 [rad] from the horizontal, q2 relative to link 1, qd [rad/s], tau [N m].

    Raises:
        PendubotError: no rig can have these parameters.
    """

    __slots__ = ()
    export = _export

    def __post_init__(self) -> None:
        if problems := self.unphysical():
            raise ParameterError(f'no rig can have these parameters: {"; ".join(problems)}; correct them')

    @classmethod
    def load(cls, path: File) -> Pendubot:
        """Return the rig of a result file, or of a file with parameters written by hand.

        Raises:
            PendubotError: it cannot be read.
        """
        return cls(**asdict(read_result(Path(path)).theta))

    @property
    def theta(self) -> Array:
        """The parameters of :attr:`model` as a vector, shape (7,), (9,), (10,) or (14,)."""
        return self.vector()

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return M(q) [kg m^2], shape (..., 2, 2), of q, shape (..., 2)."""
        return dynamics.mass_matrix(self.theta, q)

    def bias(self, q: ArrayLike, qd: ArrayLike) -> Array:
        """Return the torque of Coriolis forces and gravity, V(q, qd) qd + G(q) [N m], shape (..., 2)."""
        free = replace(self, b1=0.0, b2=0.0, Fc1=0.0, Fc2=0.0, Fs1=0.0, Fs2=0.0, k1=0.0, k2=0.0)
        result: Array = -np.einsum('...ij,...j->...i', self.mass_matrix(q), free.acceleration(q, qd))
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


@dataclass(frozen=True, repr=False)
class Identified:
    """The result of an identification.

    Attributes:
        result: the entries of its file.
        motions: for training and for validation; None of a loaded result.
    """

    result: Result
    motions: tuple[Sequence[Trajectory], Sequence[Trajectory]] | None = None
    export = _export

    @classmethod
    def load(cls, path: File) -> Identified:
        """Return the result of a file.

        Raises:
            PendubotError: it is not the file of an identification.
        """
        return cls(read_complete_result(Path(path)))

    @property
    def pendubot(self) -> Pendubot:
        """The identified rig; raises PendubotError if the estimate is not physical."""
        return Pendubot(**asdict(self.result.theta))

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the D estimated parameters."""
        return tuple(self.result.parameters)

    @property
    def theta(self) -> Array:
        """The estimated values, shape (D,)."""
        return np.array([entry.value for entry in self.result.parameters.values()])

    @property
    def std_error(self) -> Array:
        """The standard errors of the estimates, shape (D,); NaN if unknown."""
        return np.array([entry.std_error for entry in self.result.parameters.values()], dtype=float)

    @property
    def intervals(self) -> Array:
        """The 95 % confidence intervals, shape (D, 2); NaN if unknown."""
        return np.array([entry.interval for entry in self.result.parameters.values()], dtype=float)

    @property
    def covariance(self) -> Array:
        """The covariance of the estimates, shape (D, D); NaN if unknown."""
        return np.array(self.result.covariance, dtype=float)

    @property
    def level(self) -> Level:
        """The level of the result."""
        return self.result.level

    @property
    def warnings(self) -> list[str]:
        """The warnings, a sentence each."""
        return self.result.warnings

    @property
    def command(self) -> str:
        """The command line that repeats the identification; empty if a recording was in memory."""
        return command(self.result)

    def frame(self) -> DataFrame:
        """Return a frame with one row for each parameter: value, std_error, low, high, unit, meaning.

        Raises:
            PendubotError: pandas is not installed.
        """
        low, high = self.intervals.T
        units, meaning = zip(*(MEANINGS[name] for name in self.names), strict=True)
        columns = {'value': self.theta, 'std_error': self.std_error, 'low': low, 'high': high}
        return _frame({**columns, 'unit': units, 'meaning': meaning}, self.names)

    def save(self, path: File, *, overwrite: bool = False) -> None:
        """Write the result file.

        Raises:
            PendubotError: it exists already, or cannot be written.
        """
        write_atomically(Path(path), result_text(self.result), overwrite=overwrite)

    def report(self, folder: File, *, overwrite: bool = False, figures: bool = False) -> Path:
        """Write the report, a page with figures, and the result file; return the path of the page.

        For a loaded result the recordings are read again; the page lists missing ones.

        Args:
            folder: folder to write.
            overwrite: replace files in it.
            figures: write the figures also as SVG and PNG.

        Raises:
            PendubotError: the folder holds something already, or cannot be written.
        """
        from .report.page import write_report

        notes: list[str] = []
        try:
            motions = self._recordings()
        except PendubotError as error:
            motions, notes = None, [f'figures of the recordings; {error}']
        with OutputFolder(Path(folder), overwrite=overwrite) as output:
            return write_report(output, self.result, motions, notes=notes, static=figures)

    def plot(self, what: Plot = 'simulation', axes: Axes | Sequence[Axes] | None = None) -> list[Axes]:
        """Draw a figure of the report with matplotlib, and return its axes.

        Args:
            what: measured and simulated motion (the panels q1, q2, q1', q2' and two of errors), the recordings (tau1,
                q1, q2; with a torque at the elbow one more), or the unexplained torque (shoulder, elbow).
            axes: to draw the first panels into, as many as there are axes; None: all, in a new figure.

        Raises:
            PendubotError: the recordings of a loaded result cannot be read again.
            ParameterError: there is no such plot, or no axes were given.
        """
        from .report.plots import Prepared

        draws = {'simulation': Prepared.simulation, 'recordings': Prepared.data, 'torque': Prepared.unexplained_torque}
        if what not in draws:
            raise ParameterError(f'there is no plot {what!r}; {", ".join(draws)} are expected')
        plot: Any = draws[what](Prepared.of(self.result, *self._recordings()))[0].content
        if axes is None:
            from matplotlib import pyplot

            size = len(plot.panels)
            axes = pyplot.subplots(size, sharex=True, figsize=(8, 1.3 * size), layout='constrained')[1]
        drawn: list[Axes] = np.ravel(np.asarray(axes, dtype=object)).tolist()
        if not drawn:
            raise ParameterError('no axes were given; give one for each panel, or leave out axes for a new figure')
        plot.draw(drawn)
        return drawn

    def _recordings(self) -> tuple[Sequence[Trajectory], Sequence[Trajectory]]:
        """Return the motions for training and for validation; read the recordings of a loaded result again."""
        return self.motions or read_recordings(self.result)

    def __repr__(self) -> str:
        values = ', '.join(f'{name}={value:.6g}' for name, value in zip(self.names, self.theta, strict=True))
        return f'<Identified {self.level.name}: {values}>'

    def __str__(self) -> str:
        from .report.tables import summary

        return summary(self.result)

    def _repr_html_(self) -> str:
        """Return level, parameters with their intervals, and prediction errors for a notebook."""
        from .report.tables import parameter_table, prediction_table, verdict

        sentences = self.warnings or [verdict(self.result)]
        paragraphs = ''.join(f'<p>{self.level.name}: {html.escape(sentence)}</p>' for sentence in sentences)
        return f'{paragraphs}{parameter_table(self.result).html()}{prediction_table(self.result).html()}'
