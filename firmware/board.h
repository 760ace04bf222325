/* Copyright 2026 The pendubot_identification authors
 * SPDX-License-Identifier: Apache-2.0 */
/* What a port gives to firmware.c, and what it calls there: all that another board needs. */
#ifndef BOARD_H
#define BOARD_H

#include "pendubot_link.h"

/* What a port gives. */

/* Counts per turn, torque limit, sample period and name. */
const struct pendubot_settings *board_settings(void);

/* Another number at every boot, and why it booted (README.md lists the causes). */
uint32_t board_boot_id(void);
uint8_t board_reset_cause(void);

/* The time of this sample: a clock that begins at 0 and wraps at 2^32. */
uint32_t board_micros(void);

/* Encoders first, because they are what the time is of; then current, supply, and the faults that stand. */
void board_read(struct pendubot_reading *reading);

/* Lets the motor give a torque until the next call; 0 takes all voltage from it. */
void board_torque(int32_t torque);

/* Fills `data` with what the host has sent, at most `room` bytes, and returns how many; it never waits. */
size_t board_receive(uint8_t *data, size_t room);

/* Returns how many bytes board_send takes without waiting. */
size_t board_room(void);

/* Sends; returns whether all of it went out. */
bool board_send(const uint8_t *data, size_t size);

/* What firmware.c gives. */

/* The board's link; for a port to read. */
extern struct pendubot_link firmware_link;

/* Boots: to be called once, motor off, before the first sample. */
void firmware_boot(void);

/* Takes a sample: to be called every sample period, by one interrupt or one thread alone. */
void firmware_sample(void);

#endif
