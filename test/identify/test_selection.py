# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What is left out in turn, and which model the predictions of that speak for."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from pendubot_identification.identify.estimate import Effort, Estimate, averaged
from pendubot_identification.identify.prediction import HORIZONS, Prediction
from pendubot_identification.identify.selection import compare_models, folds
from pendubot_identification.model.parameters import MODELS
from pendubot_identification.trajectories.motion import Motion
from pendubot_identification.trajectories.trajectory import Trajectory


def motion(samples, start=0.0, name='m'):
    t = start + 0.01 * np.arange(samples)
    return Motion.prepare(Trajectory(t, np.zeros((samples, 2)), np.zeros((samples, 2)), name=name), 0.0)


recordings = st.lists(st.integers(100, 900), min_size=1, max_size=6).map(
    lambda lengths: [motion(n, start=3.0 * k, name=f'recording {k}') for k, n in enumerate(lengths)]
)


@given(recordings)
def test_folds_leave_nothing_out_twice_and_lose_nothing(motions):
    found = folds(motions)
    for whole in motions:
        held_out = sorted((f.held_out.start, f.held_out.end) for f in found if f.held_out.name == whole.name)
        edges = np.array(held_out).ravel()
        assert edges[0] == whole.start
        assert edges[-1] == whole.end
        np.testing.assert_array_equal(edges[1:-1:2], edges[2::2], 'one begins where the other ends')
        assert (np.diff(edges)[::2] > 0).all()
    total = sum(m.end - m.start for m in motions)
    for fold in found:
        everything = [fold.held_out, *fold.training]
        assert sum(m.end - m.start for m in everything) == pytest.approx(total)
        for m in fold.training:
            if m.name == fold.held_out.name:
                assert m.end <= fold.held_out.start or m.start >= fold.held_out.end
        assert all(len(m.recorded) > 1 for m in everything)

    assert len({f.name for f in found}) == len(found)
    if len(motions) >= 3:
        assert [(f.name, f.held_out) for f in found] == [(m.name, m) for m in motions]
    else:
        first = found[0].held_out
        assert len(found) in (5, 6)
        assert found[0].name == f'{first.name}, 0.00 to {first.end - first.start:.2f} s'


def predicted(loss=0.0):
    """A prediction of a given loss."""
    errors = np.full((len(HORIZONS), 4), np.exp(loss))
    return Prediction(errors, errors, np.full(len(HORIZONS), 10))


losses = st.integers(2, 8).flatmap(
    lambda count: st.lists(
        st.lists(st.floats(-6, 1), min_size=count, max_size=count), min_size=len(MODELS), max_size=len(MODELS)
    )
)


@given(losses)
def test_the_smallest_model_within_one_standard_error_of_the_best_is_chosen(rows):
    chosen, scores = compare_models(
        {model: [predicted(loss) for loss in row] for model, row in zip(MODELS, rows, strict=True)}
    )
    assert [s.model for s in scores] == list(MODELS)
    values = np.array(rows)
    best = values[np.argmin(values.mean(axis=1))]
    # Of different models that are as good on average, rounding says which is the best.
    assume(all((row == best).all() or row.mean() > best.mean() + 1e-9 for row in values))
    for score, row in zip(scores, values, strict=True):
        assert score.loss == pytest.approx(row.mean())
        deviation = np.std(row - best, ddof=1) / np.sqrt(len(row))
        assert score.behind == pytest.approx((row.mean() - best.mean(), deviation), abs=1e-9)
        assert score.error.shape == (3,)
    number = list(MODELS).index(chosen)
    within = [s.behind[0] <= s.behind[1] for s in scores]
    assert within[number]
    assert not any(within[:number])
    assert scores[number].loss >= min(s.loss for s in scores)


HARD = np.array([-4.0, -1.0, -2.5, 0.0])
NOISE = np.array([0.01, -0.01, 0.0, 0.005])


