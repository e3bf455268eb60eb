/* Functions whose counts are known: a thousand times one instruction, and a return. */

#include "embedded.h"

#if defined(__arm__)
#define NOTHING "nop"
#define LOAD "ldr r1, [r0]"
#define STORE "str r1, [r0]"
#define STACK "sub sp, #480\nstr r1, [sp]\nadd sp, #480"
#define RETURN "bx lr"
#elif defined(__aarch64__)
#define NOTHING "nop"
#define LOAD "ldr x1, [x0]"
#define STORE "str x1, [x0]"
#define STACK "sub sp, sp, #480\nstr x1, [sp]\nadd sp, sp, #480"
#define RETURN "ret"
#elif defined(__riscv)
#define NOTHING "nop"
#define LOAD "ld a1, 0(a0)"
#define STORE "sd a1, 0(a0)"
#define STACK "addi sp, sp, -480\nsd a1, 0(sp)\naddi sp, sp, 480"
#define RETURN "ret"
#else
#define NOTHING "nop"
#define LOAD "movq (%rdi), %rax"
#define STORE "movq %rax, (%rdi)"
#define STACK "subq $472, %rsp\nmovq %rax, (%rsp)\naddq $472, %rsp"
#define RETURN "ret"
#endif

#define THOUSAND(name, instruction) \
    __attribute__((naked)) int name(embedded_qp *qp) { \
        __asm__(".rept 1000\n" instruction "\n.endr\n" RETURN); \
    }

THOUSAND(embedded_set_up, NOTHING)
THOUSAND(embedded_loads, LOAD)
THOUSAND(embedded_stores, STORE)
__attribute__((naked)) int embedded_stack(embedded_qp *qp) { __asm__(STACK "\n" RETURN); }
