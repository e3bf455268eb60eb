/* Run a recorded trace of a program natively or under another emulator: a program of Linux.

   The trace on standard input is words of 64 bits, little-endian, each followed by what it names:
     1 address size bytes   write memory           2 address argument   call a function
     3 address size bytes   compare memory
   A call of an empty function comes first. Printed at the end: how many bytes differed. */

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

#ifndef __x86_64__
#define request(number) ((void)(number))
#else
/* A request of Valgrind: five instructions that do nothing on a processor. */
static void request(uint64_t number) {
    volatile uint64_t words[6] = {number};
    uint64_t result = 0;
    __asm__ volatile("rolq $3, %%rdi; rolq $13, %%rdi; rolq $61, %%rdi; rolq $51, %%rdi;"
                     "xchgq %%rbx, %%rbx"
                     : "+d"(result)
                     : "a"(words)
                     : "cc", "memory");
}
#endif
#define CALLGRIND(k) (((uint64_t)'C' << 24 | (uint64_t)'T' << 16) + (k))
#define DUMP 0
#define ZERO 1

typedef int function(void *);

#ifdef __x86_64__
__attribute__((naked)) static int nothing(void *argument) { __asm__("ret"); }
#else
static int nothing(void *argument) { return argument != NULL; }
#endif

static int read_word(uint64_t *word) { return fread(word, sizeof *word, 1, stdin) == 1; }

static void *read_pointer(void) {
    uint64_t word = 0;
    read_word(&word);
    return (void *)(uintptr_t)word;
}

__attribute__((noinline)) static void call(function *volatile called, void *argument) {
    request(CALLGRIND(ZERO));
    called(argument);
    request(CALLGRIND(DUMP));
}

static int map(uintptr_t address, size_t size) {
    const int how = MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED | MAP_NORESERVE;
    return mmap((void *)address, size, PROT_READ | PROT_WRITE | PROT_EXEC, how, -1, 0) == MAP_FAILED;
}

int main(void) {
    uint64_t kind, differing = 0;
    if (map(PROGRAM, PROGRAM_SIZE) || map(DATA, DATA_SIZE)) return perror("mmap"), 1;
    call(nothing, NULL);
    while (read_word(&kind)) {
        char *address = read_pointer();
        const size_t size = (size_t)(uintptr_t)read_pointer();
        if (kind == 2) {
            call((function *)address, (void *)size);
        } else if (kind == 1) {
            if (fread(address, 1, size, stdin) != size) return 2;
            __builtin___clear_cache(address, address + size);
        } else {
            char *expected = malloc(size);
            if (fread(expected, 1, size, stdin) != size) return 2;
            for (size_t i = 0; i < size; i++) differing += expected[i] != address[i];
            free(expected);
        }
    }
    printf("%llu\n", (unsigned long long)differing);
    return 0;
}
