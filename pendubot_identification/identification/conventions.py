# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Checks of signs, order, zeros, units and timestamps of recordings, by their motion.

No physical parameters explain a recording that breaks a convention. Therefore a list of corrections is tried: changes
of sense or order (:data:`_TURNS`), and the zeros, constant effort, and input delay that fit best. The weak criterion
is minimised after each one, and they are ranked by the fraction of the squared effort that the model does not explain.
The best one is accepted if it is significant (F test) and the corrected motion fits a pendubot. The corrected
recordings are checked again for a second fault.

Not detectable: another gear ratio or torque unit, which scales all parameters (except for mN m, which gives an
implausible density of link 2); both joints and both efforts reversed, which is the view from behind; and the error of a
zero if friction holds a link away from hanging.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import fdtri, ndtri

from pendubot_identification.arrays import Array
from pendubot_identification.criteria.energy import Regression
from pendubot_identification.criteria.quadratic import Quadratic, smallest
from pendubot_identification.criteria.weak import DELAY_STRIDE, WIDTH, estimate_delay, weak_regression
from pendubot_identification.errors import TrajectoryError
from pendubot_identification.level import Level
from pendubot_identification.model.dynamics import GRAVITY
from pendubot_identification.model.parameters import MODELS, NAMES, Bounds, default_bounds
from pendubot_identification.model.simulation import HANGING
from pendubot_identification.trajectories.conversion import Affine, Conversion
from pendubot_identification.trajectories.motion import Motion

from . import DELAYS
from .estimate import regression_covariance
from .settings import Settings

Matrix = tuple[tuple[float, float], tuple[float, float]]
#: The model with dry friction and a rotor; a larger model would fit faults.
MODEL = 'rotor'
#: The effort may be in any unit.
BOUNDS = default_bounds().of(MODELS[MODEL]).scaled(1e6)


@dataclass(frozen=True, slots=True)
class ConventionSettings:
    """Thresholds of faults; fractions are of the squared effort."""

    #: Weight of the elbow's residuals beside the shoulder's: elbows are small.
    elbow: float = 3.0
    #: Significance level of the F test, the same for all corrections.
    significance: float = 1e-4
    #: Longest duration [s] that the F test counts, because model errors repeat: the fraction must fall by 1.3.
    longest: float = 5.0
    #: Unexplained fraction above which a motion fits no pendubot: of real rigs it is .02, of simulated end stops .3.
    unfit: float = 0.35
    #: Unexplained fraction of a poor fit: of unmodelled effects it is at most .08, of a push or lost counts .15.
    poor_fit: float = 0.1
    #: Motion [rad] below which recordings fit any rig.
    moved: float = 0.5
    #: Motion, in the unit of the recording, below which it is not in degrees.
    degrees: float = 10.0
    #: Fraction that an offset must explain (1 % of the effort's RMS), and least errors of a zero [rad] and a delay [s].
    offset: float = 1e-4
    zero: float = math.radians(2.0)
    delay: float = 0.01
    #: Ratio of static to sliding friction, which holds a link away from hanging while its zero is set.
    static: float = 1.3
    #: Ratio of the fractions before and after a correction above which a parameter is wrong by a sixth or more.
    severe: float = 5.0
    #: Largest density of a link [kg/m^3], of a cube as wide as the distance of its centre from the joint. It is 16 to
    #: 80 on large rigs, 2500 on one of 3 cm.
    dense: float = 5000.0
    #: Error of a link's length, as a fraction of it.
    length: float = 0.1


SETTINGS = ConventionSettings()


