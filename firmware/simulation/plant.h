// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* A simulated pendubot: the equations and steps of the package's model/simulation.py with the seven parameters of the
 * paper. */
#ifndef PLANT_H
#define PLANT_H

#include <stdint.h>

struct plant {
    double P1, P2, P3, P4, P5, b1, b2; /* kg m^2 (P1 to P3), kg m (P4, P5), N m s (b1, b2) */
    double q[2], v[2];                 /* rad from horizontal, from link 1; rad/s */
};

/* The paper's rig (Table 8), hanging at rest. */
extern const struct plant plant_of_the_paper;

/* A rig with typical proportions for balancing. */
extern const struct plant plant_to_balance;

/* Limits of a board with the paper's rig, the same as in the package's virtual board; stall torque: twice gravity's. */
#define SIMULATED_LIMITS                                                                                              \
    {                                                                                                                 \
        .torque_slew = 1000000, .max_speed = 100000, .max_travel1 = 60000, .max_travel2 = 300000,                     \
        .stall_torque = 500000, .stall_ms = 500, .continuous_ma = 15000, .overload_ms = 2000, .max_vbus = 3000,       \
    }

/* Advances the motion by a time [s] under a torque at the shoulder [N m], in Runge-Kutta steps of at most 1 ms. */
void plant_advance(struct plant *plant, double torque, double duration);

/* Returns the encoder's counts of a joint, 0 when hanging. */
int32_t plant_counts(const struct plant *plant, int joint, double counts_per_turn);

#endif
