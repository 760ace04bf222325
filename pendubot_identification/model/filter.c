// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* The extended Kalman filters of filter.py, with the same names: G filters, each with L parameter vectors. */
#include "motion.h"

/* Approximate time of one step of a block [ns]. */
#define FILTERING 300.0
#define HALF_PI 1.57079632679489661923

/* Kinds of terms, torques at a joint per unit of their coefficients; numbered as filter.TermKind. */
enum { CONSTANT, ANGLE, DRAG, DIRECTION, VISCOUS_DRIFT, COULOMB_DRIFT, SINE, COSINE, CREEP };

typedef struct {
    int64_t lanes, groups, steps, terms, tables;
    const int64_t *kind, *joint;   /* of every term */
    const double *number;          /* of every term: repetitions per turn, or a speed */
    const double *theta;           /* (14, L) */
    const double *width;           /* (2, L) */
    const double *coefficient;     /* (terms, L) */
    const double *offset;          /* (2, L) */
    const double *noise;           /* (levels, 4, L): variances of q1, q2; intensities of both torques */
    const int64_t *table;          /* (L): index of the table of initial states, torques and positions */
    const int64_t *level, *length; /* (G): index of the noise level, number of steps */
    const double *start, *spread;  /* (tables, G, 4), (G, 4): mean and variance of the initial state */
    const double *h, *elapsed;     /* (G, S): length of each step [s], elapsed fraction of the total duration */
    const double *tau;             /* (tables, G, S, 2) */
    const double *y;               /* (tables, G, S, 2): measured at the end of the step */
    const int64_t *row;            /* (G, S): index of the innovation, or -1 without a measurement */
    double *e, *s;                 /* (N, 2, L): innovations and their variances */
} Filter;

/* The terms with a coefficient other than 0 in some lane of a block. */
#define MOST_TERMS 256
typedef struct {
    int64_t count, number[MOST_TERMS];
    vec coefficient[MOST_TERMS];
} Terms;

/* The extra torques at a state, and their derivatives by the joint's angle and speed. */
INLINE void terms(const Filter *f, const Terms *active, Theta *th, vec q1, vec q2, vec v1, vec v2, vec passed, vec by_q[2],
    vec by_v[2])
{
    th->extra[0] = th->extra[1] = by_q[0] = by_q[1] = by_v[0] = by_v[1] = all(0.0);
    for (int64_t i = 0; i < active->count; i++) {
        int64_t k = active->number[i];
        int j = f->joint[k];
        vec q = j ? q2 : q1, v = j ? v2 : v1, value, dq = {}, dv = {}, s, o;
        double n = f->number[k];
        vec sign = tangent_hyperbolic(v * th->sharpness[j]), slope = (1.0 - sign * sign) * th->sharpness[j];
        switch (f->kind[k]) {
        case ANGLE: value = q, dq = all(1.0); break;
        case DRAG: value = v * magnitude(v), dv = 2.0 * magnitude(v); break;
        case DIRECTION: value = magnitude(sign), dv = either(v < 0.0, -slope, slope); break;
        case VISCOUS_DRIFT: value = passed * v, dv = passed; break;
        case COULOMB_DRIFT: value = passed * sign, dv = passed * slope; break;
        case SINE: sine_cosine(n * q, &s, &o), value = s, dq = n * o; break;
        case COSINE: sine_cosine(n * q, &s, &o), value = o, dq = -n * s; break;
        case CREEP:
            o = exponential(-(v * v) * (1.0 / (n * n)));
            value = sign * o, dv = (slope - sign * v * (2.0 / (n * n))) * o;
            break;
        default: value = all(1.0);
        }
        vec c = active->coefficient[i];
        th->extra[j] += c * value, by_q[j] += c * dq, by_v[j] += c * dv;
    }
}

/* result = a b, of 4 x 4. */
INLINE void product(const vec a[4][4], const vec b[4][4], vec result[4][4])
{
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++)
            result[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j] + a[i][3] * b[3][j];
}

