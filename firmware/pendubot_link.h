// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* The board's side of the serial protocol, version 2, see docs/protocol.md.
 *
 * The caller passes bytes, samples and the time, and receives bytes and a torque. The functions read no clock, no port
 * and no pin. They allocate no memory and have no static variables: all state is in the caller's struct. None of them
 * may interrupt another one on the same struct. Torques are in micro-N m, times in microseconds.
 *
 * A board calls pendubot_boot once, and pendubot_receive and then pendubot_sample every sample period:
 *
 *     pendubot_boot(&link, &settings, boot_id, reset);
 *     ...
 *     pendubot_receive(&link, now, reading.faults, bytes, count);
 *     size = pendubot_sample(&link, now, &reading, &torque, out, room);
 */
#ifndef PENDUBOT_LINK_H
#define PENDUBOT_LINK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The status bits of a STATE. */
#define PENDUBOT_ARMED (UINT32_C(1) << 0)
#define PENDUBOT_WATCHDOG (UINT32_C(1) << 1)
#define PENDUBOT_EMERGENCY_STOP (UINT32_C(1) << 2)
#define PENDUBOT_SATURATED (UINT32_C(1) << 3)
#define PENDUBOT_ENCODER_1 (UINT32_C(1) << 4)
#define PENDUBOT_ENCODER_2 (UINT32_C(1) << 5)
#define PENDUBOT_OVER_CURRENT (UINT32_C(1) << 6)
#define PENDUBOT_OVER_TEMPERATURE (UINT32_C(1) << 7)
#define PENDUBOT_UNDERVOLTAGE (UINT32_C(1) << 8)
#define PENDUBOT_DAMAGED_FRAME (UINT32_C(1) << 9)
#define PENDUBOT_OVERRUN (UINT32_C(1) << 10)
#define PENDUBOT_REFUSED (UINT32_C(1) << 11)
#define PENDUBOT_LATE (UINT32_C(1) << 12)
#define PENDUBOT_SLEW (UINT32_C(1) << 13)
#define PENDUBOT_OVERVOLTAGE (UINT32_C(1) << 14)
#define PENDUBOT_SPEED (UINT32_C(1) << 15)
#define PENDUBOT_TRAVEL (UINT32_C(1) << 16)
#define PENDUBOT_STALL (UINT32_C(1) << 17)
#define PENDUBOT_OVERLOAD (UINT32_C(1) << 18)
#define PENDUBOT_ZEROED (UINT32_C(1) << 19)

/* The bits that keep the motor off while they are set. The link detects exceeded limits; a port may report any bit. */
#define PENDUBOT_FAULTS                                                                                                \
    (PENDUBOT_EMERGENCY_STOP | PENDUBOT_ENCODER_1 | PENDUBOT_ENCODER_2 | PENDUBOT_OVER_CURRENT                         \
        | PENDUBOT_OVER_TEMPERATURE | PENDUBOT_UNDERVOLTAGE | PENDUBOT_OVERVOLTAGE | PENDUBOT_SPEED | PENDUBOT_TRAVEL  \
        | PENDUBOT_STALL | PENDUBOT_OVERLOAD)

/* Sizes of complete frames on the wire, including the delimiter. */
enum { PENDUBOT_STATE_FRAME = 40, PENDUBOT_HELLO_FRAME = 94 };

/* The size of the longest frame without its delimiter. The decoder drops longer ones. */
enum { PENDUBOT_MAX_FRAME = 93 };

/* The state of a decoder; initially zero. */
struct pendubot_decoder {
    uint8_t frame[PENDUBOT_MAX_FRAME];
    uint8_t size;
    bool overlong;
};

/* The limits in HELLO; 0 if the board has no such limit. */
struct pendubot_limits {
    uint32_t torque_slew;                /* largest change of the torque, micro-N m per ms */
    uint32_t max_speed;                  /* of either joint, mrad/s */
    uint32_t max_travel1, max_travel2;   /* of shoulder and elbow to either side of count 0, mrad */
    uint32_t stall_torque;               /* smallest torque at which the shoulder has to move ... */
    uint16_t stall_ms;                   /* ... within this time */
    uint16_t continuous_ma, overload_ms; /* the motor's continuous current; permitted time of twice this current */
    uint16_t max_vbus;                   /* highest supply voltage, 10 mV */
};

