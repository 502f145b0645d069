/* A hostile host: frames good, absurd, damaged, cut and junk, at random times, and after each one the promises of the
 * core are checked.
 *
 *   hpac_driver FRAMES SEED [damaged]   prints one line "name value" a figure; exits with 1 if a promise was broken.
 *
 * With `damaged` nearly all frames are damaged ones. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bench.h"
#include "hpac_motion.h"

/* The admissible speed includes the tolerance for the wire's roundings, at its largest in the shortest move. */
#define SPEED_PERMILLE (1000 + 1000 * HPAC_TIME_TOLERANCE_US / (HPAC_MOVE_MIN_MS * 1000) + 5)

typedef struct {
    uint64_t frames, accepted, refused;
    uint64_t damaged, damaged_accepted;
    uint64_t lost_bytes, frames_lost_beyond_one;
    uint64_t outside_limits, too_fast, pulses_unarmed, estop_ignored;
    uint64_t armed_ticks, faults;
} figures_t;

static uint64_t random_state;

static uint32_t any(uint32_t below)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return (uint32_t)((random_state >> 16) % below);
}

static void check_outputs(const bench_t *bench, const uint32_t *last, uint64_t elapsed_us, figures_t *figures)
{
    for (int i = 0; i < HPAC_SERVOS; i++) {
        const hpac_servo_t *servo = &bench->hand.config.servo[i];
        uint32_t pulse = bench->pulses[i];
        if (pulse == 0u) {
            continue;
        }
        bool armed = bench->hand.state == HPAC_STATE_ARMED || bench->hand.state == HPAC_STATE_FAULT;
        figures->pulses_unarmed += armed ? 0u : 1u;
        figures->outside_limits += pulse < hpac_servo_pulse(servo, servo->min_urad)
                                   || pulse > hpac_servo_pulse(servo, servo->max_urad);
        if (last[i] != 0u) {
            uint64_t step_ns = pulse > last[i] ? pulse - last[i] : last[i] - pulse;
            uint64_t rate_ns_s = (uint64_t)servo->rate_urad_s * (uint64_t)servo->ns_per_rad / 1000000u;
            figures->too_fast += step_ns > rate_ns_s * elapsed_us / 1000000u * SPEED_PERMILLE / 1000u + 3u;
        }
    }
}

static void tick(bench_t *bench, uint32_t elapsed_us, figures_t *figures)
{
    uint32_t last[HPAC_SERVOS];
    uint8_t ignored[HPAC_TX_CAPACITY];
    memcpy(last, bench->pulses, sizeof last);
    bench->now_us += elapsed_us;
    bool was_fault = bench->hand.state == HPAC_STATE_FAULT;
    hpac_hand_tick(&bench->hand, bench->now_us, bench->pulses);
    hpac_hand_transmit(&bench->hand, ignored, sizeof ignored);
    check_outputs(bench, last, elapsed_us, figures);
    figures->armed_ticks += bench->hand.state == HPAC_STATE_ARMED;
    figures->faults += !was_fault && bench->hand.state == HPAC_STATE_FAULT;
}

/* Feed, then look at the outputs without letting time pass. */
static void feed(bench_t *bench, const uint8_t *bytes, size_t length, figures_t *figures)
{
    hpac_hand_receive(&bench->hand, bench->now_us, bytes, length);
    tick(bench, 0, figures);
}

static size_t random_payload(uint8_t *payload, uint8_t type)
{
    switch (type) {
    case HPAC_ARM:
        hpac_put_u32(payload, any(20) != 0u ? HPAC_LIMITS_HASH : any(UINT32_MAX));
        payload[HPAC_ARM_AT_ACTION] = (uint8_t)any(any(10) != 0u ? 3u : 256u);
        return HPAC_ARM_LENGTH;
    case HPAC_MOVE:
        hpac_put_u16(payload, (uint16_t)any(any(4) != 0u ? 600u : 65536u));
        for (int i = 0; i < HPAC_SERVOS; i++) {
            hpac_put_u16(payload + 2 + 2 * i, (uint16_t)any(any(50) != 0u ? 13500u : 65536u));
        }
        return HPAC_MOVE_LENGTH;
    case HPAC_STATUS:
        hpac_put_u16(payload, (uint16_t)any(200));
        return HPAC_STATUS_LENGTH;
    default:
        return 0;
    }
}

static size_t random_frame(bench_t *bench, uint8_t *wire, uint8_t *type)
{
    static const uint8_t types[] = { HPAC_HELLO, HPAC_ARM, HPAC_ARM, HPAC_CLEAR, HPAC_HEARTBEAT, HPAC_STATUS, HPAC_ESTOP };
    uint8_t payload[64];
    *type = any(3) != 0u ? HPAC_MOVE : types[any(any(30) != 0u ? 6 : 7)];
    if (*type == HPAC_CLEAR && bench->hand.state == HPAC_STATE_ARMED && any(10) != 0u) {
        *type = HPAC_HEARTBEAT;
    }
    if (*type == HPAC_HELLO && any(10) != 0u) {
        *type = HPAC_MOVE;
    }
    if (any(500) == 0u) {
        *type = (uint8_t)any(256);
    }
    size_t length = random_payload(payload, *type);
    uint8_t flags = (uint8_t)(any(30) != 0u ? any(4) & (*type == HPAC_MOVE ? 3u : 0u) : any(256));
    bench->seq = (uint16_t)(any(30) != 0u ? bench->seq + 1u : any(65536));
    uint8_t version = (uint8_t)(any(200) != 0u ? HPAC_VERSION : any(256));
    return bench_frame(wire, version, *type, bench->seq, flags, payload, length);
}

