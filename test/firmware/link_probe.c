// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* Calls pendubot_link.c as records on stdin say, and answers on stdout; link_probe.py has the other end. */
#include "pendubot_link.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void take(void *into, size_t size)
{
    if (size > 0 && fread(into, size, 1, stdin) != 1) {
        exit(1);
    }
}

static void give(const void *what, size_t size)
{
    fwrite(what, 1, size, stdout);
}

/* Bytes of their own size on the heap, so that the sanitizer sees who reads or writes beyond. */
static uint8_t *exactly(size_t size)
{
    uint8_t *bytes = malloc(size > 0 ? size : 1);
    if (bytes == NULL) {
        exit(1);
    }
    return bytes;
}

int main(void)
{
    static struct pendubot_link link;
    static struct pendubot_decoder decoder;
    static char firmware[17];
    for (int call; (call = getchar()) != EOF;) {
        if (call == 'B') {
            struct {
                uint32_t boot_id, cpr1, cpr2;
                int32_t torque_limit;
                uint32_t sample_period_us, fault_pc, build, torque_constant;
                uint32_t torque_slew, max_speed, max_travel1, max_travel2, stall_torque;
                uint16_t stall_ms, continuous_ma, overload_ms, max_vbus;
                uint16_t watchdog_max_ms;
                uint8_t reset_cause, fault_cause;
                char firmware[16];
            } given;
            take(&given, sizeof given);
            memcpy(firmware, given.firmware, 16);
            struct pendubot_settings settings = {
                .cpr1 = given.cpr1,
                .cpr2 = given.cpr2,
                .torque_limit = given.torque_limit,
                .sample_period_us = given.sample_period_us,
                .watchdog_max_ms = given.watchdog_max_ms,
                .torque_constant = given.torque_constant,
                .build = given.build,
                .limits = { given.torque_slew, given.max_speed, given.max_travel1, given.max_travel2,
                    given.stall_torque, given.stall_ms, given.continuous_ma, given.overload_ms, given.max_vbus },
                .firmware = firmware,
            };
            struct pendubot_reset reset = { given.fault_pc, given.fault_cause, given.reset_cause };
            pendubot_boot(&link, &settings, given.boot_id, reset);
        } else if (call == 'R') {
            struct {
                uint32_t now, faults, size;
            } given;
            take(&given, sizeof given);
            uint8_t *bytes = exactly(given.size);
            take(bytes, given.size);
            pendubot_receive(&link, given.now, given.faults, bytes, given.size);
            free(bytes);
        } else if (call == 'S') {
            struct {
                uint32_t now;
                int32_t enc1, enc2;
                uint32_t faults, room;
                int16_t current;
                uint16_t vbus;
            } given;
            take(&given, sizeof given);
            struct pendubot_reading reading = { given.enc1, given.enc2, given.current, given.vbus, given.faults };
            uint8_t *out = exactly(given.room);
            struct {
                int32_t torque;
                uint32_t size;
            } answer;
            answer.size = (uint32_t)pendubot_sample(&link, given.now, &reading, &answer.torque, out, given.room);
            give(&answer, sizeof answer);
            give(out, answer.size);
            free(out);
        } else if (call == 'O') {
            pendubot_note_overrun(&link);
        } else if (call == 'D') {
            uint32_t size;
            take(&size, sizeof size);
            for (uint32_t k = 0; k < size; k++) {
                struct pendubot_request c = { 0 };
                uint8_t byte = 0;
                take(&byte, 1);
                uint8_t event = (uint8_t)pendubot_decode(&decoder, byte, &c);
                if (event != PENDUBOT_NOTHING) {
                    give(&event, 1);
                    give(&c, sizeof c);
                }
            }
            uint8_t end = PENDUBOT_NOTHING;
            give(&end, 1);
        }
        if (call == 'S' || call == 'D') {
            fflush(stdout);
        }
    }
    return 0;
}
