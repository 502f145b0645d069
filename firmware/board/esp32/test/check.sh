#!/bin/sh
# Compile the ESP32 port against our own stubs with a timer of 20 and of 14 bits, and run it on a chip that is not there.
set -eu
cd "$(dirname "$0")"
mkdir -p ../../../build
for bits in 20 14; do
    # shellcheck disable=SC2086 # flags are words
    ${CC:-cc} ${WARNINGS:--Wall} -std=gnu11 -g -fsanitize=address,undefined -DSTUB_LEDC_BITS=$bits -I. -Istubs -I../main \
        -I../../../core -I../../../test -o ../../../build/esp32_port \
        ../main/*.c fake.c test_port.c ../../../test/bench.c ../../../core/*.c
    ../../../build/esp32_port
done
