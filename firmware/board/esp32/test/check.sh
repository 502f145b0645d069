#!/bin/sh
# Compile the ESP32 port against our own stubs, once a chip and wiring, and run each on a chip that is not there.
set -eu
cd "$(dirname "$0")"
mkdir -p ../../../build
port() {
    name=$1
    shift
    printf 'esp32 port, %s: ' "$name"
    # shellcheck disable=SC2086 # flags are words
    ${CC:-cc} ${WARNINGS:--Wall} -std=gnu11 -g -fsanitize=address,undefined "$@" -I. -Istubs -I../main \
        -I../.. -I../../../core -I../../../test -o ../../../build/esp32_port \
        ../main/*.c ../../loop.c fake.c test_port.c ../../../test/oracle.c ../../../core/*.c -lm
    ../../../build/esp32_port
}
pins() {
    target=$1
    shift
    for free in -1 "$@"; do
        for pca in 0 1; do
            ${CC:-cc} -Wall -DSTUB_TARGET="$target" -DESTOP_PIN="$free" -DSERVOS_ON_PCA9685=$pca -Istubs -I../main \
                -o ../../../build/esp32_pins test_pins.c
            ../../../build/esp32_pins
        done
    done
}
pins 32 27 32 33
pins 3 18 21
pins 6 11 2 3
pins 13 0
port "ESP32, supply measured" -DSTUB_TARGET=32 -DSUPPLY_ADC_CHANNEL=6
port "C6 with e-stop, supply measured, trims" -DSTUB_TARGET=6 -DESTOP_PIN=11 -DSUPPLY_ADC_CHANNEL=0 \
    -DSERVO_TRIMS_NS='0, -1, 1, -20000, 20000, 300' -DSERVO_DIRECTIONS='1, -1, 1, 1, -1, 1'
port "C3 behind its own USB" -DSTUB_TARGET=13 -DPORT_IS_USB=1 -DESTOP_PIN=0
port "S3 with a PCA9685" -DSTUB_TARGET=3 -DSERVOS_ON_PCA9685=1 -DESTOP_PIN=18 -DSUPPLY_ADC_CHANNEL=0
