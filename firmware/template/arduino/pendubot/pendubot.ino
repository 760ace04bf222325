/* Copyright 2026 The pendubot_identification authors
 * SPDX-License-Identifier: Apache-2.0 */
/* A pendubot board as an Arduino sketch, written for a Teensy 4.
 *
 * Copy pendubot_link.c, pendubot_link.h, firmware.c and board.h into this folder. The PWM pin needs 10 kOhm to ground. A
 * loop() that hangs leaves the motor on: add a hardware watchdog, see the last lines, before you connect a motor.
 */
#include <EEPROM.h>
#include "board.h"

/* Pins. The emergency stop is a closed contact to ground. */
enum { PIN_SHOULDER_A = 2, PIN_SHOULDER_B = 3, PIN_ELBOW_A = 4, PIN_ELBOW_B = 5, PIN_STOP = 6, PIN_PWM = 9,
    PIN_DIRECTION = 10, PIN_CURRENT = 14, PIN_SUPPLY = 15 };

/* Measure these on your rig. */
const uint32_t COUNTS_PER_TURN = 4000;
const uint32_t PERIOD_US = 2000;
const int32_t TORQUE_LIMIT = 1000000;    /* micro-N m */
const int32_t MICRO_NM_PER_A = 200000;   /* torque at the shoulder for 1 A */
const int32_t MOTOR_MILLIOHM = 2000;     /* with leads and bridge */
const int32_t MICROVOLT_PER_STEP = 8862; /* of the supply, 12 bits: 10 kOhm below 100 kOhm */
const int32_t ZERO_STEPS = 2048, MICROAMPERE_PER_STEP = 8057; /* of the current, 12 bits */
const int32_t OVER_CURRENT_MA = 10000, UNDERVOLTAGE_10MV = 1800;
/* Slew micro-N m/ms, speed mrad/s, travels mrad, stall micro-N m and ms, continuous mA, overload ms, supply 10 mV. */
const struct pendubot_limits LIMITS = { 300000, 60000, 25000, 100000, 500000, 500, 5000, 2000, 3000 };
const struct pendubot_settings SETTINGS = { COUNTS_PER_TURN, COUNTS_PER_TURN, TORQUE_LIMIT, PERIOD_US, 500,
    (uint32_t)MICRO_NM_PER_A, 0, LIMITS, "arduino 2" };
const int DUTY_MAX = 4095 * 95 / 100;

/* Quadrature: maps the last and present state of both pins to -1, 0 or 1. If both changed, an edge was missed. */
struct Encoder {
    const uint8_t a, b;
    volatile int32_t counts;
    volatile uint8_t pins;
    volatile bool missed;

    void begin(void (*on_edge)())
    {
        pinMode(a, INPUT_PULLUP);
        pinMode(b, INPUT_PULLUP);
        pins = read();
        attachInterrupt(digitalPinToInterrupt(a), on_edge, CHANGE);
        attachInterrupt(digitalPinToInterrupt(b), on_edge, CHANGE);
    }
    uint8_t read() const { return (uint8_t)(digitalRead(a) << 1 | digitalRead(b)); }
    void edge()
    {
        static const int8_t STEP[16] = { 0, 1, -1, 2, -1, 0, 2, 1, 1, 2, 0, -1, 2, -1, 1, 0 };
        uint8_t now = read();
        int8_t step = STEP[pins << 2 | now];
        pins = now;
        missed = missed || step == 2;
        counts = counts + (step == 2 ? 0 : step);
    }
    uint32_t take(int32_t *to, uint32_t fault)
    {
        noInterrupts();
        *to = counts;
        uint32_t found = missed ? fault : 0;
        missed = false;
        interrupts();
        return found;
    }
};

Encoder shoulder = { PIN_SHOULDER_A, PIN_SHOULDER_B, 0, 0, false }, elbow = { PIN_ELBOW_A, PIN_ELBOW_B, 0, 0, false };
uint32_t sampled_us, due_us;
int32_t supply_10mv;
uint8_t waiting[256], written, sent; /* transmit buffer, so that no sample waits; both indices wrap */

const struct pendubot_settings *board_settings(void) { return &SETTINGS; }
struct pendubot_reset board_reset(void) { return { 0, 0, 1 }; }
uint32_t board_micros(void) { return sampled_us; }
size_t board_room(void) { return 255u - (uint8_t)(written - sent); }

uint32_t board_boot_id(void)
{
    uint32_t boots;
    EEPROM.get(0, boots);
    EEPROM.put(0, ++boots);
    return boots;
}

void board_read(struct pendubot_reading *reading)
{
    uint32_t faults = shoulder.take(&reading->enc1, PENDUBOT_ENCODER_1);
    faults |= elbow.take(&reading->enc2, PENDUBOT_ENCODER_2);
    sampled_us = micros();
    int32_t current_ma = (analogRead(PIN_CURRENT) - ZERO_STEPS) * MICROAMPERE_PER_STEP / 1000;
    supply_10mv = analogRead(PIN_SUPPLY) * MICROVOLT_PER_STEP / 10000;
    faults |= digitalRead(PIN_STOP) == HIGH ? PENDUBOT_EMERGENCY_STOP : 0;
    faults |= abs(current_ma) > OVER_CURRENT_MA ? PENDUBOT_OVER_CURRENT : 0;
    faults |= supply_10mv < UNDERVOLTAGE_10MV ? PENDUBOT_UNDERVOLTAGE : 0;
    reading->current_ma = (int16_t)current_ma;
    reading->vbus_10mv = (uint16_t)supply_10mv;
    reading->faults = faults;
}

/* Voltage is R / k times torque, without the induced voltage of the turning motor. */
void board_torque(int32_t torque)
{
    int64_t millivolt = (int64_t)abs(torque) * MOTOR_MILLIOHM / MICRO_NM_PER_A;
    int64_t duty = torque == 0 || supply_10mv == 0 ? 0 : millivolt * 4095 / (10 * supply_10mv);
    digitalWrite(PIN_DIRECTION, torque > 0 ? HIGH : LOW);
    analogWrite(PIN_PWM, (int)(duty < DUTY_MAX ? duty : DUTY_MAX));
}

size_t board_receive(uint8_t *data, size_t room)
{
    size_t size = 0;
    while (size < room && Serial.available() > 0) {
        data[size++] = (uint8_t)Serial.read();
    }
    return size;
}

bool board_send(const uint8_t *data, size_t size)
{
    for (size_t k = 0; k < size; k++) {
        waiting[written++] = data[k];
    }
    return true; /* firmware.c asks board_room first */
}

void setup()
{
    pinMode(PIN_PWM, OUTPUT);
    analogWriteFrequency(PIN_PWM, 20000);
    analogWriteResolution(12);
    analogReadResolution(12);
    pinMode(PIN_DIRECTION, OUTPUT);
    pinMode(PIN_STOP, INPUT_PULLUP);
    shoulder.begin([] { shoulder.edge(); });
    elbow.begin([] { elbow.edge(); });
    Serial.begin(921600);
    firmware_boot();
    due_us = micros();
}

void loop()
{
    while (written != sent && Serial.availableForWrite() > 0) {
        Serial.write(waiting[sent++]);
    }
    if ((int32_t)(micros() - due_us) >= 0) {
        firmware_sample();
        /* Feed the hardware watchdog here. */
        due_us = micros() - due_us < PERIOD_US ? due_us + PERIOD_US : micros() + PERIOD_US;
    }
}
