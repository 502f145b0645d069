/* What every board does, over and over: take bytes in, advance the hand, put six widths out, send answers. A board supplies
 * its clock, port, outputs and inputs, none of which may wait; no call here waits either. */
#ifndef HPAC_LOOP_H
#define HPAC_LOOP_H

#include "hpac_hand.h"

/* --- what the board supplies --- */

/* A clock that never goes back [us]. */
uint64_t board_clock_us(void);

/* Take what has come in, up to `capacity` bytes. Returns how many. */
size_t board_read(uint8_t *bytes, size_t capacity);

/* How many bytes may be written without waiting, and write them. */
size_t board_room(void);
void board_write(const uint8_t *bytes, size_t length);

/* Switch the servo supply. */
void board_power(bool on);

/* The e-stop input; false if there is none. */
bool board_estop_pressed(void);

/* The servo supply in front of its switch [mV]; 0 if it is not measured. */
uint16_t board_supply_mv(void);

/* Set six widths [ns], 0 for none; all of them take effect together at the start of the next period. False if they could
 * not be set: then there are no pulses. */
bool servo_output_write(const uint32_t pulses[HPAC_SERVOS]);

/* --- the loop --- */

/* Memory that outlives every reset but power-on, when it is noise. */
typedef struct {
    hpac_memory_t hand;
    uint32_t boots;
    uint32_t crc;
} loop_memory_t;

typedef struct {
    hpac_hand_t hand;
    const hpac_config_t *config;
    loop_memory_t *kept;
    uint32_t period_us; /* widths are written once a period, in step with it */
    uint64_t next_us;   /* when they are written next */
    uint32_t written[HPAC_SERVOS];
} loop_t;

/* Start the hand after a reset. `kept` and `config` stay the caller's, as long as the loop runs. */
void loop_start(loop_t *loop, const hpac_config_t *config, hpac_reset_t reset, loop_memory_t *kept);

/* Once round, at 1 ms or faster. Set `period_us` and the first `next_us` before. */
void loop_once(loop_t *loop);

#endif
