/* Debian's compiler for the lx106 comes without these parts of its run-time library. Plain shift-and-subtract. */
#include <stdint.h>

uint64_t __udivdi3(uint64_t dividend, uint64_t divisor);
int64_t __divdi3(int64_t dividend, int64_t divisor);
int64_t __muldi3(int64_t left, int64_t right);
uint32_t __udivsi3(uint32_t dividend, uint32_t divisor);
uint32_t __umodsi3(uint32_t dividend, uint32_t divisor);
int32_t __divsi3(int32_t dividend, int32_t divisor);
int32_t __modsi3(int32_t dividend, int32_t divisor);

uint64_t __udivdi3(uint64_t dividend, uint64_t divisor)
{
    uint64_t quotient = 0;
    uint64_t rest = 0;
    for (int bit = 0; bit < 64; bit++) { /* shifts by one alone: others would need the library again */
        rest = (rest << 1) | (dividend >> 63);
        dividend <<= 1;
        quotient <<= 1;
        if (rest >= divisor) {
            rest -= divisor;
            quotient |= 1u;
        }
    }
    return quotient;
}

int64_t __divdi3(int64_t dividend, int64_t divisor)
{
    uint64_t top = dividend < 0 ? 0u - (uint64_t)dividend : (uint64_t)dividend;
    uint64_t bottom = divisor < 0 ? 0u - (uint64_t)divisor : (uint64_t)divisor;
    uint64_t quotient = __udivdi3(top, bottom);
    return (int64_t)((dividend < 0) != (divisor < 0) ? 0u - quotient : quotient);
}

int64_t __muldi3(int64_t left, int64_t right)
{
    uint64_t product = 0;
    uint64_t addend = (uint64_t)left;
    for (uint64_t bits = (uint64_t)right; bits != 0u; bits >>= 1) {
        if ((bits & 1u) != 0u) {
            product += addend;
        }
        addend <<= 1;
    }
    return (int64_t)product;
}

uint32_t __udivsi3(uint32_t dividend, uint32_t divisor) { return (uint32_t)__udivdi3(dividend, divisor); }

uint32_t __umodsi3(uint32_t dividend, uint32_t divisor)
{
    uint32_t rest = 0;
    for (int bit = 31; bit >= 0; bit--) {
        rest = (rest << 1) | ((dividend >> bit) & 1u);
        rest = rest >= divisor ? rest - divisor : rest;
    }
    return rest;
}

int32_t __divsi3(int32_t dividend, int32_t divisor) { return (int32_t)__divdi3(dividend, divisor); }

int32_t __modsi3(int32_t dividend, int32_t divisor) { return dividend - divisor * __divsi3(dividend, divisor); }
