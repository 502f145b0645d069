/* The hand: one state machine between received bytes and six pulse widths.
 *
 * The caller owns the struct and the clock. It calls hpac_hand_receive() with what came in, hpac_hand_tick() at 50 Hz
 * or faster, puts the six widths on the pins, and sends what hpac_hand_transmit() gives. No call blocks, allocates or
 * keeps a pointer. States and transitions are drawn in firmware/README.md. */
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
    hpac_config_t config;
    hpac_rx_t rx;
    hpac_ramp_t ramp;
    hpac_counters_t count;
    uint64_t now_us;   /* latest time seen; never goes back */
    uint64_t heard_us; /* last accepted frame */
    uint64_t armed_us;
    uint64_t load_us;   /* the load estimate stands here */
    uint64_t status_us; /* last periodic STATUS */
    uint32_t status_period_us;
    uint32_t heat[HPAC_SERVOS];
    uint32_t last_move_crc;
    uint16_t last_seq; /* of the last accepted MOVE, if any_move */
    uint16_t boot_count;
    uint8_t state;  /* hpac_state_t */
    uint8_t fault;  /* hpac_fault_t */
    uint8_t action; /* hpac_action_t */
    uint8_t reset;  /* hpac_reset_t */
    uint8_t attached; /* bit i: servo i gets pulses */
    bool any_move;
    bool relaxing; /* the relax action runs; pulses stop at its end */
    bool usable;   /* the servo table passed hpac_servo_usable() */
    bool started;  /* a time has been seen */
    uint8_t tx[HPAC_TX_CAPACITY];
    uint16_t tx_start;
    uint16_t tx_length;
} hpac_hand_t;

/* The servo table that was generated from the hand's parameters, without trims. */
void hpac_config_default(hpac_config_t *config);

/* Start in BOOT, without pulses. After a brown-out or a crash, or with an unusable servo table, start in FAULT.
 * `config` is copied. */
void hpac_hand_init(hpac_hand_t *hand, const hpac_config_t *config, hpac_reset_t reset, uint16_t boot_count);

/* Take in bytes from the host, any bytes. Every intact frame is carried out whole or refused whole, and answered. Read
 * the clock after the bytes: with an older time a move seems to come before the one before it has ended. */
void hpac_hand_receive(hpac_hand_t *hand, uint64_t now_us, const uint8_t *bytes, size_t length);

/* Advance to `now_us` and write the six pulse widths [ns]; 0 is no pulse. A time before the last one counts as it. */
void hpac_hand_tick(hpac_hand_t *hand, uint64_t now_us, uint32_t pulses[HPAC_SERVOS]);

/* Move up to `capacity` bytes of answers to `out`. Returns how many. */
size_t hpac_hand_transmit(hpac_hand_t *hand, uint8_t *out, size_t capacity);

#endif
