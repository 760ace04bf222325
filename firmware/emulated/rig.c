// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* Replaces stm32f4/rig.c: a simulated pendubot instead of encoders and motor, for QEMU, which has neither.
 *
 * All other files are the program of a rig: interrupts, USART, rings, watchdog, the bridge's registers. QEMU has no
 * clocks to start, and ignores writes to TIM1 and the IWDG.
 */
#include "port.h"
#include "registers.h"
#include "rig.h"
#include "simulation/plant.h"

static const struct pendubot_settings settings = {
    .cpr1 = COUNTS_SHOULDER,
    .cpr2 = COUNTS_ELBOW,
    .torque_limit = TORQUE_LIMIT_MICRO_NM,
    .sample_period_us = 1000000 / SAMPLE_HZ,
    .watchdog_max_ms = WATCHDOG_MAX_MS,
    .torque_constant = MICRO_NM_PER_A,
    .build = BUILD_ID,
    .limits = SIMULATED_LIMITS,
    .firmware = "emulated 2",
};

enum { VBUS_10MV = 2400, MICRO_NM_PER_MA = MICRO_NM_PER_A / 1000 };

/* The last word of the RAM, which the test of QEMU may set to a number. */
#define SEED (*(volatile uint32_t *)0x2001fffcu)

static struct plant plant;
static int32_t applied;
static uint32_t boots __attribute__((section(".noinit")));

const struct pendubot_settings *board_settings(void)
{
    return &settings;
}

void rig_start(void)
{
    plant = plant_of_the_paper;
    boots++;
}

uint32_t board_boot_id(void)
{
    return SEED ^ boots * 0x9e3779b9u;
}

struct pendubot_reset board_reset(void)
{
    return fault_log_read(boots == 1 ? 1 : 4);
}

void board_read(struct pendubot_reading *reading)
{
    reading->enc1 = plant_counts(&plant, 0, COUNTS_SHOULDER);
    reading->enc2 = plant_counts(&plant, 1, COUNTS_ELBOW);
    reading->current_ma = (int16_t)(applied / MICRO_NM_PER_MA);
    reading->vbus_10mv = VBUS_10MV;
    reading->faults = 0;
}

void board_torque(int32_t torque)
{
    applied = torque;
    motor_torque(torque, VBUS_10MV);
}

void rig_after_sample(void)
{
    plant_advance(&plant, applied * 1e-6, 1.0 / SAMPLE_HZ);
}

void rig_show(void)
{
}
