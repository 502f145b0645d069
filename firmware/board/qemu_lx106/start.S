/* l32r reaches back only: the constants stand before, the reset vector jumps over them. */
    .section .text.start, "ax"
    .global _start
_start:
    j 1f
    .align 4
stack: .word stack_top
entry: .word main
1:  l32r a1, stack
    l32r a0, entry
    callx0 a0
2:  j 2b
