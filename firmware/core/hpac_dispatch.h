/* One intact frame: judged, carried out whole or refused whole, and answered. */
#ifndef HPAC_DISPATCH_H
#define HPAC_DISPATCH_H

#include "hpac_hand.h"

/* Take the frame in hand->rx. */
void hpac_dispatch(hpac_hand_t *hand);

/* The same for a frame of another version: ESTOP is carried out, HELLO is told who is there, all else is refused. */
void hpac_dispatch_other_version(hpac_hand_t *hand);

#endif