@dataclass(frozen=True, slots=True)
class Fault:
    """A convention that recordings break."""

    #: ``sign``, ``order``, ``absolute``, ``degrees``, ``counts``, ``unit``, ``zero``, ``offset``, ``delay``,
    #: ``length``, or ``motion`` if the motion fits no pendubot after any correction.
    name: str
    found: str  #: the finding, in words.
    remedy: str  #: the expected convention, and the correction, in words.
    level: Level = Level.WARN  #: ERROR where parameters from such recordings are useless, else WARN.
    #: fraction of the squared effort that the model does not explain; NaN without a correction.
    unexplained: float = math.nan
    corrected: float = math.nan  #: the same fraction after the correction.
    change: Affine | None = None  #: the correction of the motion; None if there is none.
    delay: float | None = None  #: of the effort [s], if that is the correction.
    options: tuple[str, ...] = ()  #: of the conversion that correct the recordings, if there are any.
    corrected_conversion: Conversion | None = None  #: the conversion with these options.

    @property
    def sentence(self) -> str:
        """The message: finding, fit of the correction, and remedy."""
        fit = ''
        if not math.isnan(self.corrected):
            fit = (
                f': the model does not explain {100 * self.unexplained:.3g} % of the squared effort as recorded, and '
                f'{100 * self.corrected:.3g} % after the correction'
            )
        return f'{self.found}{fit}; {self.remedy}' + (f': {", ".join(self.options)}' if self.options else '')


def _from_hanging(Q: Matrix, T: Matrix | None = None) -> Affine:
    """Return the map Q of positions relative to hanging, and T of efforts."""
    return Affine.of(Q, np.array(HANGING) - np.array(Q) @ np.array(HANGING), T)


_FIRST, _SECOND, _BOTH = ((-1, 0), (0, 1)), ((1, 0), (0, -1)), ((-1, 0), (0, -1))
_EXCHANGED, _RELATIVE, _IN_RADIANS = ((0, 1), (1, 0)), ((1, 0), (-1, 1)), np.eye(2) * math.pi / 180
_EXPECTED = {
    'sign': 'positions and efforts of both joints must be positive in one sense of rotation',
    'order': 'shoulder first, elbow second',
    'absolute': 'it must be relative to link 1',
    'degrees': 'positions must be in radians',
    'counts': 'a turn must be 2 pi',
}
_NEGATED, _DISORDERED, _HORIZONTAL = 'has the wrong sign', 'are in the wrong order', 'as measured from the horizontal'
_ELBOW = "negate the elbow's position and effort (or the shoulder's)"
_SHOULDER = "negate the shoulder's position (or the elbow's and the effort)"
_TO_HANGING = "negate the shoulder's position, so that hanging is -90 degrees"
_ABSOLUTE = 'absolute', "the elbow's position is absolute", "subtract the shoulder's position"
#: Corrections of sense or order: name, fault, remedy, and map. Of equal ones, the first is reported.
_TURNS: tuple[tuple[str, str, str, Affine], ...] = (
    ('sign', f"the elbow's position {_NEGATED}", "negate the elbow's position", Affine.of(_SECOND)),
    ('sign', 'the elbow turns the other way than the shoulder', _ELBOW, Affine.of(_SECOND, T=_SECOND)),
    ('sign', f'the effort {_NEGATED}', 'negate the effort (or both positions)', Affine.of(T=_BOTH)),
    ('sign', f"the shoulder's position {_NEGATED}", _SHOULDER, _from_hanging(_FIRST)),
    ('sign', f"the shoulder's position {_NEGATED}, {_HORIZONTAL}", _TO_HANGING, Affine.of(_FIRST)),
    ('sign', f"the shoulder's effort {_NEGATED}", "negate the shoulder's effort", Affine.of(T=_FIRST)),
    ('sign', f"the elbow's effort {_NEGATED}", "negate the elbow's effort", Affine.of(T=_SECOND)),
    ('order', f'the joints {_DISORDERED}', 'exchange the joints', _from_hanging(_EXCHANGED, _EXCHANGED)),
    ('order', f'the joints {_DISORDERED}', 'exchange the joints', Affine.of(_EXCHANGED, T=_EXCHANGED)),
    ('order', f"the joints' positions {_DISORDERED}", 'exchange the positions', _from_hanging(_EXCHANGED)),
    ('order', f"the joints' positions {_DISORDERED}", 'exchange the positions', Affine.of(_EXCHANGED)),
    ('order', f"the joints' efforts {_DISORDERED}", 'exchange the efforts', Affine.of(T=_EXCHANGED)),
    (*_ABSOLUTE, _from_hanging(_RELATIVE)),
    (*_ABSOLUTE, Affine.of(_RELATIVE)),
    ('degrees', 'the positions are in degrees', 'convert them', Affine.of(_IN_RADIANS)),
    ('degrees', 'the positions are in degrees from hanging', 'convert them', Affine.of(_IN_RADIANS, HANGING)),
    *(
        (
            'counts',
            f'{whose} position is {n:g} times the rotation',
            f'multiply the counts per turn by {n:g}',
            _from_hanging(((n**-shoulder, 0), (0, n**-elbow))),
        )
        for n in (2, 4, 1 / 2, 1 / 4)
        for whose, shoulder, elbow in (("the shoulder's", 1, 0), ("the elbow's", 0, 1), ("each joint's", 1, 1))
    ),
)
#: The expected zeros.
_ZEROS = (
    'q1 must be 0 where link 1 is horizontal, -90 degrees hanging',
    'q2 must be 0 where link 2 continues link 1',
)


