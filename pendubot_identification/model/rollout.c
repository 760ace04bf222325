/* Copyright 2026 The pendubot_identification authors
 * SPDX-License-Identifier: Apache-2.0 */
/* What numpy cannot do well: many simulations of the pendubot side by side.
 *
 * Plain C without Python.h, called through ctypes. Nothing here is a model of its own: motions are those
 * of rollout.py and dynamics.py, whose names are used. Compiled without contraction, so that every processor gives the
 * same numbers.
 */
#define _GNU_SOURCE
#include <pthread.h>
#include <sched.h>
#include <stdint.h>
#include <string.h>
#include <unistd.h>

#define VERSION 6 /* of the calls below, in mde.c and in piecewise.c; kernel.py asks for it */

#define EXPORT __attribute__((visibility("default")))
#define INLINE static inline __attribute__((always_inline))

/* The loops are compiled for several processors, and the right ones are taken when they are loaded. */
#if !defined(__x86_64__) || !defined(__GLIBC__) || !defined(__GNUC__) || defined(__clang__)
#define LOOP static
#elif __GNUC__ < 12
#define LOOP static __attribute__((target_clones("avx2", "default")))
#else
#define LOOP static __attribute__((target_clones("arch=x86-64-v4", "avx2", "default")))
#endif

/* Vectors of four: one register or two, as the processor has them. (Of eight they are three times slower on processors
 * without AVX-512: the compiler takes them apart.) */
#define LANES 4
typedef double vec __attribute__((vector_size(8 * LANES)));
typedef int64_t ints __attribute__((vector_size(8 * LANES)));

INLINE vec all(double x) { return x - (vec){}; }
INLINE vec either(ints mask, vec a, vec b) { return (vec)((mask & (ints)a) | (~mask & (ints)b)); }
INLINE vec magnitude(vec x) { return (vec)((ints)x & INT64_MAX); }

/* ---- Elementary functions, to about one unit in the last place; coefficients of sine and cosine as in fdlibm ---- */

/* Adding it leaves the nearest whole number in the low bits. */
#define WHOLE 6755399441055744.0
/* Angles beyond this [rad] come from a simulation that diverges: they become NaN. */
#define FARTHEST 1e6

INLINE void sine_cosine(vec x, vec *sine, vec *cosine)
{
    vec shifted = x * 6.36619772367581382433e-01 + WHOLE, k = shifted - WHOLE;
    ints quadrant = (ints)shifted;
    vec r = ((x - k * 1.57079632673412561417e+00) - k * 6.07710050630396597660e-11) - k * 2.02226624879595063154e-21;
    vec z = r * r;
    vec s = r + r * z * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04
        + z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
    vec c = 1.0 - (0.5 * z - z * z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03
        + z * (2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09
        + z * -1.13596475577881948265e-11))))));
    ints odd = -(quadrant & 1), lost = ~(magnitude(x) <= FARTHEST);
    *sine = (vec)(((ints)either(odd, c, s) ^ ((quadrant & 2) << 62)) | lost);
    *cosine = (vec)(((ints)either(odd, s, c) ^ (((quadrant + 1) & 2) << 62)) | lost);
}

/* e^x - 1 = scale * (r-part) + (scale - 1), scale a power of two; x from -700 to 700 or NaN. */
INLINE vec exp_minus_1(vec x)
{
    vec shifted = x * 1.44269504088896338700e+00 + WHOLE, k = shifted - WHOLE;
    vec r = (x - k * 6.93147180369123816490e-01) - k * 1.90821492927058770002e-10;
    double factorial = 6227020800.0; /* of 13 */
    vec p = all(1.0 / factorial);
    for (int n = 13; n > 2; n--) {
        factorial /= n;
        p = p * r + 1.0 / factorial;
    }
    p = r + r * r * p;
    vec scale = (vec)(((ints)shifted + 1023) << 52);
    return scale * p + (scale - 1.0);
}

INLINE vec exponential(vec x)
{
    x = either(x < -700.0, all(-700.0), either(x > 700.0, all(700.0), x));
    return exp_minus_1(x) + 1.0;
}

INLINE vec tangent_hyperbolic(vec x)
{
    vec twice = 2.0 * magnitude(x);
    vec e = exp_minus_1(either(twice > 40.0, all(40.0), twice));
    return (vec)((ints)(e / (e + 2.0)) | ((ints)x & INT64_MIN));
}

/* ---- Motion: dynamics.py and rollout.py ---- */

