// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* Parallel simulations of the pendubot, see rollout.py. */
#include "motion.h"

#define VERSION 8 /* of the interface of rollout.c, filter.c and mde.c; kernel.py checks it */
/* Approximate time of one step of a block [ns]. */
#define ROLLING 150.0
#define DERIVING 500.0

/* The simulations: theta (size, vectors or 1), tau (2, steps, lanes); `state` as for the two functions below. */
typedef struct {
    int64_t size, vectors, lanes, steps, every;
    double h;
    const double *theta, *state, *tau;
    double *result;
} Motions;

LOOP void roll(const void *work, int64_t begin, int64_t end)
{
    const Motions *m = work;
    int64_t size = m->size, vectors = m->vectors, lanes = m->lanes, steps = m->steps, total = vectors * lanes;
    const double *theta = m->theta, *state = m->state, *tau = m->tau;
    double h = m->h, half = h / 2, sixth = h / 6;
    for (int64_t first = LANES * begin; first < total && first < LANES * end; first += LANES) {
        int64_t count = total - first < LANES ? total - first : LANES;
        int64_t vector[LANES], lane[LANES], adjacent = 1;
        for (int w = 0; w < LANES; w++) {
            int64_t i = first + (w < count ? w : count - 1); /* pad the last block with copies of the last lane */
            vector[w] = i / lanes;
            lane[w] = i % lanes;
            adjacent &= lane[w] == lane[0] + w;
        }
        Theta th = {size, {}, {all(1.0 / SIGN_WIDTH), all(1.0 / SIGN_WIDTH)}, {}};
        for (int64_t j = 0; j < size; j++)
            th.p[j] = gather(theta + j * vectors, vector);
        vec q1 = gather(state, lane), q2 = gather(state + lanes, lane);
        vec v1 = gather(state + 2 * lanes, lane), v2 = gather(state + 3 * lanes, lane);
        double *out = m->result + first;
        for (int64_t k = 0;; k++) {
            store(out, q1, count), store(out + total, q2, count);
            store(out + 2 * total, v1, count), store(out + 3 * total, v2, count);
            if (k == steps)
                break;
            out += 4 * total;
            const double *now = tau + k * lanes;
            vec t1 = adjacent ? load(now + lane[0], LANES) : gather(now, lane);
            vec t2 = adjacent ? load(now + steps * lanes + lane[0], LANES) : gather(now + steps * lanes, lane);
            vec k1[4], k2[4], u1 = v1, u2 = v2, x1 = q1, x2 = q2, sum1 = {}, sum2 = {};
            for (int stage = 0; stage < 4; stage++) {
                Point at;
                accelerate(&th, x1, x2, u1, u2, t1, t2, &at);
                k1[stage] = at.a1, k2[stage] = at.a2;
                if (stage < 3) {
                    double part = stage < 2 ? half : h;
                    sum1 += at.a1, sum2 += at.a2;
                    x1 = q1 + part * u1, x2 = q2 + part * u2;
                    u1 = v1 + part * at.a1, u2 = v2 + part * at.a2;
                }
            }
            q1 += h * (v1 + sixth * sum1), q2 += h * (v2 + sixth * sum2);
            v1 += sixth * (k1[0] + 2.0 * (k1[1] + k1[2]) + k1[3]);
            v2 += sixth * (k2[0] + 2.0 * (k2[1] + k2[2]) + k2[3]);
        }
    }
}
/* states (steps + 1, 4, vectors, lanes) of theta (size, vectors), state (4, lanes), tau (2, steps, lanes). */
EXPORT void pendubot_roll(int64_t threads, int64_t size, int64_t vectors, int64_t lanes, int64_t steps, double h,
    const double *theta, const double *state, const double *tau, double *states)
{
    Motions motions = {size, vectors, lanes, steps, 1, h, theta, state, tau, states};
    share(roll, &motions, (vectors * lanes + LANES - 1) / LANES, ROLLING * steps, threads);
}

/* The accelerations, and their derivatives by the initial state and theta (columns), from the derivatives of the state:
 * as in dynamics.py, M da = dh - dM a for M a = h. */
