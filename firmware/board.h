// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* The nine functions that a port supplies, and the two that it calls. */
#ifndef BOARD_H
#define BOARD_H

#include "pendubot_link.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A port supplies these. */

/* Returns the board's constants and limits. */
const struct pendubot_settings *board_settings(void);

/* Returns another number at every boot, so that an ARM from before a restart is invalid after it. */
uint32_t board_boot_id(void);

/* Returns the cause of the boot, and the processor fault before it, if there was one. */
struct pendubot_reset board_reset(void);

/* Returns the time of this sample in microseconds: a clock that begins at 0 and wraps at 2^32. */
uint32_t board_micros(void);

/* Reads the encoders first, because the sample's time is for them; then current, supply and faults. */
void board_read(struct pendubot_reading *reading);

/* Sets the motor's torque [micro-N m] until the next call; 0 removes all voltage from it. */
void board_torque(int32_t torque);

/* Fills `data` with at most `room` received bytes, and returns their number; it never waits. */
size_t board_receive(uint8_t *data, size_t room);

/* Returns the number of bytes that board_send takes without waiting. */
size_t board_room(void);

/* Sends bytes; returns whether all were sent. */
bool board_send(const uint8_t *data, size_t size);

/* firmware.c supplies these. */

/* The board's link. A port may read it. */
extern struct pendubot_link firmware_link;

/* Starts with the motor off. Call it once, before the first sample. */
void firmware_boot(void);

/* Takes a sample. Call it every sample period, from a single interrupt or thread. */
void firmware_sample(void);

#ifdef __cplusplus
}
#endif

#endif
