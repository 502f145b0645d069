#pragma once
#include <stddef.h>
#include <stdint.h>
#include "esp_err.h"
#define UART_NUM_0 0
#define UART_DATA_8_BITS 3
#define UART_PARITY_DISABLE 0
#define UART_STOP_BITS_1 1
#define UART_HW_FLOWCTRL_DISABLE 0
#define UART_SCLK_DEFAULT 4
typedef struct {
    int baud_rate;
    int data_bits;
    int parity;
    int stop_bits;
    int flow_ctrl;
    uint8_t rx_flow_ctrl_thresh;
    int source_clk;
} uart_config_t;
esp_err_t uart_driver_install(int port, int rx_bytes, int tx_bytes, int queue_length, void *queue, int flags);
esp_err_t uart_param_config(int port, const uart_config_t *config);
int uart_read_bytes(int port, void *buffer, uint32_t length, uint32_t ticks);
int uart_tx_chars(int port, const char *bytes, uint32_t length);
#define UART_PIN_NO_CHANGE (-1)
esp_err_t uart_set_pin(int port, int tx, int rx, int rts, int cts);