def detect_faults(motions: Sequence[Motion], settings: Settings) -> tuple[Fault, ...]:
    """Return the faults of convention that recordings of one rig have in common; none if they are too short.

    Each has the options that correct it and the faults before it. Little motion or large friction may hide a zero or a
    delay. Of two simultaneous faults the first may be confused with another one whose correction fits nearly as well.
    """
    (low, high), delay = settings.delays, settings.least_delay
    long = _long_enough(motions, settings)
    if not long:
        return ()
    if delay and low < high:  # the user expects a delay
        delay = estimate_delay(long, MODEL, BOUNDS, low, high, weights=(1, SETTINGS.elbow, 0))
    recordings = _Recordings(long, delay)
    faults, corrected = list[Fault](), recordings
    while len(faults) < 2 and (fault := _best_correction(corrected)) is not None:
        faults.append(fault)
        corrected = corrected.after(fault.change, fault.delay)
    if corrected.unexplained > SETTINGS.unfit:
        faults, corrected = [], recordings
    if corrected.unexplained > SETTINGS.poor_fit:
        faults += _unfit(corrected)
    faults += _wrong_unit(corrected)
    if settings.link_length is not None:
        model = 'rotor' if settings.model == 'auto' else settings.model
        faults += _wrong_length(corrected, model, settings.link_length)
    return tuple(_with_options(faults, settings.reading))


def corrections(motion: Motion, delay: float, settings: Settings) -> list[Fault]:
    """Return all corrections of one recording that may be tried, whether they fit or not; none if it is too short."""
    recordings = _Recordings(_long_enough([motion], settings), delay)
    if not recordings.motions or math.isinf(recordings.limit):
        return []
    return [*_candidates(recordings), *_wrong_unit(recordings)]


def _long_enough(motions: Sequence[Motion], settings: Settings) -> tuple[Motion, ...]:
    """Return the recordings that are longer than a test function and all delays; none if the effort is constant."""
    low, high = settings.delays
    shortest = WIDTH + max(DELAYS[1], high) - min(DELAYS[0], low)
    long = tuple(m for m in motions if m.end - m.start > shortest)
    # A constant effort has the effect of gravity in another direction.
    return long if any(np.ptp(m.recorded.tau, axis=0).any() for m in long) else ()


def _with_options(faults: Sequence[Fault], conversion: Conversion) -> Iterator[Fault]:
    """Yield the faults with the options that correct them one after the other."""
    for fault in faults:
        corrected = None if fault.change is None else conversion.then(fault.change)
        if corrected is not None:
            before, after = conversion.options(), corrected.options()
            added, removed = [o for o in after if o not in before], [o for o in before if o not in after]
            words = [f'add {" ".join(added)}'] * bool(added) + [f'leave out {" ".join(removed)}'] * bool(removed)
            fault, conversion = replace(fault, options=tuple(words), corrected_conversion=corrected), corrected
        yield fault


