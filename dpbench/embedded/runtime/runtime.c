/* What the programs need of a C library. The linker keeps only what a solver calls. */

#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#undef stdout
#undef stderr

/* Clang would make of these functions' loops calls of the same functions. */
#pragma clang attribute push( \
    __attribute__((no_builtin("memcpy", "memmove", "memset"))), apply_to = function)

extern char heap_start[];
char *embedded_heap_end = heap_start; /* how much was ever taken; nothing is given back */

/* Weak: cplusplus.cpp has others. */
__attribute__((weak)) void *malloc(size_t size) {
    char *here = embedded_heap_end;
    embedded_heap_end += (size + 15) & ~(size_t)15;
    return here;
}

void *calloc(size_t count, size_t size) { return memset(malloc(count * size), 0, count * size); }

__attribute__((weak)) void free(void *memory) { (void)memory; }

typedef long __attribute__((may_alias)) word;

/* Forwards, word by word where both are aligned; right also for overlaps with `to` below `from`. */
__attribute__((noinline)) static void *copy_up(void *to, const void *from, size_t size) {
    char *t = to;
    const char *f = from;
    if (((size_t)t | (size_t)f) % sizeof(word) == 0)
        for (; size >= sizeof(word); size -= sizeof(word), t += sizeof(word), f += sizeof(word))
            *(word *)t = *(const word *)f;
    while (size--) *t++ = *f++;
    return to;
}

void *memcpy(void *restrict to, const void *restrict from, size_t size) {
    return copy_up(to, from, size);
}

void *memmove(void *to, const void *from, size_t size) {
    char *t = to;
    const char *f = from;
    if (t <= f) return copy_up(to, from, size);
    while (size--) t[size] = f[size];
    return to;
}

void *memset(void *to, int byte, size_t size) {
    char *t = to;
    while (size--) *t++ = (char)byte;
    return to;
}

int memcmp(const void *a, const void *b, size_t size) {
    const unsigned char *x = a, *y = b;
    for (; size; size--, x++, y++)
        if (*x != *y) return *x - *y;
    return 0;
}

/* One instruction each. */
double sqrt(double x) { return __builtin_sqrt(x); }
float sqrtf(float x) { return __builtin_sqrtf(x); }
double fabs(double x) { return __builtin_fabs(x); }
float fabsf(float x) { return __builtin_fabsf(x); }

double hypot(double x, double y) {
    const double a = fabs(x), b = fabs(y), large = a > b ? a : b, small = a > b ? b : a;
    return large == 0 ? 0 : large * sqrt(1 + (small / large) * (small / large));
}

int printf(const char *restrict format, ...) { return (void)format, 0; }
int puts(const char *text) { return (void)text, 0; }
int putchar(int letter) { return letter; }
int fprintf(FILE *restrict file, const char *restrict format, ...) {
    return (void)file, (void)format, 0;
}
size_t fwrite(const void *restrict from, size_t size, size_t count, FILE *restrict file) {
    return (void)from, (void)size, (void)file, count;
}
int fflush(FILE *file) { return (void)file, 0; }
void exit(int code) {
    (void)code;
    __builtin_trap();
}
FILE *const stdout = NULL;
FILE *const stderr = NULL;

#ifdef __arm__
/* Names of the same under the ABI of Arm. */
void __aeabi_memcpy(void *to, const void *from, size_t size) { memcpy(to, from, size); }
void __aeabi_memcpy4(void *to, const void *from, size_t size) { memcpy(to, from, size); }
void __aeabi_memcpy8(void *to, const void *from, size_t size) { memcpy(to, from, size); }
void __aeabi_memmove(void *to, const void *from, size_t size) { memmove(to, from, size); }
void __aeabi_memmove4(void *to, const void *from, size_t size) { memmove(to, from, size); }
void __aeabi_memmove8(void *to, const void *from, size_t size) { memmove(to, from, size); }
void __aeabi_memset(void *to, size_t size, int byte) { memset(to, byte, size); }
void __aeabi_memset4(void *to, size_t size, int byte) { memset(to, byte, size); }
void __aeabi_memset8(void *to, size_t size, int byte) { memset(to, byte, size); }
void __aeabi_memclr(void *to, size_t size) { memset(to, 0, size); }
void __aeabi_memclr4(void *to, size_t size) { memset(to, 0, size); }
void __aeabi_memclr8(void *to, size_t size) { memset(to, 0, size); }
/* The ABI returns it in registers of integers. */
__attribute__((pcs("aapcs"))) double __aeabi_l2d(long long x) {
    return (double)(int)(x >> 32) * 4294967296.0 + (double)(unsigned)x;
}
#endif

#pragma clang attribute pop
