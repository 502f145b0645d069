/* The smallest test harness: CHECK counts, reports and goes on. */
#ifndef CHECK_H
#define CHECK_H

#include <stdbool.h>

#define CHECK(condition) check_that((condition), #condition, __FILE__, __LINE__)

void check_that(bool holds, const char *what, const char *file, int line);

#endif
