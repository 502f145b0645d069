/* A second opinion on the hand: what docs/wire.md and firmware/README.md say that it does, written without the core.
 *
 * It has its own codec, its own servo table, its own arithmetic (floating point) and its own clock. It is told what went
 * into the hand and what came out, predicts every answer and every pulse, and says what differs. */
#ifndef ORACLE_H
#define ORACLE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define ORACLE_SERVOS 6

typedef struct {
    double min, max, rest, centre; /* urad */
    double rate;                   /* urad/s */
    double ns_per_rad, centre_ns, trim_ns;
    int direction;
    bool holds_unpowered;
} oracle_servo_t;

/* What holds whatever happens inside: every pulse is one that the table has, and none is further from the last one than
 * the slew limit lets it come. */
typedef struct {
    oracle_servo_t table[ORACLE_SERVOS];
    uint32_t last[ORACLE_SERVOS];  /* ns, as long as pulses go on */
    double credit[ORACLE_SERVOS]; /* urad */
    uint64_t last_us;
    bool seen;
    unsigned long outside, fast; /* how often */
    char broken[160]; /* the first thing that was wrong, or empty */
} oracle_guard_t;

typedef struct {
    bool minimum_jerk;
    int64_t elapsed_us, duration_us;
    int64_t late_us; /* the hand may have begun it so much later */
    double doubt, speed_doubt; /* how far roundings may lead, those of the moves that it pre-empted included [urad, urad/s] */
    double from[ORACLE_SERVOS], speed[ORACLE_SERVOS], to[ORACLE_SERVOS];
} oracle_ramp_t;

typedef struct {
    uint8_t bytes[64];
    size_t length;
    bool overrun;
} oracle_decoder_t;

typedef struct {
    oracle_guard_t guard;
    oracle_decoder_t host;
    oracle_ramp_t ramp;
    uint8_t answers[24][64]; /* frames of this call, decoded; the first byte is the length */
    unsigned answers_heard, answers_expected;
    uint64_t safe_until_us; /* when the hold or the relax that runs is over */
    uint64_t now_us, heard_us, load_us, status_us;
    int64_t status_period_us, step_us, behind_us, supply_low_us;
    int64_t passed_us;                      /* the time that motions have taken up */
    int64_t start_from_us, start_until_us;  /* in it, when the next servo starts: between these */
    int64_t due_from_us, due_until_us, chance_us; /* when it may have started first */
    uint8_t due;            /* the servo that starts about now, counted from 1 */
    const uint32_t *pulses; /* of this call, or NULL */
    double heat[ORACLE_SERVOS];    /* permille squared */
    double pose[ORACLE_SERVOS];    /* at the last tick, urad */
    double stood[ORACLE_SERVOS];   /* when it was armed, urad */
    double stood_doubt;
    double credit[ORACLE_SERVOS];  /* urad */
    uint32_t session, last_crc, accepted;
    unsigned refused, bad_crc, bad_frame, bad_version, overrun, trips;
    uint16_t last_seq;
    unsigned watchdog_ms, supply_mv, boot_count;
    uint8_t state, fault, action, reset, attached, placed;
    bool any_move, repeatable, starting, holding, relaxing, estop_pressed, started, in_doubt;
    unsigned long moves, refusals, arms, faults; /* what was tried */
} oracle_t;

/* The table of the hand as built; `rate` in rad/s, since tests also use a faster one. */
void oracle_table(oracle_servo_t table[ORACLE_SERVOS], double rate);

/* A hand that has just started: `reset` as on the wire. */
void oracle_start(oracle_t *oracle, const oracle_servo_t table[ORACLE_SERVOS], uint8_t reset, unsigned boot_count);

/* One call of the hand: what it was given at `now_us`, and what it said. `pulses` are NULL for a call that only received.
 * False, with oracle->guard.broken saying why, once something differs. */
bool oracle_judge(oracle_t *oracle, uint64_t now_us, const uint8_t *bytes, size_t length, const uint8_t *answers,
                  size_t answers_length, const uint32_t *pulses);

/* The guard alone, for a hand whose inside has been tampered with. */
void oracle_guard_start(oracle_guard_t *guard, const oracle_servo_t table[ORACLE_SERVOS]);
bool oracle_guard(oracle_guard_t *guard, uint64_t now_us, const uint32_t pulses[ORACLE_SERVOS]);

/* The codec: encode a frame between zero bytes, decode what stood between two of them. Lengths, 0 if it is no frame. */
size_t oracle_encode(uint8_t *wire, uint8_t version, uint8_t type, uint16_t seq, uint8_t flags, const uint8_t *payload, size_t length);
typedef enum { ORACLE_INTACT, ORACLE_NOT_COBS, ORACLE_TOO_SHORT, ORACLE_DAMAGED } oracle_verdict_t;
oracle_verdict_t oracle_decode(const uint8_t *encoded, size_t length, uint8_t *frame, size_t *frame_length);

/* The limits hash of a table. */
uint32_t oracle_hash(const oracle_servo_t table[ORACLE_SERVOS]);

#endif
