/* The hand's motion: where it is, whether a MOVE is admissible, and the guard at the output. */
#ifndef HPAC_MOTION_H
#define HPAC_MOTION_H

#include "hpac_hand.h"

/* Commanded angle of one servo now [urad], within its limits unless something is broken. */
int32_t hpac_motion_angle(const hpac_hand_t *hand, unsigned servo);

/* Effort of one servo now [permille]: 0 without pulses. See hpac_load.h. */
uint32_t hpac_motion_effort(const hpac_hand_t *hand, unsigned servo);

/* What is left of the rate limit of the hottest servo [permille]. */
uint16_t hpac_motion_rate_permille(const hpac_hand_t *hand);

/* True if the motion's state can be computed with: its angles are the table's, its speed and duration bounded. */
bool hpac_motion_sound(const hpac_hand_t *hand);

/* Stand at `pose`, brought within the limits; it also becomes what the next output is compared with. */
void hpac_motion_stand(hpac_hand_t *hand, const int32_t pose[HPAC_SERVOS]);

/* Stand where it is. */
void hpac_motion_stop(hpac_hand_t *hand);

/* Ramp the servos that have pulses to rest, slowly. */
void hpac_motion_relax(hpac_hand_t *hand);

/* How long a relax may take from anywhere [us]. */
uint32_t hpac_motion_relax_max_us(const hpac_hand_t *hand);

/* Take a servo without pulses to stand where its first pulse is to find it: at rest, to which the springs pull it, or,
 * where it holds by itself, at its last commanded angle. */
void hpac_motion_place(hpac_hand_t *hand, unsigned servo);

/* True if the commanded pose is the rest pose. */
bool hpac_motion_at_rest(const hpac_hand_t *hand);

/* How long one servo may need to come to its first pulse [us]: where it is is known only to lie between its last
 * commanded angle and rest, or after power-on anywhere. */
uint32_t hpac_motion_start_us(const hpac_hand_t *hand, unsigned servo);

/* Start a MOVE, or refuse it whole and go on as before; *servo is then the one at fault, if a single one is. */
hpac_reason_t hpac_motion_move(hpac_hand_t *hand, const uint8_t *payload, uint8_t flags, uint8_t *servo);

/* Take up the present angles as the output of a tick. False, with *servo the one at fault, if an angle is outside of
 * the table or further from the last output than the slew limit lets it come: then nothing is taken up. */
bool hpac_motion_output(hpac_hand_t *hand, unsigned *servo);

#endif