def corrected(motion: Motion, delay: float, faults: Sequence[Fault]) -> tuple[Motion, float]:
    """Return a motion and the delay of its effort [s] after the corrections of faults."""
    recordings = _Recordings((motion,), delay)
    for fault in faults:
        recordings = recordings.after(fault.change, fault.delay)
    return recordings.motions[0], recordings.delay


def corrected_conversion(faults: Sequence[Fault]) -> Conversion | None:
    """Return the conversion that corrects as many of the faults as options can; None if they correct none."""
    return next((f.corrected_conversion for f in reversed(faults) if f.corrected_conversion is not None), None)


def sound(faults: Sequence[Fault], zeros: Array | None = None) -> bool:
    """Return whether signs, order and zeros are right, or ``zeros`` [rad], shape (R, 2), contain the wrong zero."""
    severe = [f for f in faults if f.level is Level.ERROR and f.name not in ('delay', 'motion', 'offset')]
    return all(zeros is not None and _is_zero(fault, zeros) for fault in severe)


def _is_zero(fault: Fault, zeros: Array) -> bool:
    """Return whether a fault is the common error of the zeros [rad], shape (R, 2)."""
    change = fault.change if fault.name == 'zero' else None
    return change is not None and bool((np.abs(change.c + zeros.mean(axis=0)) < SETTINGS.zero)[change.c != 0].all())


def agrees_with_exact_fit(fault: Fault, zeros: Array) -> bool:
    """Return whether a fault is consistent with an exact fit and its zeros [rad], shape (R, 2)."""
    return _is_zero(fault, zeros) or fault.name in ('unit', 'length', 'delay', 'counts')


def link_length(motions: Sequence[Motion], model: str, delay: float = 0.0) -> tuple[float, float]:
    """Return P3 / P5 = l1, the length of link 1 [m], and its standard error, from the elbow's own equation.

    On a pendubot that equation contains no torque. If the result differs from the measured length, signs, zeros or
    timestamps of the angles are wrong, not the torque constant. Both are NaN if all motions are shorter than the test
    function, which ``energy`` does not need.
    """
    motions = [motion for motion in motions if motion.end - motion.start > WIDTH + abs(delay)]
    if not motions:
        return math.nan, math.nan
    names = NAMES[: MODELS[model]]
    others = [names.index(name) for name in ('P3', 'P2', 'b2', 'Fc2', 'J2', 'Fs2', 'k2') if name in names]
    parts = []
    for motion in motions:
        residuals = weak_regression(motion, model, delay, weights=(1, 1))
        phi, y, t = (values[1::2] for values in (residuals.phi, residuals.y, residuals.t))
        # All is divided by P5, whose column contains no velocity.
        parts.append(Regression(np.column_stack([phi[:, others], -y]), -phi[:, names.index('P5')], t))
    ratios = _pooled(parts).free_minimum()
    _, std_error, *_ = regression_covariance(parts, ratios, np.ones(len(ratios), dtype=bool))
    return float(ratios[0]), float(std_error[0])


def joint_regression(motion: Motion, model: str, delay: float) -> Regression:
    """Return the weak-form residuals of both joints, with a weight for the elbow."""
    return weak_regression(motion, model, delay, weights=(1, SETTINGS.elbow), stride=DELAY_STRIDE, coarse=True)


