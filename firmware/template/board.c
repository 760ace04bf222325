// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* A port to begin with: it compiles as C and as C++, talks to nobody, and never moves a motor.
 *
 * Copy it beside pendubot_link.c, pendubot_link.h, firmware.c and board.h, and replace what each comment names. Begin
 * with board_send and the encoders: then the bridge publishes /joint_states. Connect the motor last.
 */
#include "board.h"

/* Replace all numbers by those of your rig. 0 as a limit means that the board does not have it. */
const struct pendubot_settings *board_settings(void)
{
    static const struct pendubot_settings settings = {
        4000, 4000, /* encoder counts per turn of shoulder and elbow: four times the lines */
        1000000,    /* largest torque, micro-N m */
        10000,      /* sample period, us */
        500,        /* longest time for which a COMMAND holds, ms */
        0,          /* torque of 1 A, micro-N m */
        0,          /* which source this is */
        {
            300000, /* torque slew, micro-N m per ms */
            60000,  /* largest speed of either joint, mrad/s */
            25000,  /* largest travel of the shoulder, mrad */
            100000, /* largest travel of the elbow, mrad */
            500000, /* torque at which the shoulder has to move, micro-N m ... */
            500,    /* ... within this time, ms */
            5000,   /* continuous current of the motor, mA; twice as much ... */
            2000,   /* ... it bears for this time, ms */
            3000,   /* highest supply, 10 mV */
        },
        "my board 1", /* its name */
    };
    return &settings;
}

/* Replace by a number that differs at every boot: a random number generator, or a count in memory that lasts. */
uint32_t board_boot_id(void)
{
    return 1;
}

/* Replace by the cause that your processor's reset flags show. */
struct pendubot_reset board_reset(void)
{
    struct pendubot_reset reset = { 0, 0, 1 };
    return reset;
}

/* Replace by a clock in microseconds. The real one, not a count of samples: a late sample has to look late. */
uint32_t board_micros(void)
{
    static uint32_t now;
    return now += 10000;
}

/* Replace by your encoders' counts, the current and the supply. Set a fault's bit while it lasts: an emergency stop
 * that is pressed, an encoder whose signals are impossible, over current, over temperature, undervoltage. */
void board_read(struct pendubot_reading *reading)
{
    reading->enc1 = 0;
    reading->enc2 = 0;
    reading->current_ma = 0;
    reading->vbus_10mv = 0;
    reading->faults = PENDUBOT_EMERGENCY_STOP; /* until you read the real one: it keeps the motor off */
}

/* Replace by the duty and direction that give this torque [micro-N m]. 0 has to take all voltage from the motor. */
void board_torque(int32_t torque)
{
    (void)torque;
}

/* Replace: take what the host has sent, at most `room` bytes, into `data`; do not wait. */
size_t board_receive(uint8_t *data, size_t room)
{
    (void)data;
    (void)room;
    return 0;
}

/* Replace by the free space of your transmit buffer, which needs 135 bytes or more. */
size_t board_room(void)
{
    return 256;
}

/* Replace: put all bytes into the transmit buffer, do not wait, and return whether they had room. */
bool board_send(const uint8_t *data, size_t size)
{
    (void)data;
    (void)size;
    return true;
}

/* Replace the loop by a timer's interrupt of this period. Feed a hardware watchdog only where samples still come: while
 * the program hangs, the motor would keep its last voltage. */
int main(void)
{
    firmware_boot();
    for (int sample = 0; sample < 10; sample++) {
        firmware_sample();
    }
    return 0;
}
