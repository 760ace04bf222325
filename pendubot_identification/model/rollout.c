// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* Parallel simulations of the pendubot, see rollout.py. */
#include "motion.h"

#define VERSION 11 /* of the interface of rollout.c, filter.c and mde.c; kernel.py checks it */
#define COLUMNS (4 + PARAMETERS) /* derivatives by the initial state and theta */
#define TOGETHER 16 /* blocks of lanes with a common loop over the steps, so that their results are adjacent */

INLINE void load_states(const double *from, int64_t stride, int64_t count, vec x[], int rows)
{
    for (int i = 0; i < rows; i++)
        x[i] = load(from + i * stride, count);
}

/* Load the torque at the start of step k, and its change. */
INLINE void load_torque(Rig *rig, const double *tau, const double *change, int64_t k, int64_t stride, int64_t count)
{
    load_states(tau + k, stride, count, rig->torque, 2);
    load_states(change + k, stride, count, rig->change, 2);
    rig->torque[0] -= rig->change[0], rig->torque[1] -= rig->change[1];
}

/* states (steps + 1, 4, lanes) of theta (14, lanes), state (4, lanes), tau and change (2, steps, lanes), for the blocks
 * from begin to end. */
EXPORT void pendubot_roll(int64_t begin, int64_t end, int64_t lanes, int64_t steps, double h, const double *theta,
    const double *state, const double *tau, const double *change, double *states)
{
    end = BLOCK * end < lanes ? BLOCK * end : lanes;
    for (int64_t first = BLOCK * begin; first < end; first += LANES) {
        int64_t count = end - first < LANES ? end - first : LANES;
        Rig rig = {.sharpness = {all(1.0 / SIGN_WIDTH), all(1.0 / SIGN_WIDTH)}};
        vec x[4];
        load_states(theta + first, lanes, count, rig.p, PARAMETERS);
        load_states(state + first, lanes, count, x, 4);
        for (int64_t k = 0;; k++) {
            for (int i = 0; i < 4; i++)
                store(states + (4 * k + i) * lanes + first, x[i], count);
            if (k == steps)
                break;
            load_torque(&rig, tau, change, k * lanes + first, steps * lanes, count);
            Point at;
            accelerate(&rig, x, &at);
            runge_kutta(&rig, h, x, at);
        }
    }
}

/* The accelerations' derivatives by theta. */
INLINE void by_theta(const Rig *rig, const Point *at, const vec x[4], vec b[2][PARAMETERS])
{
    vec v1 = x[2], one[PARAMETERS] = {}, two[PARAMETERS] = {};
    one[0] = -at->a1;
    one[1] = two[1] = -(at->a1 + at->a2);
    one[2] = at->coriolis - at->c2 * (2.0 * at->a1 + at->a2);
    two[2] = -(at->s2 * v1 * v1 + at->c2 * at->a1);
    one[3] = -GRAVITY * at->c1;
    one[4] = two[4] = -GRAVITY * at->c12;
    two[9] = -at->a2;
    for (int j = 0; j < 2; j++) {
        vec *h = j ? two : one;
        h[5 + j] = -x[2 + j], h[7 + j] = -at->sign[j];
        h[10 + j] = -(at->stribeck[j] * at->sign[j]), h[12 + j] = -(magnitude(rig->torque[j]) * at->sign[j]);
    }
    for (int k = 0; k < PARAMETERS; k++)
        b[0][k] = at->i11 * one[k] - at->i12 * two[k], b[1][k] = at->i22 * two[k] - at->i12 * one[k];
}