INLINE void accelerate_sensitivity(const Theta *theta, vec q1, vec q2, vec v1, vec v2, vec t1, vec t2,
    const vec dq1[], const vec dq2[], const vec dv1[], const vec dv2[], vec d1[], vec d2[], vec *a1, vec *a2)
{
    const vec *p = theta->p, zero = {};
    Point at;
    accelerate(theta, q1, q2, v1, v2, t1, t2, &at);
    vec slope1 = p[5], slope2 = p[6], one[LARGEST_MODEL] = {}, two[LARGEST_MODEL] = {};
    if (theta->size >= 9) {
        if (theta->size >= 14) {
            double curvature = 2.0 / (STRIBECK_SPEED * STRIBECK_SPEED);
            slope1 -= p[10] * at.stribeck[0] * at.sign[0] * v1 * curvature;
            slope2 -= p[11] * at.stribeck[1] * at.sign[1] * v2 * curvature;
            one[10] = -(at.stribeck[0] * at.sign[0]), two[11] = -(at.stribeck[1] * at.sign[1]);
            one[12] = -(magnitude(t1) * at.sign[0]), two[13] = -(magnitude(t2) * at.sign[1]);
        }
        slope1 += at.dry[0] * (1.0 - at.sign[0] * at.sign[0]) * theta->sharpness[0];
        slope2 += at.dry[1] * (1.0 - at.sign[1] * at.sign[1]) * theta->sharpness[1];
        one[7] = -at.sign[0], two[8] = -at.sign[1], two[9] = -at.a2;
    }
    /* The right-hand side by theta ... */
    one[0] = -at.a1;
    one[1] = two[1] = -(at.a1 + at.a2);
    one[2] = at.coriolis - at.c2 * (2.0 * at.a1 + at.a2);
    two[2] = -(at.s2 * v1 * v1 + at.c2 * at.a1);
    one[3] = -GRAVITY * at.c1;
    one[4] = two[4] = -GRAVITY * at.c12;
    one[5] = -v1, two[6] = -v2;
    /* ... and by the state. */
    vec g12 = p[4] * GRAVITY * at.s12, g1 = p[3] * GRAVITY * at.s1 + g12;
    vec by_q2_1 = p[2] * (at.c2 * v2 * (2.0 * v1 + v2) + at.s2 * (2.0 * at.a1 + at.a2)) + g12;
    vec by_q2_2 = p[2] * (at.s2 * at.a1 - at.c2 * v1 * v1) + g12;
    vec by_v1_1 = 2.0 * p[2] * at.s2 * v2 - slope1, by_v2_1 = 2.0 * p[2] * at.s2 * (v1 + v2);
    vec by_v1_2 = 2.0 * p[2] * at.s2 * v1;
    vec i11 = at.m22 * at.inverse, i12 = at.m12 * at.inverse, i22 = at.m11 * at.inverse;
    for (int64_t c = 0; c < 4 + theta->size; c++) {
        vec h1 = g1 * dq1[c] + by_q2_1 * dq2[c] + by_v1_1 * dv1[c] + by_v2_1 * dv2[c] + (c < 4 ? zero : one[c - 4]);
        vec h2 = g12 * dq1[c] + by_q2_2 * dq2[c] - by_v1_2 * dv1[c] - slope2 * dv2[c] + (c < 4 ? zero : two[c - 4]);
        d1[c] = i11 * h1 - i12 * h2;
        d2[c] = i22 * h2 - i12 * h1;
    }
    *a1 = at.a1, *a2 = at.a2;
}

