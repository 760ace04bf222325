// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
#include "pendubot_link.h"

enum { VERSION = 2 };
enum { TYPE_STATE = 1, TYPE_COMMAND = 2, TYPE_HELLO = 3, TYPE_HELLO_REQUEST = 4, TYPE_ARM = 5 };
enum { MODE_DISARM = 0, MODE_TORQUE = 1, MODE_CONFIRM_ZEROS = 2 };

/* Bytes: a header is type, version, seq and t_us; a CRC follows the payload. */
enum { HEADER = 8, CRC = 4, COMMAND_PAYLOAD = 12, ARM_PAYLOAD = 12, NAME = 16, LONGEST_BODY = 88 };

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
    /* A 16-bit int would overflow in this shift. */
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

/* Writes the frame of a body, which must have room for its CRC behind it, and returns the frame's size.
 *
 * COBS replaces every zero of the content by a code byte with the distance to the next one. The first code byte
 * precedes the content, the last one points to the delimiter. This is complete for less than 254 bytes.
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

/* Decodes COBS in place, with the content from frame[1] on; returns whether the code bytes lead to the end. */
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

/* The result of decoding a byte: nothing yet, a complete message, or dropped bytes. */
enum event { NOTHING, COMMAND, ARM, HELLO_REQUEST, DAMAGED };

/* A COMMAND or an ARM. */
struct request {
    uint32_t session;
    uint32_t boot_id; /* of an ARM alone */
    int32_t torque;   /* of a COMMAND alone */
    uint16_t seq;
    uint16_t watchdog_ms;
    uint16_t lock; /* of an ARM alone */
    uint8_t mode;  /* of a COMMAND alone: 0 disarm, 1 torque, 2 zeros confirmed */
};

static enum event read_frame(uint8_t *frame, size_t size, struct request *request)
{
    if (!undo_cobs(frame, size) || size < 1 + HEADER + CRC) {
        return DAMAGED;
    }
    const uint8_t *content = frame + 1;
    size_t body = size - 1 - CRC;
    if (crc32(content, body) != get32(content + body) || content[1] != VERSION) {
        return DAMAGED;
    }
    const uint8_t *payload = content + HEADER;
    size_t payload_size = body - HEADER;
    request->seq = get16(content + 2);
    if (content[0] == TYPE_HELLO_REQUEST && payload_size == 0) {
        return HELLO_REQUEST;
    }
    if (content[0] == TYPE_COMMAND && payload_size == COMMAND_PAYLOAD) {
        request->mode = payload[0];
        request->watchdog_ms = get16(payload + 2);
        request->torque = (int32_t)get32(payload + 4);
        request->session = get32(payload + 8);
        return COMMAND;
    }
    if (content[0] == TYPE_ARM && payload_size == ARM_PAYLOAD) {
        request->boot_id = get32(payload);
        request->session = get32(payload + 4);
        request->lock = get16(payload + 8);
        request->watchdog_ms = get16(payload + 10);
        return ARM;
    }
    return DAMAGED;
}

/* Decodes one byte; fills `request` if it completes a COMMAND or an ARM. */
static enum event decode(struct pendubot_decoder *decoder, uint8_t byte, struct request *request)
{
    if (byte == 0) {
        size_t size = decoder->size;
        decoder->size = 0;
        decoder->overlong = false;
        return size == 0 ? NOTHING : read_frame(decoder->frame, size, request);
    }
    if (decoder->overlong) {
        return NOTHING;
    }
    if (decoder->size == PENDUBOT_MAX_FRAME) {
        decoder->size = 0;
        decoder->overlong = true;
        return DAMAGED;
    }
    decoder->frame[decoder->size++] = byte;
    return NOTHING;
}

/* The limits */

/* 2 pi, in 1e-9. */
#define TAU_NANO UINT64_C(6283185307)

/* A single wrong count makes two fast samples: at its start and at its end. */
enum { FAST_SAMPLES = 3 };

/* Largest change of counts of a shoulder at rest. */
enum { STILL_COUNTS = 2 };

/* Returns a product, or UINT64_MAX if it is larger. */
static uint64_t product(uint64_t a, uint32_t b)
{
    uint64_t high = (a >> 32) * b + ((a & UINT32_MAX) * b >> 32);
    return high > UINT32_MAX ? UINT64_MAX : a * b;
}

