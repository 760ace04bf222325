/* What numpy cannot do well: MDE's loop of generations, and many simulations of the pendubot side by side.
 *
 * Plain C without Python.h, called by kernel.py through ctypes. Nothing here is a model of its own: generations are
 * those of mde.py, from the same random numbers and with the same roundings; motions are those of rollout.py and
 * dynamics.py, whose names are used. Compiled without contraction, so that every processor gives the same numbers.
 */
#define _GNU_SOURCE
#include <math.h>
#include <pthread.h>
#include <sched.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define VERSION 2 /* of the calls below; kernel.py asks for it */

#define EXPORT __attribute__((visibility("default")))
#define INLINE static inline __attribute__((always_inline))

#if __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "random words are taken apart as on a little-endian processor; without this kernel numpy does the work"
#endif

/* Work that can be split: do parts `first` to `end` of it, and return 0, or 1 without memory. */
typedef int64_t Work(const void *what, int64_t first, int64_t end);

/* VERSIONS(name) compiles the inline function `name` for several processors; BEST_OF(name) is what this one can do. */
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__)
#define VERSION_FOR(name, processor, features) \
    __attribute__((target(features))) static int64_t name##_##processor(const void *what, int64_t first, int64_t end) \
    { \
        return name(what, first, end); \
    }
/* Tuned for a processor whose gathers pay. */
#define AVX512 "avx2,bmi2,avx512f,avx512dq,avx512bw,avx512vl,prefer-vector-width=512,tune=icelake-server"
#define VERSIONS(name) \
    VERSION_FOR(name, avx512, AVX512) \
    VERSION_FOR(name, avx2, "avx2,bmi2") \
    static int64_t name##_any(const void *what, int64_t first, int64_t end) { return name(what, first, end); }
