#pragma once
#include <stdint.h>
#define GPIO_OUT_W1TS_REG 1
#define GPIO_OUT_W1TC_REG 0
#define REG_WRITE(reg, value) stub_write((reg), (value))
void stub_write(int level, uint32_t pins);
