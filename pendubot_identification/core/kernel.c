/* What numpy cannot do well: MDE's loop of generations, and many simulations of the pendubot side by side.
 *
 * Plain C without Python.h, called by kernel.py through ctypes. Nothing here is a model of its own: generations are
 * those of mde.py, from the same random numbers and with the same roundings; motions are those of rollout.py and
 * dynamics.py, whose names are used. Compiled without contraction, so that every processor gives the same numbers.
 */
#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define VERSION 1 /* of the calls below; kernel.py asks for it */

#define EXPORT __attribute__((visibility("default")))
#define INLINE static inline __attribute__((always_inline))
#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
/* Compiled twice; the loader takes what the processor can do. */
#define CLONES __attribute__((target_clones("avx2", "default")))
#else
#define CLONES
#endif

/* Vectors of four: one register or two, as the processor has them. (Of eight they were no faster here, and on processors
 * without AVX-512 three times slower: the compiler takes them apart.) */
#define LANES 4
typedef double vec __attribute__((vector_size(8 * LANES)));
typedef int64_t ints __attribute__((vector_size(8 * LANES)));
typedef uint64_t words __attribute__((vector_size(8 * LANES)));

INLINE vec all(double x) { return x - (vec){}; }
INLINE vec either(ints mask, vec a, vec b) { return (vec)((mask & (ints)a) | (~mask & (ints)b)); }
INLINE vec square_root(vec x)
{
    for (int w = 0; w < LANES; w++)
        x[w] = sqrt(x[w]);
    return x;
}
INLINE int any(ints mask)
{
    int64_t found = 0;
    for (int w = 0; w < LANES; w++)
        found |= mask[w];
    return found != 0;
}
INLINE vec magnitude(vec x) { return (vec)((ints)x & INT64_MAX); }

/* ---- Elementary functions, to about one unit in the last place; coefficients of sine and cosine as in fdlibm ---- */

/* Adding it leaves the nearest whole number in the low bits. */
#define WHOLE 6755399441055744.0
/* Angles beyond this [rad] are those of a motion that is lost: they become NaN. */
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
    vec p = 1.0 / 6227020800.0 * r + 1.0 / 479001600.0;
    p = p * r + 1.0 / 39916800.0;
    p = p * r + 1.0 / 3628800.0;
    p = p * r + 1.0 / 362880.0;
    p = p * r + 1.0 / 40320.0;
    p = p * r + 1.0 / 5040.0;
    p = p * r + 1.0 / 720.0;
    p = p * r + 1.0 / 120.0;
    p = p * r + 1.0 / 24.0;
    p = p * r + 1.0 / 6.0;
    p = p * r + 0.5;
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
#define TOGETHER 16 /* blocks of lanes whose sensitivities are written side by side */

typedef struct {
    int64_t size; /* D: 7, 9, 10 or 14 */
    vec p[LARGEST_MODEL];
} Theta;

/* What both simulation and sensitivity need of one point in time. */
typedef struct {
    vec c1, s1, c2, s2, c12, s12;
    vec m11, m12, m22, inverse;
    vec sign[2], bell[2];
    vec coriolis, a1, a2;
} Point;

/* Elbow's angles first; sines of q1 and q1 + q2 are for derivatives alone, and the compiler leaves them out. */
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
        vec dry1 = p[7], dry2 = p[8];
        at->sign[0] = tangent_hyperbolic(v1 * (1.0 / SIGN_WIDTH));
        at->sign[1] = tangent_hyperbolic(v2 * (1.0 / SIGN_WIDTH));
        if (theta->size >= 14) {
            vec x1 = v1 * (1.0 / STRIBECK_SPEED), x2 = v2 * (1.0 / STRIBECK_SPEED);
            at->bell[0] = exponential(-(x1 * x1));
            at->bell[1] = exponential(-(x2 * x2));
            dry1 = dry1 + p[10] * at->bell[0] + p[12] * magnitude(t1);
            dry2 = dry2 + p[11] * at->bell[1] + p[13] * magnitude(t2);
        }
        f1 += dry1 * at->sign[0];
        f2 += dry2 * at->sign[1];
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
    memcpy(to, &x, count * sizeof(double));
}

