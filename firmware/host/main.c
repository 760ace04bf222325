// Copyright 2026 The pendubot_identification authors
// SPDX-License-Identifier: Apache-2.0
/* A board as a Linux program: the firmware on a pseudo-terminal, with a simulated pendubot.
 *
 * It takes the options in the usage below, with the same meaning as in the package's virtual_board, and writes the same
 * trace. SIGUSR1 disconnects the cable and SIGUSR2 connects it again.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <getopt.h>
#include <math.h>
#include <poll.h>
#include <pty.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "board.h"
#include "simulation/plant.h"

#define MICRO 1e-6
#define VBUS_10MV 2400
#define MILLIAMPERE_PER_MICRO_NM 0.01

static const char usage[] =
    "usage: pendubot_board [--link PATH] [--rate HZ] [--counts N] [--torque-limit NM] [--preset paper|balance]\n"
    "                      [--trace FILE] [--duration S] [--seed N] [--fault NAME=VALUE ...] [--limit NAME=VALUE ...]\n"
    "faults: bit_flip (probability, of each sample's bytes), glitch (of each sample), reset_at, stuck_at (seconds after\n"
    "the start)\n"
    "limits, in the units of HELLO, 0 for none: torque_slew, max_speed, max_travel1, max_travel2, stall_torque, stall_ms,\n"
    "continuous_ma, overload_ms, max_vbus\n";

/* Micro-N m: twice the gravity torque (P4 + P5) g of the paper's rig, and 1.5 times (P4 + P5) g of plant_to_balance. */
enum { STALL_TORQUE = 500000, STALL_TORQUE_TO_BALANCE = 1920000 };

static struct pendubot_settings settings = {
    .cpr1 = 4000,
    .cpr2 = 4000,
    .torque_limit = 2000000,
    .sample_period_us = 10000,
    .watchdog_max_ms = 500,
    .torque_constant = 100000,
    .build = BUILD_ID,
    .limits = SIMULATED_LIMITS,
    .firmware = "host in C",
};

static double bit_flip, glitch, reset_at = INFINITY, stuck_at = INFINITY;
static struct plant plant;
static const char *link_path;
static FILE *trace;
static uint64_t elapsed_us, booted_us; /* time since the start, and its value at the last boot */
static int32_t origin[2], counts[2], torque_now;
static bool stuck; /* the shoulder's encoder stands still */
static uint8_t cause = 1;
static char slave_path[64];
static int master = -1;
static bool cut; /* the last frame was truncated */
static volatile sig_atomic_t stopped, plugged_in = 1;

static void fail(const char *subject)
{
    fprintf(stderr, "pendubot_board: %s: %s\n", subject, strerror(errno));
    exit(1);
}

static int64_t now_ns(clockid_t clock)
{
    struct timespec t;
    clock_gettime(clock, &t);
    return t.tv_sec * INT64_C(1000000000) + t.tv_nsec;
}

static bool chance(double probability)
{
    return probability > 0 && drand48() < probability;
}

static size_t below(size_t bound)
{
    return (size_t)(drand48() * (double)bound);
}

/* The pseudo-terminal */

static void plug(void)
{
    int slave;
    struct termios raw;
    char former[sizeof slave_path];
    memcpy(former, slave_path, sizeof former);
    if (openpty(&master, &slave, slave_path, NULL, NULL) != 0) {
        fail("no pseudo-terminal");
    }
    if (strcmp(former, slave_path) == 0) {
        /* A reconnected device gets another path: take the next. */
        int taken[2] = { master, slave };
        if (openpty(&master, &slave, slave_path, NULL, NULL) != 0) {
            fail("no pseudo-terminal");
        }
        close(taken[0]);
        close(taken[1]);
    }
    tcgetattr(slave, &raw);
    cfmakeraw(&raw);
    tcsetattr(slave, TCSANOW, &raw);
    /* Closed here, so that the kernel shows whether a host is connected, and buffers nothing without one. */
    close(slave);
    fcntl(master, F_SETFL, O_NONBLOCK);
    cut = false;
    if (link_path != NULL) {
        struct stat there;
        if (lstat(link_path, &there) == 0 && S_ISLNK(there.st_mode)) {
            unlink(link_path);
        }
        if (symlink(slave_path, link_path) != 0) {
            fail(link_path);
        }
    }
}

static void unplug(void)
{
    if (master >= 0) {
        close(master);
        master = -1;
        if (link_path != NULL) {
            unlink(link_path);
        }
    }
}

static bool host_is_there(void)
{
    struct pollfd hangup = { .fd = master };
    return master >= 0 && poll(&hangup, 1, 0) >= 0 && !(hangup.revents & POLLHUP);
}

