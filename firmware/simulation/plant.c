// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
#include "plant.h"

#include <math.h>

#define PI 3.14159265358979323846
#define GRAVITY 9.81
#define LONGEST_STEP 1e-3

#define HANGING { -PI / 2, 0.0 }, { 0.0, 0.0 }

const struct plant plant_of_the_paper = { 0.002207, 0.000400, 0.000101, 0.022447, 0.003326, 0.006592, 0.00009, HANGING };
const struct plant plant_to_balance = { 0.0148, 0.0051, 0.0046, 0.1003, 0.0303, 0.0008, 0.0001, HANGING };

struct state {
    double q1, q2, v1, v2;
};

/* Returns the derivative of a state: M(q) q'' + V(q, q') q' + G(q) = tau - b q', with the inverse of M written out. */
static struct state rate(const struct plant *p, struct state x, double torque)
{
    double c2 = cos(x.q2), s2 = sin(x.q2), g2 = p->P5 * GRAVITY * cos(x.q1 + x.q2);
    double m11 = p->P1 + p->P2 + 2 * p->P3 * c2, m12 = p->P2 + p->P3 * c2, m22 = p->P2;
    double h1 = torque - p->b1 * x.v1 + p->P3 * s2 * (2 * x.v1 * x.v2 + x.v2 * x.v2) - p->P4 * GRAVITY * cos(x.q1) - g2;
    double h2 = -p->b2 * x.v2 - p->P3 * s2 * x.v1 * x.v1 - g2;
    double determinant = m11 * m22 - m12 * m12;
    struct state change = { x.v1, x.v2, (m22 * h1 - m12 * h2) / determinant, (m11 * h2 - m12 * h1) / determinant };
    return change;
}

static struct state moved(struct state x, struct state change, double h)
{
    struct state to = { x.q1 + h * change.q1, x.q2 + h * change.q2, x.v1 + h * change.v1, x.v2 + h * change.v2 };
    return to;
}

void plant_advance(struct plant *plant, double torque, double duration)
{
    int steps = (int)ceil(duration / LONGEST_STEP - 1e-9);
    double h = duration / steps;
    struct state x = { plant->q[0], plant->q[1], plant->v[0], plant->v[1] };
    for (int k = 0; k < steps; k++) {
        struct state a = rate(plant, x, torque);
        struct state b = rate(plant, moved(x, a, h / 2), torque);
        struct state c = rate(plant, moved(x, b, h / 2), torque);
        struct state d = rate(plant, moved(x, c, h), torque);
        x = moved(moved(moved(moved(x, a, h / 6), b, h / 3), c, h / 3), d, h / 6);
    }
    plant->q[0] = x.q1;
    plant->q[1] = x.q2;
    plant->v[0] = x.v1;
    plant->v[1] = x.v2;
}

int32_t plant_counts(const struct plant *plant, int joint, double counts_per_turn)
{
    double hanging = joint == 0 ? -PI / 2 : 0.0;
    return (int32_t)lrint((plant->q[joint] - hanging) * counts_per_turn / (2 * PI));
}
