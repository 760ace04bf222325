/* Copyright 2026 The pendubot_identification authors
 * SPDX-License-Identifier: Apache-2.0 */
#include "pendubot_link.h"

enum { VERSION = 1 };
enum { TYPE_STATE = 1, TYPE_COMMAND = 2, TYPE_HELLO = 3, TYPE_HELLO_REQUEST = 4 };
enum { MODE_DISARM = 0, MODE_TORQUE = 1 };

/* Bytes: a header is type, version, seq and t_us; a CRC follows the payload. */
enum { HEADER = 8, CRC = 4, COMMAND_PAYLOAD = 8, NAME = 16, LONGEST_BODY = 48 };

/* Numbers as bytes, little-endian */

static uint8_t *put16(uint8_t *at, uint16_t value)
{
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
    return at + 2;
}

static uint8_t *put32(uint8_t *at, uint32_t value)
{
    return put16(put16(at, (uint16_t)value), (uint16_t)(value >> 16));
}

static uint16_t get16(const uint8_t *at)
{
    /* Where an int has 16 bits, one that is shifted this far would overflow. */
    return (uint16_t)(at[0] | (uint16_t)at[1] << 8);
}

static uint32_t get32(const uint8_t *at)
{
    return get16(at) | (uint32_t)get16(at + 2) << 16;
}

/* A frame: COBS(body + CRC) + 0x00 */

/* The CRC-32 of IEEE 802.3, as zlib's, by half bytes. */
static uint32_t crc32(const uint8_t *data, size_t size)
{
    static const uint32_t table[16] = {
        0x00000000, 0x1db71064, 0x3b6e20c8, 0x26d930ac, 0x76dc4190, 0x6b6b51f4, 0x4db26158, 0x5005713c, //
        0xedb88320, 0xf00f9344, 0xd6d6a3e8, 0xcb61b38c, 0x9b64c2b0, 0x86d3d2d4, 0xa00ae278, 0xbdbdf21c, //
    };
    uint32_t crc = 0xffffffff;
    for (size_t k = 0; k < size; k++) {
        crc ^= data[k];
        crc = crc >> 4 ^ table[crc & 15];
        crc = crc >> 4 ^ table[crc & 15];
    }
    return ~crc;
}

/* Writes the frame of a body that has room for its CRC behind it, and returns its size.
 *
 * Every zero of the content becomes a code byte that says how far the next one is; the first code byte stands before
 * the content, the last one leads to the delimiter. That is all there is to COBS in less than 254 bytes.
 */
static size_t write_frame(uint8_t *out, uint8_t *body, size_t size)
{
    put32(body + size, crc32(body, size));
    size_t code = 0, at = 1;
    for (size_t k = 0; k < size + CRC; k++) {
        if (body[k] == 0) {
            out[code] = (uint8_t)(at - code);
            code = at;
        } else {
            out[at] = body[k];
        }
        at++;
    }
    out[code] = (uint8_t)(at - code);
    out[at] = 0;
    return at + 1;
}

/* Undoes COBS in place, leaving the content from frame[1] on; returns whether the code bytes lead to the end. */
static bool undo_cobs(uint8_t *frame, size_t size)
{
    size_t at = 0;
    while (at < size) {
        size_t distance = frame[at];
        frame[at] = 0;
        at += distance;
    }
    return at == size;
}

static enum pendubot_event read_frame(uint8_t *frame, size_t size, struct pendubot_command *command)
{
    if (!undo_cobs(frame, size)) {
        return PENDUBOT_BAD_COBS;
    }
    const uint8_t *content = frame + 1;
    if (size < 1 + HEADER + CRC) {
        return PENDUBOT_BAD_LENGTH;
    }
    size_t body = size - 1 - CRC;
    if (crc32(content, body) != get32(content + body)) {
        return PENDUBOT_BAD_CRC;
    }
    if (content[1] != VERSION) {
        return PENDUBOT_BAD_VERSION;
    }
    if (content[0] == TYPE_HELLO_REQUEST) {
        return body == HEADER ? PENDUBOT_HELLO_REQUEST : PENDUBOT_BAD_LENGTH;
    }
    if (content[0] != TYPE_COMMAND) {
        return PENDUBOT_BAD_TYPE;
    }
    if (body != HEADER + COMMAND_PAYLOAD) {
        return PENDUBOT_BAD_LENGTH;
    }
    command->seq = get16(content + 2);
    command->t_us = get32(content + 4);
    command->mode = content[HEADER];
    command->flags = content[HEADER + 1];
    command->watchdog_ms = get16(content + HEADER + 2);
    command->torque = (int32_t)get32(content + HEADER + 4);
    return PENDUBOT_COMMAND;
}

enum pendubot_event pendubot_decode(struct pendubot_decoder *decoder, uint8_t byte, struct pendubot_command *command)
{
    if (byte == 0) {
        size_t size = decoder->size;
        decoder->size = 0;
        decoder->overlong = false;
        return size == 0 ? PENDUBOT_NOTHING : read_frame(decoder->frame, size, command);
    }
    if (decoder->overlong) {
        return PENDUBOT_NOTHING;
    }
    if (decoder->size == PENDUBOT_MAX_FRAME) {
        decoder->size = 0;
        decoder->overlong = true;
        return PENDUBOT_OVERLONG;
    }
    decoder->frame[decoder->size++] = byte;
    return PENDUBOT_NOTHING;
}

/* The rules of the board */

