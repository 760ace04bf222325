"""MDE, DE and HDE against the paper's Table 1 written as plain loops; DE also against SwarmOps."""

import io
import math
from fractions import Fraction

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from pendubot_identification.optimizers.mde import MDE, MDESettings
from pendubot_identification.optimizers.optimizer import minimize
from pendubot_identification.paper.benchmark_functions import FUNCTIONS
from pendubot_identification.paper.competition import DE_SETTINGS
from pendubot_identification.paper.differential_evolution import HDE, classic
from test.paper.swarmops_peer import peer

RASTRIGIN = FUNCTIONS[3]


class Numbers:
    """What chance says of one run, generation by generation, read from its stream's bytes one number at a time."""

    def __init__(self, seed, run, population, dimension, per_component):
        self.stream = np.random.Generator(np.random.SFC64([seed, run]))
        self.start = self.stream.random((population, dimension))
        self.population, self.dimension, self.per_component = population, dimension, per_component

    def generation(self):
        n, d = self.population, self.dimension
        size = n * (4 + 2 + 2 + 2 * d + (4 * d if self.per_component else 4 + 2))
        words = self.stream.bit_generator.random_raw(4 * math.ceil(size / 32))
        stream = io.BytesIO(b''.join(int(word).to_bytes(8, 'little') for word in words))

        def row(size):
            return [int.from_bytes(stream.read(size), 'little') for _ in range(n)]

        u = {'F': row(4), 'CR': row(2), 'jrand': row(2)}
        u['partners'] = [row(4) for _ in range(d if self.per_component else 1)]
        u['chance'] = [[v // 2 for v in row(2)] for _ in range(d)]
        if not self.per_component:
            u['operator'] = [v // 2 for v in row(2)]
        return u


def partners(i, population, u):
    """Three others, one after the other from those that are left, by the digits of a number from 0 to 1."""
    left, chance = [(i + 1 + k) % population for k in range(population - 1)], Fraction(u, 2**32)
    chosen = []
    for _ in range(3):
        chance *= len(left)
        chosen.append(left.pop(int(chance)))
        chance %= 1
    return chosen


def inside(x, target, low, high):
    return (target + low) / 2 if x < low else (target + high) / 2 if x > high else x


def plain_de(function, dimension, numbers, generations, F, CR, mutation):
    """DE/rand/1/bin or DE/best/1/bin of fixed F and CR, as any textbook has it; partners once a vector."""
    half = function.half_width
    X = (-half + numbers.start * (2 * half)).tolist()
    J = [float(function.value(np.array(x))) for x in X]
    for _ in range(generations):
        u, best = numbers.generation(), X[int(np.argmin(J))]
        trials = []
        for i, x in enumerate(X):
            r2, r3, r1 = partners(i, len(X), u['partners'][0][i])
            base = X[r1] if mutation == 'rand/1' else best
            jrand = u['jrand'][i] * dimension // 2**16
            v = list(x)
            for j in range(dimension):
                if u['chance'][j][i] < round(CR * 2**15) or j == jrand:
                    v[j] = inside(base[j] + F * (X[r2][j] - X[r3][j]), x[j], -half, half)
            trials.append(v)
        for i, v in enumerate(trials):
            value = float(function.value(np.array(v)))
            if value <= J[i]:
                X[i], J[i] = v, value
    return min(J), X[int(np.argmin(J))]


def papers_mde(function, dimension, numbers, generations, settings):
    """The pseudocode of the paper's Table 1, line by line, with one flag for its text's reading."""
    half, NP = function.half_width, settings.population
    (F_low, F_high), (CR_low, CR_high) = settings.weight, (round(CR * 2**15) for CR in settings.crossover)
    threshold = round(settings.threshold * 2**15)
    X = (-half + numbers.start * (2 * half)).tolist()
    J = [float(function.value(np.array(x))) for x in X]
    for _ in range(generations):
        u, best = numbers.generation(), X[int(np.argmin(J))]
        trials = []
        for i in range(NP):
            F = F_low + u['F'][i] // 2 / 2**31 * (F_high - F_low)
            CR = CR_low + u['CR'][i] * (CR_high - CR_low + 1) // 2**16
            jrand = u['jrand'][i] * dimension // 2**16
            v = list(X[i])
            for j in range(dimension):
                chance = u['chance'][j][i]
                if chance < CR or j == jrand:
                    k = j if settings.per_component else 0
                    # r1, r2, r3 of the paper are any three; best/1 uses two of them, rand/1 all.
                    a, b, c = partners(i, NP, u['partners'][k][i])
                    if not settings.per_component:
                        is_best = u['operator'][i] < threshold
                    elif j == jrand:
                        is_best = chance < threshold
                    else:
                        is_best = chance < CR * threshold // 2**15
                    base = best[j] if is_best else X[c][j]
                    v[j] = inside(base + F * (X[a][j] - X[b][j]), X[i][j], -half, half)
            trials.append(v)
        for i, v in enumerate(trials):
            value = float(function.value(np.array(v)))
            if value <= J[i]:
                X[i], J[i] = v, value
    return min(J), X[int(np.argmin(J))]


def agree(optimizer, function, seed, plain):
    """Assert that every run ended where the plain loop ends, to the last bit."""
    result = minimize(optimizer, function.value)
    per_component = optimizer.settings.per_component
    for run in range(len(result.value)):
        numbers = Numbers(seed, run, optimizer.settings.population, result.x.shape[1], per_component)
        value, x = plain(numbers)
        assert value == result.value[run]
        assert x == result.x[run].tolist()


@pytest.mark.parametrize('per_component', [True, False])
@pytest.mark.parametrize('function', FUNCTIONS[1:], ids=lambda f: f.name)
def test_mde_is_the_papers_table_1(function, per_component):
    settings = MDESettings(population=9, generations=40, per_component=per_component)
    optimizer = MDE(function.bounds(3), settings, runs=2, seed=7)
    agree(optimizer, function, 7, lambda numbers: papers_mde(function, 3, numbers, 40, settings))


def test_mde_without_its_novelties_is_plain_de():
    settings = classic(generations=50)
    optimizer = MDE(RASTRIGIN.bounds(4), settings, runs=2, seed=3)
    agree(optimizer, RASTRIGIN, 3, lambda numbers: plain_de(RASTRIGIN, 4, numbers, 50, 0.6714, 0.5026, 'rand/1'))


@pytest.mark.parametrize(('threshold', 'mutation'), [(1.0, 'best/1'), (0.0, 'rand/1')])
def test_the_threshold_at_its_ends_is_one_operator(threshold, mutation):
    settings = MDESettings(10, 40, threshold, (0.5, 0.5), (0.9, 0.9), per_component=False)
    optimizer = MDE(RASTRIGIN.bounds(3), settings, runs=3, seed=5)
    agree(optimizer, RASTRIGIN, 5, lambda numbers: plain_de(RASTRIGIN, 3, numbers, 40, 0.5, 0.9, mutation))


def test_hde_without_a_step_is_de():
    """A step of length 0 changes nothing, whatever it costs."""
    bounds = RASTRIGIN.bounds(3)
    de = minimize(MDE(bounds, classic(generations=60), runs=4, seed=2), RASTRIGIN.value)
    hde = minimize(HDE(bounds, RASTRIGIN.gradient, classic(generations=60), rate=0.0, runs=4, seed=2), RASTRIGIN.value)
    np.testing.assert_array_equal(hde.x, de.x)
    np.testing.assert_array_equal(hde.history, de.history)
    assert hde.evaluations.tolist() == [18 + 60 * 19] * 4
    assert hde.cost.tolist() == [18 + g * 19 for g in range(61)]


def test_hde_steps_down_the_gradient_of_the_best():
    sphere = FUNCTIONS[0]
    asked = []

    def watched(x):
        asked.append(x.copy())
        return sphere.value(x)

    result = minimize(HDE(sphere.bounds(2), sphere.gradient, classic(generations=30), rate=0.25, runs=3), watched)
    assert [a.shape[1] for a in asked] == [18] + [19] * 30
    for generation in range(1, 31):
        step = asked[generation][:, -1]
        np.testing.assert_allclose(sphere.value(step), result.history[generation - 1] / 4, rtol=1e-12)
        assert (result.history[generation] <= sphere.value(step) * (1 + 1e-12)).all(), 'a step that is better is kept'
    once = minimize(HDE(sphere.bounds(5), sphere.gradient, classic(target=0.0), rate=0.5), sphere.value)
    assert once.generations.tolist() == [1] * 10, 'half of this gradient leads to the minimum at once'


def test_hde_stays_inside_and_takes_no_step_that_is_worse():
    griewank = FUNCTIONS[1]
    asked = []

    def watched(x):
        asked.append(np.abs(x).max())
        return griewank.value(x)

    optimizer = HDE(griewank.bounds(3), griewank.gradient, classic(generations=50), rate=1e4, runs=4)
    result = minimize(optimizer, watched)
    assert max(asked) <= griewank.half_width
    assert (np.diff(result.history, axis=0) <= 0).all()


@pytest.mark.parametrize('function', FUNCTIONS, ids=lambda f: f.name)
def test_de_agrees_with_swarmops(function):
    """Table 3's settings, n = 2, 100 runs of 30 generations: the errors come from one distribution."""
    settings = classic(DE_SETTINGS.population, 0.6714, 0.5026, generations=29)
    ours = minimize(MDE(function.bounds(2), settings, runs=100, seed=1), function.value).value
    theirs = peer('DE', function, 2, [18, 0.5026, 0.6714], evaluations=30 * 18, runs=100, seed=1)
    assert mannwhitneyu(ours, theirs).pvalue > 0.01