static void damaged_frame(bench_t *bench, figures_t *figures)
{
    uint8_t wire[128];
    uint8_t original[128];
    uint8_t type;
    size_t length = random_frame(bench, wire, &type);
    memcpy(original, wire, length);
    for (uint32_t flips = 1u + any(6); flips > 0u; flips--) {
        uint32_t bit = 8u + any((uint32_t)(8u * (length - 2u)));
        wire[bit / 8u] = (uint8_t)(wire[bit / 8u] ^ (1u << (bit % 8u)));
    }
    if (memcmp(original, wire, length) == 0) {
        return; /* the flips cancelled out */
    }
    uint32_t before = bench->hand.count.accepted;
    uint16_t refused = bench->hand.count.refused;
    feed(bench, wire, length, figures);
    figures->damaged++;
    figures->damaged_accepted += bench->hand.count.accepted != before;
    figures->damaged_accepted += bench->hand.count.refused != refused && refused != UINT16_MAX;
}

/* Two frames with one byte lost anywhere: at least one of them must come through. */
static void lost_byte(bench_t *bench, figures_t *figures)
{
    uint8_t wire[64];
    size_t length = bench_frame(wire, HPAC_VERSION, HPAC_HEARTBEAT, ++bench->seq, HPAC_FLAG_NO_ACK, NULL, 0);
    length += bench_frame(wire + length, HPAC_VERSION, HPAC_HEARTBEAT, ++bench->seq, HPAC_FLAG_NO_ACK, NULL, 0);
    size_t at = any((uint32_t)length);
    memmove(wire + at, wire + at + 1, length - at - 1u);
    uint32_t before = bench->hand.count.accepted;
    wire[length - 1u] = 0; /* what the next frame would begin with */
    feed(bench, wire, length, figures);
    figures->lost_bytes++;
    figures->frames_lost_beyond_one += bench->hand.count.accepted - before < 1u;
}

static void junk(bench_t *bench, figures_t *figures)
{
    uint8_t bytes[40];
    size_t length = any(sizeof bytes) + 1u;
    for (size_t i = 0; i < length; i++) {
        bytes[i] = (uint8_t)any(256);
    }
    bytes[length - 1u] = 0;
    feed(bench, bytes, length, figures);
}

static void intact_frame(bench_t *bench, figures_t *figures)
{
    uint8_t wire[128];
    uint8_t type;
    uint32_t before = bench->hand.count.accepted;
    size_t length = random_frame(bench, wire, &type);
    size_t cut = any(length > 1u ? (uint32_t)length : 1u);
    hpac_hand_receive(&bench->hand, bench->now_us, wire, cut); /* in two pieces */
    feed(bench, wire + cut, length - cut, figures);
    bool accepted = bench->hand.count.accepted != before;
    figures->accepted += accepted;
    figures->refused += !accepted;
    figures->estop_ignored += type == HPAC_ESTOP && accepted && !bench_silent(bench);
}

static void step(bench_t *bench, bool mostly_damaged, figures_t *figures)
{
    uint32_t kind = mostly_damaged && any(50) != 0u ? 14u : any(20);
    if (kind < 14u) {
        intact_frame(bench, figures);
    } else if (kind < 18u) {
        damaged_frame(bench, figures);
    } else if (kind == 18u) {
        lost_byte(bench, figures);
    } else {
        junk(bench, figures);
    }
    figures->frames++;
    tick(bench, any(1000) != 0u ? any(20000) : any(700000), figures);
}

int main(int count, char **arguments)
{
    uint64_t frames = count > 1 ? strtoull(arguments[1], NULL, 10) : 100000u;
    random_state = count > 2 ? strtoull(arguments[2], NULL, 10) * 2u + 1u : 1u;
    bool mostly_damaged = count > 3 && strcmp(arguments[3], "damaged") == 0;
    figures_t figures = { 0 };
    bench_t bench;
    bench_start(&bench);
    hpac_config_default(&bench.hand.config); /* the promises are those of the real table */
    for (int i = 0; i < 20; i++) {
        any(2); /* leave the small seeds behind */
    }
    while (figures.frames < frames) {
        step(&bench, mostly_damaged, &figures);
        if (figures.frames % 100000u == 0u) { /* 16-bit counters stay at their largest: start again with the same state */
            memset(&bench.hand.count, 0, sizeof bench.hand.count);
            memset(bench.hand.heat, 0, sizeof bench.hand.heat);
        }
    }
    printf("frames %" PRIu64 "\naccepted %" PRIu64 "\nrefused %" PRIu64 "\n", figures.frames, figures.accepted, figures.refused);
    printf("armed_ticks %" PRIu64 "\nfaults %" PRIu64 "\n", figures.armed_ticks, figures.faults);
    printf("damaged %" PRIu64 "\ndamaged_accepted %" PRIu64 "\n", figures.damaged, figures.damaged_accepted);
    printf("lost_bytes %" PRIu64 "\nframes_lost_beyond_one %" PRIu64 "\n", figures.lost_bytes, figures.frames_lost_beyond_one);
    printf("outside_limits %" PRIu64 "\ntoo_fast %" PRIu64 "\n", figures.outside_limits, figures.too_fast);
    printf("pulses_unarmed %" PRIu64 "\nestop_ignored %" PRIu64 "\n", figures.pulses_unarmed, figures.estop_ignored);
    uint64_t broken = figures.damaged_accepted + figures.frames_lost_beyond_one + figures.outside_limits + figures.too_fast
                      + figures.pulses_unarmed + figures.estop_ignored;
    return broken == 0u && figures.accepted > 0u && figures.armed_ticks > 0u ? 0 : 1;
}
