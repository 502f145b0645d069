/* Reset: stack, global pointer, zeroed .bss, painted stack, then main(). Initialised data lies in RAM with the code. */
    .section .text.start
    .global _start
_start:
    .option push
    .option norelax
    la gp, __global_pointer$
    .option pop
    la sp, stack_top
    la t0, bss_start
    la t1, bss_end
1:  bgeu t0, t1, 2f
    sw zero, 0(t0)
    addi t0, t0, 4
    j 1b
2:  la t0, stack_bottom     /* paint the stack, so that how deep it was used can be read later */
    li t1, 0xa5a5a5a5
3:  sw t1, 0(t0)
    addi t0, t0, 4
    bltu t0, sp, 3b
    call main
4:  wfi
    j 4b
