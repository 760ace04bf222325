// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* The steps of a sample, the same in every port. */
#include "board.h"

/* Largest number of bytes received or sent per sample: more than a line of 921600 bit/s carries in 1 ms. */
enum { ROOM = 256 };

struct pendubot_link firmware_link;

void firmware_boot(void)
{
    board_torque(0);
    pendubot_boot(&firmware_link, board_settings(), board_boot_id(), board_reset());
}

void firmware_sample(void)
{
    uint8_t heard[ROOM], said[ROOM];
    struct pendubot_reading reading;
    int32_t torque;
    board_read(&reading);
    uint32_t now = board_micros();
    size_t count = board_receive(heard, sizeof heard);
    pendubot_receive(&firmware_link, now, reading.faults, heard, count);
    size_t room = board_room();
    size_t size = pendubot_sample(&firmware_link, now, &reading, &torque, said, room < ROOM ? room : ROOM);
    board_torque(torque);
    if (!board_send(said, size)) {
        pendubot_note_overrun(&firmware_link);
    }
}
