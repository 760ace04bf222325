/* Copyright 2026 The pendubot_identification authors
 * SPDX-License-Identifier: Apache-2.0 */
/* Piecewise polynomials at many times, and what makes a spline of values, as in piecewise.py: plain C, called through
 * ctypes. */
#include <stdint.h>

#define EXPORT __attribute__((visibility("default")))
/* So many pieces on, and no farther, the next time is looked for one by one: times mostly increase. */
#define NEAR 8

typedef struct {
    int64_t count, powers, pieces, order;
    const double *c, *x, *t;
    double *values;
} Piecewise;

/* The number of the piece in which a time lies, from that of the time before on. */
static inline int64_t piece_of(const Piecewise *p, double time, int64_t at)
{
    int64_t last = p->pieces - 1, limit = at + NEAR < last ? at + NEAR : last;
    const double *x = p->x;
    while (at < limit && time >= x[at + 1])
        at++;
    if ((at > 0 && time < x[at]) || (at < last && time >= x[at + 1])) {
        int64_t end = p->pieces;
        for (at = 0; end - at > 1;) { /* x[at] <= time < x[end], but beyond the ends */
            int64_t middle = (at + end) / 2;
            if (time >= x[middle])
                at = middle;
            else
                end = middle;
        }
    }
    return at;
}

/* Some columns of all of them. */
static inline __attribute__((always_inline)) void evaluate(const Piecewise *p, int64_t columns, int first, int some)
{
    int64_t at = 0, next = p->pieces * columns;
    for (int64_t i = 0; i < p->count; i++) {
        at = piece_of(p, p->t[i], at);
        double since = p->t[i] - p->x[at], value[4] = {0};
        const double *c = p->c + at * columns + first;
        for (int64_t power = p->powers - 1; power >= p->order; power--, c += next) {
            double factor = 1;
            for (int64_t k = 0; k < p->order; k++)
                factor *= power - k;
            for (int j = 0; j < some; j++)
                value[j] = value[j] * since + c[j] * factor;
        }
        for (int j = 0; j < some; j++)
            p->values[i * columns + first + j] = value[j];
    }
}

/* Values of shape (count, columns) at times t of the derivative of this order of polynomials of so many powers, the
 * highest first, c of shape (powers, pieces, columns), between x of shape (pieces + 1). */
EXPORT void pendubot_piecewise(int64_t count, int64_t powers, int64_t pieces, int64_t columns, int64_t order,
    const double *c, const double *x, const double *t, double *values)
{
    Piecewise p = {count, powers, pieces, order, c, x, t, values};
    int64_t first = 0;
    for (; columns - first >= 4; first += 4)
        evaluate(&p, columns, first, 4);
    for (; columns - first >= 2; first += 2)
        evaluate(&p, columns, first, 2);
    if (first < columns)
        evaluate(&p, columns, first, 1);
}

/* Solve below[k] s[k-1] + middle[k] s[k] + above[k] s[k+1] = right[k] for s of shape (count, columns), by elimination
 * from the first to the last. It is left in right; middle is spent. */
EXPORT void pendubot_tridiagonal(int64_t count, int64_t columns, const double *below, double *middle,
    const double *above, double *right)
{
    for (int64_t k = 1; k < count; k++) {
        double factor = below[k] / middle[k - 1];
        middle[k] -= factor * above[k - 1];
        for (int64_t j = 0; j < columns; j++)
            right[k * columns + j] -= factor * right[(k - 1) * columns + j];
    }
    for (int64_t k = count - 1; k >= 0; k--)
        for (int64_t j = 0; j < columns; j++) {
            double after = k < count - 1 ? above[k] * right[(k + 1) * columns + j] : 0;
            right[k * columns + j] = (right[k * columns + j] - after) / middle[k];
        }
}
