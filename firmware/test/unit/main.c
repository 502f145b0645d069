/* Unit tests of the core: prints what failed, exits with 1 if anything did. */
#include <stdio.h>

#include "check.h"
#include "tests.h"

static int checks;
static int failures;

void check_that(bool holds, const char *what, const char *file, int line)
{
    checks++;
    if (!holds) {
        failures++;
        printf("%s:%d: failed: %s\n", file, line, what);
    }
}

int main(void)
{
    test_frame();
    test_ramp();
    test_servo_and_load();
    test_states();
    test_moves();
    test_malformed();
    test_vectors();
    test_oracle();
    printf("firmware unit tests: %d checks, %d failed\n", checks, failures);
    return failures == 0 && checks > 0 ? 0 : 1;
}
