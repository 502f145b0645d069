/* What the hand says: frames into its answer queue, whole or not at all. */
#ifndef HPAC_ANSWER_H
#define HPAC_ANSWER_H

#include "hpac_hand.h"

void hpac_answer_hello(hpac_hand_t *hand, uint16_t seq);
void hpac_answer_ack(hpac_hand_t *hand, uint16_t seq, uint8_t acked, hpac_reason_t reason, uint8_t servo);
/* `seq` is 0 when nobody asked. */
void hpac_answer_status(hpac_hand_t *hand, uint16_t seq);
void hpac_answer_fault(hpac_hand_t *hand, unsigned servo);

#endif
