/* Written for this test: what the configuration of a target would say. */
#pragma once
#define CONFIG_IDF_TARGET_ESP32 1