@dataclass(frozen=True)
class _Recordings:
    """Recordings after corrections, with the fit of the weak criterion."""

    motions: tuple[Motion, ...]
    delay: float

    def after(self, change: Affine | None = None, delay: float | None = None) -> _Recordings:
        """Return the recordings after a correction."""
        motions = self.motions if change is None else tuple(motion.changed(change) for motion in self.motions)
        return _Recordings(motions, self.delay if delay is None else delay)

    @cached_property
    def regressions(self) -> list[Regression]:
        key = 'conventions', self.delay
        return [m.once(key, partial(joint_regression, m, MODEL, self.delay)) for m in self.motions]

    @cached_property
    def criterion(self) -> Quadratic:
        return _pooled(self.regressions)

    @cached_property
    def unexplained(self) -> float:
        return unexplained_fraction(self.criterion)

    @property
    def strongest(self) -> tuple[_Recordings, float]:
        """The recording with the largest squared effort, and its fraction of that of all recordings."""
        efforts = np.array([part.y @ part.y for part in self.regressions])
        most = int(efforts.argmax())
        return _Recordings(self.motions[most : most + 1], self.delay), float(efforts[most] / max(efforts.sum(), 1e-300))

    def squared_residuals(self) -> Array:
        """Return the squared residual of each recording with the common parameters."""
        theta = self.criterion.minimum_in_box(BOUNDS)
        return np.array([((part.phi @ theta - part.y) ** 2).sum() for part in self.regressions])

    @property
    def freedom(self) -> float:
        """Degrees of freedom: test functions half a support apart are independent, each with two equations."""
        seconds = sum(motion.end - motion.start for motion in self.motions)
        return 4 * min(seconds, SETTINGS.longest) / WIDTH - len(BOUNDS.names) - 1

    @property
    def limit(self) -> float:
        """Ratio of unexplained fractions above which one more parameter is significant, by the F test."""
        n = self.freedom
        return 1 + float(fdtri(1, n, 1 - SETTINGS.significance)) / n if n > 0 else math.inf


def _candidates(recordings: _Recordings) -> list[Fault]:
    """Return the corrections, at level OK if the error is too small for a fault."""
    return [*_turns(recordings), *_zeros(recordings), *_offset(recordings), *_delay(recordings)]


def _best_correction(recordings: _Recordings) -> Fault | None:
    """Return the fault whose correction fits best, if that is significant, and name others that fit as well."""
    unexplained, limit = recordings.unexplained, recordings.limit
    if math.isinf(limit):
        return None
    candidates = _candidates(recordings)
    # Small errors are no faults; a correction must explain more than they do.
    expected = min([unexplained, *(each.corrected for each in candidates if each.level is Level.OK)])
    ranked = sorted((each for each in candidates if each.level > Level.OK), key=lambda each: each.corrected)
    if not ranked:
        return None
    best = ranked[0]
    # For a zero, a small error of the other one does not count. Less than 1e-12 is a rounding error.
    before = unexplained if best.name == 'zero' else expected
    if before < limit * best.corrected + 1e-12 or best.corrected > SETTINGS.unfit:
        return None
    gains = recordings.squared_residuals() - recordings.after(best.change, best.delay).squared_residuals()
    if len(gains) > 1 and gains.sum() <= gains.max():  # the fault of one recording alone
        return None
    # Of corrections with the same residual the first is reported: without elbow effort some are equal.
    tied = {each.corrected: each.found for each in reversed(ranked) if each.corrected <= limit * best.corrected}
    names = dict.fromkeys(tied[corrected] for corrected in sorted(tied))
    level = best.level if unexplained < SETTINGS.severe * best.corrected else Level.ERROR
    return replace(best, found=', or '.join(names), level=level, unexplained=unexplained)


def _turns(recordings: _Recordings) -> Iterator[Fault]:
    moved = max(float(np.ptp(m.recorded.q, axis=0).max()) for m in recordings.motions)
    strongest, part = recordings.strongest
    for name, found, remedy, change in _TURNS:
        if name == 'degrees' and moved < SETTINGS.degrees:
            continue
        try:
            # With all recordings, the residual is not less than with one; efforts are assumed to change alike.
            if part * strongest.after(change).unexplained > recordings.unexplained:
                continue
            corrected = recordings.after(change).unexplained
        except TrajectoryError:  # the motion would be faster than a rig can be
            continue
        # An angle divided by n has a quantization noise divided by n^2, and fits better for that alone.
        squared = 4 ** np.abs(np.log2(np.diag(change.Q))).max() if name == 'counts' else 0.0
        if squared * recordings.limit * corrected > recordings.unexplained:
            continue
        yield Fault(name, found, f'{_EXPECTED[name]}: {remedy}', Level.ERROR, corrected=corrected, change=change)