/* Advance the derivatives d of q1, q2, v1, v2 by one Runge-Kutta step from the state x. */
INLINE void step_sensitivity(Rig *rig, double h, const vec x[4], vec d[4][COLUMNS])
{
    vec y[4] = {x[0], x[1], x[2], x[3]}, at[4][COLUMNS], inner[2][COLUMNS] = {}, whole[2][COLUMNS] = {};
    memcpy(at, d, sizeof(at));
    for (int stage = 0; stage < 4; stage++) {
        Point point;
        vec a[2][4], b[2][PARAMETERS], u[2] = {y[2], y[3]};
        advance_torque(rig, stage);
        accelerate(rig, y, &point);
        by_state(rig, &point, y, a);
        by_theta(rig, &point, y, b);
        double part = stage < 2 ? h / 2 : h, weight = stage == 0 || stage == 3 ? 1.0 : 2.0;
        y[2] = x[2] + part * point.a1, y[3] = x[3] + part * point.a2;
        for (int i = 0; i < 2; i++)
            y[i] = x[i] + part * u[i];
        for (int c = 0; c < COLUMNS; c++) {
            vec moved[2], now[4] = {at[0][c], at[1][c], at[2][c], at[3][c]};
            for (int i = 0; i < 2; i++) {
                moved[i] = a[i][0] * now[0] + a[i][1] * now[1] + a[i][2] * now[2] + a[i][3] * now[3];
                if (c >= 4)
                    moved[i] += b[i][c - 4];
                whole[i][c] += weight * moved[i];
                if (stage < 3)
                    inner[i][c] += moved[i];
                at[i][c] = d[i][c] + part * now[2 + i];
                at[2 + i][c] = d[2 + i][c] + part * moved[i];
            }
        }
    }
    for (int i = 0; i < 2; i++)
        for (int c = 0; c < COLUMNS; c++) {
            d[i][c] += h * d[2 + i][c] + h * h / 6 * inner[i][c];
            d[2 + i][c] += h / 6 * whole[i][c];
        }
}

/* result (steps / every + 1, 4, 18, lanes) of theta (14), states (steps + 1, 4, lanes), tau and change (2, steps,
 * lanes), for the blocks from begin to end. */
EXPORT void pendubot_sensitivities(int64_t begin, int64_t end, int64_t lanes, int64_t steps, int64_t every, double h,
    const double *theta, const double *states, const double *tau, const double *change, double *result)
{
    end = BLOCK * end < lanes ? BLOCK * end : lanes;
    Rig rig = {.sharpness = {all(1.0 / SIGN_WIDTH), all(1.0 / SIGN_WIDTH)}};
    for (int64_t j = 0; j < PARAMETERS; j++)
        rig.p[j] = all(theta[j]);
    for (int64_t group = BLOCK * begin; group < end; group += LANES * TOGETHER) {
        int64_t last = group + LANES * TOGETHER < end ? group + LANES * TOGETHER : end;
        vec chained[TOGETHER][4][COLUMNS] = {}; /* derivatives of q1, q2, v1, v2 */
        for (int b = 0; b < TOGETHER; b++)
            for (int i = 0; i < 4; i++)
                chained[b][i][i] = all(1.0);
        for (int64_t k = 0; k <= steps; k++)
            for (int64_t first = group; first < last; first += LANES) {
                int64_t count = last - first < LANES ? last - first : LANES;
                vec(*d)[COLUMNS] = chained[(first - group) / LANES], x[4];
                double *out = result + k / every * 4 * COLUMNS * lanes + first;
                for (int i = 0; i < 4 && k % every == 0; i++)
                    for (int c = 0; c < COLUMNS; c++)
                        store(out + (i * COLUMNS + c) * lanes, d[i][c], count);
                if (k == steps)
                    continue;
                load_states(states + 4 * k * lanes + first, lanes, count, x, 4);
                load_torque(&rig, tau, change, k * lanes + first, steps * lanes, count);
                step_sensitivity(&rig, h, x, d);
            }
    }
}

/* VERSION, or 0 if the library needs AVX-512 and the processor lacks it. */
__attribute__((visibility("default"))) int64_t pendubot_version(void)
{
#ifdef __AVX512VL__
    if (!__builtin_cpu_supports("avx512vl") || !__builtin_cpu_supports("avx512dq"))
        return 0;
#endif
    return VERSION;
}
