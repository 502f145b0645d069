/* A hand on the bench: frames in, the last ACK and six pulses out, time by hand. */
#ifndef BENCH_H
#define BENCH_H

#include "hpac_hand.h"

typedef struct {
    hpac_hand_t hand;
    hpac_config_t config;
    uint64_t now_us;
    uint32_t pulses[HPAC_SERVOS];
    uint16_t seq;
    uint32_t session;                /* of the frames that bench_send() sends */
    int acks;                        /* since bench_send() was called last */
    uint8_t acked, reason, servo;    /* of the last ACK */
    uint8_t fault_servo;             /* of the last FAULT */
    uint8_t answer_types[256];       /* how often each type was answered since bench_send(), up to 255 */
} bench_t;

/* A servo table for tests, which does not change with the hand's parameters: 4 rad/s, six different ranges. */
void bench_config(hpac_config_t *config);

/* A hand just switched on, with that table, whose servos are known to be at rest. */
void bench_start(bench_t *bench);

/* A hand that has been greeted, or armed with all its servos at rest. */
void bench_idle(bench_t *bench);
void bench_armed(bench_t *bench, hpac_action_t action);

/* Send one frame with the next sequence number, its session filled in; without a payload, one of nothing but the
 * session. Returns the ACK's reason, or -1 if none came. */
int bench_send(bench_t *bench, uint8_t type, uint8_t flags, const uint8_t *payload, size_t length);

/* The watchdog that the bench arms with; tests of other periods say so. */
#define BENCH_WATCHDOG_MS 500

/* ARM with the right limits hash and that watchdog; `wrong_hash` flips bits of the hash. */
int bench_arm(bench_t *bench, uint8_t action, uint32_t wrong_hash);

/* MOVE with angles in 1e-4 rad. */
int bench_move(bench_t *bench, uint8_t flags, uint16_t duration_ms, const int16_t servo[HPAC_SERVOS]);

/* Encode a frame of any version, type and sequence; returns its length on the wire. */
size_t bench_frame(uint8_t *wire, uint8_t version, uint8_t type, uint16_t seq, uint8_t flags, const uint8_t *payload,
                   size_t length);

/* Feed raw bytes now, and take in the answers. */
void bench_feed(bench_t *bench, const uint8_t *bytes, size_t length);

/* Let time pass in steps of 1 ms, or in steps of a servo's period. */
void bench_run(bench_t *bench, uint32_t ms);
void bench_skip(bench_t *bench, uint32_t ms);

/* True if no servo, or every servo, gets pulses. */
bool bench_silent(const bench_t *bench);
bool bench_all_pulses(const bench_t *bench);

#endif