def _zeros(recordings: _Recordings) -> Iterator[Fault]:
    """Yield the errors of both zeros, at level OK if friction can hold the link there."""
    for joint, expected in enumerate(_ZEROS):
        criterion = _turned_criterion(recordings, joint)
        angle = _best_angle(criterion, recordings.limit)
        theta = dict(zip(NAMES, criterion(angle).minimum_in_box(BOUNDS), strict=False))
        weight = GRAVITY * (theta['P5'] + (theta['P4'] if joint == 0 else 0.0))
        friction = SETTINGS.static * theta[('Fc1', 'Fc2')[joint]]
        held = math.asin(friction / weight) if friction < weight else math.pi / 2
        wrong = abs(angle) > max(SETTINGS.zero, held / math.sqrt(len(recordings.motions)))
        corrected, degrees = unexplained_fraction(criterion(angle)), math.degrees(angle)
        # For one parameter, F is the square of its value over its standard error.
        F = (recordings.unexplained / max(corrected, 1e-12) - 1) * recordings.freedom
        error = abs(degrees) / math.sqrt(F) if F > 0 else math.inf
        found = f"q{joint + 1}'s zero is off by {degrees:.1f} +- {error:.1g} degrees"
        remedy, change = f'{expected}: subtract {degrees:.1f} degrees', _subtracted(joint, angle)
        yield Fault('zero', found, remedy, Level.WARN if wrong else Level.OK, corrected=corrected, change=change)


def _turned_criterion(recordings: _Recordings, joint: int) -> Callable[[float], Quadratic]:
    """Return the criterion as a function of an angle [rad] that is subtracted from a joint's position.

    The columns of gravity and coupling are linear in its cosine and sine. A quarter turn gives the columns of the sine.
    """
    size, columns = len(BOUNDS.names), ([3, 4], [2, 4])[joint]
    quarter = recordings.after(_subtracted(joint, math.pi / 2)).regressions
    criterion = _pooled(recordings.regressions, [part.phi[:, columns] for part in quarter])

    def turned(angle: float) -> Quadratic:
        directions = np.eye(size + 2, size)
        directions[columns, columns], directions[[size, size + 1], columns] = math.cos(angle), math.sin(angle)
        return criterion.along(directions)

    return turned


def _best_angle(criterion: Callable[[float], Quadratic], limit: float) -> float:
    """Return the angle that fits best, or a quarter turn, a likely convention, if it fits as well."""

    def least(angle: float) -> float:
        return criterion(angle).least_in_box(BOUNDS)

    step = math.pi / 12
    angles = np.arange(-math.pi, math.pi, step)
    nearest = smallest(angles, [criterion(angle).floor for angle in angles], least)
    found = minimize_scalar(least, bounds=(nearest - step, nearest + step), options={'xatol': 1e-4}).x
    best = min(float(found), nearest, key=least)
    quarter = round(best / (math.pi / 2)) * math.pi / 2
    return quarter if quarter and least(quarter) < limit * least(best) else best


def _offset(recordings: _Recordings) -> Iterator[Fault]:
    """Yield the constant error of the recorded effort at the shoulder [N m]."""
    largest = max(float(np.abs(m.recorded.tau[:, 0]).max()) for m in recordings.motions)
    if largest > 0:
        shoulder = [np.arange(len(part.y)) % 2 == 0 for part in recordings.regressions]
        criterion, bounds = _pooled(recordings.regressions, shoulder), BOUNDS.beside(('offset',), largest)
        offset, corrected = float(criterion.minimum_in_box(bounds)[-1]), unexplained_fraction(criterion, bounds)
        found = f"the shoulder's effort is off by a constant {offset:.3g} N m"
        remedy = f'it must be 0 where no torque acts: subtract {offset:.3g} N m'
        level = Level.WARN if recordings.unexplained - corrected > SETTINGS.offset else Level.OK
        yield Fault('offset', found, remedy, level, corrected=corrected, change=Affine.of(d=(-offset, 0.0)))


