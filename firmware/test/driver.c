/* A hostile host: frames good, absurd, damaged, cut, of other sessions and versions, silences, streams at the rate limit and
 * late ticks. The oracle (oracle.h) judges every call.
 *
 *   hpac_driver FRAMES SEED [damaged] [tampered]   prints one line "name value" a figure; exits with 1 if anything was wrong.
 *
 * With `damaged` nearly all frames are damaged ones. `tampered` is the negative control: pulses are changed on their way to
 * the oracle, damaged frames are mended and whole frames lost on their way to the hand, and the figures must tell. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "hpac_hand.h"
#include "oracle.h"

#define SESSION 0x51e55107u

typedef struct {
    hpac_hand_t hand;
    hpac_config_t config;
    oracle_t oracle;
    uint64_t now_us;
    uint32_t pulses[HPAC_SERVOS];
    uint16_t seq;
    uint8_t last_move[64]; /* on the wire, to be said again */
    size_t last_move_length;
    bool heard_estop;
} run_t;

typedef struct {
    uint64_t frames, damaged, damaged_accepted, lost_bytes, frames_lost_beyond_one;
    uint64_t pulses_unarmed, estop_ignored, armed_ticks, hands, broken;
    uint64_t outside, fast, accepted, refused, moves, arms, faults;
} figures_t;

/* What the host is up to: a program at work, one that streams as fast as it may, anybody, nobody, a bad line. */
typedef enum { WORKING, STREAMING, ANYTHING, SILENT, NOISE, MOODS } mood_t;

static bool tampered;
static uint64_t random_state;
static figures_t figures;

static uint32_t any(uint32_t below)
{
    random_state ^= random_state << 13;
    random_state ^= random_state >> 7;
    random_state ^= random_state << 17;
    return (uint32_t)((random_state >> 16) % below);
}

static void judge(run_t *run, const uint8_t *bytes, size_t length, const uint32_t *pulses)
{
    uint8_t answers[HPAC_TX_CAPACITY];
    size_t answered = hpac_hand_transmit(&run->hand, answers, sizeof answers);
    oracle_judge(&run->oracle, run->now_us, bytes, length, answers, answered, pulses);
}

/* Let time pass and look at the pins. */
static void tick(run_t *run, uint32_t elapsed_us)
{
    run->now_us += elapsed_us;
    hpac_hand_tick(&run->hand, &run->config, run->now_us, run->pulses);
    run->pulses[0] += tampered && run->pulses[0] != 0u && any(50) == 0u ? 500000u : 0u;
    judge(run, NULL, 0, run->pulses);
    for (int i = 0; i < HPAC_SERVOS; i++) {
        bool powered = hpac_hand_powered(&run->hand);
        figures.pulses_unarmed += run->pulses[i] != 0u && !powered;
        figures.estop_ignored += run->pulses[i] != 0u && run->heard_estop;
    }
    run->heard_estop = false;
    figures.armed_ticks += run->oracle.state == 2u;
}

/* Bytes come at any time, not just after a tick; but while servos start, whose moments the oracle knows to some microseconds
 * only, the pins are looked at first. */
static void feed(run_t *run, const uint8_t *bytes, size_t length)
{
    uint32_t elapsed_us = any(2) * any(1500);
    if (run->oracle.starting) {
        tick(run, elapsed_us);
    } else {
        run->now_us += elapsed_us;
    }
    hpac_hand_receive(&run->hand, &run->config, run->now_us, bytes, length);
    judge(run, bytes, length, NULL);
}

static void put(uint8_t *at, uint32_t value, unsigned bytes)
{
    for (unsigned i = 0; i < bytes; i++) {
        at[i] = (uint8_t)(value >> (8u * i));
    }
}

static size_t frame_of(run_t *run, uint8_t *wire, uint8_t type, uint8_t flags, const uint8_t *payload, size_t length)
{
    return oracle_encode(wire, 2, type, ++run->seq, flags, payload, length);
}

static void say(run_t *run, uint8_t type, uint8_t flags, const uint8_t *payload, size_t length)
{
    uint8_t wire[128];
    size_t size = frame_of(run, wire, type, flags, payload, length);
    feed(run, wire, size);
    figures.frames++;
    if (type == 3u) {
        memcpy(run->last_move, wire, size);
        run->last_move_length = size;
    }
    run->heard_estop = run->heard_estop || type == 5u;
}

static void say_session(run_t *run, uint8_t type)
{
    uint8_t payload[4];
    put(payload, SESSION, 4);
    say(run, type, 0, payload, sizeof payload);
}

static void say_arm(run_t *run)
{
    uint8_t payload[11];
    put(payload, SESSION, 4);
    put(payload + 4, oracle_hash(run->oracle.guard.table), 4);
    put(payload + 8, any(3) == 0u ? 100u + any(1901) : 400u, 2);
    payload[10] = (uint8_t)any(3);
    say(run, 2, 0, payload, sizeof payload);
}