/* Mean x and covariance p over one step of h: classic Runge-Kutta, and I + h A + h^2 A^2 / 2. */
INLINE void predict(const Filter *f, const Terms *active, Theta *th, const vec noise[2], const vec narrow[2], double h,
    vec t1, vec t2, vec passed, vec x[4], vec p[4][4])
{
    vec q1 = x[0], q2 = x[1], v1 = x[2], v2 = x[3], by_q[2], by_v[2];
    /* Statistical linearisation of the sign of dry friction: the width grows with the variance of the speed. */
    for (int j = 0; j < 2; j++) {
        vec wide = narrow[j] + HALF_PI * p[2 + j][2 + j], root;
        for (int w = 0; w < LANES; w++)
            root[w] = __builtin_sqrt(wide[w]);
        th->sharpness[j] = 1.0 / root;
    }
    Point at;
    terms(f, active, th, q1, q2, v1, v2, passed, by_q, by_v);
    accelerate(th, q1, q2, v1, v2, t1, t2, &at);
    vec k1[4], k2[4], u1 = v1, u2 = v2, x1, x2, sum1 = {}, sum2 = {};
    /* A: derivatives of the accelerations by the state, as in dynamics.py. */
    vec slope[2], *t = th->p;
    for (int j = 0; j < 2; j++) {
        vec v = j ? v2 : v1;
        slope[j] = t[5 + j] + at.dry[j] * (1.0 - at.sign[j] * at.sign[j]) * th->sharpness[j]
            - t[10 + j] * at.stribeck[j] * at.sign[j] * v * (2.0 / (STRIBECK_SPEED * STRIBECK_SPEED)) - by_v[j];
    }
    vec g12 = t[4] * GRAVITY * at.s12, i11 = at.m22 * at.inverse, i12 = at.m12 * at.inverse, i22 = at.m11 * at.inverse;
    vec right[2][4] = {{t[3] * GRAVITY * at.s1 + g12 + by_q[0],
                           t[2] * (at.c2 * v2 * (2.0 * v1 + v2) + at.s2 * (2.0 * at.a1 + at.a2)) + g12,
                           2.0 * t[2] * at.s2 * v2 - slope[0], 2.0 * t[2] * at.s2 * (v1 + v2)},
        {g12, t[2] * (at.s2 * at.a1 - at.c2 * v1 * v1) + g12 + by_q[1], -2.0 * t[2] * at.s2 * v1, -slope[1]}};
    vec a[2][4], transition[4][4], moved[4][4];
    for (int j = 0; j < 4; j++) {
        a[0][j] = i11 * right[0][j] - i12 * right[1][j];
        a[1][j] = i22 * right[1][j] - i12 * right[0][j];
    }
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 4; j++) { /* A = (0, I; a), A^2 = (a; a A) */
            vec squared = a[i][2] * a[0][j] + a[i][3] * a[1][j];
            squared = j < 2 ? squared : squared + a[i][j - 2];
            transition[i][j] = h * h / 2 * a[i][j] + (i == j ? 1.0 : i + 2 == j ? h : 0.0);
            transition[2 + i][j] = h * a[i][j] + h * h / 2 * squared + (i + 2 == j ? 1.0 : 0.0);
        }
    product(transition, p, moved);
    for (int i = 0; i < 4; i++)
        for (int j = 0; j <= i; j++)
            p[i][j] = p[j][i] = moved[i][0] * transition[j][0] + moved[i][1] * transition[j][1]
                + moved[i][2] * transition[j][2] + moved[i][3] * transition[j][3];
    /* White torque noise through the inverse of the mass matrix. */
    vec w[2][2] = {{i11 * i11 * noise[0] + i12 * i12 * noise[1], -i12 * (i11 * noise[0] + i22 * noise[1])}, {}};
    w[1][0] = w[0][1], w[1][1] = i12 * i12 * noise[0] + i22 * i22 * noise[1];
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++) {
            p[i][j] += h * h * h / 3 * w[i][j];
            p[i][2 + j] += h * h / 2 * w[i][j], p[2 + i][j] += h * h / 2 * w[i][j];
            p[2 + i][2 + j] += h * w[i][j];
        }
    k1[0] = at.a1, k2[0] = at.a2;
    for (int stage = 1; stage < 4; stage++) {
        double part = stage < 3 ? h / 2 : h;
        sum1 += k1[stage - 1], sum2 += k2[stage - 1];
        x1 = q1 + part * u1, x2 = q2 + part * u2;
        u1 = v1 + part * k1[stage - 1], u2 = v2 + part * k2[stage - 1];
        terms(f, active, th, x1, x2, u1, u2, passed, by_q, by_v);
        accelerate(th, x1, x2, u1, u2, t1, t2, &at);
        k1[stage] = at.a1, k2[stage] = at.a2;
    }
    x[0] = q1 + h * (v1 + h / 6 * sum1), x[1] = q2 + h * (v2 + h / 6 * sum2);
    x[2] = v1 + h / 6 * (k1[0] + 2.0 * (k1[1] + k1[2]) + k1[3]);
    x[3] = v2 + h / 6 * (k2[0] + 2.0 * (k2[1] + k2[2]) + k2[3]);
}