static bool write_whole(const uint8_t *data, size_t size)
{
    /* A delimiter ends a truncated frame: else the next one would be lost with it. */
    if (cut && write(master, "", 1) != 1) {
        return false;
    }
    ssize_t sent = write(master, data, size);
    cut = sent > 0 && (size_t)sent < size;
    return sent == (ssize_t)size;
}

/* The functions of board.h */

const struct pendubot_settings *board_settings(void)
{
    return &settings;
}

uint32_t board_boot_id(void)
{
    return (uint32_t)mrand48() | 1;
}

struct pendubot_reset board_reset(void)
{
    struct pendubot_reset reset = { .cause = cause };
    return reset;
}

uint32_t board_micros(void)
{
    return (uint32_t)(elapsed_us - booted_us);
}

void board_read(struct pendubot_reading *reading)
{
    uint32_t cpr[2] = { settings.cpr1, settings.cpr2 };
    for (int joint = stuck ? 1 : 0; joint < 2; joint++) {
        counts[joint] = plant_counts(&plant, joint, cpr[joint]) - origin[joint];
    }
    stuck = (double)elapsed_us >= stuck_at * 1e6;
    reading->enc1 = counts[0] + (chance(glitch) ? (int32_t)cpr[0] / 2 : 0);
    reading->enc2 = counts[1];
    reading->current_ma = (int16_t)lrint(fmax(-32768, fmin(32767, torque_now * MILLIAMPERE_PER_MICRO_NM)));
    reading->vbus_10mv = VBUS_10MV;
    reading->faults = 0;
}

void board_torque(int32_t torque)
{
    torque_now = torque;
}

size_t board_receive(uint8_t *data, size_t room)
{
    /* After a host has closed the port, reading fails when no more bytes are buffered. */
    ssize_t size = master >= 0 ? read(master, data, room) : -1;
    return size > 0 ? (size_t)size : 0;
}

size_t board_room(void)
{
    return SIZE_MAX;
}

bool board_send(const uint8_t *data, size_t size)
{
    uint8_t bytes[600];
    memcpy(bytes, data, size);
    if (trace != NULL) {
        /* Written before sending, so that the trace contains every sample that a host has. */
        const uint32_t status = firmware_link.status;
        fprintf(trace, "%u,%d,%d,%d,%u\n", board_micros(), counts[0], counts[1], torque_now, status);
        fflush(trace);
    }
    if (!plugged_in) {
        if (master >= 0 && write(master, data, size / 2) >= 0) {
            printf("cable out at %lld ns\n", (long long)now_ns(CLOCK_REALTIME));
        }
        unplug();
        return true;
    }
    if (chance(bit_flip)) {
        bytes[below(size)] ^= (uint8_t)(1u << below(8));
    }
    return host_is_there() && write_whole(bytes, size);
}

/* The program */

static void on_signal(int number)
{
    if (number == SIGUSR1) {
        plugged_in = 0;
    } else if (number == SIGUSR2) {
        plugged_in = 1;
    } else {
        stopped = 1;
    }
}

static double number(const char *name, const char *text, double low, double high)
{
    char *end;
    double value = strtod(text, &end);
    if (end == text || *end != '\0' || !(value >= low && value <= high)) {
        fprintf(stderr, "pendubot_board: %s is %s; a number from %g to %g is expected\n", name, text, low, high);
        exit(2);
    }
    return value;
}

/* Sets the field of NAME=VALUE: a fault, which is a double, or a limit, which is an integer of its size. */
static void set(const char *text)
{
    struct pendubot_limits *to = &settings.limits;
    const struct {
        const char *name;
        void *at;
        size_t size;
        double most;
    } fields[] = {
        { "bit_flip", &bit_flip, sizeof bit_flip, 1 },
        { "glitch", &glitch, sizeof glitch, 1 },
        { "reset_at", &reset_at, sizeof reset_at, INFINITY },
        { "stuck_at", &stuck_at, sizeof stuck_at, INFINITY },
        { "torque_slew", &to->torque_slew, sizeof to->torque_slew, UINT32_MAX },
        { "max_speed", &to->max_speed, sizeof to->max_speed, UINT32_MAX },
        { "max_travel1", &to->max_travel1, sizeof to->max_travel1, UINT32_MAX },
        { "max_travel2", &to->max_travel2, sizeof to->max_travel2, UINT32_MAX },
        { "stall_torque", &to->stall_torque, sizeof to->stall_torque, UINT32_MAX },
        { "stall_ms", &to->stall_ms, sizeof to->stall_ms, UINT16_MAX },
        { "continuous_ma", &to->continuous_ma, sizeof to->continuous_ma, UINT16_MAX },
        { "overload_ms", &to->overload_ms, sizeof to->overload_ms, UINT16_MAX },
        { "max_vbus", &to->max_vbus, sizeof to->max_vbus, UINT16_MAX },
    };
    for (size_t k = 0; k < sizeof fields / sizeof *fields; k++) {
        size_t size = strlen(fields[k].name);
        if (strncmp(text, fields[k].name, size) == 0 && text[size] == '=') {
            double value = number(fields[k].name, text + size + 1, 0, fields[k].most);
            if (fields[k].size == sizeof(double)) {
                *(double *)fields[k].at = value;
            } else if (fields[k].size == sizeof(uint32_t)) {
                *(uint32_t *)fields[k].at = (uint32_t)value;
            } else {
                *(uint16_t *)fields[k].at = (uint16_t)value;
            }
            return;
        }
    }
    fprintf(stderr, "pendubot_board: no fault or limit %s\n%s", text, usage);
    exit(2);
}

