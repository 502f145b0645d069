#pragma once
typedef int esp_err_t;
#define ESP_OK 0
#define ESP_FAIL -1
void stub_check(esp_err_t error, const char *what);
#define ESP_ERROR_CHECK(call) stub_check((call), #call)