static uint32_t magnitude(int32_t value)
{
    return value < 0 ? 0u - (uint32_t)value : (uint32_t)value;
}

static uint32_t distance(int32_t a, int32_t b)
{
    return a < b ? (uint32_t)b - (uint32_t)a : (uint32_t)a - (uint32_t)b;
}

/* Returns an angle [mrad] in whole counts, or UINT32_MAX, which no count exceeds, if there is no limit. */
static uint32_t counts_of(uint32_t mrad, uint32_t counts_per_turn)
{
    uint64_t counts = product((uint64_t)mrad * counts_per_turn, 1000000) / TAU_NANO;
    return mrad == 0 || counts > UINT32_MAX ? UINT32_MAX : (uint32_t)counts;
}

static void begin_monitor(struct pendubot_monitor *monitor, const struct pendubot_settings *settings)
{
    const struct pendubot_limits *limits = &settings->limits;
    monitor->speed[0] = (uint64_t)limits->max_speed * settings->cpr1;
    monitor->speed[1] = (uint64_t)limits->max_speed * settings->cpr2;
    monitor->travel[0] = counts_of(limits->max_travel1, settings->cpr1);
    monitor->travel[1] = counts_of(limits->max_travel2, settings->cpr2);
    monitor->stall_us = UINT32_C(1000) * limits->stall_ms;
    monitor->hottest = INT64_C(3000) * limits->continuous_ma * limits->continuous_ma * limits->overload_ms;
}

/* Returns whether the shoulder has been at rest for too long under the applied torque. */
static bool stalls(struct pendubot_link *link, int32_t counts, uint32_t elapsed_us)
{
    struct pendubot_monitor *monitor = &link->monitor;
    uint32_t torque = link->settings.limits.stall_torque;
    bool strained = torque != 0 && magnitude(link->applied) >= torque;
    if (!strained || distance(counts, monitor->still_at) > STILL_COUNTS) {
        monitor->still_at = counts;
        monitor->still_us = 0;
        return false;
    }
    uint32_t left_us = monitor->stall_us - monitor->still_us;
    monitor->still_us += elapsed_us < left_us ? elapsed_us : left_us;
    return monitor->stall_us != 0 && monitor->still_us == monitor->stall_us;
}

/* Returns whether the motor's heat is at its limit. */
static bool overloaded(struct pendubot_link *link, int32_t current_ma, uint32_t elapsed_us)
{
    struct pendubot_monitor *monitor = &link->monitor;
    int64_t bearable = (int64_t)link->settings.limits.continuous_ma * link->settings.limits.continuous_ma;
    /* Below 2^31, so that the product stays below 2^63. */
    int64_t elapsed = elapsed_us < INT32_MAX ? (int64_t)elapsed_us : INT32_MAX;
    int64_t heat = monitor->heat + ((int64_t)current_ma * current_ma - bearable) * elapsed;
    monitor->heat = heat < 0 ? 0 : heat < monitor->hottest ? heat : monitor->hottest;
    return monitor->hottest != 0 && monitor->heat == monitor->hottest;
}

/* Returns the fault bits of the limits exceeded at a sample. */
static uint32_t check(struct pendubot_link *link, const struct pendubot_reading *reading, uint32_t elapsed_us)
{
    const struct pendubot_limits *limits = &link->settings.limits;
    struct pendubot_monitor *monitor = &link->monitor;
    const int32_t counts[2] = { reading->enc1, reading->enc2 };
    uint32_t faults = 0;
    bool fast = false;
    for (size_t joint = 0; joint < 2; joint++) {
        uint32_t moved = link->sampled ? distance(counts[joint], monitor->before[joint]) : 0;
        fast |= product(TAU_NANO, moved) > product(monitor->speed[joint], elapsed_us);
        monitor->before[joint] = counts[joint];
        if (magnitude(counts[joint]) > monitor->travel[joint]) {
            faults |= PENDUBOT_TRAVEL;
        }
    }
    if (limits->max_speed == 0 || !fast) {
        monitor->fast = 0;
    } else if (monitor->fast < FAST_SAMPLES) {
        monitor->fast++;
    }
    faults |= monitor->fast == FAST_SAMPLES ? PENDUBOT_SPEED : 0;
    faults |= stalls(link, reading->enc1, elapsed_us) ? PENDUBOT_STALL : 0;
    faults |= overloaded(link, reading->current_ma, elapsed_us) ? PENDUBOT_OVERLOAD : 0;
    faults |= limits->max_vbus != 0 && reading->vbus_10mv > limits->max_vbus ? PENDUBOT_OVERVOLTAGE : 0;
    return faults;
}

