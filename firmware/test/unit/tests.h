#ifndef TESTS_H
#define TESTS_H

void test_frame(void);
void test_ramp(void);
void test_servo_and_load(void);
void test_states(void);
void test_moves(void);
void test_malformed(void);
void test_vectors(void);
void test_oracle(void);

#endif
