/* The synchronised move: six servos leave together and arrive together. Integers only, so every target gives the
 * same bits. Angles in urad, speeds in urad/s, time in us. */
#ifndef HPAC_RAMP_H
#define HPAC_RAMP_H

#include <stdbool.h>
#include <stdint.h>

#include "hpac_protocol.h"

typedef struct {
    uint32_t elapsed_us;
    uint32_t duration_us; /* elapsed_us is not below it: at rest at `to` */
    bool minimum_jerk;
    int32_t from[HPAC_SERVOS];
    int32_t from_speed[HPAC_SERVOS]; /* used by minimum jerk only */
    int32_t to[HPAC_SERVOS];
} hpac_ramp_t;

/* Rest at `pose`. */
void hpac_ramp_rest(hpac_ramp_t *ramp, const int32_t pose[HPAC_SERVOS]);

/* True until the move has ended. */
bool hpac_ramp_moving(const hpac_ramp_t *ramp);

/* Let the move go on for this time. */
void hpac_ramp_advance(hpac_ramp_t *ramp, uint32_t us);

/* Angle of one servo. Exactly `to` from the end of the move on. */
int32_t hpac_ramp_angle(const hpac_ramp_t *ramp, unsigned servo);

/* Speed of one servo. Exactly 0 from the end of the move on. */
int32_t hpac_ramp_speed(const hpac_ramp_t *ramp, unsigned servo);

/* A bound on the speed that one servo reaches between its start and the end of the move: exact for linear moves and
 * for minimum jerk from rest (1.875 times the mean), never too small otherwise. */
int64_t hpac_ramp_peak_speed(const hpac_ramp_t *ramp, unsigned servo);

/* The outermost angle that one servo's minimum-jerk move may reach before it turns to its target: with the start and
 * the target it spans all of the move. Equal to the start for linear moves and from rest. */
int64_t hpac_ramp_turning_angle(const hpac_ramp_t *ramp, unsigned servo);

#endif