/* A move of `ms` to somewhere near `share_permille` of what the rate limit allows, from where the oracle takes the hand to
 * be at its end. */
static void say_move(run_t *run, uint32_t ms, uint32_t share_permille, uint8_t flags)
{
    uint8_t payload[18];
    put(payload, SESSION, 4);
    put(payload + 4, ms, 2);
    for (int i = 0; i < HPAC_SERVOS; i++) {
        const oracle_servo_t *s = &run->oracle.guard.table[i];
        double reach = s->rate * ms * 1e-3 * share_permille * 1e-3;
        double to = run->oracle.pose[i] + (any(2) != 0u ? reach : -reach);
        to = to < s->min || to > s->max ? 2 * run->oracle.pose[i] - to : to;
        to = to < s->min ? s->min : to > s->max ? s->max : to;
        put(payload + 6 + 2 * i, (uint32_t)(int32_t)(to / 100 + 0.5), 2);
    }
    say(run, 3, flags, payload, sizeof payload);
}

static void work(run_t *run)
{
    oracle_t *o = &run->oracle;
    if (o->session != SESSION) {
        say_session(run, 1);
    } else if (o->state == 3u) {
        say_session(run, any(20) == 0u ? 1u : 6u);
    } else if (o->state < 2u) {
        say_arm(run);
    } else if (o->starting || any(8) == 0u) {
        say_session(run, 4);
    } else if (any(40) == 0u) {
        say_session(run, 6);
    } else if (any(20) == 0u && run->last_move_length > 0u) {
        feed(run, run->last_move, run->last_move_length);
    } else {
        uint8_t flags = (uint8_t)any(4);
        say_move(run, 10u + any(500), (flags & 1u) != 0u ? any(540) : any(1005), flags);
    }
}

static size_t random_payload(run_t *run, uint8_t *payload, uint8_t type)
{
    static const uint8_t lengths[8] = { 0, 4, 11, 18, 4, 0, 4, 2 };
    size_t length = type < 8u ? lengths[type] : any(60);
    if (any(60) == 0u) {
        length = any(60);
    }
    for (size_t i = 0; i < length; i++) {
        payload[i] = (uint8_t)any(any(3) != 0u ? 256u : 2u);
    }
    if (length >= 4u && type != 7u && any(30) != 0u) {
        put(payload, any(30) != 0u ? SESSION : any(3), 4);
    }
    if (type == 2u && length == 11u) {
        put(payload + 4, any(20) != 0u ? oracle_hash(run->oracle.guard.table) : any(UINT32_MAX), 4);
        put(payload + 8, any(20) != 0u ? 98u + any(1905) : any(65536), 2);
        payload[10] = (uint8_t)any(any(10) != 0u ? 3u : 256u);
    } else if (type == 3u && length == 18u) {
        put(payload + 4, any(4) != 0u ? 8u + any(1200) : any(65536), 2);
        for (int i = 0; i < HPAC_SERVOS; i++) {
            put(payload + 6 + 2 * i, any(50) != 0u ? any(13600) : any(65536), 2);
        }
    } else if (type == 7u && length == 2u) {
        put(payload, any(200), 2);
    }
    return length;
}

static size_t random_frame(run_t *run, uint8_t *wire, uint8_t *type)
{
    static const uint8_t types[] = { 1, 2, 2, 6, 4, 4, 7, 3 };
    uint8_t payload[64];
    *type = any(3) != 0u ? 3u : any(20) != 0u ? types[any(8)] : 5u;
    if (any(300) == 0u) {
        *type = (uint8_t)any(256);
    }
    size_t length = random_payload(run, payload, *type);
    uint8_t flags = (uint8_t)(any(20) != 0u ? (*type == 3u ? any(4) : *type == 4u ? any(2) * 2u : 0u) : any(256));
    run->seq = (uint16_t)(any(30) != 0u ? run->seq + 1u : any(65536));
    return oracle_encode(wire, (uint8_t)(any(100) != 0u ? 2u : any(256)), *type, run->seq, flags, payload, length);
}

static void anything(run_t *run)
{
    uint8_t wire[128];
    uint8_t type;
    size_t length = random_frame(run, wire, &type);
    size_t cut = any((uint32_t)length);
    feed(run, wire, cut); /* in two pieces */
    if (any(50) == 0u) {
        tick(run, any(2000));
    }
    feed(run, wire + cut, length - cut);
    run->heard_estop = run->heard_estop || (type == 5u && length <= HPAC_FRAME_MAX + 3u);
    figures.frames++;
}

