/* SPDX-License-Identifier: {{ license }} */
/* {{ generated }}. Start-up of a Cortex-M for the self-test in QEMU: vectors, FPU, memory, exit by semihosting. */
#include <stdint.h>

extern uint32_t stack_top;
extern uint32_t data_start;
extern uint32_t data_end;
extern const uint32_t data_load;
extern uint32_t bss_start;
extern uint32_t bss_end;
extern void initialise_monitor_handles(void);
int main(void);
void reset(void);
void fault(void);

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    &stack_top, (const void *)reset, (const void *)fault, (const void *)fault};

__attribute__((noreturn)) static void stop(uint32_t code)
{
    /* SYS_EXIT: ADP_Stopped_ApplicationExit or ADP_Stopped_RunTimeErrorUnknown */
    register uint32_t r0 __asm("r0") = 0x18U;
    register uint32_t r1 __asm("r1") = (code == 0U) ? 0x20026U : 0x20023U;
    for (;;)
    {
        __asm volatile("bkpt 0xab" : : "r"(r0), "r"(r1) : "memory");
    }
}

void fault(void)
{
    stop(1U);
}

void reset(void)
{
    const uint32_t *from = &data_load;
#if defined(__ARM_FP)
    *(volatile uint32_t *)0xE000ED88U |= 0x00F00000U; /* CPACR: the FPU is on */
    __asm volatile("dsb\n isb");
#endif
    for (uint32_t *to = &data_start; to < &data_end; to++)
    {
        *to = *from;
        from++;
    }
    for (uint32_t *to = &bss_start; to < &bss_end; to++)
    {
        *to = 0U;
    }
    initialise_monitor_handles();
    stop((uint32_t)main());
}