/* The rules of the board */

void pendubot_boot(struct pendubot_link *link, const struct pendubot_settings *settings, uint32_t boot_id,
    struct pendubot_reset reset)
{
    const struct pendubot_link begun = {
        .settings = *settings,
        .reset = reset,
        .boot_id = boot_id,
        .lock = 1,
        .hellos_due = 1,
        .fresh = true,
    };
    *link = begun;
    begin_monitor(&link->monitor, settings);
    uint64_t step = (uint64_t)settings->limits.torque_slew * settings->sample_period_us / 1000;
    /* No change of a torque is larger than UINT32_MAX. */
    link->step = settings->limits.torque_slew == 0 || step > UINT32_MAX ? UINT32_MAX : (uint32_t)step;
}

/* Returns the present faults, and an emergency stop since the boot. */
static uint32_t lasting(struct pendubot_link *link, uint32_t faults)
{
    if (faults & PENDUBOT_EMERGENCY_STOP) {
        link->stopped = true;
    }
    return (faults & PENDUBOT_FAULTS) | link->exceeded | (link->stopped ? PENDUBOT_EMERGENCY_STOP : 0);
}

/* Switches the motor off, and invalidates earlier ARMs by a new lock number. */
static void disarm(struct pendubot_link *link, uint32_t reason)
{
    link->latched |= reason;
    link->lock++;
    link->armed = false;
    link->wanted = 0;
    link->slewed = 0;
}

static void hold(struct pendubot_link *link, uint32_t now_us, const struct request *request)
{
    uint16_t longest = link->settings.watchdog_max_ms;
    uint32_t held_ms = request->watchdog_ms < longest ? request->watchdog_ms : longest;
    link->holds_until_us = now_us + 1000 * held_ms;
    link->cmd_seq = request->seq;
}

static void refuse(struct pendubot_link *link)
{
    link->refused++;
    link->notes |= PENDUBOT_REFUSED;
}

static void obey(struct pendubot_link *link, uint32_t now_us, uint32_t faults, const struct request *command)
{
    if (command->mode == MODE_DISARM) {
        disarm(link, 0);
        link->latched = 0;
        link->cmd_seq = command->seq;
    } else if (command->mode == MODE_CONFIRM_ZEROS) {
        link->zeroed = link->zeroed || command->session == link->boot_id;
    } else if (command->mode != MODE_TORQUE) {
        return;
    } else if (command->session == 0 || command->session != link->session) {
        refuse(link);
    } else if (link->armed && !faults) {
        link->wanted = command->torque;
        hold(link, now_us, command);
    }
}

static void arm(struct pendubot_link *link, uint32_t now_us, uint32_t faults, const struct request *request)
{
    if (link->armed && request->session == link->session) {
        return; /* a repeated request */
    }
    bool fits = request->boot_id == link->boot_id && request->lock == link->lock && request->session != 0;
    if (!fits || link->armed || faults) {
        refuse(link);
        return;
    }
    link->armed = true;
    link->session = request->session;
    link->latched = 0;
    hold(link, now_us, request);
}

