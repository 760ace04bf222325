// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* Common parts of rollout.c and filter.c: elementary functions and the equations of motion of dynamics.py on SIMD vectors.
 *
 * Plain C without Python.h, called through ctypes. Compiled without contraction, so that every processor gives the same
 * numbers.
 */
#ifndef PENDUBOT_MOTION_H
#define PENDUBOT_MOTION_H
#include <stdint.h>
#include <string.h>

#define INLINE static inline __attribute__((always_inline))

/* Exported loops are compiled with and without AVX2; the loader selects the version for the processor. */
#if !defined(__x86_64__) || !defined(__GLIBC__) || !defined(__GNUC__) || defined(__clang__) || defined(__AVX2__)
#define EXPORT __attribute__((visibility("default")))
#else
#define EXPORT __attribute__((visibility("default"), target_clones("avx2", "default")))
#endif

/* A vector of eight is one register of AVX-512. Without AVX-512 it would take three times as long, because the compiler
 * splits it; a vector of four is one register or two. */
#ifdef __AVX512VL__
#define LANES 8
#else
#define LANES 4
#endif
#define BLOCK 8 /* lanes of one part of the work: a multiple of LANES */
typedef double vec __attribute__((vector_size(8 * LANES)));
typedef int64_t ints __attribute__((vector_size(8 * LANES)));
typedef uint64_t bits __attribute__((vector_size(8 * LANES))); /* of sums, which may overflow for NaN */

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
    bits quadrant = (bits)shifted;
    vec r = ((x - k * 1.57079632673412561417e+00) - k * 6.07710050630396597660e-11) - k * 2.02226624879595063154e-21;
    vec z = r * r;
    vec z2 = z * z, z4 = z2 * z2;
    vec s = r + r * z * ((-1.66666666666666324348e-01 + z * 8.33333333332248946124e-03)
        + z2 * (-1.98412698298579493134e-04 + z * 2.75573137070700676789e-06)
        + z4 * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10));
    vec c = 1.0 - (0.5 * z - z2 * ((4.16666666666666019037e-02 + z * -1.38888888888741095749e-03)
        + z2 * (2.48015872894767294178e-05 + z * -2.75573143513906633035e-07)
        + z4 * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)));
    ints odd = -(ints)(quadrant & 1);
    bits lost = (bits) ~(magnitude(x) <= FARTHEST);
    *sine = (vec)(((bits)either(odd, c, s) ^ ((quadrant & 2) << 62)) | lost);
    *cosine = (vec)(((bits)either(odd, s, c) ^ (((quadrant + 1) & 2) << 62)) | lost);
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
    vec scale = (vec)(((bits)shifted + 1023) << 52);
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
#define PARAMETERS 14

/* Kinds of terms, torques at a joint per unit of their coefficients; numbered as filter.TermKind. */
enum { CONSTANT, ANGLE, DRAG, DIRECTION, VISCOUS_DRIFT, COULOMB_DRIFT, SINE, COSINE, CREEP };

typedef struct {
    int64_t kind, joint;
    double number; /* repetitions per turn, or a speed */
    vec coefficient;
} Term;

typedef struct {
    vec p[PARAMETERS];
    vec sharpness[2]; /* 1 / width of the change of sign of dry friction, each joint [s/rad] */
    vec torque[2]; /* at the current stage of a step */
    vec change[2]; /* of the torque in half a step */
    int64_t terms;
    const Term *term;
    double elapsed; /* fraction of the total duration */
} Rig;

/* The accelerations at one state, and what their derivatives also need. */
typedef struct {
    vec c1, s1, c2, s2, c12, s12;
    vec i11, i12, i22; /* M^-1 = (i11, -i12; -i12, i22) */
    vec dry[2], sign[2], stribeck[2];
    vec extra[2], by_q[2], by_v[2]; /* torques of all terms, and their derivatives by angle and speed of the joint */
    vec coriolis, a1, a2;
} Point;

INLINE void add_terms(const Rig *rig, const vec x[4], Point *at)
{
    for (int j = 0; j < 2; j++)
        at->extra[j] = at->by_q[j] = at->by_v[j] = all(0.0);
    for (const Term *t = rig->term; t < rig->term + rig->terms; t++) {
        int64_t j = t->joint;
        vec q = x[j], v = x[2 + j], value, dq = {}, dv = {}, s, o;
        double n = t->number;
        vec sign = tangent_hyperbolic(v * rig->sharpness[j]), slope = (1.0 - sign * sign) * rig->sharpness[j];
        switch (t->kind) {
        case ANGLE: value = q, dq = all(1.0); break;
        case DRAG: value = v * magnitude(v), dv = 2.0 * magnitude(v); break;
        case DIRECTION: value = magnitude(sign), dv = either(v < 0.0, -slope, slope); break;
        case VISCOUS_DRIFT: value = rig->elapsed * v, dv = all(rig->elapsed); break;
        case COULOMB_DRIFT: value = rig->elapsed * sign, dv = rig->elapsed * slope; break;
        case SINE: sine_cosine(n * q, &s, &o), value = s, dq = n * o; break;
        case COSINE: sine_cosine(n * q, &s, &o), value = o, dq = -n * s; break;
        case CREEP:
            o = exponential(-(v * v) * (1.0 / (n * n)));
            value = sign * o, dv = (slope - sign * v * (2.0 / (n * n))) * o;
            break;
        default: value = all(1.0);
        }
        vec c = t->coefficient;
        at->extra[j] += c * value, at->by_q[j] += c * dq, at->by_v[j] += c * dv;
    }
}

