// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* Common parts of rollout.c and filter.c: the equations of motion of dynamics.py on SIMD vectors, elementary functions,
 * and threads.
 *
 * Plain C without Python.h, called through ctypes. Compiled without contraction, so that every processor gives the same
 * numbers.
 */
#ifndef PENDUBOT_MOTION_H
#define PENDUBOT_MOTION_H
#define _GNU_SOURCE
#include <pthread.h>
#include <sched.h>
#include <stdint.h>
#include <string.h>
#include <unistd.h>

#define EXPORT __attribute__((visibility("default")))
#define INLINE static inline __attribute__((always_inline))

/* The loops are compiled with and without AVX2; the loader selects the version for the processor. */
#if !defined(__x86_64__) || !defined(__GLIBC__) || !defined(__GNUC__) || defined(__clang__) || defined(__AVX2__)
#define LOOP static
#else
#define LOOP static __attribute__((target_clones("avx2", "default")))
#endif

/* A vector of eight is one register of AVX-512. Without AVX-512 it would take three times as long, because the compiler
 * splits it; a vector of four is one register or two. */
#ifdef __AVX512VL__
#define LANES 8
#else
#define LANES 4
#endif
typedef double vec __attribute__((vector_size(8 * LANES)));
typedef int64_t ints __attribute__((vector_size(8 * LANES)));

INLINE vec all(double x) { return x - (vec){}; }
INLINE vec either(ints mask, vec a, vec b) { return (vec)((mask & (ints)a) | (~mask & (ints)b)); }
INLINE vec magnitude(vec x) { return (vec)((ints)x & INT64_MAX); }

/* ---- Elementary functions, to about one unit in the last place; coefficients of sine and cosine as in fdlibm ---- */

/* After its addition the low bits hold the nearest integer. */
#define WHOLE 6755399441055744.0
/* Largest angle [rad]; larger ones, of a simulation that diverges, become NaN. */
#define FARTHEST 1e6

INLINE void sine_cosine(vec x, vec *sine, vec *cosine)
{
    vec shifted = x * 6.36619772367581382433e-01 + WHOLE, k = shifted - WHOLE;
    ints quadrant = (ints)shifted;
    vec r = ((x - k * 1.57079632673412561417e+00) - k * 6.07710050630396597660e-11) - k * 2.02226624879595063154e-21;
    vec z = r * r;
    vec z2 = z * z, z4 = z2 * z2;
    vec s = r + r * z * ((-1.66666666666666324348e-01 + z * 8.33333333332248946124e-03)
        + z2 * (-1.98412698298579493134e-04 + z * 2.75573137070700676789e-06)
        + z4 * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10));
    vec c = 1.0 - (0.5 * z - z2 * ((4.16666666666666019037e-02 + z * -1.38888888888741095749e-03)
        + z2 * (2.48015872894767294178e-05 + z * -2.75573143513906633035e-07)
        + z4 * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)));
    ints odd = -(quadrant & 1), lost = ~(magnitude(x) <= FARTHEST);
    *sine = (vec)(((ints)either(odd, c, s) ^ ((quadrant & 2) << 62)) | lost);
    *cosine = (vec)(((ints)either(odd, s, c) ^ (((quadrant + 1) & 2) << 62)) | lost);
}

