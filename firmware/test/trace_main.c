#include <stdio.h>

#include "trace.h"

int main(void)
{
    printf("trace %08lx\n", (unsigned long)hpac_trace());
    return 0;
}
