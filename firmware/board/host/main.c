/* The firmware as a process: opens a pseudo-terminal, prints its path, and runs the core against the real clock.
 *
 *   hpac_host [--pulses FILE] [--parent PID] [--boot-text] [--cold] [--trim SERVO NS] [--reverse SERVO]
 *
 * FILE gets a line "time_us,pulse_ns × 6" whenever a width changes, before the answer that tells of it is sent.
 * With --cold it does not know where its servos are, as after power-on, and takes longer to arm. Ends on SIGTERM or SIGINT, or when the process PID is no longer its parent. */
#define _XOPEN_SOURCE 600

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "hpac_hand.h"

#define TICK_US 1000u

typedef struct {
    const char *pulses_path;
    long parent;
    bool boot_text;
    bool cold;
    hpac_config_t config;
} options_t;

static volatile sig_atomic_t stopped;

static void stop(int signal_number)
{
    (void)signal_number;
    stopped = 1;
}

static uint64_t clock_us(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u;
}

static int fail(const char *what)
{
    fprintf(stderr, "hpac_host: %s: %s\n", what, strerror(errno));
    return 1;
}

static bool read_servo(const char *text, int *servo)
{
    char *end;
    long value = strtol(text, &end, 10);
    *servo = (int)value;
    return end != text && *end == '\0' && value >= 0 && value < HPAC_SERVOS;
}

static bool read_options(int count, char **arguments, options_t *options)
{
    int servo;
    for (int i = 1; i < count; i++) {
        const char *name = arguments[i];
        int left = count - i - 1;
        if (strcmp(name, "--boot-text") == 0) {
            options->boot_text = true;
        } else if (strcmp(name, "--cold") == 0) {
            options->cold = true;
        } else if (strcmp(name, "--pulses") == 0 && left >= 1) {
            options->pulses_path = arguments[++i];
        } else if (strcmp(name, "--parent") == 0 && left >= 1) {
            options->parent = strtol(arguments[++i], NULL, 10);
        } else if (strcmp(name, "--trim") == 0 && left >= 2 && read_servo(arguments[i + 1], &servo)) {
            options->config.servo[servo].trim_ns = (int32_t)strtol(arguments[i + 2], NULL, 10);
            i += 2;
        } else if (strcmp(name, "--reverse") == 0 && left >= 1 && read_servo(arguments[i + 1], &servo)) {
            options->config.servo[servo].direction = -1;
            i++;
        } else {
            fprintf(stderr, "usage: hpac_host [--pulses FILE] [--parent PID] [--boot-text] [--cold] "
                            "[--trim SERVO NS] [--reverse SERVO]   (SERVO 0 to 5)\n");
            return false;
        }
    }
    return true;
}

/* Open a raw pseudo-terminal. Its far end stays open here too, so that a host may come and go. */
static int open_port(void)
{
    int port = posix_openpt(O_RDWR | O_NOCTTY);
    if (port < 0 || grantpt(port) != 0 || unlockpt(port) != 0) {
        return -1;
    }
    int far_end = open(ptsname(port), O_RDWR | O_NOCTTY);
    struct termios settings;
    if (far_end < 0 || tcgetattr(far_end, &settings) != 0) {
        return -1;
    }
    settings.c_iflag = 0;
    settings.c_oflag = 0;
    settings.c_lflag = 0;
    settings.c_cflag = CS8 | CREAD | CLOCAL;
    if (tcsetattr(far_end, TCSANOW, &settings) != 0 || fcntl(port, F_SETFL, O_NONBLOCK) != 0) {
        return -1;
    }
    return port;
}

static void log_pulses(FILE *log, uint64_t now_us, const uint32_t pulses[HPAC_SERVOS], uint32_t last[HPAC_SERVOS])
{
    if (log == NULL || memcmp(pulses, last, HPAC_SERVOS * sizeof pulses[0]) == 0) {
        return;
    }
    memcpy(last, pulses, HPAC_SERVOS * sizeof pulses[0]);
    fprintf(log, "%llu", (unsigned long long)now_us);
    for (int i = 0; i < HPAC_SERVOS; i++) {
        fprintf(log, ",%lu", (unsigned long)pulses[i]);
    }
    fputc('\n', log);
    fflush(log);
}

typedef struct {
    uint8_t bytes[HPAC_TX_CAPACITY];
    size_t length;
} pending_t;

/* Send what is pending, then what the hand has to say. A host that does not read stalls this, and nothing else. */
static void send_answers(int port, hpac_hand_t *hand, pending_t *pending)
{
    if (pending->length == 0u) {
        pending->length = hpac_hand_transmit(hand, pending->bytes, sizeof pending->bytes);
    }
    if (pending->length == 0u) {
        return;
    }
    ssize_t sent = write(port, pending->bytes, pending->length);
    if (sent > 0) {
        pending->length -= (size_t)sent;
        memmove(pending->bytes, pending->bytes + sent, pending->length);
    }
}

static void run(int port, const options_t *options, FILE *log)
{
    static const char boot_text[] = "ets Jul 29 2019 12:21:46\r\n\r\nrst:0x1 (POWERON_RESET),boot:0x13\r\n";
    hpac_hand_t hand;
    pending_t pending = { .length = 0 };
    uint32_t pulses[HPAC_SERVOS];
    uint32_t last[HPAC_SERVOS] = { 0 };
    uint64_t start_us = clock_us();
    uint64_t next_us = 0;
    hpac_memory_t at_rest = { .heat = { 0 } };
    for (int i = 0; i < HPAC_SERVOS; i++) {
        at_rest.pose[i] = options->config.servo[i].rest_urad;
    }
    hpac_hand_init(&hand, &options->config, HPAC_RESET_POWER_ON, 1, options->cold ? NULL : &at_rest);
    if (options->boot_text) {
        pending.length = sizeof boot_text - 1u;
        memcpy(pending.bytes, boot_text, pending.length);
    }
    while (!stopped && (options->parent == 0 || getppid() == options->parent)) {
        uint8_t received[256];
        uint64_t now_us = clock_us() - start_us;
        struct pollfd waiting = { .fd = port, .events = POLLIN };
        poll(&waiting, 1, now_us < next_us ? 1 : 0);
        ssize_t length = read(port, received, sizeof received);
        now_us = clock_us() - start_us;
        if (length > 0) {
            hpac_hand_receive(&hand, &options->config, now_us, received, (size_t)length);
        } else if (now_us < next_us) {
            continue;
        }
        next_us = now_us + TICK_US;
        hpac_hand_tick(&hand, &options->config, now_us, pulses);
        log_pulses(log, now_us, pulses, last);
        send_answers(port, &hand, &pending);
    }
}

int main(int count, char **arguments)
{
    options_t options = { .pulses_path = NULL, .parent = 0 };
    hpac_config_default(&options.config);
    if (!read_options(count, arguments, &options)) {
        return 2;
    }
    signal(SIGTERM, stop);
    signal(SIGINT, stop);
    int port = open_port();
    if (port < 0) {
        return fail("cannot open a pseudo-terminal");
    }
    FILE *log = NULL;
    if (options.pulses_path != NULL && (log = fopen(options.pulses_path, "w")) == NULL) {
        return fail(options.pulses_path);
    }
    printf("%s\n", ptsname(port));
    fflush(stdout);
    run(port, &options, log);
    if (log != NULL) {
        fclose(log);
    }
    return 0;
}
