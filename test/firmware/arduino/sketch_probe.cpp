// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* Runs the sketch with the commands on stdin and answers on stdout; used by test_template.py. */
#include "Arduino.h"

#include <iostream>
#include <string>

#include "pendubot.ino"

Pin pin[PINS];
uint32_t now_us;
SerialPort Serial;
Memory EEPROM;

static void set_level(int number, int level)
{
    bool changes = pin[number].level != level;
    pin[number].level = level;
    if (changes && pin[number].on_change != nullptr) {
        pin[number].on_change();
    }
}

int main()
{
    std::string command;
    while (std::cin >> command) {
        unsigned first = 0, second = 0;
        if (command == "setup") {
            setup();
        } else if (command == "hear" && std::cin >> first) {
            Serial.to_board.push_back(static_cast<uint8_t>(first));
        } else if (command == "pin" && std::cin >> first >> second) {
            set_level(static_cast<int>(first), static_cast<int>(second));
        } else if (command == "quietly" && std::cin >> first >> second) {
            pin[first].level = static_cast<int>(second); /* a change too short for an interrupt */
        } else if (command == "analog" && std::cin >> first >> second) {
            pin[first].analog = static_cast<int>(second);
        } else if (command == "wait" && std::cin >> first) {
            /* In steps of 100 us, at 92 bytes per ms. */
            for (uint32_t end = now_us + first; now_us != end; now_us += 100) {
                Serial.room = 9;
                loop();
            }
            std::cout << pin[PIN_PWM].analog << ' ' << pin[PIN_DIRECTION].level;
            for (; !Serial.to_host.empty(); Serial.to_host.pop_front()) {
                std::cout << ' ' << static_cast<int>(Serial.to_host.front());
            }
            std::cout << std::endl;
        }
    }
    return 0;
}