#define GRAVITY 9.81
#define SIGN_WIDTH 0.05
#define STRIBECK_SPEED 0.5
#define LARGEST_MODEL 14
#define COLUMNS (4 + LARGEST_MODEL) /* what a motion depends on: its initial state and theta */
#define TOGETHER 16 /* blocks of lanes that go through a step one after the other, so that they are written nearby */

typedef struct {
    int64_t size; /* D: 7, 9, 10 or 14 */
    vec p[LARGEST_MODEL];
} Theta;

/* The accelerations at one point in time, and what their derivatives share with them. */
typedef struct {
    vec c1, s1, c2, s2, c12, s12;
    vec m11, m12, m22, inverse;
    vec dry[2], sign[2], stribeck[2];
    vec coriolis, a1, a2;
} Point;

/* The sines of q1 and q1 + q2 are for the derivatives alone: elsewhere the compiler leaves them out. */
INLINE void accelerate(const Theta *theta, vec q1, vec q2, vec v1, vec v2, vec t1, vec t2, Point *at)
{
    const vec *p = theta->p;
    vec f1 = p[5] * v1, f2 = p[6] * v2;
    sine_cosine(q2, &at->s2, &at->c2);
    sine_cosine(q1, &at->s1, &at->c1);
    sine_cosine(q1 + q2, &at->s12, &at->c12);
    at->m11 = p[0] + p[1] + 2.0 * p[2] * at->c2;
    at->m12 = p[1] + p[2] * at->c2;
    at->m22 = p[1] + p[9];
    if (theta->size >= 9) {
        at->dry[0] = p[7], at->dry[1] = p[8];
        at->sign[0] = tangent_hyperbolic(v1 * (1.0 / SIGN_WIDTH));
        at->sign[1] = tangent_hyperbolic(v2 * (1.0 / SIGN_WIDTH));
        if (theta->size >= 14) {
            vec x1 = v1 * (1.0 / STRIBECK_SPEED), x2 = v2 * (1.0 / STRIBECK_SPEED);
            at->stribeck[0] = exponential(-(x1 * x1));
            at->stribeck[1] = exponential(-(x2 * x2));
            at->dry[0] = at->dry[0] + p[10] * at->stribeck[0] + p[12] * magnitude(t1);
            at->dry[1] = at->dry[1] + p[11] * at->stribeck[1] + p[13] * magnitude(t2);
        }
        f1 += at->dry[0] * at->sign[0];
        f2 += at->dry[1] * at->sign[1];
    }
    at->coriolis = at->s2 * v2 * (2.0 * v1 + v2);
    vec g2 = p[4] * GRAVITY * at->c12;
    vec h1 = t1 - f1 + p[2] * at->coriolis - p[3] * GRAVITY * at->c1 - g2;
    vec h2 = t2 - f2 - p[2] * at->s2 * v1 * v1 - g2;
    at->inverse = 1.0 / (at->m11 * at->m22 - at->m12 * at->m12);
    at->a1 = (at->m22 * h1 - at->m12 * h2) * at->inverse;
    at->a2 = (at->m11 * h2 - at->m12 * h1) * at->inverse;
}

INLINE vec load(const double *from, int64_t count)
{
    vec x = all(from[count - 1]);
    memcpy(&x, from, count * sizeof(double));
    return x;
}

INLINE void store(double *to, vec x, int64_t count)
{
    if (count == LANES) /* of known size: one instruction */
        memcpy(to, &x, sizeof(x));
    else
        memcpy(to, &x, count * sizeof(double));
}

INLINE vec gather(const double *from, const int64_t *index)
{
    vec x;
    for (int w = 0; w < LANES; w++)
        x[w] = from[index[w]];
    return x;
}

/* What is simulated: theta (size, vectors or 1), tau (2, steps, lanes); `state` as the two calls below have it. */
typedef struct {
    int64_t size, vectors, lanes, steps, every;
    double h;
    const double *theta, *state, *tau;
    double *result;
} Motions;

/* ---- Several cores ---- */

#define MOST_THREADS 64
/* Nanoseconds of work that are worth a thread, and what a block takes for a step, about. */
#define WORTH_A_THREAD 100000.0
#define ROLLING 150.0
#define DERIVING 500.0

/* A loop over blocks of LANES motions, from the first to the one before the end. */
typedef void Loop(const Motions *motions, int64_t first, int64_t end);

typedef struct {
    Loop *loop;
    const Motions *motions;
    int64_t first, end;
} Part;

static void *do_part(void *argument)
{
    Part *part = argument;
    part->loop(part->motions, part->first, part->end);
    return NULL;
}

/* The cores that this process may use. */
static int64_t cores(void)
{
#ifdef CPU_COUNT
    cpu_set_t set;
    if (!sched_getaffinity(0, sizeof(set), &set))
        return CPU_COUNT(&set);
#endif
    return sysconf(_SC_NPROCESSORS_ONLN);
}

