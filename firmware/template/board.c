// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* A template for a port: it compiles as C and as C++, sends nothing, and never moves a motor.
 *
 * Copy it beside pendubot_link.c, pendubot_link.h, firmware.c and board.h, and make the replacements in the comments.
 * Begin with board_send and the encoders: then the bridge publishes /joint_states. Connect the motor last.
 */
#include "board.h"

/* Replace all numbers by your rig's. A limit of 0 means that the board does not have it. */
const struct pendubot_settings *board_settings(void)
{
    static const struct pendubot_settings settings = {
        4000, 4000, /* encoder counts per turn of shoulder and elbow: four times the lines */
        1000000,    /* largest torque, micro-N m */
        10000,      /* sample period, us */
        500,        /* longest time for which a COMMAND holds, ms */
        0,          /* torque of 1 A, micro-N m */
        0,          /* commit of the source */
        {
            300000, /* torque slew, micro-N m per ms */
            60000,  /* largest speed of either joint, mrad/s */
            25000,  /* largest travel of the shoulder, mrad */
            100000, /* largest travel of the elbow, mrad */
            500000, /* torque at which the shoulder has to move, micro-N m ... */
            500,    /* ... within this time, ms */
            5000,   /* continuous current of the motor, mA */
            2000,   /* permitted time of twice this current, ms */
            3000,   /* highest supply voltage, 10 mV */
        },
        "my board 1", /* its name */
    };
    return &settings;
}

/* Replace by a number that differs at every boot: from a random number generator, or a counter in persistent memory. */
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

/* Replace by a real clock in microseconds. A count of samples would not show late samples. */
uint32_t board_micros(void)
{
    static uint32_t now;
    return now += 10000;
}

/* Replace by your encoders' counts, the current and the supply. Set a fault's bit while it lasts: a pressed emergency
 * stop, impossible encoder signals, over current, over temperature, undervoltage. */
void board_read(struct pendubot_reading *reading)
{
    reading->enc1 = 0;
    reading->enc2 = 0;
    reading->current_ma = 0;
    reading->vbus_10mv = 0;
    reading->faults = PENDUBOT_EMERGENCY_STOP; /* keeps the motor off until you read the real one */
}

/* Replace by the duty and direction that give this torque [micro-N m]. 0 has to remove all voltage from the motor. */
void board_torque(int32_t torque)
{
    (void)torque;
}

/* Replace: copy at most `room` received bytes into `data`; do not wait. */
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

/* Replace: copy all bytes into the transmit buffer, do not wait, and return whether they fit. */
bool board_send(const uint8_t *data, size_t size)
{
    (void)data;
    (void)size;
    return true;
}

/* Replace the loop by a timer interrupt of this period. Feed a hardware watchdog only while samples are taken: without
 * it, the motor would keep its last voltage while the program hangs. */
int main(void)
{
    firmware_boot();
    for (int sample = 0; sample < 10; sample++) {
        firmware_sample();
    }
    return 0;
}
