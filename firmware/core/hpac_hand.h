/* The hand: one state machine between received bytes and six pulse widths.
 *
 * The caller owns the struct, the servo table and the clock. It calls hpac_hand_receive() with what came in,
 * hpac_hand_tick() at 50 Hz or faster, puts the six widths on the pins, and sends what hpac_hand_transmit() gives. No call
 * blocks or allocates. The servo table belongs into flash: it is passed with every call, so that no bit in RAM stands for
 * it. States and transitions are drawn in firmware/README.md. */
#ifndef HPAC_HAND_H
#define HPAC_HAND_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "hpac_frame.h"
#include "hpac_protocol.h"
#include "hpac_ramp.h"
#include "hpac_servo.h"

/* Answers wait here until the board sends them; a full queue drops whole answers and counts them. */
#define HPAC_TX_CAPACITY 512u

typedef struct {
    hpac_servo_t servo[HPAC_SERVOS];
} hpac_config_t;

/* Since boot. All but `accepted` stay at their largest value once they reach it. */
typedef struct {
    uint32_t accepted;       /* frames that were carried out; wraps */
    uint16_t refused;        /* intact frames that were not */
    uint16_t bad_crc;        /* damaged frames */
    uint16_t bad_frame;      /* not COBS, too short, or a device's message */
    uint16_t bad_version;    /* intact frames of another version */
    uint16_t overrun;        /* longer than any frame */
    uint16_t dropped;        /* answers that found the queue full */
    uint16_t watchdog_trips; /* times the host fell silent while armed */
} hpac_counters_t;

typedef struct {
    const hpac_config_t *config; /* what the present call was given */
    hpac_rx_t rx;
    hpac_ramp_t ramp;
    hpac_counters_t count;
    uint64_t now_us;   /* latest time seen */
    uint64_t not_now_us; /* its complement: nothing else would show that a bit of it has turned, and motions follow it */
    uint64_t heard_us; /* last accepted frame of the session */
    uint64_t load_us;   /* the load estimate stands here */
    uint64_t status_us; /* last periodic STATUS */
    uint64_t safe_until_us; /* when the hold or the relax that runs is over, finished or not */
    uint32_t status_period_us;
    uint32_t step_us;       /* how far motions have gone on since the last output */
    uint32_t behind_us;     /* how much of the present motion's time late calls have held back */
    uint32_t start_left_us; /* until the next servo starts */
    uint32_t supply_low_us; /* for how long the servo supply has been too low */
    uint32_t heat[HPAC_SERVOS];
    int32_t pose[HPAC_SERVOS]; /* commanded angles of the last output [urad] */
    int32_t credit_nrad[HPAC_SERVOS]; /* of the rate limit, after the last output */
    uint32_t session; /* the nonce of the last HELLO; 0 before the first */
    uint32_t last_move_crc;
    uint16_t last_seq; /* of the last accepted MOVE, if any_move */
    uint16_t boot_count;
    uint16_t watchdog_ms;
    uint16_t supply_mv;
    uint8_t state;  /* hpac_state_t */
    uint8_t fault;  /* hpac_fault_t */
    uint8_t action; /* hpac_action_t */
    uint8_t reset;  /* hpac_reset_t */
    uint8_t attached; /* bit i: servo i gets pulses */
    uint8_t placed;   /* bit i: servo i has had pulses since power-on, so its angle is not just anywhere */
    bool any_move;
    bool repeatable; /* the last accepted MOVE may come again: neither CLEAR nor a fault came after it */
    bool starting;   /* armed, but not all servos have their pulses or the hand is not at rest yet */
    bool holding;    /* the hold action runs; a relax follows it */
    bool relaxing;   /* the relax action runs; pulses stop at its end */
    bool estop_pressed;
    bool started; /* a time has been seen */
    uint8_t tx[HPAC_TX_CAPACITY];
    uint16_t tx_start;
    uint16_t tx_length;
} hpac_hand_t;

#define HPAC_ALL_SERVOS ((1u << HPAC_SERVOS) - 1u)

/* What may outlive a reset in memory that the reset does not clear. */
typedef struct {
    uint32_t heat[HPAC_SERVOS];
    int32_t pose[HPAC_SERVOS];
    uint32_t placed; /* as in hpac_hand_t */
} hpac_memory_t;

/* The servo table that was generated from the hand's parameters, without trims. */
void hpac_config_default(hpac_config_t *config);

/* Start in BOOT, without pulses, at the rest pose. After a brown-out or a crash, or with an unusable servo table, start
 * in FAULT. `memory` is what hpac_hand_remember() gave before the reset, or NULL after power-on. */
void hpac_hand_init(hpac_hand_t *hand, const hpac_config_t *config, hpac_reset_t reset, uint16_t boot_count,
                    const hpac_memory_t *memory);

/* Tell what the board's other pins say: the e-stop input, which stops the pulses and keeps CLEAR away while it is
 * pressed, and the servo supply before its switch [mV], 0 if no pin measures it. */
void hpac_hand_inputs(hpac_hand_t *hand, bool estop_pressed, uint16_t supply_mv);

/* Take in bytes from the host, any bytes. Every intact frame is carried out whole or refused whole, and answered. Read
 * the clock after the bytes: with an older time a move seems to come before the one before it has ended. */
void hpac_hand_receive(hpac_hand_t *hand, const hpac_config_t *config, uint64_t now_us, const uint8_t *bytes, size_t length);

/* Advance to `now_us` and write the six pulse widths [ns]; 0 is no pulse. A time up to HPAC_CLOCK_BACK_MAX_MS before the
 * last one counts as it, an older one is a broken clock: the fault `internal`. */
void hpac_hand_tick(hpac_hand_t *hand, const hpac_config_t *config, uint64_t now_us, uint32_t pulses[HPAC_SERVOS]);

/* Tell that the widths of the last tick could not be set: the fault `internal`, without pulses. */
void hpac_hand_output_failed(hpac_hand_t *hand);

/* Whether the servo supply is to be on: from ARM, a little before the first pulse, to the last pulse. */
bool hpac_hand_powered(const hpac_hand_t *hand);

/* What to keep for the next start. */
void hpac_hand_remember(const hpac_hand_t *hand, hpac_memory_t *memory);

/* Move up to `capacity` bytes of answers to `out`. Returns how many. */
size_t hpac_hand_transmit(hpac_hand_t *hand, uint8_t *out, size_t capacity);

#endif