@pytest.mark.parametrize(
    ('losses', 'expected'),
    [
        # Recordings differ by far more than the models, but on every one the third is better than the first two.
        ((HARD + 0.3, HARD + 0.2 + NOISE, HARD, HARD + NOISE / 10), 'rotor'),
        # Better, but on one recording only.
        ((HARD, HARD - [0.5, 0, -0.05, 0], HARD + 1, HARD + 1), 'viscous'),
    ],
)
def test_what_counts_is_the_difference_on_the_same_recordings(losses, expected):
    chosen, scores = compare_models(
        {model: [predicted(loss) for loss in row] for model, row in zip(MODELS, losses, strict=True)}
    )
    assert chosen == expected
    assert scores[1].loss < scores[0].loss


def test_folds_that_tell_nothing_do_not_count():
    """Recordings too short for any prediction, beside one that is not; and no other at all."""
    nothing = Prediction.none()
    rows = {'viscous': -1.0, 'coulomb': -3.0, 'rotor': -3.0, 'geared': -2.0}
    chosen, scores = compare_models({model: [nothing, predicted(loss), nothing] for model, loss in rows.items()})
    assert chosen == 'coulomb'
    assert scores[0].behind == (2.0, pytest.approx(np.nan, nan_ok=True)), 'of one fold there is no spread'
    assert compare_models({model: [nothing] for model in rows})[0] == 'viscous'


def test_a_model_that_is_exact_is_chosen_whatever_the_folds_say():
    rows = {'viscous': -1.0, 'coulomb': -2.0, 'rotor': -3.0}
    chosen, scores = compare_models({model: [predicted(loss)] * 3 for model, loss in rows.items()}, exact='coulomb')
    assert chosen == 'coulomb'
    assert [s.exact for s in scores] == [False, True, False]
    assert not any(s.exact for s in compare_models({model: [predicted(loss)] for model, loss in rows.items()})[1])


def answer(model, theta, std_error, delay=0.0):
    size = len(theta)
    return Estimate(
        criterion='weak',
        model=model,
        theta=np.array(theta),
        free=np.ones(size, dtype=bool),
        covariance=np.diag(std_error) ** 2.0,
        correlation=np.eye(size),
        std_error=np.array(std_error),
        uncertainty='known',
        effort=Effort('zero', delay),
        J=1.0,
        residuals=1,
        condition_number=1.0,
        converged=True,
        held=np.zeros(len(theta), dtype=bool),
    )


def test_the_average_of_models_knows_how_they_differ():
    small, large = answer('rotor', [1.0, 2.0], [0.1, 0.2]), answer('geared', [3.0, 2.0, 4.0], [0.1, 0.4, 1.0], 0.01)
    found = averaged([small, large], [0.25, 0.75])
    assert found.model == 'geared'
    np.testing.assert_allclose(found.theta, [2.5, 2.0, 3.0])
    assert found.effort.delay == pytest.approx(0.0075)
    variance = [0.01 + 0.25 * 1.5**2 + 0.75 * 0.5**2, 0.25 * 0.04 + 0.75 * 0.16, 0.75 + 0.25 * 9 + 0.75 * 1]
    np.testing.assert_allclose(found.std_error**2, variance)
    np.testing.assert_allclose(np.diag(found.covariance), variance)
    np.testing.assert_allclose(found.covariance[0, 2], 0.25 * -1.5 * -3 + 0.75 * 0.5 * 1)
    assert '25 % rotor, 75 % geared' in found.steps[-1]


def test_a_parameter_on_its_bound_in_one_model_alone_is_free_in_the_average():
    small, large = answer('rotor', [1.0], [0.1]), answer('geared', [0.0], [0.2])
    bound = replace(large, free=np.array([False]), covariance=np.full((1, 1), np.nan))
    assert averaged([small, bound], [0.5, 0.5]).covariance == pytest.approx(0.25 + 0.01 / 2)
    both = averaged([replace(bound, model='rotor'), bound], [0.5, 0.5])
    assert not both.free.any()
    assert np.isnan(both.covariance).all()
