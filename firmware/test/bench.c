#include "bench.h"

#include <string.h>


void bench_config(hpac_config_t *config)
{
    static const int32_t max_urad[HPAC_SERVOS] = { 1356600, 1386000, 1350200, 1360800, 1349700, 1570000 };
    for (int i = 0; i < HPAC_SERVOS; i++) {
        config->servo[i] = (hpac_servo_t){ .max_urad = max_urad[i],
                                           .centre_urad = max_urad[i] / 2,
                                           .rate_urad_s = 4000000,
                                           .ns_per_rad = 636620,
                                           .centre_ns = HPAC_PULSE_CENTRE_NS,
                                           .direction = 1 };
    }
}

void bench_start(bench_t *bench)
{
    static const hpac_memory_t at_rest = { .placed = HPAC_ALL_SERVOS };
    memset(bench, 0, sizeof *bench);
    bench_config(&bench->config);
    hpac_hand_init(&bench->hand, &bench->config, HPAC_RESET_POWER_ON, 1, &at_rest);
    bench->now_us = 1000000;
    bench->session = 0x51e55107u;
    hpac_hand_tick(&bench->hand, &bench->config, bench->now_us, bench->pulses);
}

void bench_idle(bench_t *bench)
{
    bench_start(bench);
    bench_send(bench, HPAC_HELLO, 0, NULL, 0);
}

void bench_armed(bench_t *bench, hpac_action_t action)
{
    bench_idle(bench);
    bench_arm(bench, (uint8_t)action, 0);
    while (bench->hand.starting) {
        bench_run(bench, 10);
        bench_send(bench, HPAC_HEARTBEAT, 0, NULL, 0);
    }
}

size_t bench_frame(uint8_t *wire, uint8_t version, uint8_t type, uint16_t seq, uint8_t flags, const uint8_t *payload,
                   size_t length)
{
    uint8_t frame[HPAC_HEADER_LENGTH + 64 + HPAC_CRC_LENGTH] = { version, type };
    hpac_put_u16(frame + HPAC_AT_SEQ, seq);
    frame[HPAC_AT_FLAGS] = flags;
    if (length > 0u) {
        memcpy(frame + HPAC_HEADER_LENGTH, payload, length);
    }
    size_t body = HPAC_HEADER_LENGTH + length;
    hpac_put_u32(frame + body, hpac_crc32(frame, body));
    size_t code_at = 1;
    size_t at = 2;
    wire[0] = 0;
    for (size_t i = 0; i < body + HPAC_CRC_LENGTH; i++) {
        if (frame[i] == 0u) {
            wire[code_at] = (uint8_t)(at - code_at);
            code_at = at++;
        } else {
            wire[at++] = frame[i];
        }
    }
    wire[code_at] = (uint8_t)(at - code_at);
    wire[at++] = 0;
    return at;
}

static void take_in(bench_t *bench)
{
    uint8_t bytes[HPAC_TX_CAPACITY];
    size_t length = hpac_hand_transmit(&bench->hand, bytes, sizeof bytes);
    hpac_rx_t rx;
    hpac_rx_init(&rx);
    for (size_t i = 0; i < length; i++) {
        if (bytes[i] == 0u && rx.received > 2u) { /* the type is the third byte of our frames: 1st code, version */
            uint8_t type = rx.frame[2];
            if (bench->answer_types[type] < 255u) {
                bench->answer_types[type]++;
            }
        }
        bool whole = hpac_rx_push(&rx, bytes[i]) == HPAC_RX_FRAME;
        const uint8_t *payload = rx.frame + HPAC_HEADER_LENGTH;
        if (whole && rx.frame[HPAC_AT_TYPE] == HPAC_FAULT) {
            bench->fault_servo = payload[HPAC_FAULT_AT_SERVO];
        }
        if (whole && rx.frame[HPAC_AT_TYPE] == HPAC_ACK) {
            bench->acks++;
            bench->acked = payload[HPAC_ACK_AT_ACKED];
            bench->reason = payload[HPAC_ACK_AT_REASON];
            bench->servo = payload[HPAC_ACK_AT_SERVO];
        }
    }
}

void bench_feed(bench_t *bench, const uint8_t *bytes, size_t length)
{
    hpac_hand_receive(&bench->hand, &bench->config, bench->now_us, bytes, length);
    hpac_hand_tick(&bench->hand, &bench->config, bench->now_us, bench->pulses);
    take_in(bench);
}

int bench_send(bench_t *bench, uint8_t type, uint8_t flags, const uint8_t *payload, size_t length)
{
    uint8_t wire[128];
    uint8_t body[64] = { 0 };
    bool tied = type == HPAC_HELLO || type == HPAC_ARM || type == HPAC_MOVE || type == HPAC_HEARTBEAT || type == HPAC_CLEAR;
    if (payload != NULL) {
        memcpy(body, payload, length);
    } else if (tied) {
        length = 4;
    }
    if (tied && length >= 4u) {
        hpac_put_u32(body, bench->session);
    }
    bench->acks = 0;
    memset(bench->answer_types, 0, sizeof bench->answer_types);
    bench_feed(bench, wire, bench_frame(wire, HPAC_VERSION, type, ++bench->seq, flags, body, length));
    return bench->acks > 0 ? bench->reason : -1;
}

int bench_arm(bench_t *bench, uint8_t action, uint32_t wrong_hash)
{
    uint8_t payload[HPAC_ARM_LENGTH];
    hpac_put_u32(payload + HPAC_ARM_AT_LIMITS_HASH, hpac_servo_hash(bench->config.servo) ^ wrong_hash);
    hpac_put_u16(payload + HPAC_ARM_AT_WATCHDOG_MS, BENCH_WATCHDOG_MS);
    payload[HPAC_ARM_AT_ACTION] = action;
    return bench_send(bench, HPAC_ARM, 0, payload, sizeof payload);
}

int bench_move(bench_t *bench, uint8_t flags, uint16_t duration_ms, const int16_t servo[HPAC_SERVOS])
{
    uint8_t payload[HPAC_MOVE_LENGTH];
    hpac_put_u16(payload + HPAC_MOVE_AT_DURATION_MS, duration_ms);
    for (int i = 0; i < HPAC_SERVOS; i++) {
        hpac_put_u16(payload + HPAC_MOVE_AT_SERVO + 2 * i, (uint16_t)servo[i]);
    }
    return bench_send(bench, HPAC_MOVE, flags, payload, sizeof payload);
}

static void pass(bench_t *bench, uint32_t ms)
{
    bench->now_us += 1000u * ms;
    hpac_hand_tick(&bench->hand, &bench->config, bench->now_us, bench->pulses);
    take_in(bench);
}

void bench_run(bench_t *bench, uint32_t ms)
{
    for (uint32_t i = 0; i < ms; i++) {
        pass(bench, 1);
    }
}

void bench_skip(bench_t *bench, uint32_t ms)
{
    for (; ms > 20u; ms -= 20u) {
        pass(bench, 20);
    }
    pass(bench, ms);
}

bool bench_silent(const bench_t *bench)
{
    for (int i = 0; i < HPAC_SERVOS; i++) {
        if (bench->pulses[i] != 0u) {
            return false;
        }
    }
    return true;
}

bool bench_all_pulses(const bench_t *bench)
{
    for (int i = 0; i < HPAC_SERVOS; i++) {
        if (bench->pulses[i] == 0u) {
            return false;
        }
    }
    return true;
}
