/* Written for this test: what the configuration of a target would say. -DSTUB_TARGET=32, 3 (S3), 6 (C6), 13 (C3) */
#pragma once
#if STUB_TARGET == 32
#define CONFIG_IDF_TARGET_ESP32 1
#elif STUB_TARGET == 3
#define CONFIG_IDF_TARGET_ESP32S3 1
#elif STUB_TARGET == 6
#define CONFIG_IDF_TARGET_ESP32C6 1
#elif STUB_TARGET == 13
#define CONFIG_IDF_TARGET_ESP32C3 1
#endif