/* The constants of a board in HELLO. */
struct pendubot_settings {
    uint32_t cpr1, cpr2;  /* encoder counts per turn */
    int32_t torque_limit; /* 0 or more */
    uint32_t sample_period_us;
    uint16_t watchdog_max_ms;
    uint32_t torque_constant; /* torque at the shoulder per A; 0 if unknown */
    uint32_t build;           /* commit of the source; 0 if unknown */
    struct pendubot_limits limits;
    const char *firmware; /* name, at most 16 characters of ASCII */
};

/* The cause of a boot. */
struct pendubot_reset {
    uint32_t fault_pc;   /* program counter at the last processor fault since power-on; 0 if unknown */
    uint8_t fault_cause; /* exception number of that fault; 0 if there was none */
    uint8_t cause;       /* 1 power, 2 reset pin or debugger, 3 watchdog, 4 software */
};

/* The measurements of a sample. */
struct pendubot_reading {
    int32_t enc1, enc2; /* counts, not wrapped per turn */
    int16_t current_ma;
    uint16_t vbus_10mv;
    uint32_t faults; /* bits of PENDUBOT_FAULTS for present faults */
};

/* The state of the limit checks, and constants that pendubot_boot computes for them. */
struct pendubot_monitor {
    uint64_t speed[2];     /* max_speed times counts per turn */
    uint32_t travel[2];    /* counts */
    uint32_t stall_us;     /* stall_ms */
    int64_t heat, hottest; /* heat of the motor and its limit, mA^2 us */
    uint32_t still_us;     /* time without motion of the shoulder under torque */
    int32_t still_at;      /* counts of the shoulder at the start of this time */
    int32_t before[2];     /* counts at the sample before */
    uint8_t fast;          /* number of consecutive fast samples */
};

/* A board; only the functions below change it. */
struct pendubot_link {
    struct pendubot_settings settings;
    struct pendubot_decoder decoder;
    struct pendubot_monitor monitor;
    struct pendubot_reset reset;
    uint32_t boot_id;
    uint32_t session;        /* session that may command; 0 before the first ARM */
    uint32_t status;         /* status bits of the last STATE */
    uint32_t latched;        /* reason for disarming, until a mode 0 or an ARM */
    uint32_t exceeded;       /* exceeded limits at the last sample */
    uint32_t notes;          /* status bits for the next STATE alone */
    uint32_t holds_until_us; /* the end of the watchdog's time */
    uint32_t sampled_us;     /* the time of the last sample */
    uint32_t step;           /* largest change of the torque from one sample to the next */
    int32_t wanted;          /* torque of the last COMMAND */
    int32_t applied;         /* torque of the last STATE */
    int32_t slewed;          /* start of the next torque change */
    uint16_t seq;            /* number of the next frame */
    uint16_t cmd_seq;        /* number of the last accepted request */
    uint16_t lock, refused;
    uint8_t hellos_due;
    bool fresh;   /* no frame was sent yet */
    bool sampled; /* a sample was taken before */
    bool armed, stopped, zeroed;
};

/* Initialises the link: disarmed, torque 0, a HELLO due. `boot_id` must differ at every boot. */
void pendubot_boot(struct pendubot_link *link, const struct pendubot_settings *settings, uint32_t boot_id,
    struct pendubot_reset reset);

/* Decodes bytes from the host. Their commands apply from the next sample on. `faults`: present faults. */
void pendubot_receive(struct pendubot_link *link, uint32_t now_us, uint32_t faults, const uint8_t *data, size_t size);

/* Checks the limits, decides about the motor, writes the due frames into `out`, and returns their size.
 *
 * `torque` is the motor's torque from now until the next sample. HELLOs leave room for the STATE; a HELLO without room
 * waits for a later sample. Without room for the STATE it is lost, and the next one reports the loss.
 */
size_t pendubot_sample(struct pendubot_link *link, uint32_t now_us, const struct pendubot_reading *reading,
    int32_t *torque, uint8_t *out, size_t room);

/* For a port that could not send a sample's frames: the next STATE reports the loss. */
void pendubot_note_overrun(struct pendubot_link *link);

#ifdef __cplusplus
}
#endif

#endif