static void damaged(run_t *run)
{
    uint8_t wire[128];
    uint8_t original[128];
    uint8_t type;
    size_t length = random_frame(run, wire, &type);
    memcpy(original, wire, length);
    for (uint32_t flips = 1u + any(6); flips > 0u; flips--) {
        uint32_t bit = 8u + any((uint32_t)(8u * (length - 2u)));
        wire[bit / 8u] = (uint8_t)(wire[bit / 8u] ^ (1u << (bit % 8u)));
    }
    if (memcmp(original, wire, length) == 0) {
        return; /* the flips cancelled out */
    }
    hpac_counters_t before = run->hand.count;
    feed(run, tampered ? original : wire, length);
    figures.damaged++;
    figures.frames++;
    figures.damaged_accepted += run->hand.count.accepted != before.accepted || run->hand.count.refused != before.refused
                                || run->hand.count.bad_version != before.bad_version;
}

/* Two frames with one byte lost anywhere: at least one of them must come through. */
static void lost_byte(run_t *run)
{
    uint8_t wire[64];
    const uint8_t now[2] = { 0 };
    size_t length = frame_of(run, wire, 7, 0, now, sizeof now);
    length += frame_of(run, wire + length, 7, 0, now, sizeof now);
    size_t at = any((uint32_t)length);
    memmove(wire + at, wire + at + 1, length - at - 1u);
    uint32_t before = run->hand.count.accepted;
    wire[length - 1u] = 0; /* what the next frame would begin with */
    feed(run, wire, tampered ? 1u : length);
    figures.lost_bytes++;
    figures.frames++;
    figures.frames_lost_beyond_one += run->hand.count.accepted - before < 1u;
}

static void junk(run_t *run)
{
    uint8_t bytes[90];
    size_t length = any(sizeof bytes) + 1u;
    for (size_t i = 0; i < length; i++) {
        bytes[i] = (uint8_t)any(256);
    }
    bytes[length - 1u] = 0;
    feed(run, bytes, length);
    figures.frames++;
}

static uint32_t pause_us(void)
{
    uint32_t kind = any(200);
    return kind == 0u ? any(400000) : kind < 4u ? any(60000) : kind < 100u ? any(2000) : any(20001);
}

static void step(run_t *run, mood_t mood)
{
    switch (mood) {
    case WORKING:
        work(run);
        break;
    case STREAMING: /* short moves, back to back, a little too fast for ever */
        if (run->oracle.state == 2u && !run->oracle.starting) {
            uint32_t ms = 10u + any(3) * 5u;
            say_move(run, ms, 1000u + any(120), 2);
            tick(run, 1000u * ms - any(1000));
            return;
        }
        work(run);
        break;
    case ANYTHING:
        anything(run);
        break;
    case SILENT:
        tick(run, any(4) != 0u ? 20000u : any(20000));
        return;
    default:
        if (any(10) != 0u) {
            damaged(run);
        } else if (any(3) != 0u) {
            lost_byte(run);
        } else {
            junk(run);
        }
        break;
    }
    if (any(400) == 0u || (any(20) == 0u && run->oracle.estop_pressed)) {
        run->oracle.estop_pressed = any(4) == 0u;
        run->oracle.supply_mv = any(2) == 0u ? 0u : 4400u + any(1600);
        hpac_hand_inputs(&run->hand, run->oracle.estop_pressed, (uint16_t)run->oracle.supply_mv);
    }
    if (any(20000) == 0u && run->now_us > 1000000u) {
        run->now_us -= any(2) == 0u ? 100000u : 100001u + any(800000);
    }
    for (uint32_t ticks = any(3); ticks > 0u; ticks--) {
        tick(run, pause_us());
    }
    tick(run, pause_us());
}

static void start(run_t *run)
{
    static const uint64_t starts[] = { 0, 1000000, (1ull << 32) - 3000000, 4294967296000ull - 3000000, 1ull << 40 };
    static const hpac_reset_t resets[] = { HPAC_RESET_POWER_ON, HPAC_RESET_POWER_ON, HPAC_RESET_BROWNOUT, HPAC_RESET_CRASH };
    oracle_servo_t table[ORACLE_SERVOS];
    hpac_reset_t reset = resets[any(4)];
    memset(run, 0, sizeof *run);
    run->now_us = starts[any(5)];
    hpac_config_default(&run->config);
    oracle_table(table, 2.0);
    for (int i = 0; i < HPAC_SERVOS && any(2) == 0u; i++) { /* another copy of the hand */
        int32_t trim_ns = (int32_t)any(40001) - 20000;
        int32_t direction = any(2) == 0u ? 1 : -1;
        run->config.servo[i].trim_ns = trim_ns;
        run->config.servo[i].direction = direction;
        table[i].trim_ns = trim_ns;
        table[i].direction = direction;
    }
    bool holds = any(2) == 0u;
    for (int i = 0; i < HPAC_SERVOS; i++) {
        run->config.servo[i].holds_unpowered = holds;
        table[i].holds_unpowered = holds;
    }
    if (any(4) == 0u) { /* another hand: servos that rest in the middle of their ranges */
        for (int i = 0; i < HPAC_SERVOS; i++) {
            run->config.servo[i].min_urad = 10000 * i;
            run->config.servo[i].rest_urad = 400000 + 50000 * i;
            table[i].min = 10000 * i;
            table[i].rest = 400000 + 50000 * i;
        }
    }
    hpac_hand_init(&run->hand, &run->config, reset, 7, NULL);
    oracle_start(&run->oracle, table, (uint8_t)reset, 7);
    tick(run, 0);
    if (any(2) == 0u) {
        const uint8_t look[4] = { 0 };
        say(run, 1, 0, look, sizeof look);
    }
    figures.hands++;
}

