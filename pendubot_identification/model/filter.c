// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* The extended Kalman filters of filter.py, with the same names: G filters, each with L parameter vectors. */
#include "motion.h"

#define HALF_PI 1.57079632679489661923

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
    const double *tau, *change;    /* (tables, G, S, 2): mean of each step, half of the change within it */
    const double *y;               /* (tables, G, S, 2): measured at the end of the step */
    const int64_t *row;            /* (G, S): index of the innovation, or -1 without a measurement */
    double *e, *s;                 /* (N, 2, L): innovations and their variances */
} Filter;

/* result = a b, of 4 x 4. */
INLINE void product(const vec a[4][4], const vec b[4][4], vec result[4][4])
{
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++)
            result[i][j] = a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j] + a[i][3] * b[3][j];
}

/* Mean x and covariance p over one step of h: classic Runge-Kutta, and I + h A + h^2 A^2 / 2. */
INLINE void predict(Rig *rig, const vec noise[2], const vec narrow[2], double h, vec x[4], vec p[4][4])
{
    /* Statistical linearisation of the sign of dry friction: the width grows with the variance of the speed. */
    for (int j = 0; j < 2; j++) {
        vec wide = narrow[j] + HALF_PI * p[2 + j][2 + j], root;
        for (int w = 0; w < LANES; w++)
            root[w] = __builtin_sqrt(wide[w]);
        rig->sharpness[j] = 1.0 / root;
    }
    Point at;
    vec a[2][4], transition[4][4], moved[4][4];
    accelerate(rig, x, &at);
    by_state(rig, &at, x, a);
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
    vec i11 = at.i11, i12 = at.i12, i22 = at.i22, mixed = -i12 * (i11 * noise[0] + i22 * noise[1]);
    vec w[2][2] = {{i11 * i11 * noise[0] + i12 * i12 * noise[1], mixed},
        {mixed, i12 * i12 * noise[0] + i22 * i22 * noise[1]}};
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++) {
            p[i][j] += h * h * h / 3 * w[i][j];
            p[i][2 + j] += h * h / 2 * w[i][j], p[2 + i][j] += h * h / 2 * w[i][j];
            p[2 + i][2 + j] += h * w[i][j];
        }
    runge_kutta(rig, h, x, at);
}

/* Run filter g for the lanes from `first` on, at most LANES. */
INLINE void filter(const Filter *f, int64_t g, int64_t first)
{
    int64_t L = f->lanes, count = L - first < LANES ? L - first : LANES, at = g * f->steps;
    Term term[f->terms + 1];
    Rig rig = {.term = term};
    vec r[2], noise[2], narrow[2], offset[2], x[4] = {}, p[4][4] = {};
    for (int i = 0; i < PARAMETERS; i++)
        rig.p[i] = load(f->theta + i * L + first, count);
    for (int j = 0; j < 2; j++) {
        const double *values = f->noise + f->level[g] * 4 * L + first;
        vec w = load(f->width + j * L + first, count);
        narrow[j] = w * w;
        offset[j] = load(f->offset + j * L + first, count);
        r[j] = load(values + j * L, count), noise[j] = load(values + (2 + j) * L, count);
    }
    for (int64_t k = 0; k < f->terms; k++) {
        vec c = load(f->coefficient + k * L + first, count);
        int64_t any = 0;
        for (int w = 0; w < LANES; w++)
            any |= c[w] != 0.0;
        if (any)
            term[rig.terms++] = (Term){f->kind[k], f->joint[k], f->number[k], c};
    }
    const double *tau[LANES], *change[LANES], *y[LANES];
    for (int w = 0; w < LANES; w++) {
        int64_t entry = f->table[first + (w < count ? w : count - 1)] * f->groups + g;
        int64_t begin = entry * f->steps * 2;
        tau[w] = f->tau + begin, change[w] = f->change + begin, y[w] = f->y + begin;
        for (int i = 0; i < 4; i++)
            x[i][w] = f->start[4 * entry + i];
    }
    for (int i = 0; i < 4; i++)
        p[i][i] = all(f->spread[4 * g + i]);
    x[0] -= offset[0], x[1] -= offset[1];
    for (int64_t k = 0; k < f->length[g]; k++) {
        for (int w = 0; w < LANES; w++)
            for (int j = 0; j < 2; j++) {
                rig.change[j][w] = change[w][2 * k + j];
                rig.torque[j][w] = tau[w][2 * k + j] - change[w][2 * k + j];
            }
        rig.elapsed = f->elapsed[at + k];
        predict(&rig, noise, narrow, f->h[at + k], x, p);
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

/* Run the parts of the work from `begin` to `end`: part n is filter n % groups for BLOCK lanes. */
EXPORT void pendubot_filter(int64_t begin, int64_t end, const Filter *f)
{
    for (int64_t n = begin; n < end; n++)
        for (int64_t first = n / f->groups * BLOCK, k = 0; k < BLOCK && first + k < f->lanes; k += LANES)
            filter(f, n % f->groups, first + k);
}