void pendubot_receive(struct pendubot_link *link, uint32_t now_us, uint32_t faults, const uint8_t *data, size_t size)
{
    struct request request;
    faults = lasting(link, faults);
    for (size_t k = 0; k < size; k++) {
        switch (decode(&link->decoder, data[k], &request)) {
        case NOTHING:
            break;
        case COMMAND:
            obey(link, now_us, faults, &request);
            break;
        case ARM:
            arm(link, now_us, faults, &request);
            break;
        case HELLO_REQUEST:
            link->hellos_due = (uint8_t)(link->hellos_due + (link->hellos_due < UINT8_MAX));
            break;
        case DAMAGED:
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
    const struct pendubot_limits *limits = &s->limits;
    uint8_t body[LONGEST_BODY + CRC];
    uint8_t *at = put32(put_header(link, body, TYPE_HELLO, now_us), link->boot_id);
    *at++ = link->reset.cause;
    *at++ = link->reset.fault_cause;
    at = put16(at, s->watchdog_max_ms);
    at = put32(put32(at, s->cpr1), s->cpr2);
    at = put32(put32(at, (uint32_t)s->torque_limit), s->sample_period_us);
    at = put32(put32(put32(at, link->reset.fault_pc), s->build), s->torque_constant);
    at = put32(put32(at, limits->torque_slew), limits->max_speed);
    at = put32(put32(at, limits->max_travel1), limits->max_travel2);
    at = put16(put32(at, limits->stall_torque), limits->stall_ms);
    at = put16(put16(put16(at, limits->continuous_ma), limits->overload_ms), limits->max_vbus);
    const char *name = s->firmware;
    for (size_t k = 0; k < NAME; k++) {
        *at++ = (uint8_t)(*name == '\0' ? 0 : *name++);
    }
    return write_frame(out, body, (size_t)(at - body));
}

static size_t write_state(
    struct pendubot_link *link, uint32_t now_us, const struct pendubot_reading *reading, uint8_t *out)
{
    uint8_t body[LONGEST_BODY + CRC];
    uint8_t *at = put_header(link, body, TYPE_STATE, now_us);
    at = put32(put32(at, (uint32_t)reading->enc1), (uint32_t)reading->enc2);
    at = put32(at, (uint32_t)link->applied);
    at = put16(put16(at, (uint16_t)reading->current_ma), reading->vbus_10mv);
    at = put32(put16(at, link->cmd_seq), link->status);
    at = put16(put16(at, link->lock), link->refused);
    return write_frame(out, body, (size_t)(at - body));
}

static int32_t clamped(int32_t value, int64_t low, int64_t high)
{
    return (int32_t)(value < low ? low : value > high ? high : value);
}

/* Decides about the motor from the faults and the time; sets `applied` and `status`. */
static void decide(struct pendubot_link *link, uint32_t now_us, uint32_t faults, uint32_t elapsed_us)
{
    if (link->armed && faults) {
        /* Latched, so that an intermittent fault does not leave the motor on in between. */
        disarm(link, faults);
    } else if (link->armed && (int32_t)(now_us - link->holds_until_us) >= 0) {
        /* The difference, because the clock wraps. */
        disarm(link, PENDUBOT_WATCHDOG);
    }
    int32_t limit = link->settings.torque_limit;
    int32_t allowed = clamped(link->wanted, -(int64_t)limit, limit);
    link->slewed = clamped(allowed, (int64_t)link->slewed - link->step, (int64_t)link->slewed + link->step);
    link->applied = link->slewed;

    uint32_t status = faults | link->latched | link->notes;
    status |= link->armed ? PENDUBOT_ARMED : 0;
    status |= allowed != link->wanted ? PENDUBOT_SATURATED : 0;
    status |= link->applied != allowed ? PENDUBOT_SLEW : 0;
    status |= UINT64_C(2) * elapsed_us > UINT64_C(3) * link->settings.sample_period_us ? PENDUBOT_LATE : 0;
    status |= link->zeroed ? PENDUBOT_ZEROED : 0;
    link->status = status;
    link->notes = 0;
}

size_t pendubot_sample(struct pendubot_link *link, uint32_t now_us, const struct pendubot_reading *reading,
    int32_t *torque, uint8_t *out, size_t room)
{
    uint32_t elapsed_us = link->sampled ? now_us - link->sampled_us : link->settings.sample_period_us;
    link->exceeded = check(link, reading, elapsed_us);
    link->sampled_us = now_us;
    link->sampled = true;
    decide(link, now_us, lasting(link, reading->faults), elapsed_us);
    *torque = link->applied;

    size_t size = 0;
    if (link->fresh && room > 0) {
        /* A delimiter ends the frame that the restart truncated; the first frame would be lost with it. */
        link->fresh = false;
        out[size++] = 0;
    }
    while (link->hellos_due > 0 && room - size >= PENDUBOT_HELLO_FRAME + PENDUBOT_STATE_FRAME) {
        link->hellos_due--;
        size += write_hello(link, now_us, out + size);
    }
    if (room - size < PENDUBOT_STATE_FRAME) {
        link->seq++;
        pendubot_note_overrun(link);
        return size;
    }
    return size + write_state(link, now_us, reading, out + size);
}

void pendubot_note_overrun(struct pendubot_link *link)
{
    link->notes |= PENDUBOT_OVERRUN;
}
