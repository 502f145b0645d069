/* Prints the trace of test/trace.c, the same number on every target, and how deep the stack was used; then ends. */
#include "trace.h"
#include "virt.h"

static void print(const char *text)
{
    for (; *text != '\0'; text++) {
        while (!virt_write_byte((uint8_t)*text)) {
        }
    }
}

static void print_number(const char *name, uint32_t number)
{
    print(name);
    for (int shift = 28; shift >= 0; shift -= 4) {
        char digit[2] = { "0123456789abcdef"[(number >> shift) & 15u], '\0' };
        print(digit);
    }
    print("\n");
}

int main(void)
{
    print_number("trace ", hpac_trace());
    print_number("stack 0x", virt_stack_used());
    virt_exit(0);
    return 0;
}