/* e^x - 1 = scale * (e^r - 1) + (scale - 1), scale a power of two; x from -700 to 700 or NaN. */
INLINE vec exp_minus_1(vec x)
{
    vec shifted = x * 1.44269504088896338700e+00 + WHOLE, k = shifted - WHOLE;
    vec r = (x - k * 6.93147180369123816490e-01) - k * 1.90821492927058770002e-10;
    /* r^2 / 2! + ... + r^13 / 13!, by pairs, which are independent, unlike the products of Horner's scheme. */
    vec r2 = r * r, r4 = r2 * r2, pair[6];
    double factorial = 1.0;
    for (int n = 0; n < 6; n++) {
        factorial *= 2 * n + 2;
        pair[n] = all(1.0 / factorial);
        factorial *= 2 * n + 3;
        pair[n] += r * (1.0 / factorial);
    }
    vec p = (pair[0] + r2 * pair[1]) + r4 * ((pair[2] + r2 * pair[3]) + r4 * (pair[4] + r2 * pair[5]));
    p = r + r2 * p;
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
#define COLUMNS (4 + LARGEST_MODEL) /* derivatives by the initial state and theta */
#define TOGETHER 16 /* blocks of lanes with a common loop over the steps, so that their results are adjacent */

typedef struct {
    int64_t size; /* D: 7, 9, 10 or 14 */
    vec p[LARGEST_MODEL];
    vec sharpness[2]; /* 1 / width of the change of sign of dry friction, each joint [s/rad] */
    vec extra[2];     /* additional torques [N m] */
} Theta;

/* The accelerations at one state, and terms that their derivatives also need. */
typedef struct {
    vec c1, s1, c2, s2, c12, s12;
    vec m11, m12, m22, inverse;
    vec dry[2], sign[2], stribeck[2];
    vec coriolis, a1, a2;
} Point;

/* Only derivatives need the sines of q1 and q1 + q2: elsewhere the compiler omits them. */
INLINE void accelerate(const Theta *theta, vec q1, vec q2, vec v1, vec v2, vec t1, vec t2, Point *at)
{
    const vec *p = theta->p;
    vec f1 = p[5] * v1, f2 = p[6] * v2;
    sine_cosine(q2, &at->s2, &at->c2);
    sine_cosine(q1, &at->s1, &at->c1);
    at->s12 = at->s1 * at->c2 + at->c1 * at->s2, at->c12 = at->c1 * at->c2 - at->s1 * at->s2;
    at->m11 = p[0] + p[1] + 2.0 * p[2] * at->c2;
    at->m12 = p[1] + p[2] * at->c2;
    at->m22 = p[1] + p[9];
    if (theta->size >= 9) {
        at->dry[0] = p[7], at->dry[1] = p[8];
        at->sign[0] = tangent_hyperbolic(v1 * theta->sharpness[0]);
        at->sign[1] = tangent_hyperbolic(v2 * theta->sharpness[1]);
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
    vec h1 = t1 + theta->extra[0] - f1 + p[2] * at->coriolis - p[3] * GRAVITY * at->c1 - g2;
    vec h2 = t2 + theta->extra[1] - f2 - p[2] * at->s2 * v1 * v1 - g2;
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
    if (count == LANES) /* a constant size: one instruction */
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

/* ---- Several cores ---- */

#define MOST_THREADS 64
/* Least work of a thread [ns]. */
#define WORTH_A_THREAD 100000.0

/* A loop over the blocks of work from `first` to `end` - 1. */
typedef void Loop(const void *work, int64_t first, int64_t end);

typedef struct {
    Loop *loop;
    const void *work;
    int64_t first, end;
} Part;

static inline void *do_part(void *argument)
{
    Part *part = argument;
    part->loop(part->work, part->first, part->end);
    return NULL;
}

/* The number of cores that this process may use. */
static inline int64_t cores(void)
{
#ifdef CPU_COUNT
    cpu_set_t set;
    if (!sched_getaffinity(0, sizeof(set), &set))
        return CPU_COUNT(&set);
#endif
    return sysconf(_SC_NPROCESSORS_ONLN);
}

/* Do all blocks, which take `nanoseconds` each, on at most `threads` threads, including this one; 0: one per core. The
 * result does not depend on the number of threads. */
static inline void share(Loop *loop, const void *work, int64_t blocks, double nanoseconds, int64_t threads)
{
    int64_t started = 0;
    int64_t worth = nanoseconds * blocks / WORTH_A_THREAD, most = blocks < worth ? blocks : worth;
    threads = threads || most < 2 ? threads : cores();
    threads = threads < most ? threads : most;
    threads = threads < 1 ? 1 : threads < MOST_THREADS ? threads : MOST_THREADS;
    Part parts[MOST_THREADS];
    pthread_t others[MOST_THREADS];
    for (int64_t i = threads - 1; i >= 0; i--) {
        parts[i] = (Part){loop, work, i * blocks / threads, (i + 1) * blocks / threads};
        if (i > 0 && !pthread_create(&others[started], NULL, do_part, &parts[i]))
            started++;
        else
            do_part(&parts[i]);
    }
    while (started > 0)
        pthread_join(others[--started], NULL);
}

#endif