def _delay(recordings: _Recordings) -> Iterator[Fault]:
    """Yield the delay of the effort."""
    delay = estimate_delay(recordings.motions, MODEL, BOUNDS, *DELAYS, weights=(1, SETTINGS.elbow, 0))
    # The difference between held and measured efforts is half an interval, and the hold is uncertain.
    least = SETTINGS.delay + max(motion.interval for motion in recordings.motions) / 2
    late = round(1000 * delay)
    shift = f'is stamped {-late} ms later than it acts' if late < 0 else f'acts {late} ms later than it is stamped'
    remedy = f'each effort must bear the time from which it acts: identify with a delay of {delay:.3f} s'
    level = Level.WARN if abs(delay - recordings.delay) >= least else Level.OK
    corrected = recordings.after(delay=delay).unexplained
    yield Fault('delay', f'the effort {shift}', remedy, level, corrected=corrected, delay=delay)


def _unfit(recordings: _Recordings) -> Iterator[Fault]:
    """Yield a fault if the motion fits no pendubot with any unit of the effort."""
    moved = np.max([np.ptp(m.recorded.q, axis=0) for m in recordings.motions], axis=0)
    if math.isfinite(recordings.limit) and moved.min() > SETTINGS.moved:
        unfit = recordings.unexplained > SETTINGS.unfit
        yield Fault(
            'motion',
            f'the motion {"does not fit" if unfit else "hardly fits"} any pendubot: the model does not explain '
            f'{100 * recordings.unexplained:.3g} % of the squared effort, and no known correction helps',
            'check the signs and zeros of both angles, the order of the joints, whether q2 is relative to link 1, '
            'units and counts per turn, the sign and the stamps of the effort, and whether the links moved freely',
            Level.ERROR if unfit else Level.WARN,
            unexplained=recordings.unexplained,
        )


def _wrong_unit(recordings: _Recordings) -> Iterator[Fault]:
    """Yield a fault if the effort is in mN m, by an implausible density of link 2.

    m2 is at least P5^2 / P2, and d2 at most P2 / P5.
    """
    theta, unexplained = recordings.criterion.minimum_in_box(BOUNDS), recordings.unexplained
    P2, P5 = theta[1], theta[4]
    least = float((P5**5 / SETTINGS.dense) ** 0.25)
    # A less dense link must fit significantly worse.
    if 0 < P2 < least and unexplained < SETTINGS.unfit:
        less_dense = unexplained_fraction(recordings.criterion, BOUNDS.replaced('P2', least, least))
        if less_dense > recordings.limit * unexplained:
            found = (
                f'link 2 would weigh {P5**2 / P2:.3g} kg or more, within {100 * P2 / P5:.2g} cm of its joint; the '
                'effort seems to be in mN m'
            )
            change = Affine.of(T=np.eye(2) / 1000)
            yield Fault('unit', found, 'it must be in N m: divide it by 1000', Level.ERROR, change=change)


def _wrong_length(recordings: _Recordings, model: str, expected: float) -> Iterator[Fault]:
    length, error = link_length(recordings.motions, model, recordings.delay)
    if abs(length - expected) > max(-ndtri(SETTINGS.significance / 2) * error, SETTINGS.length * expected):
        yield Fault(
            'length',
            f'the elbow moves as on a link 1 of {length:.3f} +- {error:.3f} m, {expected:.3f} m is expected',
            'measure from axis to axis, and check the signs, the zeros, the counts per turn and the stamps of both '
            'angles',
        )


def _subtracted(joint: int, angle: float) -> Affine:
    return Affine.of(c=-angle * np.eye(2)[joint])


def _pooled(parts: Sequence[Regression], more: Sequence[Array] | None = None) -> Quadratic:
    """Return the criterion of recordings, with additional columns for each of them."""
    columns = [part.phi for part in parts]
    if more is not None:
        columns = [np.column_stack(pair) for pair in zip(columns, more, strict=True)]
    return Quadratic.pool([Quadratic.reduce(phi, part.y) for phi, part in zip(columns, parts, strict=True)])


def unexplained_fraction(criterion: Quadratic, bounds: Bounds = BOUNDS) -> float:
    """Return the fraction of the squared effort that no parameters within their bounds explain."""
    effort = float(criterion(np.zeros(len(bounds.names))))
    return criterion.least_in_box(bounds) / effort if effort > 0 else 1.0