INLINE vec gather(const double *from, const int64_t *index)
{
    vec x;
    for (int w = 0; w < LANES; w++)
        x[w] = from[index[w]];
    return x;
}

/* states (steps + 1, 4, vectors, lanes) of theta (size, vectors), state (4, lanes), tau (2, steps, lanes). */
EXPORT CLONES void pendubot_roll(int64_t size, int64_t vectors, int64_t lanes, int64_t steps, double h,
    const double *theta, const double *state, const double *tau, double *states)
{
    int64_t total = vectors * lanes;
    double half = h / 2, sixth = h / 6;
    for (int64_t first = 0; first < total; first += LANES) {
        int64_t count = total - first < LANES ? total - first : LANES;
        int64_t vector[LANES], lane[LANES], adjacent = 1;
        for (int w = 0; w < LANES; w++) {
            int64_t i = first + (w < count ? w : count - 1); /* what is left over repeats the last one */
            vector[w] = i / lanes;
            lane[w] = i % lanes;
            adjacent &= lane[w] == lane[0] + w;
        }
        Theta th = {size, {}};
        for (int64_t j = 0; j < size; j++)
            th.p[j] = gather(theta + j * vectors, vector);
        vec q1 = gather(state, lane), q2 = gather(state + lanes, lane);
        vec v1 = gather(state + 2 * lanes, lane), v2 = gather(state + 3 * lanes, lane);
        double *out = states + first;
        for (int64_t k = 0;; k++) {
            if (count == LANES) {
                store(out, q1, LANES), store(out + total, q2, LANES);
                store(out + 2 * total, v1, LANES), store(out + 3 * total, v2, LANES);
            } else {
                store(out, q1, count), store(out + total, q2, count);
                store(out + 2 * total, v1, count), store(out + 3 * total, v2, count);
            }
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

/* Derivatives of the accelerations from those of positions and velocities, columns (state 4, then theta). */
INLINE void accelerate_sensitivity(const Theta *theta, vec q1, vec q2, vec v1, vec v2, vec t1, vec t2,
    const vec dq1[], const vec dq2[], const vec dv1[], const vec dv2[], vec d1[], vec d2[], vec *a1, vec *a2)
{
    const vec *p = theta->p, zero = {};
    Point at;
    accelerate(theta, q1, q2, v1, v2, t1, t2, &at);
    vec slope1 = p[5], slope2 = p[6], one[LARGEST_MODEL] = {}, two[LARGEST_MODEL] = {};
    if (theta->size >= 9) {
        vec dry1 = p[7], dry2 = p[8];
        if (theta->size >= 14) {
            double bend = 2.0 / (STRIBECK_SPEED * STRIBECK_SPEED);
            slope1 -= p[10] * at.bell[0] * at.sign[0] * v1 * bend;
            slope2 -= p[11] * at.bell[1] * at.sign[1] * v2 * bend;
            dry1 += p[10] * at.bell[0] + p[12] * magnitude(t1);
            dry2 += p[11] * at.bell[1] + p[13] * magnitude(t2);
            one[10] = -(at.bell[0] * at.sign[0]), two[11] = -(at.bell[1] * at.sign[1]);
            one[12] = -(magnitude(t1) * at.sign[0]), two[13] = -(magnitude(t2) * at.sign[1]);
        }
        slope1 += dry1 * (1.0 - at.sign[0] * at.sign[0]) * (1.0 / SIGN_WIDTH);
        slope2 += dry2 * (1.0 - at.sign[1] * at.sign[1]) * (1.0 / SIGN_WIDTH);
        one[7] = -at.sign[0], two[8] = -at.sign[1], two[9] = -at.a2;
    }
    /* M da = dh - dM a, along the parameters ... */
    one[0] = -at.a1;
    one[1] = two[1] = -(at.a1 + at.a2);
    one[2] = at.coriolis - at.c2 * (2.0 * at.a1 + at.a2);
    two[2] = -(at.s2 * v1 * v1 + at.c2 * at.a1);
    one[3] = -GRAVITY * at.c1;
    one[4] = two[4] = -GRAVITY * at.c12;
    one[5] = -v1, two[6] = -v2;
    /* ... and along the states. */
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

/* Lead derivatives x of q1, q2, v1, v2 over one step. */
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

/* result (steps, 4, 4 + size, lanes) of theta (size), states (steps + 1, 4, lanes), tau (2, steps, lanes). */
EXPORT CLONES void pendubot_sensitivities(int64_t size, int64_t lanes, int64_t steps, double h, const double *theta,
    const double *states, const double *tau, double *result)
{
    int64_t columns = 4 + size;
    Theta th = {size, {}};
    for (int64_t j = 0; j < size; j++)
        th.p[j] = all(theta[j]);
    for (int64_t group = 0; group < lanes; group += LANES * TOGETHER) {
        int64_t end = group + LANES * TOGETHER < lanes ? group + LANES * TOGETHER : lanes;
        vec chained[TOGETHER][4][COLUMNS] = {}; /* derivatives of q1, q2, v1, v2 */
        for (int b = 0; b < TOGETHER; b++)
            for (int i = 0; i < 4; i++)
                chained[b][i][i] = all(1.0);
        for (int64_t k = 0; k < steps; k++) {
            for (int64_t first = group; first < end; first += LANES) {
                int64_t count = end - first < LANES ? end - first : LANES;
                vec(*x)[COLUMNS] = chained[(first - group) / LANES];
                const double *now = states + 4 * k * lanes + first, *torque = tau + k * lanes + first;
                vec state[4], t1 = load(torque, count), t2 = load(torque + steps * lanes, count);
                for (int i = 0; i < 4; i++)
                    state[i] = load(now + i * lanes, count);
                step_sensitivity(&th, h, state, t1, t2, x);
                double *out = result + k * 4 * columns * lanes + first;
                for (int i = 0; i < 4; i++)
                    for (int64_t c = 0; c < columns; c++)
                        if (count == LANES)
                            store(out + (i * columns + c) * lanes, x[i][c], LANES);
                        else
                            store(out + (i * columns + c) * lanes, x[i][c], count);
            }
        }
    }
}

/* ---- Modified differential evolution: mde.py ---- */

/* Random numbers of numpy's SFC64 for LANES streams at once, one per lane. */
typedef struct {
    words a, b, c, counter;
} Streams;

INLINE words next(Streams *s)
{
    words x = s->a + s->b + s->counter;
    s->counter += 1;
    s->a = s->b ^ (s->b >> 11);
    s->b = s->c + (s->c << 3);
    s->c = ((s->c << 24) | (s->c >> 40)) + x;
    return x;
}

/* A float in [0, 1) as numpy makes it of 32 bits. */
INLINE float unit(uint32_t bits) { return (float)(int32_t)(bits >> 8) * (1.0f / 16777216.0f); }

typedef struct {
    int64_t population, dimension, per_component, generations;
    double threshold, weight_low, weight_high, crossover_low, crossover_high, target, spread; /* the last two may be NaN */
} Settings;

enum { QUADRATIC, SPHERE, GRIEWANK, ACKLEY, RASTRIGIN };

/* Values of points x (dimension, room), room a multiple of LANES. `data` of QUADRATIC: phi (D, D), y (D), the count of
 * residuals, the least value, and what being indefinite costs at the rate of 1, for what LARGEST_COUPLING. */
INLINE void evaluate(int64_t kind, const double *data, int64_t dimension, int64_t room, const double *x, double *values)
{
    const double *y = data + dimension * dimension, *rest = y + dimension;
    for (int64_t t = 0; t < room; t += LANES) {
        vec sum = {}, part = {}, s, c;
        if (kind == QUADRATIC) {
            for (int64_t k = 0; k < dimension; k++) {
                /* In the order of quadratic.py. */
                vec r = data[(k + 1) * dimension - 1] * load(x + (dimension - 1) * room + t, LANES) - y[k];
                for (int64_t j = k; j < dimension - 1; j++)
                    r += data[k * dimension + j] * load(x + j * room + t, LANES);
                sum += r * r;
            }
            sum = sum / rest[0] + rest[1];
            if (rest[2] != 0.0) {
                vec P1 = load(x + t, LANES), P2 = load(x + room + t, LANES), P3 = load(x + 2 * room + t, LANES);
                vec both = P1 + P2, apart = P1 - P2, rough = P3 * (2.0 / rest[3]);
                /* Roots and quotients are slow, and most vectors are clearly without excess. */
                if (any(~(apart * apart + rough * rough < both * both * (1.0 - 1e-12)) | ~(both > 0.0))) {
                    vec coupling = 2.0 * P3 / rest[3], root = square_root(apart * apart + coupling * coupling);
                    vec excess = root / both - 1.0;
                    excess = either(excess > 0.0, excess, all(0.0));
                    sum += rest[2] * either(both > 0.0, excess, magnitude(P3) + 1.0);
                }
            }
        } else {
            double size = dimension;
            vec product = all(1.0);
            for (int64_t j = 0; j < dimension; j++) {
                vec z = load(x + j * room + t, LANES);
                sum += z * z;
                if (kind == GRIEWANK) {
                    sine_cosine(z / sqrt(j + 1.0), &s, &c);
                    product *= c;
                } else if (kind == ACKLEY || kind == RASTRIGIN) {
                    sine_cosine(6.28318530717958647693 * z, &s, &c);
                    part += c;
                }
            }
            if (kind == GRIEWANK)
                sum = 1.0 + sum / 4000.0 - product;
            if (kind == RASTRIGIN)
                sum += 10.0 * (size - part);
            if (kind == ACKLEY) {
                sum = -20.0 * exp_minus_1(-0.2 * square_root(sum / size)) - 2.71828182845904523536 * exp_minus_1(part / size - 1.0);
            }
        }
        store(values + t, sum, LANES);
    }
}

INLINE int32_t whole(float u, int32_t count) { return (int32_t)(u * (float)count); }

/* What one generation needs beside the runs themselves. Elements are the components of the population's vectors, one
 * vector after the other, and what is left over up to a whole number of registers is computed along for nothing. */
typedef struct {
    uint32_t *bits; /* (LANES, room for one generation's) random bits */
    int32_t *target, *component; /* of an element: where its target's vector begins, and which component it is */
    int32_t *plus, *minus, *base, *jrand, *drawn_target, *drawn_plus, *drawn_minus, *drawn_base;
    float *crossover;
    double *weight, *lower, *upper, *trials, *transposed, *values;
} Room;

#define REGISTER 16 /* elements of four bytes in the longest register */
#define UP(count) (((count) + REGISTER - 1) & ~(REGISTER - 1))
#define EACH(e, count) _Pragma("GCC ivdep") for (int32_t e = 0; e < UP(count); e++)
/* Fill `width` elements, or up to three more, which the next ones overwrite. */
#define FILL(to, first, width, value) \
    for (int32_t j_ = 0; j_ < (width); j_ += LANES) \
        for (int w_ = 0; w_ < LANES; w_++) \
            (to)[(first) + j_ + w_] = (value)

/* Make the trials of one generation of one run: _Mutations.draw and MDE._mutated. */
INLINE void mutate(const Settings *how, const Room *room, const uint32_t *bits, const double *vectors)
{
    int32_t n = how->population, d = how->dimension, elements = n * d, draws = how->per_component ? elements : n;
    const uint32_t *cross = bits + 3 * n, *operator = cross + elements;
    const uint32_t *first = operator + draws, *second = first + draws, *third = second + draws;
    double weights = how->weight_high - how->weight_low, rates = how->crossover_high - how->crossover_low;
    float threshold = how->threshold;
    const int32_t *component = room->component, *jrand = room->jrand, *targets = room->target;
    int32_t *plus = room->plus, *minus = room->minus, *base = room->base;
    const double *lower = room->lower, *upper = room->upper;
    double *weight = room->weight, *trials = room->trials;
    const float *crossover = room->crossover;
    for (int32_t t = 0; t < n; t++) {
        double F = how->weight_low + (double)unit(bits[t]) * weights;
        double CR = how->crossover_low + (double)unit(bits[n + t]) * rates;
        /* A float is below CR exactly where it is below the first float that is not. */
        float rate = CR;
        uint32_t bits_of_rate;
        memcpy(&bits_of_rate, &rate, 4);
        bits_of_rate += rate < CR;
        memcpy(&rate, &bits_of_rate, 4);
        int32_t forced = whole(unit(bits[2 * n + t]), d);
        FILL(room->weight, t * d, d, F);
        FILL(room->crossover, t * d, d, rate);
        FILL(room->jrand, t * d, d, forced);
    }
    int32_t *to_plus = how->per_component ? plus : room->drawn_plus;
    int32_t *to_minus = how->per_component ? minus : room->drawn_minus;
    int32_t *to_base = how->per_component ? base : room->drawn_base;
    const int32_t *target = how->per_component ? targets : room->drawn_target;
    EACH(e, draws) {
        int32_t p = 1 + whole(unit(first[e]), n - 1), m = 1 + whole(unit(second[e]), n - 2);
        int32_t b = 1 + whole(unit(third[e]), n - 3);
        m += m >= p;
        b += b >= (p < m ? p : m);
        b += b >= (p < m ? m : p);
        p = target[e] + p * d, m = target[e] + m * d, b = target[e] + b * d;
        to_plus[e] = p >= elements ? p - elements : p;
        to_minus[e] = m >= elements ? m - elements : m;
        b = b >= elements ? b - elements : b;
        to_base[e] = unit(operator[e]) <= threshold ? elements : b; /* behind the population stands the best one */
    }
    for (int32_t t = 0; t < n && !how->per_component; t++) {
        FILL(plus, t * d, d, to_plus[t]);
        FILL(minus, t * d, d, to_minus[t]);
        FILL(base, t * d, d, to_base[t]);
    }
    EACH(e, elements) {
        int crosses = (unit(cross[e]) < crossover[e]) | (component[e] == jrand[e]);
        base[e] = (crosses ? base[e] : targets[e]) + component[e];
        plus[e] += component[e];
        minus[e] = crosses ? minus[e] + component[e] : plus[e]; /* a difference of 0 */
    }
    EACH(e, elements) {
        double x = (vectors[plus[e]] - vectors[minus[e]]) * weight[e] + vectors[base[e]];
        x = x < lower[e] ? (vectors[e] + lower[e]) * 0.5 : x;
        trials[e] = x > upper[e] ? (vectors[e] + upper[e]) * 0.5 : x;
    }
}

/* Take the trials' values, and return the number of the best vector. */
INLINE int64_t select_better(const Settings *how, const Room *room, double *vectors, double *values)
{
    int64_t n = how->population, d = how->dimension, best = 0;
    for (int64_t t = 0; t < n; t++)
        if (room->values[t] <= values[t]) {
            values[t] = room->values[t];
            for (int64_t j = 0; j < d; j++)
                vectors[t * d + j] = room->trials[t * d + j];
        }
    for (int64_t t = 1; t < n; t++)
        best = values[t] < values[best] ? t : best;
    for (int64_t j = 0; j < d; j++)
        vectors[n * d + j] = vectors[best * d + j];
    return best;
}

enum { RUNNING, GENERATIONS, CLOSE, REACHED };

INLINE int64_t stops(const Settings *how, int64_t generation, const double *values, double lowest)
{
    double highest = lowest;
    for (int64_t t = 0; t < how->population && !isnan(how->spread); t++)
        highest = values[t] > highest ? values[t] : highest;
    if (lowest <= how->target)
        return REACHED;
    if (highest - lowest <= how->spread * fabs(lowest))
        return CLOSE;
    return generation >= how->generations ? GENERATIONS : RUNNING;
}

/* Lead up to LANES runs on from the end of `generation`, by `count` generations or until they stop.
 *
 * An even number of random numbers, of which every run takes the same, must have been drawn: any multiple of mde.BLOCK
 * generations. streams (runs, 4), vectors (runs, population + 1, dimension), values (runs, population), history (count,
 * runs), last (runs) the last generation of each, reason (runs) as above. Returns 0, or 1 without memory.
 */
EXPORT CLONES int64_t pendubot_mde(const Settings *how, int64_t kind, const double *data, const double *lower,
    const double *upper, int64_t runs, int64_t generation, int64_t count, uint64_t *streams, double *vectors,
    double *values, double *history, int64_t *last, int64_t *reason)
{
    int64_t n = how->population, d = how->dimension, elements = n * d, draws = how->per_component ? elements : n;
    int64_t needed = 3 * n + elements + 4 * draws; /* random numbers of a generation, two from each word */
    int64_t bits = UP(needed + REGISTER), some = UP(elements + d + REGISTER), rows = UP(n);
    double *doubles = calloc(4 * some + d * rows + rows + runs * some, sizeof(double));
    int32_t *integers = calloc(11 * some, sizeof(int32_t));
    uint32_t *halves = calloc(LANES * bits, sizeof(uint32_t));
    if (!doubles || !integers || !halves) {
        free(doubles), free(integers), free(halves);
        return 1;
    }
    double *own = doubles + 4 * some + d * rows + rows; /* vectors, with room behind those of each run */
    Room room = {
        halves, integers, integers + some, integers + 2 * some, integers + 3 * some, integers + 4 * some,
        integers + 5 * some, integers + 6 * some, integers + 7 * some, integers + 8 * some, integers + 9 * some,
        (float *)(integers + 10 * some), doubles, doubles + some, doubles + 2 * some, doubles + 3 * some,
        doubles + 4 * some, doubles + 4 * some + d * rows,
    };
    for (int64_t e = 0; e < elements; e++) {
        room.target[e] = e / d * d, room.component[e] = e % d;
        room.lower[e] = lower[e % d], room.upper[e] = upper[e % d];
    }
    for (int64_t t = 0; t < n; t++)
        room.drawn_target[t] = t * d;
    Streams s = {};
    for (int64_t r = 0; r < runs; r++) {
        s.a[r] = streams[4 * r], s.b[r] = streams[4 * r + 1];
        s.c[r] = streams[4 * r + 2], s.counter[r] = streams[4 * r + 3];
        reason[r] = RUNNING;
        memcpy(own + r * some, vectors + r * (elements + d), (elements + d) * sizeof(double));
    }
    int64_t going = runs, left_over = 0;
    for (int64_t k = 0; k < count; k++) {
        if (!going) { /* all have stopped: they keep their values */
            memcpy(history + k * runs, history + (k - 1) * runs, runs * sizeof(double));
            continue;
        }
        /* Of an odd number one half of the last word is left, and is the next generation's first. */
        for (int64_t w = 0; left_over && w < runs; w++)
            halves[w * bits] = halves[w * bits + needed];
        for (int64_t at = left_over; at < needed; at += 2) {
            words x = next(&s);
            for (int w = 0; w < LANES; w++)
                memcpy(halves + w * bits + at, (char *)&x + 8 * w, 8);
        }
        left_over = (needed - left_over) & 1;
        for (int64_t r = 0; r < runs; r++) {
            double *costs = values + r * n;
            if (reason[r] == RUNNING) {
                mutate(how, &room, halves + r * bits, own + r * some);
                for (int64_t j = 0; j < d; j++)
                    for (int64_t t = 0; t < n; t++)
                        room.transposed[j * rows + t] = room.trials[t * d + j];
                evaluate(kind, data, d, rows, room.transposed, room.values);
                int64_t best = select_better(how, &room, own + r * some, costs);
                last[r] = generation + k + 1;
                history[k * runs + r] = costs[best];
                reason[r] = stops(how, last[r], costs, costs[best]);
                going -= reason[r] != RUNNING;
            } else
                history[k * runs + r] = history[(k - 1) * runs + r];
        }
    }
    for (int64_t r = 0; r < runs; r++) {
        streams[4 * r] = s.a[r], streams[4 * r + 1] = s.b[r];
        streams[4 * r + 2] = s.c[r], streams[4 * r + 3] = s.counter[r];
        memcpy(vectors + r * (elements + d), own + r * some, (elements + d) * sizeof(double));
    }
    free(doubles), free(integers), free(halves);
    return 0;
}

EXPORT int64_t pendubot_version(void)
{
    return VERSION;
}
