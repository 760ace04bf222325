/* Copyright 2026 The pendubot_identification authors
 * SPDX-License-Identifier: Apache-2.0 */
/* The board's side of the serial protocol, version 1, as docs/protocol.md has it.
 *
 * Bytes and the board's time come in, bytes and a torque go out. Nothing here reads a clock, a port or a pin,
 * allocates, or has a variable of its own: all that lasts is in the struct that the caller keeps. None of the functions
 * may interrupt another one with the same struct. All torques are in micro-N m, all times in microseconds.
 *
 * A board does this, and every sample period calls pendubot_receive and then pendubot_sample:
 *
 *     pendubot_boot(&link, &settings, boot_id, reset_cause);
 *     ...
 *     pendubot_receive(&link, now, faults, bytes, count);
 *     size = pendubot_sample(&link, now, &reading, &torque, out, room);
 */
#ifndef PENDUBOT_LINK_H
#define PENDUBOT_LINK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* The status bits of a STATE. */
enum {
    PENDUBOT_ARMED = 1 << 0,
    PENDUBOT_WATCHDOG = 1 << 1,
    PENDUBOT_EMERGENCY_STOP = 1 << 2,
    PENDUBOT_SATURATED = 1 << 3,
    PENDUBOT_ENCODER_1 = 1 << 4,
    PENDUBOT_ENCODER_2 = 1 << 5,
    PENDUBOT_OVER_CURRENT = 1 << 6,
    PENDUBOT_OVER_TEMPERATURE = 1 << 7,
    PENDUBOT_UNDERVOLTAGE = 1 << 8,
    PENDUBOT_DAMAGED_FRAME = 1 << 9,
    PENDUBOT_OVERRUN = 1 << 10,
    /* Those that keep the motor off while they stand; a board reports any of them as faults. */
    PENDUBOT_FAULTS = PENDUBOT_EMERGENCY_STOP | PENDUBOT_ENCODER_1 | PENDUBOT_ENCODER_2 | PENDUBOT_OVER_CURRENT
                      | PENDUBOT_OVER_TEMPERATURE | PENDUBOT_UNDERVOLTAGE,
};

/* Sizes of whole frames on the wire, delimiter included. */
enum { PENDUBOT_STATE_FRAME = 34, PENDUBOT_HELLO_FRAME = 54 };

/* The longest frame without its delimiter; what is longer is dropped. */
enum { PENDUBOT_MAX_FRAME = 53 };

/* What ended with a byte: nothing yet, a message, or bytes that are dropped, and why. */
enum pendubot_event {
    PENDUBOT_NOTHING,
    PENDUBOT_COMMAND,
    PENDUBOT_HELLO_REQUEST,
    PENDUBOT_OVERLONG,
    PENDUBOT_BAD_COBS,
    PENDUBOT_BAD_LENGTH,
    PENDUBOT_BAD_CRC,
    PENDUBOT_BAD_VERSION,
    PENDUBOT_BAD_TYPE,
};

struct pendubot_command {
    uint16_t seq;
    uint32_t t_us; /* the host's clock */
    uint8_t mode;  /* 0 disarm and unlock, 1 torque */
    uint8_t flags;
    uint16_t watchdog_ms;
    int32_t torque;
};

/* Begins as zeros. */
struct pendubot_decoder {
    uint8_t frame[PENDUBOT_MAX_FRAME];
    uint8_t size;
    bool overlong;
};

/* Takes one byte; `command` is filled where a PENDUBOT_COMMAND ends with it. */
enum pendubot_event pendubot_decode(struct pendubot_decoder *decoder, uint8_t byte, struct pendubot_command *command);

/* What a HELLO says. */
struct pendubot_settings {
    uint32_t cpr1, cpr2; /* encoder counts per turn */
    int32_t torque_limit; /* 0 or more */
    uint32_t sample_period_us;
    uint16_t watchdog_max_ms;
    const char *firmware; /* at most 16 characters of ASCII */
};

/* What the board measured at a sample. */
struct pendubot_reading {
    int32_t enc1, enc2; /* counts, not wrapped per turn */
    int16_t current_ma;
    uint16_t vbus_10mv;
    uint32_t faults; /* of PENDUBOT_FAULTS, what is wrong now */
};

/* A board; only the functions below change it. */
struct pendubot_link {
    struct pendubot_settings settings;
    struct pendubot_decoder decoder;
    uint32_t boot_id;
    uint8_t reset_cause;
    uint8_t hellos_due;
    uint16_t seq;     /* of the next frame */
    uint16_t cmd_seq; /* of the last command obeyed */
    uint16_t status;  /* of the last STATE */
    bool fresh; /* nothing was sent yet */
    bool armed, locked, tripped, stopped;
    int32_t wanted; /* torque of the last command obeyed */
    uint32_t holds_until_us;
    uint32_t notes; /* PENDUBOT_DAMAGED_FRAME and PENDUBOT_OVERRUN, for the next STATE */
};

/* Begins: disarmed, locked, torque 0, a HELLO due. `boot_id` differs from that of the boots before. */
void pendubot_boot(
    struct pendubot_link *link, const struct pendubot_settings *settings, uint32_t boot_id, uint8_t reset_cause);

/* Takes bytes from the host; what they command counts from the next sample on. `faults`: what is wrong now. */
void pendubot_receive(
    struct pendubot_link *link, uint32_t now_us, uint32_t faults, const uint8_t *data, size_t size);

/* Decides about the motor, writes the frames that are due into `out`, and returns their size.
 *
 * `torque` is what the motor is to give from now until the next sample. Of HELLOs as many are written as leave room for
 * the STATE, the others later; where there is no room for the STATE, it is lost and the next one says so.
 */
size_t pendubot_sample(struct pendubot_link *link, uint32_t now_us, const struct pendubot_reading *reading,
    int32_t *torque, uint8_t *out, size_t room);

/* For a port that finds out later that it could not send a sample's frames: the next STATE says so. */
void pendubot_note_overrun(struct pendubot_link *link);

#endif
