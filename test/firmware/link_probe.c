// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* Calls pendubot_link.c with the records on stdin and answers on stdout; used by link_probe.py. */
#include "pendubot_link.h"

#include <stdio.h>
#include <stdlib.h>

static void take(void *into, size_t size)
{
    if (size > 0 && fread(into, size, 1, stdin) != 1) {
        exit(1);
    }
}

static void give(const void *data, size_t size)
{
    fwrite(data, 1, size, stdout);
}

/* Allocates exactly these bytes, so that the sanitizer detects accesses beyond them. */
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
    for (int call; (call = getchar()) != EOF;) {
        if (call == 'B') {
            static struct {
                struct pendubot_settings settings;
                struct pendubot_reset reset;
                uint32_t boot_id;
                char firmware[17];
            } given;
            take(&given, sizeof given);
            given.settings.firmware = given.firmware;
            pendubot_boot(&link, &given.settings, given.boot_id, given.reset);
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
                struct pendubot_reading reading;
                uint32_t now, room;
            } given;
            struct {
                int32_t torque;
                uint32_t size;
            } answer;
            take(&given, sizeof given);
            uint8_t *out = exactly(given.room);
            answer.size = (uint32_t)pendubot_sample(&link, given.now, &given.reading, &answer.torque, out, given.room);
            give(&answer, sizeof answer);
            give(out, answer.size);
            free(out);
        } else if (call == 'O') {
            pendubot_note_overrun(&link);
        }
        if (call == 'S') {
            fflush(stdout);
        }
    }
    return 0;
}
