#include "hpac_hand.h"

#include "hpac_answer.h"
#include "hpac_dispatch.h"
#include "hpac_motion.h"
#include "hpac_state.h"

void hpac_config_default(hpac_config_t *config)
{
    static const hpac_servo_t table[HPAC_SERVOS] = HPAC_SERVO_TABLE;
    for (int i = 0; i < HPAC_SERVOS; i++) {
        config->servo[i] = table[i];
    }
}

void hpac_hand_init(hpac_hand_t *hand, const hpac_config_t *config, hpac_reset_t reset, uint16_t boot_count)
{
    *hand = (hpac_hand_t){ .config = *config, .reset = (uint8_t)reset, .boot_count = boot_count, .usable = true };
    hpac_rx_init(&hand->rx);
    for (int i = 0; i < HPAC_SERVOS; i++) {
        hand->usable = hand->usable && hpac_servo_usable(&config->servo[i]);
    }
    hpac_state_detach(hand);
    hand->state = HPAC_STATE_BOOT;
    if (!hand->usable) {
        hpac_state_fault(hand, HPAC_FAULT_CONFIG, HPAC_NO_SERVO);
    } else if (reset == HPAC_RESET_BROWNOUT) {
        hpac_state_fault(hand, HPAC_FAULT_BROWNOUT, HPAC_NO_SERVO);
    } else if (reset == HPAC_RESET_CRASH) {
        hpac_state_fault(hand, HPAC_FAULT_CRASH, HPAC_NO_SERVO);
    }
}

void hpac_hand_tick(hpac_hand_t *hand, uint64_t now_us, uint32_t pulses[HPAC_SERVOS])
{
    hpac_state_advance(hand, now_us);
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        const hpac_servo_t *servo = &hand->config.servo[i];
        int32_t urad = hpac_motion_angle(hand, i);
        if (hand->attached != 0u && (urad < servo->min_urad || urad > servo->max_urad)) {
            hpac_state_fault(hand, HPAC_FAULT_INTERNAL, i);
        }
    }
    for (unsigned i = 0; i < HPAC_SERVOS; i++) {
        bool attached = (hand->attached & (1u << i)) != 0u;
        pulses[i] = attached ? hpac_servo_pulse(&hand->config.servo[i], hpac_motion_angle(hand, i)) : 0u;
    }
}

static void on_other_version(hpac_hand_t *hand)
{
    hpac_state_count(&hand->count.bad_version);
    if (hand->rx.frame[HPAC_AT_TYPE] == HPAC_HELLO) {
        hpac_answer_hello(hand, hpac_get_u16(hand->rx.frame + HPAC_AT_SEQ));
    }
}

void hpac_hand_receive(hpac_hand_t *hand, uint64_t now_us, const uint8_t *bytes, size_t length)
{
    hpac_state_advance(hand, now_us);
    for (size_t i = 0; i < length; i++) {
        switch (hpac_rx_push(&hand->rx, bytes[i])) {
        case HPAC_RX_MORE:
            break;
        case HPAC_RX_FRAME:
            hpac_dispatch(hand);
            break;
        case HPAC_RX_VERSION:
            on_other_version(hand);
            break;
        case HPAC_RX_CRC:
            hpac_state_count(&hand->count.bad_crc);
            break;
        case HPAC_RX_BAD:
            hpac_state_count(&hand->count.bad_frame);
            break;
        case HPAC_RX_OVERRUN:
            hpac_state_count(&hand->count.overrun);
            break;
        }
    }
}
