/* The hand's motion: where it is, and whether a MOVE is admissible. */
#ifndef HPAC_MOTION_H
#define HPAC_MOTION_H

#include "hpac_hand.h"

/* Commanded angle of one servo now [urad], within its limits unless something is broken. */
int32_t hpac_motion_angle(const hpac_hand_t *hand, unsigned servo);

/* Effort of one servo now [permille]: 0 without pulses. See hpac_load.h. */
uint32_t hpac_motion_effort(const hpac_hand_t *hand, unsigned servo);

/* What is left of the rate limit of the hottest servo [permille]. */
uint16_t hpac_motion_rate_permille(const hpac_hand_t *hand);

/* Stand at the rest pose. */
void hpac_motion_rest(hpac_hand_t *hand);

/* Stand where it is. */
void hpac_motion_stop(hpac_hand_t *hand);

/* Ramp to the rest pose, slowly. */
void hpac_motion_relax(hpac_hand_t *hand);

/* Start a MOVE, or refuse it whole and go on as before; *servo is then the one at fault, if a single one is. */
hpac_reason_t hpac_motion_move(hpac_hand_t *hand, const uint8_t *payload, uint8_t flags, uint8_t *servo);

#endif
