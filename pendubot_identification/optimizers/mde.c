// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* One generation of modified differential evolution (mde.py) on a quadratic criterion.
 *
 * Plain C without Python.h, called through ctypes. It has its own random number generator. An array of vectors has one
 * row for each component, so that the compiler vectorises the loops along rows. The length of a row is the population,
 * rounded up to a multiple of ROW; the additional elements are computed and ignored.
 */
#include "../model/motion.h"
#include <math.h>

#define ROW 16
#define EACH(t, count) _Pragma("GCC ivdep") for (int64_t t = 0; t < (count); t++)

typedef struct {
    int64_t population, dimension, per_component;
    double threshold, F_low, F_high, CR_low, CR_high, worth, largest_coupling;
} Settings;

/* ROW parallel xoshiro128++ generators (Blackman and Vigna, 2019). */
typedef struct {
    uint32_t a[ROW], b[ROW], c[ROW], d[ROW];
} Random;

/* Memory of a generation: one row each, but four rows of random words, and D rows of targets and of trials. */
typedef struct {
    uint32_t *words, *CR;
    int32_t *jrand, *base, *plus, *minus;
    double *F, *costs, *residuals, *targets, *trials;
} Memory;

INLINE uint32_t rotate(uint32_t x, int k) { return x << k | x >> (32 - k); }

INLINE void draw(Random *restrict s, uint32_t *restrict words, int32_t count)
{
    for (int32_t at = 0; at < count; at += ROW)
        EACH(l, ROW) {
            uint32_t a = s->a[l], b = s->b[l], c = s->c[l] ^ s->a[l], d = s->d[l] ^ s->b[l];
            words[at + l] = rotate(a + s->d[l], 7) + a;
            s->a[l] = a ^ d, s->b[l] = b ^ c, s->c[l] = c ^ b << 9, s->d[l] = rotate(d, 11);
        }
}

/* Convert a random word to an integer below n; to a 31-bit integer, for comparisons; to a number from 0 to 1. */
INLINE int32_t below(uint32_t word, int32_t n) { return (uint64_t)word * (uint32_t)n >> 32; }
INLINE uint32_t fraction(uint32_t word) { return word >> 1; }
INLINE double unit(uint32_t word) { return (int32_t)fraction(word) * 0x1p-31; }

/* Choose operator and partners of every target t: the mutant is x[base] + F (x[plus] - x[minus]). */
INLINE void choose(const Settings *s, Random *random, const Memory *m, int32_t rows, int32_t best)
{
    int32_t n = s->population;
    uint32_t threshold = s->threshold * 0x1p31;
    const uint32_t *u1 = m->words, *u2 = u1 + rows, *u3 = u2 + rows, *u4 = u3 + rows;
    draw(random, m->words, 4 * rows);
    EACH(t, rows) {
        /* Three other vectors, as distances from the target. */
        int32_t r1 = below(u1[t], n - 1), r2 = below(u2[t], n - 2), r3 = below(u3[t], n - 3);
        r2 += r2 >= r1;
        int32_t low = r1 < r2 ? r1 : r2, high = r1 < r2 ? r2 : r1;
        r3 += r3 >= low;
        r3 += r3 >= high;
        r1 += t + 1, r2 += t + 1, r3 += t + 1;
        r1 -= r1 < n ? 0 : n, r2 -= r2 < n ? 0 : n, r3 -= r3 < n ? 0 : n;
        /* Line 14 of Table 1, see mde.py. */
        int32_t best_1 = fraction(u4[t]) < threshold;
        m->base[t] = best_1 ? best : r1;
        m->plus[t] = !best_1 ? r2 : r1 == best ? r3 : r1;
        m->minus[t] = !best_1 | (r2 == best) ? r3 : r2;
    }
}

