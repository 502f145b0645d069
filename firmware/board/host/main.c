/* The firmware as a process: opens a pseudo-terminal, prints its path, and runs the core against the real clock.
 *
 *   hpac_host [--pulses FILE] [--parent PID] [--boot-text] [--cold] [--heat PERCENT] [--trim SERVO NS] [--reverse SERVO]
 *
 * FILE gets a line "time_us,pulse_ns × 6" whenever a width changes, before the answer that tells of it is sent.
 * With --cold it does not know where its servos are, as after power-on, and takes longer to arm; --heat
 * is what its servos have at the start, of what they may have. Ends on SIGTERM or SIGINT, or when the process PID is no longer its parent. */
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

#include "hpac_load.h"
#include "loop.h"

#define TICK_MS 1

typedef struct {
    const char *pulses_path;
    long parent;
    bool boot_text;
    bool cold;
    uint32_t heat_percent;
    hpac_config_t config;
} options_t;

static volatile sig_atomic_t stopped;
static int port = -1;
static FILE *pulse_log;
static uint64_t start_us;

/* Answers on their way: a host that does not read stalls them, and nothing else. */
static struct {
    uint8_t bytes[HPAC_TX_CAPACITY];
    size_t length;
} pending;

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

/* --- what loop.h asks for: no servo supply, no e-stop input --- */

uint64_t board_clock_us(void) { return clock_us() - start_us; }

size_t board_read(uint8_t *bytes, size_t capacity)
{
    ssize_t length = read(port, bytes, capacity);
    return length > 0 ? (size_t)length : 0u;
}

size_t board_room(void)
{
    ssize_t sent = pending.length > 0u ? write(port, pending.bytes, pending.length) : 0;
    if (sent > 0) {
        pending.length -= (size_t)sent;
        memmove(pending.bytes, pending.bytes + sent, pending.length);
    }
    return sizeof pending.bytes - pending.length;
}

void board_write(const uint8_t *bytes, size_t length)
{
    memcpy(pending.bytes + pending.length, bytes, length);
    pending.length += length;
    board_room();
}

void board_power(bool on) { (void)on; }

bool board_estop_pressed(void) { return false; }

uint16_t board_supply_mv(void) { return 0; }

bool servo_output_write(const uint32_t pulses[HPAC_SERVOS])
{
    static uint32_t last[HPAC_SERVOS];
    if (pulse_log == NULL || memcmp(pulses, last, sizeof last) == 0) {
        return true;
    }
    memcpy(last, pulses, sizeof last);
    fprintf(pulse_log, "%llu", (unsigned long long)board_clock_us());
    for (int i = 0; i < HPAC_SERVOS; i++) {
        fprintf(pulse_log, ",%lu", (unsigned long)pulses[i]);
    }
    fputc('\n', pulse_log);
    fflush(pulse_log);
    return true;
}

/* --- the process --- */

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
        } else if (strcmp(name, "--heat") == 0 && left >= 1) {
            options->heat_percent = (uint32_t)strtoul(arguments[++i], NULL, 10);
        } else if (strcmp(name, "--parent") == 0 && left >= 1) {
            options->parent = strtol(arguments[++i], NULL, 10);
        } else if (strcmp(name, "--trim") == 0 && left >= 2 && read_servo(arguments[i + 1], &servo)) {
            long trim_ns = strtol(arguments[i + 2], NULL, 10);
            if (trim_ns < HPAC_TRIM_MIN_NS || trim_ns > HPAC_TRIM_MAX_NS) {
                fprintf(stderr, "hpac_host: --trim %d %ld ns, allowed %d to %d ns\n", servo, trim_ns, HPAC_TRIM_MIN_NS, HPAC_TRIM_MAX_NS);
                return false;
            }
            options->config.servo[servo].trim_ns = (int32_t)trim_ns;
            i += 2;
        } else if (strcmp(name, "--reverse") == 0 && left >= 1 && read_servo(arguments[i + 1], &servo)) {
            options->config.servo[servo].direction = -1;
            i++;
        } else {
            fprintf(stderr, "usage: hpac_host [--pulses FILE] [--parent PID] [--boot-text] [--cold] [--heat PERCENT] "
                            "[--trim SERVO NS] [--reverse SERVO]   (SERVO 0 to 5)\n");
            return false;
        }
    }
    return true;
}

/* Open a raw pseudo-terminal. Its far end stays open here too, so that a host may come and go. */
static int open_port(void)
{
    int near_end = posix_openpt(O_RDWR | O_NOCTTY);
    if (near_end < 0 || grantpt(near_end) != 0 || unlockpt(near_end) != 0) {
        return -1;
    }
    int far_end = open(ptsname(near_end), O_RDWR | O_NOCTTY);
    struct termios settings;
    if (far_end < 0 || tcgetattr(far_end, &settings) != 0) {
        return -1;
    }
    settings.c_iflag = 0;
    settings.c_oflag = 0;
    settings.c_lflag = 0;
    settings.c_cflag = CS8 | CREAD | CLOCAL;
    if (tcsetattr(far_end, TCSANOW, &settings) != 0 || fcntl(near_end, F_SETFL, O_NONBLOCK) != 0) {
        return -1;
    }
    return near_end;
}

static void run(const options_t *options)
{
    static const char boot_text[] = "ets Jul 29 2019 12:21:46\r\n\r\nrst:0x1 (POWERON_RESET),boot:0x13\r\n";
    static loop_t loop;
    loop_memory_t kept;
    hpac_memory_t at_rest = { .placed = HPAC_ALL_SERVOS };
    for (int i = 0; i < HPAC_SERVOS; i++) {
        at_rest.pose[i] = options->config.servo[i].rest_urad;
        at_rest.heat[i] = (options->heat_percent < 100u ? options->heat_percent : 100u) * (HPAC_HEAT_LIMIT / 100u);
    }
    start_us = clock_us();
    loop_start(&loop, &options->config, HPAC_RESET_POWER_ON, &kept);
    if (!options->cold) {
        hpac_hand_init(&loop.hand, &options->config, HPAC_RESET_POWER_ON, 1, &at_rest);
    }
    if (options->boot_text) {
        board_write((const uint8_t *)boot_text, sizeof boot_text - 1u);
    }
    loop.period_us = TICK_MS * 1000u;
    while (!stopped && (options->parent == 0 || getppid() == options->parent)) {
        struct pollfd waiting = { .fd = port, .events = POLLIN };
        poll(&waiting, 1, TICK_MS);
        loop.next_us = board_clock_us(); /* every change is logged, before the answer that tells of it is sent */
        loop_once(&loop);
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
    port = open_port();
    if (port < 0) {
        return fail("cannot open a pseudo-terminal");
    }
    if (options.pulses_path != NULL && (pulse_log = fopen(options.pulses_path, "a")) == NULL) {
        return fail(options.pulses_path);
    }
    printf("%s\n", ptsname(port));
    fflush(stdout);
    run(&options);
    if (pulse_log != NULL) {
        fclose(pulse_log);
    }
    return 0;
}
