// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
#ifndef EEPROM_H
#define EEPROM_H

#include <cstring>

struct Memory {
    unsigned char bytes[64];

    template <typename T> void get(int at, T &to) { std::memcpy(&to, bytes + at, sizeof to); }
    template <typename T> void put(int at, const T &from) { std::memcpy(bytes + at, &from, sizeof from); }
};
extern Memory EEPROM;

#endif
