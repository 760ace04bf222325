// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* The part of Arduino that the sketch needs, on this computer; sketch_probe.cpp simulates pins, time and the line. */
#ifndef ARDUINO_H
#define ARDUINO_H

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <deque>

enum { LOW, HIGH };
enum { INPUT, OUTPUT, INPUT_PULLUP };
enum { CHANGE = 1 };
enum { PINS = 20 };

struct Pin {
    int mode, level, analog;
    void (*on_change)();
};
extern Pin pin[PINS];
extern uint32_t now_us;

struct SerialPort {
    std::deque<uint8_t> to_board, to_host;
    int room; /* free bytes of the transmit buffer */

    void begin(unsigned long) {}
    int available() { return static_cast<int>(to_board.size()); }
    int read()
    {
        int byte = to_board.front();
        to_board.pop_front();
        return byte;
    }
    int availableForWrite() { return room; }
    size_t write(uint8_t byte)
    {
        to_host.push_back(byte);
        room--;
        return 1;
    }
};
extern SerialPort Serial;

inline uint32_t micros() { return now_us; }
inline void pinMode(uint8_t number, int mode) { pin[number].mode = mode; }
inline int digitalRead(uint8_t number) { return pin[number].level; }
inline void digitalWrite(uint8_t number, int level) { pin[number].level = level; }
inline int analogRead(uint8_t number) { return pin[number].analog; }
inline void analogWrite(uint8_t number, int value) { pin[number].analog = value; }
inline void analogWriteFrequency(uint8_t, float) {}
inline void analogWriteResolution(int) {}
inline void analogReadResolution(int) {}
inline int digitalPinToInterrupt(uint8_t number) { return number; }
inline void attachInterrupt(int number, void (*on_change)(), int) { pin[number].on_change = on_change; }
inline void noInterrupts() {}
inline void interrupts() {}

#endif