/* The accelerations at the state x = (q1, q2, v1, v2). Only derivatives need the sines of q1 and q1 + q2: elsewhere the
 * compiler omits them. */
INLINE void accelerate(const Rig *rig, const vec x[4], Point *at)
{
    const vec *p = rig->p;
    vec v1 = x[2], v2 = x[3], h[2];
    sine_cosine(x[1], &at->s2, &at->c2);
    sine_cosine(x[0], &at->s1, &at->c1);
    at->s12 = at->s1 * at->c2 + at->c1 * at->s2, at->c12 = at->c1 * at->c2 - at->s1 * at->s2;
    add_terms(rig, x, at);
    for (int j = 0; j < 2; j++) {
        vec v = x[2 + j], slow = v * (1.0 / STRIBECK_SPEED);
        at->sign[j] = tangent_hyperbolic(v * rig->sharpness[j]);
        at->stribeck[j] = exponential(-(slow * slow));
        at->dry[j] = p[7 + j] + p[10 + j] * at->stribeck[j] + p[12 + j] * magnitude(rig->torque[j]);
        h[j] = rig->torque[j] + at->extra[j] - (p[5 + j] * v + at->dry[j] * at->sign[j]);
    }
    vec g2 = p[4] * GRAVITY * at->c12;
    at->coriolis = at->s2 * v2 * (2.0 * v1 + v2);
    h[0] = h[0] + p[2] * at->coriolis - p[3] * GRAVITY * at->c1 - g2;
    h[1] = h[1] - p[2] * at->s2 * v1 * v1 - g2;
    vec m11 = p[0] + p[1] + 2.0 * p[2] * at->c2, m12 = p[1] + p[2] * at->c2, m22 = p[1] + p[9];
    vec inverse = 1.0 / (m11 * m22 - m12 * m12);
    at->i11 = m22 * inverse, at->i12 = m12 * inverse, at->i22 = m11 * inverse;
    at->a1 = (m22 * h[0] - m12 * h[1]) * inverse;
    at->a2 = (m11 * h[1] - m12 * h[0]) * inverse;
}

/* The accelerations' derivatives by the state: M da = dh - dM a for M a = h. */
INLINE void by_state(const Rig *rig, const Point *at, const vec x[4], vec a[2][4])
{
    const vec *p = rig->p;
    vec v1 = x[2], v2 = x[3], g12 = p[4] * GRAVITY * at->s12, slope[2];
    for (int j = 0; j < 2; j++)
        slope[j] = p[5 + j] + at->dry[j] * (1.0 - at->sign[j] * at->sign[j]) * rig->sharpness[j]
            - p[10 + j] * at->stribeck[j] * at->sign[j] * x[2 + j] * (2.0 / (STRIBECK_SPEED * STRIBECK_SPEED))
            - at->by_v[j];
    vec h1[4] = {p[3] * GRAVITY * at->s1 + g12 + at->by_q[0],
        p[2] * (at->c2 * v2 * (2.0 * v1 + v2) + at->s2 * (2.0 * at->a1 + at->a2)) + g12,
        2.0 * p[2] * at->s2 * v2 - slope[0], 2.0 * p[2] * at->s2 * (v1 + v2)};
    vec h2[4] = {g12, p[2] * (at->s2 * at->a1 - at->c2 * v1 * v1) + g12 + at->by_q[1], -2.0 * p[2] * at->s2 * v1, -slope[1]};
    for (int k = 0; k < 4; k++)
        a[0][k] = at->i11 * h1[k] - at->i12 * h2[k], a[1][k] = at->i22 * h2[k] - at->i12 * h1[k];
}

/* Advance the torque from the stage before: the second and third stage are in the middle of a step. */
INLINE void advance_torque(Rig *rig, int stage)
{
    if (stage == 1 || stage == 3)
        rig->torque[0] += rig->change[0], rig->torque[1] += rig->change[1];
}

/* Advance the state and the torque by one classic Runge-Kutta step; `at`: the point of the state. */
INLINE void runge_kutta(Rig *rig, double h, vec x[4], Point at)
{
    vec y[4] = {x[0], x[1], x[2], x[3]}, k1[4], k2[4], sum1 = {}, sum2 = {};
    for (int stage = 0; stage < 4; stage++) {
        advance_torque(rig, stage);
        if (stage > 0)
            accelerate(rig, y, &at);
        double part = stage < 2 ? h / 2 : h;
        k1[stage] = at.a1, k2[stage] = at.a2;
        if (stage < 3)
            sum1 += at.a1, sum2 += at.a2;
        y[0] = x[0] + part * y[2], y[1] = x[1] + part * y[3];
        y[2] = x[2] + part * at.a1, y[3] = x[3] + part * at.a2;
    }
    x[0] += h * (x[2] + h / 6 * sum1), x[1] += h * (x[3] + h / 6 * sum2);
    x[2] += h / 6 * (k1[0] + 2.0 * (k1[1] + k1[2]) + k1[3]);
    x[3] += h / 6 * (k2[0] + 2.0 * (k2[1] + k2[2]) + k2[3]);
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

#endif
