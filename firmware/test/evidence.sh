#!/bin/sh
# What `make check` (short) and `make check-all` (long) run; called from the firmware folder by its Makefile.
#
# A tool that is not installed is skipped with a line on standard error; with CHECK_STRICT=1 it is a failure.
set -eu

build=build
rv32=riscv64-unknown-elf-gcc
qemu="qemu-system-riscv32 -M virt -cpu rv32,a=false,f=false,d=false -bios none -display none -monitor none"
fuzz_seconds=${FUZZ_SECONDS:-30}
driver_frames=${DRIVER_FRAMES:-10000000}

# have TOOL PACKAGE: is the tool there?
have() {
    command -v "$1" >/dev/null && return 0
    echo "SKIPPED: no $1 (Debian: apt-get install $2)" >&2
    if [ -n "${CHECK_STRICT:-}" ]; then exit 1; fi
    return 1
}

# warnings COMPILER FLAGS...: every file of the core compiles without one
warnings() {
    for file in core/*.c; do
        "$@" $WARNINGS -Icore -c "$file" -o "$build/warnings.o"
    done
    echo "warnings: none with $*"
}

# trace COMPILER FLAGS...: the same pulses to the nanosecond, the same answers to the byte
trace() {
    "$@" $WARNINGS -Icore -Itest -o "$build/trace_other" core/*.c test/bench.c test/trace.c test/trace_main.c
    "$build/trace_other" | cmp - test/trace.expected
    echo "trace: the expected one with $*"
}

size_budget() {
    make -s --no-print-directory "$build/hpac_qemu.elf"
    riscv64-unknown-elf-size -A "$build/hpac_qemu.elf" | awk '
        $1 == ".text" { text = $2 }
        $1 == ".data" || $1 == ".bss" { data += $2 }
        END {
            printf "size: text %d of 16384 bytes, data and bss %d of 4096 (core and emulated board, rv32imc -Os)\n", text, data
            exit !(text > 0 && text < 16384 && data < 4096)
        }'
}

trace_in_qemu() {
    make -s --no-print-directory "$build/trace_qemu.elf"
    timeout 60 $qemu -serial stdio -kernel "$build/trace_qemu.elf" </dev/null >"$build/trace_qemu.txt"
    head -1 "$build/trace_qemu.txt" | cmp - test/trace.expected
    echo "trace: the expected one on rv32imc in QEMU; stack used: $(sed -n 's/stack //p' "$build/trace_qemu.txt") bytes, test bench included"
}

trace_in_xtensa() {
    make -s --no-print-directory "$build/trace_lx106.elf"
    timeout 60 qemu-system-xtensa -M sim -cpu lx106 -nographic -semihosting -monitor none -kernel "$build/trace_lx106.elf" \
        </dev/null | cmp - test/trace.expected
    echo "trace: the expected one on Xtensa lx106 in QEMU"
}

driver() {
    "$build/hpac_driver" "$1" "$2" >"$build/driver.txt" || { cat "$build/driver.txt"; exit 1; }
    echo "driver: $1 hostile frames, no promise broken"
}

# fuzz KIND: from the test vectors and what earlier runs have found, for a bounded time
fuzz() {
    make -s --no-print-directory "$build/fuzz_$1"
    "$PYTHON" - "$build/corpus_$1" <<'END'
import csv, pathlib, sys
folder = pathlib.Path(sys.argv[1])
folder.mkdir(parents=True, exist_ok=True)
for i, row in enumerate(csv.DictReader(open("../docs/wire_vectors.csv", encoding="utf-8"))):
    (folder / f"vector{i}").write_bytes(bytes.fromhex(row["wire"]))
END
    "$build/fuzz_$1" -max_total_time="$fuzz_seconds" -max_len=512 -print_final_stats=1 -artifact_prefix="$build/" \
        "$build/corpus_$1" >"$build/fuzz_$1.txt" 2>&1 || { tail -40 "$build/fuzz_$1.txt"; exit 1; }
    echo "fuzz $1: $(sed -n 's/stat::number_of_executed_units: *//p' "$build/fuzz_$1.txt") runs in $fuzz_seconds s, no finding"
}

short_part() {
    warnings "$CC" -O2
    if have clang-14 clang-14; then warnings clang-14 -O2; fi
    if have $rv32 gcc-riscv64-unknown-elf; then warnings $rv32 -march=rv32imc -mabi=ilp32 -ffreestanding -Os; fi
    if have xtensa-lx106-elf-gcc gcc-xtensa-lx106; then warnings xtensa-lx106-elf-gcc -ffreestanding -Os; fi
    "$build/unit"
    "$build/trace" | cmp - test/trace.expected
    echo "trace: the expected one"
    driver 300000 1
    "$build/flips"
    "$PYTHON" test/mutants.py --cc "$CC" --controls
    if have $rv32 gcc-riscv64-unknown-elf; then size_budget; fi
    sh board/esp32/test/check.sh
    echo "firmware check: passed"
}

long_part() {
    trace "$CC" -O0
    trace "$CC" -O3
    if have clang-14 clang-14; then trace clang-14 -O0; trace clang-14 -O3; fi
    if echo 'int main(void) { return 0; }' | "$CC" -m32 -x c - -o "$build/m32" 2>/dev/null; then
        trace "$CC" -m32 -O2
    else
        have "a 32-bit C library" gcc-multilib || true
    fi
    if have $rv32 gcc-riscv64-unknown-elf && have qemu-system-riscv32 qemu-system-misc; then trace_in_qemu; fi
    if have xtensa-lx106-elf-gcc gcc-xtensa-lx106 && have qemu-system-xtensa qemu-system-misc; then trace_in_xtensa; fi
    if have cppcheck cppcheck; then
        cppcheck --quiet --std=c99 --enable=warning,performance,portability --error-exitcode=1 -Icore -Iboard core board/loop.c board/host
        echo "cppcheck: clean"
    fi
    if have clang-tidy-14 clang-tidy-14; then
        clang-tidy-14 --quiet --warnings-as-errors='*' core/*.c -- -std=c99 -Icore >"$build/tidy.txt" 2>&1 ||
            { cat "$build/tidy.txt"; exit 1; }
        echo "clang-tidy: clean"
    fi
    "$build/flips" every
    driver "$driver_frames" 2
    if have clang-14 "clang-14 libclang-rt-14-dev"; then fuzz raw; fuzz structured; fi
    echo "firmware check-all: passed"
}

case "$1" in
short) short_part ;;
long) long_part ;;
esac