LOOP void filter(const void *work, int64_t begin, int64_t finish)
{
    const Filter *f = work;
    int64_t L = f->lanes, blocks = (L + LANES - 1) / LANES;
    for (int64_t n = begin; n < finish; n++) {
        int64_t g = n / blocks, first = n % blocks * LANES, count = L - first < LANES ? L - first : LANES;
        int64_t at = g * f->steps;
        Theta th = {LARGEST_MODEL, {}, {}, {}};
        Terms active;
        vec r[2], noise[2], narrow[2], offset[2], x[4] = {}, p[4][4] = {{}, {}, {}, {}};
        for (int i = 0; i < LARGEST_MODEL; i++)
            th.p[i] = load(f->theta + i * L + first, count);
        for (int j = 0; j < 2; j++) {
            const double *values = f->noise + f->level[g] * 4 * L + first;
            vec w = load(f->width + j * L + first, count);
            narrow[j] = w * w;
            offset[j] = load(f->offset + j * L + first, count);
            r[j] = load(values + j * L, count), noise[j] = load(values + (2 + j) * L, count);
        }
        active.count = 0;
        for (int64_t k = 0; k < f->terms; k++) {
            vec c = load(f->coefficient + k * L + first, count);
            int64_t any = 0;
            for (int w = 0; w < LANES; w++)
                any |= c[w] != 0.0;
            if (any)
                active.number[active.count] = k, active.coefficient[active.count++] = c;
        }
        const double *tau[LANES], *y[LANES];
        for (int w = 0; w < LANES; w++) {
            int64_t entry = f->table[first + (w < count ? w : count - 1)] * f->groups + g;
            tau[w] = f->tau + entry * f->steps * 2, y[w] = f->y + entry * f->steps * 2;
            for (int i = 0; i < 4; i++)
                x[i][w] = f->start[4 * entry + i];
        }
        for (int i = 0; i < 4; i++)
            p[i][i] = all(f->spread[4 * g + i]);
        x[0] -= offset[0], x[1] -= offset[1];
        for (int64_t k = 0; k < f->length[g]; k++) {
            vec t1, t2;
            for (int w = 0; w < LANES; w++)
                t1[w] = tau[w][2 * k], t2[w] = tau[w][2 * k + 1];
            predict(f, &active, &th, noise, narrow, f->h[at + k], t1, t2, all(f->elapsed[at + k]), x, p);
            if (f->row[at + k] < 0)
                continue;
            double *e = f->e + f->row[at + k] * 2 * L + first, *s = f->s + f->row[at + k] * 2 * L + first;
            for (int j = 0; j < 2; j++) { /* sequential update: the errors of both joints are independent */
                vec innovation = -offset[j] - x[j], variance = p[j][j] + r[j], gain[4];
                for (int w = 0; w < LANES; w++)
                    innovation[w] += y[w][2 * k + j];
                store(e + j * L, innovation, count), store(s + j * L, variance, count);
                vec inverse = 1.0 / variance;
                for (int i = 0; i < 4; i++)
                    gain[i] = p[i][j] * inverse;
                for (int i = 0; i < 4; i++)
                    x[i] += gain[i] * innovation;
                for (int i = 0; i < 4; i++)
                    for (int o = 0; o <= i; o++)
                        p[i][o] = p[o][i] = p[i][o] - gain[i] * gain[o] * variance;
            }
        }
    }
}

/* Run all filters of f on at most `threads` threads. */
EXPORT void pendubot_filter(int64_t threads, const Filter *f)
{
    share(filter, f, f->groups * ((f->lanes + LANES - 1) / LANES), FILTERING * f->steps, threads);
}