void pendubot_boot(
    struct pendubot_link *link, const struct pendubot_settings *settings, uint32_t boot_id, uint8_t reset_cause)
{
    const struct pendubot_link begun = {
        .settings = *settings,
        .boot_id = boot_id,
        .reset_cause = reset_cause,
        .fresh = true,
        .locked = true,
        .hellos_due = 1,
    };
    *link = begun;
}

/* Returns the faults that stand: those that are there now, and an emergency stop since the boot. */
static uint32_t standing(struct pendubot_link *link, uint32_t faults)
{
    if (faults & PENDUBOT_EMERGENCY_STOP) {
        link->stopped = true;
    }
    return (faults & PENDUBOT_FAULTS) | (link->stopped ? PENDUBOT_EMERGENCY_STOP : 0u);
}

static void obey(struct pendubot_link *link, uint32_t now_us, uint32_t faults, const struct pendubot_command *command)
{
    if (command->mode == MODE_DISARM) {
        link->armed = link->locked = link->tripped = false;
        link->wanted = 0;
    } else if (command->mode == MODE_TORQUE && !link->locked && !link->tripped && !faults) {
        uint16_t longest = link->settings.watchdog_max_ms;
        uint32_t held_ms = command->watchdog_ms < longest ? command->watchdog_ms : longest;
        link->armed = true;
        link->wanted = command->torque;
        link->holds_until_us = now_us + 1000 * held_ms;
    } else {
        return;
    }
    link->cmd_seq = command->seq;
}

void pendubot_receive(struct pendubot_link *link, uint32_t now_us, uint32_t faults, const uint8_t *data, size_t size)
{
    struct pendubot_command command;
    faults = standing(link, faults);
    for (size_t k = 0; k < size; k++) {
        switch (pendubot_decode(&link->decoder, data[k], &command)) {
        case PENDUBOT_NOTHING:
            break;
        case PENDUBOT_COMMAND:
            obey(link, now_us, faults, &command);
            break;
        case PENDUBOT_HELLO_REQUEST:
            link->hellos_due = (uint8_t)(link->hellos_due + (link->hellos_due < UINT8_MAX));
            break;
        default:
            link->notes |= PENDUBOT_DAMAGED_FRAME;
        }
    }
}

static uint8_t *put_header(struct pendubot_link *link, uint8_t *at, uint8_t type, uint32_t now_us)
{
    at[0] = type;
    at[1] = VERSION;
    return put32(put16(at + 2, link->seq++), now_us);
}

static size_t write_hello(struct pendubot_link *link, uint32_t now_us, uint8_t *out)
{
    const struct pendubot_settings *s = &link->settings;
    uint8_t body[LONGEST_BODY + CRC];
    uint8_t *at = put32(put_header(link, body, TYPE_HELLO, now_us), link->boot_id);
    *at++ = link->reset_cause;
    *at++ = 0;
    at = put16(at, s->watchdog_max_ms);
    at = put32(put32(at, s->cpr1), s->cpr2);
    at = put32(at, (uint32_t)s->torque_limit);
    at = put32(at, s->sample_period_us);
    const char *name = s->firmware;
    for (size_t k = 0; k < NAME; k++) {
        *at++ = (uint8_t)(*name == '\0' ? 0 : *name++);
    }
    return write_frame(out, body, (size_t)(at - body));
}

size_t pendubot_sample(struct pendubot_link *link, uint32_t now_us, const struct pendubot_reading *reading,
    int32_t *torque, uint8_t *out, size_t room)
{
    uint32_t faults = standing(link, reading->faults);
    /* The difference, because the clock wraps. */
    if (link->armed && (int32_t)(now_us - link->holds_until_us) >= 0) {
        link->armed = false;
        link->tripped = true;
    }
    if (link->armed && faults) {
        /* Or one that comes and goes would leave the motor on in between, for commands that know nothing of it. */
        link->armed = false;
        link->locked = true;
    }
    int32_t wanted = link->armed ? link->wanted : 0, limit = link->settings.torque_limit;
    *torque = wanted > limit ? limit : wanted < -limit ? -limit : wanted;

    uint32_t status = faults | link->notes;
    status |= link->armed ? PENDUBOT_ARMED : 0u;
    status |= link->tripped ? PENDUBOT_WATCHDOG : 0u;
    status |= *torque != wanted ? PENDUBOT_SATURATED : 0u;
    link->status = (uint16_t)status;
    link->notes = 0;

    size_t size = 0;
    if (link->fresh && room > 0) {
        /* A delimiter, or the frame that the restart cut short would take the first one along. */
        link->fresh = false;
        out[size++] = 0;
    }
    while (link->hellos_due > 0 && room - size >= PENDUBOT_HELLO_FRAME + PENDUBOT_STATE_FRAME) {
        link->hellos_due--;
        size += write_hello(link, now_us, out + size);
    }
    uint8_t body[LONGEST_BODY + CRC];
    uint8_t *at = put_header(link, body, TYPE_STATE, now_us);
    at = put32(put32(at, (uint32_t)reading->enc1), (uint32_t)reading->enc2);
    at = put32(at, (uint32_t)*torque);
    at = put16(put16(at, (uint16_t)reading->current_ma), reading->vbus_10mv);
    at = put16(put16(at, link->cmd_seq), link->status);
    if (room - size < PENDUBOT_STATE_FRAME) {
        pendubot_note_overrun(link);
        return size;
    }
    return size + write_frame(out + size, body, (size_t)(at - body));
}

void pendubot_note_overrun(struct pendubot_link *link)
{
    link->notes |= PENDUBOT_OVERRUN;
}