/* Do all blocks, each of so many nanoseconds, on up to so many threads, of which this is one; 0 is one on every core.
 * What a block gives does not depend on who does it. */
static void share(Loop *loop, const Motions *motions, int64_t count, double nanoseconds, int64_t threads)
{
    int64_t blocks = (count + LANES - 1) / LANES, started = 0;
    int64_t worth = nanoseconds * blocks / WORTH_A_THREAD, most = blocks < worth ? blocks : worth;
    threads = threads || most < 2 ? threads : cores();
    threads = threads < most ? threads : most;
    threads = threads < 1 ? 1 : threads < MOST_THREADS ? threads : MOST_THREADS;
    Part parts[MOST_THREADS];
    pthread_t others[MOST_THREADS];
    for (int64_t i = threads - 1; i >= 0; i--) {
        parts[i] = (Part){loop, motions, i * blocks / threads, (i + 1) * blocks / threads};
        if (i > 0 && !pthread_create(&others[started], NULL, do_part, &parts[i]))
            started++;
        else
            do_part(&parts[i]);
    }
    while (started > 0)
        pthread_join(others[--started], NULL);
}

/* ---- The loops ---- */

LOOP void roll(const Motions *m, int64_t begin, int64_t end)
{
    int64_t size = m->size, vectors = m->vectors, lanes = m->lanes, steps = m->steps, total = vectors * lanes;
    const double *theta = m->theta, *state = m->state, *tau = m->tau;
    double h = m->h, half = h / 2, sixth = h / 6;
    for (int64_t first = LANES * begin; first < total && first < LANES * end; first += LANES) {
        int64_t count = total - first < LANES ? total - first : LANES;
        int64_t vector[LANES], lane[LANES], adjacent = 1;
        for (int w = 0; w < LANES; w++) {
            int64_t i = first + (w < count ? w : count - 1); /* fill the last block up with copies of the last lane */
            vector[w] = i / lanes;
            lane[w] = i % lanes;
            adjacent &= lane[w] == lane[0] + w;
        }
        Theta th = {size, {}};
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
    Motions what = {size, vectors, lanes, steps, 1, h, theta, state, tau, states};
    share(roll, &what, vectors * lanes, ROLLING * steps, threads);
}

/* The accelerations, and their derivatives by the first state and theta (columns), from those of the state: as in
 * dynamics.py, M da = dh - dM a for M a = h. */
INLINE void accelerate_sensitivity(const Theta *theta, vec q1, vec q2, vec v1, vec v2, vec t1, vec t2,
    const vec dq1[], const vec dq2[], const vec dv1[], const vec dv2[], vec d1[], vec d2[], vec *a1, vec *a2)
{
    const vec *p = theta->p, zero = {};
    Point at;
    accelerate(theta, q1, q2, v1, v2, t1, t2, &at);
    vec slope1 = p[5], slope2 = p[6], one[LARGEST_MODEL] = {}, two[LARGEST_MODEL] = {};
    if (theta->size >= 9) {
        if (theta->size >= 14) {
            double bend = 2.0 / (STRIBECK_SPEED * STRIBECK_SPEED);
            slope1 -= p[10] * at.stribeck[0] * at.sign[0] * v1 * bend;
            slope2 -= p[11] * at.stribeck[1] * at.sign[1] * v2 * bend;
            one[10] = -(at.stribeck[0] * at.sign[0]), two[11] = -(at.stribeck[1] * at.sign[1]);
            one[12] = -(magnitude(t1) * at.sign[0]), two[13] = -(magnitude(t2) * at.sign[1]);
        }
        slope1 += at.dry[0] * (1.0 - at.sign[0] * at.sign[0]) * (1.0 / SIGN_WIDTH);
        slope2 += at.dry[1] * (1.0 - at.sign[1] * at.sign[1]) * (1.0 / SIGN_WIDTH);
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

/* Take the derivatives x of q1, q2, v1, v2 over one step. */
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

LOOP void sensitivities(const Motions *m, int64_t begin, int64_t finish)
{
    int64_t size = m->size, columns = 4 + size, lanes = m->lanes, steps = m->steps;
    const double *states = m->state, *tau = m->tau;
    int64_t last = LANES * finish < lanes ? LANES * finish : lanes;
    Theta th = {size, {}};
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
    Motions what = {size, 1, lanes, steps, every, h, theta, states, tau, result};
    share(sensitivities, &what, lanes, DERIVING * steps, threads);
}

EXPORT int64_t pendubot_version(void)
{
    return VERSION;
}