static double parse(int argc, char **argv)
{
    static const struct option options[] = { { "link", 1, NULL, 'l' }, { "rate", 1, NULL, 'r' },
        { "counts", 1, NULL, 'c' }, { "torque-limit", 1, NULL, 't' }, { "preset", 1, NULL, 'p' },
        { "trace", 1, NULL, 'f' }, { "duration", 1, NULL, 'd' }, { "seed", 1, NULL, 's' }, { "fault", 1, NULL, 'x' },
        { "limit", 1, NULL, 'x' }, { NULL, 0, NULL, 0 } };
    double duration = INFINITY;
    plant = plant_of_the_paper;
    srand48(now_ns(CLOCK_REALTIME) ^ getpid());
    for (int c; (c = getopt_long(argc, argv, "", options, NULL)) != -1;) {
        switch (c) {
        case 'l': link_path = optarg; break;
        case 'r': settings.sample_period_us = (uint32_t)lrint(1e6 / number("--rate", optarg, 1, 10000)); break;
        case 'c': settings.cpr1 = settings.cpr2 = (uint32_t)number("--counts", optarg, 4, 1 << 24); break;
        case 't': settings.torque_limit = (int32_t)lrint(1e6 * number("--torque-limit", optarg, 0, 300)); break;
        case 'p':
            if (strcmp(optarg, "balance") == 0) {
                plant = plant_to_balance;
                if (settings.limits.stall_torque == STALL_TORQUE) {
                    settings.limits.stall_torque = STALL_TORQUE_TO_BALANCE;
                }
            } else if (strcmp(optarg, "paper") != 0) {
                fprintf(stderr, "pendubot_board: --preset is %s; paper or balance is expected\n", optarg);
                exit(2);
            }
            break;
        case 'd': duration = number("--duration", optarg, 0, INFINITY); break;
        case 's': srand48((long)number("--seed", optarg, 0, UINT32_MAX)); break;
        case 'x': set(optarg); break;
        case 'f':
            trace = fopen(optarg, "wx");
            if (trace == NULL) {
                fail(optarg);
            }
            fputs("t_us,enc1,enc2,torque,status\n", trace);
            fflush(trace);
            break;
        default: fputs(usage, stderr); exit(2);
        }
    }
    return duration;
}

int main(int argc, char **argv)
{
    double duration = parse(argc, argv);
    struct sigaction action = { .sa_handler = on_signal };
    for (const int *n = (const int[]) { SIGINT, SIGTERM, SIGHUP, SIGUSR1, SIGUSR2, 0 }; *n != 0; n++) {
        sigaction(*n, &action, NULL);
    }
    prctl(PR_SET_TIMERSLACK, 1);
    setvbuf(stdout, NULL, _IOLBF, 0);
    plug();
    printf("virtual board on %s\n", link_path != NULL ? link_path : slave_path);
    firmware_boot();
    int64_t due = now_ns(CLOCK_MONOTONIC);
    while (!stopped && (double)elapsed_us * MICRO < duration) {
        struct timespec at = { due / 1000000000, due % 1000000000 };
        if (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL) != 0) {
            continue; /* a signal came */
        }
        if ((double)elapsed_us >= reset_at * 1e6) {
            reset_at = INFINITY;
            cause = 2;
            stuck = false;
            booted_us = elapsed_us;
            origin[0] = plant_counts(&plant, 0, settings.cpr1);
            origin[1] = plant_counts(&plant, 1, settings.cpr2);
            firmware_boot();
        }
        if (master < 0 && plugged_in) {
            plug();
            printf("cable in at %lld ns\n", (long long)now_ns(CLOCK_REALTIME));
        }
        firmware_sample();
        /* After the sample, so that computing the motion does not delay it. */
        plant_advance(&plant, torque_now * MICRO, settings.sample_period_us * MICRO);
        elapsed_us += settings.sample_period_us;
        due += settings.sample_period_us * INT64_C(1000);
    }
    unplug();
    return 0;
}