INLINE void make_trials(const Settings *s, Random *random, const Memory *m, int32_t rows, const double *lower,
    const double *upper, int32_t best)
{
    int32_t d = s->dimension;
    const uint32_t *u1 = m->words, *u2 = u1 + rows, *u3 = u2 + rows;
    draw(random, m->words, 3 * rows);
    EACH(t, rows) {
        m->F[t] = s->F_low + (s->F_high - s->F_low) * unit(u1[t]);
        m->CR[t] = (s->CR_low + (s->CR_high - s->CR_low) * unit(u2[t])) * 0x1p31;
        m->jrand[t] = below(u3[t], d);
    }
    for (int32_t j = 0; j < d; j++) {
        const double *targets = m->targets + j * rows;
        double *restrict trial = m->trials + j * rows, low = lower[j], high = upper[j];
        if (s->per_component || j == 0)
            choose(s, random, m, rows, best);
        draw(random, m->words, rows);
        EACH(t, rows) {
            double v = targets[m->base[t]] + m->F[t] * (targets[m->plus[t]] - targets[m->minus[t]]);
            double bound = v < low ? low : high;
            v = (v < low) | (v > high) ? (targets[t] + bound) / 2.0 : v;
            trial[t] = (fraction(m->words[t]) < m->CR[t]) | (m->jrand[t] == j) ? v : targets[t];
        }
    }
}

/* |root [x, -1]|^2, plus the penalty worth * coupling_excess(), see parameters.py. */
INLINE void evaluate(const Settings *s, const Memory *m, int32_t rows, const double *root)
{
    int32_t d = s->dimension;
    const double *x = m->trials;
    double *restrict r = m->residuals, *restrict costs = m->costs, stretch = 2.0 / s->largest_coupling;
    EACH(t, rows) costs[t] = root[d * (d + 1) + d] * root[d * (d + 1) + d];
    for (int32_t k = 0; k < d; k++) {
        const double *row = root + k * (d + 1);
        EACH(t, rows) r[t] = -row[d];
        for (int32_t j = k; j < d; j++)
            EACH(t, rows) r[t] += row[j] * x[j * rows + t];
        EACH(t, rows) costs[t] += r[t] * r[t];
    }
    if (s->worth > 0.0)
        EACH(t, rows) {
            double P1 = x[t], P2 = x[rows + t], P3 = x[2 * rows + t], coupling = stretch * P3;
            double excess = sqrt((P1 - P2) * (P1 - P2) + coupling * coupling) / (P1 + P2) - 1.0;
            excess = P1 + P2 > 0.0 ? excess : fabs(P3) + 1.0;
            costs[t] += excess > 0.0 ? s->worth * excess : 0.0;
        }
}

/* Advance runs by one generation.
 *
 * root (D + 1, D + 1), lower and upper (D), random (runs), x (D, runs, NP), values (runs, NP). Memory: 9 rows of
 * integers, and 3 + 2 D rows of doubles.
 */
EXPORT void pendubot_mde(const Settings *s, const double *root, const double *lower, const double *upper,
    uint32_t *integers, double *doubles, int64_t runs, Random *random, double *x, double *values)
{
    int32_t n = s->population, d = s->dimension, rows = (n + ROW - 1) / ROW * ROW;
    int32_t *indices = (int32_t *)integers + 5 * rows;
    Memory m = {integers, integers + 4 * rows, indices, indices + rows, indices + 2 * rows, indices + 3 * rows,
        doubles, doubles + rows, doubles + 2 * rows, doubles + 3 * rows, doubles + (3 + d) * rows};
    for (int64_t run = 0; run < runs; run++, x += n, values += n) {
        int32_t best = 0;
        for (int32_t t = 1; t < n; t++)
            best = values[t] < values[best] ? t : best;
        for (int32_t j = 0; j < d; j++)
            memcpy(m.targets + j * rows, x + j * runs * n, n * sizeof(double));
        make_trials(s, random + run, &m, rows, lower, upper, best);
        evaluate(s, &m, rows, root);
        for (int32_t j = 0; j < d; j++) {
            double *restrict target = x + j * runs * n, *restrict trial = m.trials + j * rows;
            EACH(t, n) target[t] = m.costs[t] <= values[t] ? trial[t] : target[t];
        }
        EACH(t, n) values[t] = m.costs[t] <= values[t] ? m.costs[t] : values[t];
    }
}