#define CAN(feature) __builtin_cpu_supports(feature)
#define BEST_OF(name) \
    (CAN("avx512f") && CAN("avx512dq") && CAN("avx512bw") && CAN("avx512vl") && CAN("bmi2") ? name##_avx512 \
            : CAN("avx2") && CAN("bmi2")                                                  ? name##_avx2 \
                                                                                           : name##_any)
#else
#define VERSIONS(name)
#define BEST_OF(name) name
#endif

/* Vectors of four: one register or two, as the processor has them. (Of eight they are three times slower on processors
 * without AVX-512: the compiler takes them apart.) */
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
INLINE vec magnitude(vec x) { return (vec)((ints)x & INT64_MAX); }

/* ---- Several cores ---- */

#define MOST_THREADS 64
/* Nanoseconds of work that are worth a thread. */
#define WORTH_A_THREAD 100000.0

typedef struct {
    Work *work;
    const void *what;
    int64_t first, end, failed;
} Part;

static void *do_part(void *argument)
{
    Part *part = argument;
    part->failed = part->work(part->what, part->first, part->end);
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

/* Do `count` parts of some work, each of so many nanoseconds, on up to so many threads, of which this is one; 0 is one
 * on every core. What a part gives does not depend on who does it. */
static int64_t share(Work *work, const void *what, int64_t count, double nanoseconds, int64_t threads)
{
    double worth = nanoseconds * count / WORTH_A_THREAD;
    threads = threads ? threads : worth < 2.0 ? 1 : cores();
    threads = threads < count ? threads : count;
    threads = threads < worth ? threads : (int64_t)worth;
    threads = threads < 1 ? 1 : threads > MOST_THREADS ? MOST_THREADS : threads;
    Part parts[MOST_THREADS];
    pthread_t others[MOST_THREADS];
    int started[MOST_THREADS] = {0};
    int64_t failed = 0;
    for (int64_t i = threads - 1; i >= 0; i--) {
        parts[i] = (Part){work, what, i * count / threads, (i + 1) * count / threads, 0};
        started[i] = i > 0 && !pthread_create(&others[i], NULL, do_part, &parts[i]);
        if (!started[i])
            do_part(&parts[i]);
    }
    for (int64_t i = 0; i < threads; i++) {
        if (started[i])
            pthread_join(others[i], NULL);
        failed |= parts[i].failed;
    }
    return failed;
}

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

/* 1 - cos(2 pi x), exact at whole x, to about 4e-16 between them: twice the square of sin(pi r), r from -1/2 to 1/2, by
 * a polynomial that is least wrong at its worst. */
INLINE double versine_of_turns(double x)
{
    double r = x - ((x + WHOLE) - WHOLE), z = r * r;
    double s = r * (3.141592653589793 + z * (-5.167712780049969 + z * (2.5501640398773007 + z * (-0.5992645293189447
        + z * (0.0821458865731029 + z * (-0.007370430505916944 + z * (0.0004662998161898394
        + z * (-2.1903497074626018e-05 + z * 7.697826768224191e-07))))))));
    return 2.0 * (s * s);
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
    int64_t size, vectors, lanes, steps;
    double h;
    const double *theta, *state, *tau;
    double *result;
} Motions;

/* Blocks of LANES of all motions. */
INLINE int64_t roll(const void *what, int64_t begin, int64_t end)
{
    const Motions *m = what;
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
    return 0;
}
VERSIONS(roll)

#define BLOCKS(count) (((count) + LANES - 1) / LANES)
/* What a block takes for a step, about, in nanoseconds. */
#define ROLLING 150.0
#define DERIVING 500.0

/* states (steps + 1, 4, vectors, lanes) of theta (size, vectors), state (4, lanes), tau (2, steps, lanes). */
EXPORT void pendubot_roll(int64_t threads, int64_t size, int64_t vectors, int64_t lanes, int64_t steps, double h,
    const double *theta, const double *state, const double *tau, double *states)
{
    Motions what = {size, vectors, lanes, steps, h, theta, state, tau, states};
    share(BEST_OF(roll), &what, BLOCKS(vectors * lanes), ROLLING * steps, threads);
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

/* Blocks of LANES of all lanes. */
INLINE int64_t sensitivities(const void *what, int64_t begin, int64_t finish)
{
    const Motions *m = what;
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
        for (int64_t k = 0; k < steps; k++) {
            for (int64_t first = group; first < end; first += LANES) {
                int64_t count = end - first < LANES ? end - first : LANES;
                vec(*x)[COLUMNS] = chained[(first - group) / LANES];
                const double *now = states + 4 * k * lanes + first, *torque = tau + k * lanes + first;
                vec state[4], t1 = load(torque, count), t2 = load(torque + steps * lanes, count);
                for (int i = 0; i < 4; i++)
                    state[i] = load(now + i * lanes, count);
                step_sensitivity(&th, m->h, state, t1, t2, x);
                double *out = m->result + k * 4 * columns * lanes + first;
                for (int i = 0; i < 4; i++)
                    for (int64_t c = 0; c < columns; c++)
                        if (count == LANES)
                            store(out + (i * columns + c) * lanes, x[i][c], LANES);
                        else
                            store(out + (i * columns + c) * lanes, x[i][c], count);
            }
        }
    }
    return 0;
}
VERSIONS(sensitivities)

/* result (steps, 4, 4 + size, lanes) of theta (size), states (steps + 1, 4, lanes), tau (2, steps, lanes). */
EXPORT void pendubot_sensitivities(int64_t threads, int64_t size, int64_t lanes, int64_t steps, double h,
    const double *theta, const double *states, const double *tau, double *result)
{
    Motions what = {size, 1, lanes, steps, h, theta, states, tau, result};
    share(BEST_OF(sensitivities), &what, BLOCKS(lanes), DERIVING * steps, threads);
}

/* ---- Modified differential evolution: mde.py, _draw and _steps of which say what the random words mean ---- */

/* Random words of numpy's SFC64 for LANES streams at once, one per lane. */
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

/* Write the next `count` words, a multiple of LANES, of each stream: (LANES, stride). */
INLINE void draw(Streams *streams, int64_t count, int64_t stride, uint64_t *to)
{
    Streams s = *streams;
    for (int64_t at = 0; at < count; at += LANES) {
        words a = next(&s), b = next(&s), c = next(&s), d = next(&s);
        words ab = __builtin_shuffle(a, b, (ints){0, 4, 2, 6}), cd = __builtin_shuffle(c, d, (ints){0, 4, 2, 6});
        words ba = __builtin_shuffle(a, b, (ints){1, 5, 3, 7}), dc = __builtin_shuffle(c, d, (ints){1, 5, 3, 7});
        words stream[LANES] = {
            __builtin_shuffle(ab, cd, (ints){0, 1, 4, 5}), __builtin_shuffle(ba, dc, (ints){0, 1, 4, 5}),
            __builtin_shuffle(ab, cd, (ints){2, 3, 6, 7}), __builtin_shuffle(ba, dc, (ints){2, 3, 6, 7}),
        };
        for (int w = 0; w < LANES; w++)
            memcpy(to + w * stride + at, &stream[w], sizeof(words));
    }
    *streams = s;
}

typedef struct {
    int64_t population, dimension, per_component, generations;
    int64_t threshold, crossover_low, crossover_count; /* in units of mde.UNIT */
    double weight_low, weight_step, target, spread; /* the last two may be NaN */
} Settings;

enum { QUADRATIC, SPHERE, GRIEWANK, ACKLEY, RASTRIGIN };

/* All loops of the search go along rows, one component of all vectors, whose length is a multiple of the longest
 * register's (in elements of four bytes): what is left over is computed along for nothing. The compiler makes vectors
 * of them, of the length that the processor has. */
#define REGISTER 16
#define UP(count) (((count) + REGISTER - 1) & ~(REGISTER - 1))
#define EACH(t, count) _Pragma("GCC ivdep") for (int32_t t = 0; t < (count); t++)

/* What one run's generation needs. Rows, but for `drawn` and `population`. */
typedef struct {
    const uint64_t *drawn; /* random words */
    double *population; /* (dimension, width): a row is the population, the same again, and its best vector */
    int32_t *crossing, *best, *forced, *plus, *minus, *base;
    double *weight, *trials, *values, *scratch; /* trials (dimension, rows) */
} Room;

/* A vector whose P1 P2 is by so much more than (P3 / LARGEST_COUPLING)^2 has no excess, whatever is rounded. */
#define CLEAR (1.0 + 1e-12)

/* phi (D, D) and y (D), both by the root of the count of residuals; then the least value, what being indefinite costs
 * at the rate of 1, and for what LARGEST_COUPLING. Added in the order of quadratic.py. */
INLINE void quadratic(const double *data, int32_t dimension, int32_t rows, const double *x, double *restrict r,
    double *restrict values)
{
    const double *y = data + dimension * dimension, *rest = y + dimension;
    double floor = rest[0], worth = rest[1], limit = rest[2];
    EACH(t, rows) values[t] = 0.0;
    for (int32_t k = 0; k < dimension; k++) {
        double from = y[k], first = data[k * dimension + k];
        const double *own = x + k * rows;
        EACH(t, rows) r[t] = first * own[t] - from;
        for (int32_t j = k + 1; j < dimension; j++) {
            const double *z = x + j * rows;
            double phi = data[k * dimension + j];
            EACH(t, rows) r[t] += phi * z[t];
        }
        EACH(t, rows) values[t] += r[t] * r[t];
    }
    EACH(t, rows) values[t] += floor;
    if (worth == 0.0)
        return;
    const double *P1 = x, *P2 = x + rows, *P3 = x + 2 * rows;
    double factor = CLEAR / (limit * limit);
    int64_t some = 0;
    EACH(t, rows) some |= !((P3[t] * P3[t] * factor < P1[t] * P2[t]) & (P1[t] > 0.0));
    for (int32_t t = 0; some && t < rows; t += LANES) {
        vec a = load(P1 + t, LANES), b = load(P2 + t, LANES), c = load(P3 + t, LANES), value = load(values + t, LANES);
        vec sum = a + b, apart = a - b, coupling = 2.0 * c / limit;
        vec excess = square_root(apart * apart + coupling * coupling) / sum - 1.0;
        excess = either(sum > 0.0, either(excess > 0.0, excess, all(0.0)), magnitude(c) + 1.0);
        store(values + t, either((c * c * factor < a * b) & (a > 0.0), value, value + worth * excess), LANES);
    }
}

/* The paper's Table 2, as in benchmark_functions.py. */
INLINE void benchmark(int64_t kind, int32_t dimension, int32_t rows, const double *x, double *restrict waves,
    double *restrict values)
{
    double size = dimension;
    EACH(t, rows) values[t] = 0.0, waves[t] = kind == GRIEWANK;
    for (int32_t j = 0; j < dimension; j++) {
        const double *z = x + j * rows;
        double turns = kind == GRIEWANK ? 1.0 / (6.28318530717958647693 * sqrt(j + 1.0)) : 1.0;
        EACH(t, rows) values[t] += z[t] * z[t];
        if (kind == GRIEWANK)
            EACH(t, rows) waves[t] *= 1.0 - versine_of_turns(z[t] * turns);
        else if (kind != SPHERE)
            EACH(t, rows) waves[t] += versine_of_turns(z[t]);
    }
    if (kind == GRIEWANK)
        EACH(t, rows) values[t] = 1.0 + values[t] / 4000.0 - waves[t];
    if (kind == RASTRIGIN)
        EACH(t, rows) values[t] += 10.0 * waves[t];
    for (int32_t t = 0; kind == ACKLEY && t < rows; t += LANES) {
        vec distance = square_root(load(values + t, LANES) / size), flat = load(waves + t, LANES) / -size;
        store(values + t, -20.0 * exp_minus_1(-0.2 * distance) - 2.71828182845904523536 * exp_minus_1(flat), LANES);
    }
}

/* Make the trials of one generation. */
INLINE void mutate(const Settings *how, const Room *room, int32_t width, const double *lower, const double *upper)
{
    int32_t n = how->population, d = how->dimension, rows = UP(n), per_component = how->per_component;
    int32_t threshold = how->threshold, rate = how->crossover_low;
    uint32_t rates = how->crossover_count, others = n - 1;
    double low_weight = how->weight_low, weight_step = how->weight_step;
    const uint32_t *F = (const uint32_t *)room->drawn;
    const uint16_t *CR = (const uint16_t *)(F + n), *jrand = CR + n;
    const uint32_t *partners = (const uint32_t *)(jrand + n);
    const uint16_t *chances = (const uint16_t *)(partners + (per_component ? n * d : n)), *operators = chances + n * d;
    int32_t *restrict crossing = room->crossing, *restrict best = room->best, *restrict forced = room->forced;
    int32_t *restrict plus = room->plus, *restrict minus = room->minus, *restrict base = room->base;
    double *restrict weight = room->weight;
    EACH(t, rows) weight[t] = low_weight + (double)(int32_t)(F[t] >> 1) * weight_step;
    EACH(t, rows)
    {
        crossing[t] = rate + (int32_t)(CR[t] * rates >> 16);
        best[t] = per_component ? (crossing[t] * threshold) >> 15 : threshold;
        forced[t] = (int32_t)(jrand[t] * (uint32_t)d >> 16);
    }
    for (int32_t j = 0; j < d; j++) {
        const uint32_t *u = partners + (per_component ? j * n : 0);
        const uint16_t *v = chances + j * n, *operator = per_component ? v : operators;
        EACH(t, rows)
        {
            /* Digits of u / 2^32: products of 48 bits, as high and low halves. */
            uint32_t h = u[t] >> 16, l = u[t] & 0xffff;
            l *= others, h = h * others + (l >> 16);
            int32_t p = h >> 16;
            l = (l & 0xffff) * (others - 1), h = (h & 0xffff) * (others - 1) + (l >> 16);
            int32_t m = h >> 16;
            l = (l & 0xffff) * (others - 2), h = (h & 0xffff) * (others - 2) + (l >> 16);
            int32_t b = h >> 16;
            m += m >= p;
            int32_t low = p < m ? p : m, high = p < m ? m : p;
            b += b >= low;
            b += b >= high;
            int32_t chance = v[t] >> 1, is_forced = forced[t] == j, crosses = is_forced | (chance < crossing[t]);
            int32_t is_best = (operator[t] >> 1) < (is_forced ? threshold : best[t]);
            b = is_best ? 2 * n : t + 1 + b;
            plus[t] = t + 1 + p;
            minus[t] = crosses ? t + 1 + m : t + 1 + p; /* a difference of 0 */
            base[t] = crosses ? b : t;
        }
        const double *x = room->population + j * width;
        double *restrict trials = room->trials + j * rows, low = lower[j], high = upper[j];
        EACH(t, rows)
        {
            double y = (x[plus[t]] - x[minus[t]]) * weight[t] + x[base[t]], bound = y < low ? low : high;
            trials[t] = (y < low) | (y > high) ? (x[t] + bound) * 0.5 : y;
        }
    }
}

/* Take the trials that are at least as good, and return the number of the best vector, the first of equals. `values`
 * is a row, with infinity behind the population's. */
INLINE int32_t select_better(const Settings *how, const Room *room, int32_t width, double *restrict values)
{
    int32_t n = how->population, d = how->dimension, rows = UP(n), best = 0;
    const double *restrict offered = room->values;
    for (int32_t j = 0; j < d; j++) {
        double *restrict x = room->population + j * width, *restrict trials = room->trials + j * rows;
        EACH(t, rows) x[t] = trials[t] = offered[t] <= values[t] ? trials[t] : x[t];
        EACH(t, rows) x[n + t] = trials[t];
    }
    EACH(t, n) values[t] = offered[t] <= values[t] ? offered[t] : values[t];
    vec least = load(values, LANES);
    ints number = {0, 1, 2, 3}, where = number;
    for (int32_t t = LANES; t < rows; t += LANES) {
        vec x = load(values + t, LANES);
        number += LANES;
        ints less = x < least;
        least = either(less, x, least);
        where = (less & number) | (~less & where);
    }
    best = where[0];
    for (int w = 1; w < LANES; w++)
        best = least[w] < values[best] || (least[w] == values[best] && where[w] < best) ? where[w] : best;
    for (int32_t j = 0; j < d; j++)
        room->population[j * width + 2 * n] = room->population[j * width + best];
    return best;
}

enum { RUNNING, GENERATIONS, CLOSE, REACHED };

INLINE int64_t stops(const Settings *how, int64_t generation, const double *values, double lowest)
{
    int32_t n = how->population;
    int64_t apart = isnan(how->spread);
    double spread = how->spread * fabs(lowest);
    if (lowest <= how->target)
        return REACHED;
    if (!apart)
        EACH(t, n) apart |= !(values[t] - lowest <= spread);
    if (!apart)
        return CLOSE;
    return generation >= how->generations ? GENERATIONS : RUNNING;
}

/* Arguments of pendubot_mde. */
typedef struct {
    const Settings *how;
    int64_t kind;
    const double *data, *lower, *upper;
    int64_t runs, generation, count;
    uint64_t *streams;
    double *vectors, *values, *history;
    int64_t *last, *reason;
} Search;

/* Lead up to LANES runs, from the `first` on. */
INLINE void lead(const Search *search, int64_t first, int64_t runs, Room room, int64_t needed, int64_t stride,
    uint64_t *drawn, double *populations, double *costs)
{
    const Settings *how = search->how;
    int64_t n = how->population, d = how->dimension, rows = UP(n), width = UP(n + UP(n + 1)), going = runs;
    Streams s = {};
    for (int64_t r = 0; r < runs; r++) {
        const uint64_t *state = search->streams + 4 * (first + r);
        s.a[r] = state[0], s.b[r] = state[1], s.c[r] = state[2], s.counter[r] = state[3];
        search->reason[first + r] = RUNNING;
        for (int64_t j = 0; j < d; j++) {
            const double *from = search->vectors + ((first + r) * d + j) * (n + 1);
            double *to = populations + (r * d + j) * width;
            memcpy(to, from, n * sizeof(double)), memcpy(to + n, from, (n + 1) * sizeof(double));
        }
        for (int64_t t = 0; t < rows; t++)
            costs[r * rows + t] = t < n ? search->values[(first + r) * n + t] : INFINITY;
    }
    for (int64_t k = 0; k < search->count; k++) {
        if (going)
            draw(&s, needed, stride, drawn);
        for (int64_t r = 0; r < runs; r++) {
            double *cost = costs + r * rows, *history = search->history + (first + r) * search->count + k;
            if (search->reason[first + r] != RUNNING) { /* it keeps its value */
                *history = history[-1];
                continue;
            }
            room.drawn = drawn + r * stride, room.population = populations + r * d * width;
            mutate(how, &room, width, search->lower, search->upper);
            if (search->kind == QUADRATIC)
                quadratic(search->data, d, rows, room.trials, room.scratch, room.values);
            else
                benchmark(search->kind, d, rows, room.trials, room.scratch, room.values);
            *history = cost[select_better(how, &room, width, cost)];
            search->last[first + r] = search->generation + k + 1;
            search->reason[first + r] = stops(how, search->last[first + r], cost, *history);
            going -= search->reason[first + r] != RUNNING;
        }
    }
    for (int64_t r = 0; r < runs; r++) {
        uint64_t *state = search->streams + 4 * (first + r);
        state[0] = s.a[r], state[1] = s.b[r], state[2] = s.c[r], state[3] = s.counter[r];
        for (int64_t j = 0; j < d; j++)
            memcpy(search->vectors + ((first + r) * d + j) * (n + 1), populations + (r * d + j) * width + n,
                (n + 1) * sizeof(double));
        memcpy(search->values + (first + r) * n, costs + r * rows, n * sizeof(double));
    }
}

/* Memory that begins with a register; NULL where there is none. */
static void *zeros(int64_t count, size_t size)
{
    size_t all = (count * size + 63) & ~(size_t)63;
    void *memory = aligned_alloc(64, all);
    return memory ? memset(memory, 0, all) : NULL;
}

INLINE int64_t lead_all(const void *what, int64_t first, int64_t end)
{
    const Search *search = what;
    const Settings *how = search->how;
    int64_t n = how->population, d = how->dimension, rows = UP(n), width = UP(n + UP(n + 1));
    int64_t bits = 64 * n + 16 * n * d + (how->per_component ? 32 * n * d : 48 * n);
    int64_t needed = (bits + 255) / 256 * LANES, stride = needed + REGISTER; /* _draw's words of a generation */
    double *doubles = zeros((3 + d) * rows + LANES * (d * width + rows), sizeof(double));
    int32_t *integers = zeros(6 * rows, sizeof(int32_t));
    uint64_t *drawn = zeros(LANES * stride, sizeof(uint64_t));
    int64_t failed = !doubles || !integers || !drawn;
    if (!failed) {
        Room room = {
            NULL, NULL, integers, integers + rows, integers + 2 * rows, integers + 3 * rows, integers + 4 * rows,
            integers + 5 * rows, doubles, doubles + 3 * rows, doubles + rows, doubles + 2 * rows,
        };
        double *populations = doubles + (3 + d) * rows, *costs = populations + LANES * d * width;
        for (; first < end; first += LANES) {
            int64_t some = end - first < LANES ? end - first : LANES;
            lead(search, first, some, room, needed, stride, drawn, populations, costs);
        }
    }
    free(doubles), free(integers), free(drawn);
    return failed;
}
VERSIONS(lead_all)

/* What an element of a generation takes, about, in nanoseconds. */
#define LEADING 2.5

/* Lead runs on from the end of `generation`, by `count` generations or until they stop.
 *
 * streams (runs, 4), vectors (runs, dimension, population + 1) with the best one behind, values (runs, population),
 * history (runs, count), last (runs) the last generation of each, reason (runs) as above. Returns 0, or 1 without
 * memory.
 */
EXPORT int64_t pendubot_mde(int64_t threads, const Settings *how, int64_t kind, const double *data, const double *lower,
    const double *upper, int64_t runs, int64_t generation, int64_t count, uint64_t *streams, double *vectors,
    double *values, double *history, int64_t *last, int64_t *reason)
{
    Search search = {
        how, kind, data, lower, upper, runs, generation, count, streams, vectors, values, history, last, reason,
    };
    double work = LEADING * how->population * how->dimension * count;
    return share(BEST_OF(lead_all), &search, runs, work, threads);
}

EXPORT int64_t pendubot_version(void)
{
    return VERSION;
}