static void end(run_t *run)
{
    const oracle_t *o = &run->oracle;
    figures.accepted += o->accepted;
    figures.refused += o->refusals;
    figures.moves += o->moves;
    figures.arms += o->arms;
    figures.faults += o->faults;
    figures.outside += o->guard.outside;
    figures.fast += o->guard.fast;
    if (o->guard.broken[0] != '\0') {
        figures.broken++;
        fprintf(stderr, "hpac_driver: hand %" PRIu64 " at %" PRIu64 " us: %s\n", figures.hands, run->now_us, o->guard.broken);
    }
}

static void one_hand(uint64_t frames, bool mostly_damaged)
{
    static const uint8_t moods[] = { WORKING, WORKING, WORKING, STREAMING, ANYTHING, ANYTHING, SILENT, NOISE };
    run_t run;
    uint64_t most = figures.frames + 3000u;
    start(&run);
    for (uint32_t steps = any(3) == 0u ? any(40) : 0u; steps > 0u; steps--) {
        step(&run, ANYTHING); /* before anybody has said HELLO */
    }
    while (figures.frames < frames && figures.frames < most && run.oracle.guard.broken[0] == '\0') {
        mood_t mood = mostly_damaged && any(20) != 0u ? NOISE : (mood_t)moods[any(8)];
        uint32_t steps = mood == SILENT && any(6) == 0u ? 1900u : 1u + any(250);
        for (; steps > 0u && figures.frames < frames && run.oracle.guard.broken[0] == '\0'; steps--) {
            step(&run, mood);
            figures.frames += mood == SILENT && steps == 1u; /* a host that never speaks ends, too */
        }
    }
    end(&run);
}

int main(int count, char **arguments)
{
    uint64_t frames = count > 1 ? strtoull(arguments[1], NULL, 10) : 100000u;
    random_state = count > 2 ? strtoull(arguments[2], NULL, 10) * 2u + 1u : 1u;
    bool mostly_damaged = count > 3 && strcmp(arguments[3], "damaged") == 0;
    tampered = count > 3 && strcmp(arguments[count - 1], "tampered") == 0;
    for (int i = 0; i < 20; i++) {
        any(2); /* leave the small seeds behind */
    }
    while (figures.frames < frames && figures.broken < 5u) {
        one_hand(frames, mostly_damaged);
    }
    printf("frames %" PRIu64 "\naccepted %" PRIu64 "\nrefused %" PRIu64 "\n", figures.frames, figures.accepted, figures.refused);
    printf("hands %" PRIu64 "\narms %" PRIu64 "\nmoves %" PRIu64 "\n", figures.hands, figures.arms, figures.moves);
    printf("armed_ticks %" PRIu64 "\nfaults %" PRIu64 "\n", figures.armed_ticks, figures.faults);
    printf("damaged %" PRIu64 "\ndamaged_accepted %" PRIu64 "\n", figures.damaged, figures.damaged_accepted);
    printf("lost_bytes %" PRIu64 "\nframes_lost_beyond_one %" PRIu64 "\n", figures.lost_bytes, figures.frames_lost_beyond_one);
    printf("outside_limits %" PRIu64 "\ntoo_fast %" PRIu64 "\n", figures.outside, figures.fast);
    printf("pulses_unarmed %" PRIu64 "\nestop_ignored %" PRIu64 "\n", figures.pulses_unarmed, figures.estop_ignored);
    printf("broken %" PRIu64 "\n", figures.broken);
    uint64_t broken = figures.damaged_accepted + figures.frames_lost_beyond_one + figures.outside + figures.fast
                      + figures.pulses_unarmed + figures.estop_ignored + figures.broken;
    return broken == 0u && figures.accepted > 0u && (figures.moves > 0u || mostly_damaged) ? 0 : 1;
}