/* Advance the derivatives x of q1, q2, v1, v2 by one step. */
INLINE void step_sensitivity(const Theta *theta, double h, const vec state[4], vec t1, vec t2, vec x[4][COLUMNS])
{
    int64_t columns = 4 + theta->size;
    vec q1 = state[0], q2 = state[1], v1 = state[2], v2 = state[3], u1 = v1, u2 = v2, y1 = q1, y2 = q2;
    vec at[4][COLUMNS], inner[2][COLUMNS], whole[2][COLUMNS], d1[COLUMNS], d2[COLUMNS], a1, a2;
    for (int64_t c = 0; c < columns; c++) {
        for (int i = 0; i < 4; i++)
            at[i][c] = x[i][c];
        inner[0][c] = inner[1][c] = whole[0][c] = whole[1][c] = all(0.0);
    }
    for (int stage = 0; stage < 4; stage++) {
        accelerate_sensitivity(theta, y1, y2, u1, u2, t1, t2, at[0], at[1], at[2], at[3], d1, d2, &a1, &a2);
        double part = stage < 2 ? h / 2 : h, weight = stage == 0 || stage == 3 ? 1.0 : 2.0;
        y1 = q1 + part * u1, y2 = q2 + part * u2;
        u1 = v1 + part * a1, u2 = v2 + part * a2;
        for (int64_t c = 0; c < columns; c++) {
            whole[0][c] += weight * d1[c], whole[1][c] += weight * d2[c];
            if (stage < 3) {
                inner[0][c] += d1[c], inner[1][c] += d2[c];
                at[0][c] = x[0][c] + part * at[2][c], at[1][c] = x[1][c] + part * at[3][c];
                at[2][c] = x[2][c] + part * d1[c], at[3][c] = x[3][c] + part * d2[c];
            }
        }
    }
    for (int64_t c = 0; c < columns; c++) {
        x[0][c] += h * x[2][c] + h * h / 6 * inner[0][c], x[1][c] += h * x[3][c] + h * h / 6 * inner[1][c];
        x[2][c] += h / 6 * whole[0][c], x[3][c] += h / 6 * whole[1][c];
    }
}

LOOP void sensitivities(const void *work, int64_t begin, int64_t finish)
{
    const Motions *m = work;
    int64_t size = m->size, columns = 4 + size, lanes = m->lanes, steps = m->steps;
    const double *states = m->state, *tau = m->tau;
    int64_t last = LANES * finish < lanes ? LANES * finish : lanes;
    Theta th = {size, {}, {all(1.0 / SIGN_WIDTH), all(1.0 / SIGN_WIDTH)}, {}};
    for (int64_t j = 0; j < size; j++)
        th.p[j] = all(m->theta[j]);
    for (int64_t group = LANES * begin; group < last; group += LANES * TOGETHER) {
        int64_t end = group + LANES * TOGETHER < last ? group + LANES * TOGETHER : last;
        vec chained[TOGETHER][4][COLUMNS] = {}; /* derivatives of q1, q2, v1, v2 */
        for (int b = 0; b < TOGETHER; b++)
            for (int i = 0; i < 4; i++)
                chained[b][i][i] = all(1.0);
        for (int64_t k = 0; k <= steps; k++) {
            for (int64_t first = group; first < end; first += LANES) {
                int64_t count = end - first < LANES ? end - first : LANES;
                vec(*x)[COLUMNS] = chained[(first - group) / LANES];
                double *out = m->result + k / m->every * 4 * columns * lanes + first;
                for (int i = 0; i < 4 && k % m->every == 0; i++)
                    for (int64_t c = 0; c < columns; c++)
                        store(out + (i * columns + c) * lanes, x[i][c], count);
                if (k == steps)
                    continue;
                const double *now = states + 4 * k * lanes + first, *torque = tau + k * lanes + first;
                vec state[4], t1 = load(torque, count), t2 = load(torque + steps * lanes, count);
                for (int i = 0; i < 4; i++)
                    state[i] = load(now + i * lanes, count);
                step_sensitivity(&th, m->h, state, t1, t2, x);
            }
        }
    }
}

/* result (steps / every + 1, 4, 4 + size, lanes) of theta (size), states (steps + 1, 4, lanes), tau (2, steps, lanes). */
EXPORT void pendubot_sensitivities(int64_t threads, int64_t size, int64_t lanes, int64_t steps, int64_t every, double h,
    const double *theta, const double *states, const double *tau, double *result)
{
    Motions motions = {size, 1, lanes, steps, every, h, theta, states, tau, result};
    share(sensitivities, &motions, (lanes + LANES - 1) / LANES, DERIVING * steps, threads);
}

/* VERSION, or 0 if the library needs AVX-512 and the processor lacks it. */
EXPORT int64_t pendubot_version(void)
{
#ifdef __AVX512VL__
    if (!__builtin_cpu_supports("avx512vl") || !__builtin_cpu_supports("avx512dq"))
        return 0;
#endif
    return VERSION;
}
