#pragma once
void esp_restart_noos_dig(void) __attribute__((noreturn));
