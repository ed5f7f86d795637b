/* An exported law on a Cortex-M of QEMU (mps2): reads calls from a file, writes torques, statuses and instructions.
 *
 * Virtual time advances 64 ns an instruction (-icount shift=6), and the timer counts down at 25 MHz. A call in the file
 * is 1 where an episode begins, else 0, and an observation. What the measurement itself takes is that of `nothing`.
 */
#include <stdint.h>
#include "law.h"

typedef int (*Step)(law_state *, const REAL *, REAL *);

enum { NS_PER_TICK = 40, NS_PER_INSTRUCTION = 64 };
static volatile uint32_t *const timer = (volatile uint32_t *)0x40000000u; /* control, value, reload */
static law_state state;

static int ask(int operation, const void *given)
{
    register int r0 __asm__("r0") = operation;
    register const void *r1 __asm__("r1") = given;
    __asm__ volatile("bkpt 0xab" : "+r"(r0) : "r"(r1) : "memory");
    return r0;
}

static int opened(const char *name, int length, int mode)
{
    const uint32_t given[3] = {(uint32_t)name, (uint32_t)mode, (uint32_t)length};
    return ask(1, given);
}

static int moved(int operation, int file, void *bytes, uint32_t size)
{
    const uint32_t given[3] = {(uint32_t)file, (uint32_t)bytes, size};
    return ask(operation, given);
}

static int nothing(law_state *own, const REAL *seen, REAL *torque)
{
    (void)own;
    (void)seen;
    (void)torque;
    return 0;
}

static uint32_t __attribute__((noinline)) ticks(Step step, const REAL *seen, REAL *torque, int *status)
{
    const uint32_t before = timer[1];
    *status = step(&state, seen, torque);
    return before - timer[1];
}

static uint32_t *const low = (uint32_t *)0x203e0000u; /* of the part of the stack that is painted */

/* How many bytes of the stack have been used. */
static uint32_t depth(void)
{
    const uint32_t *at = low;
    while (*at == 0xa5a5a5a5u) {
        at++;
    }
    return 0x20400000u - (uint32_t)at;
}

void __attribute__((noreturn)) run(void);
void __attribute__((noreturn)) run(void)
{
    struct {
        REAL torque[JOINTS];
        REAL status;
        REAL instructions; /* of the call; after the last call the bytes of stack of the deepest */
    } result;
    REAL call[1 + INPUTS];
    int in, out, status;
    volatile uint32_t *at, *stack; /* volatile: a call of memset would paint its own frame */
    uint32_t own, above;
    *(volatile uint32_t *)0xe000ed88u |= 0xfu << 20; /* the floating-point unit */
    __asm__ volatile("dsb\n isb");
    timer[2] = 0xffffffffu;
    timer[1] = 0xffffffffu;
    timer[0] = 1;
    in = opened("calls.bin", 9, 1);
    out = opened("found.bin", 9, 5);
    __asm__ volatile("mov %0, sp" : "=r"(stack));
    for (at = low; at < stack; at++) {
        *at = 0xa5a5a5a5u;
    }
    own = ticks(nothing, call, result.torque, &status);
    above = depth();
    while (moved(6, in, call, sizeof call) == 0) {
        uint64_t passed;
        if (call[0] != 0) {
            law_init(&state);
        }
        passed = ticks(law_step, call + 1, result.torque, &status) - own;
        result.status = (REAL)status;
        result.instructions = (REAL)((passed * NS_PER_TICK + NS_PER_INSTRUCTION / 2) / NS_PER_INSTRUCTION);
        (void)moved(5, out, &result, sizeof result);
    }
    result.instructions = (REAL)(depth() - above);
    (void)moved(5, out, &result, sizeof result);
    for (;;) {
        (void)ask(0x18, (const void *)0x20026);
    }
}

static void __attribute__((used, noreturn)) failed(void)
{
    for (;;) {
        (void)ask(0x18, (const void *)0x20023);
    }
}

__attribute__((section(".vectors"), used)) static const void *const vectors[16] = {
    (void *)0x20400000u, (void *)run, (void *)failed, (void *)failed, (void *)failed, (void *)failed, (void *)failed,
};
