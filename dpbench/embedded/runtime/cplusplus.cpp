/* What programs of C++ need beside runtime.c: constructors of static objects, and memory that is
   given back. A free block serves the next request of its size. */

#include <chrono>
#include <stddef.h>
#include <stdlib.h>

extern "C" {
typedef void constructor();
extern constructor *init_array_start[], *init_array_end[];
extern char *embedded_heap_end;
void *__dso_handle;

struct block {
    size_t size;
    block *next;
};
enum { LISTS = 64, HEAD = 16 };
static block *lists[LISTS];

static block **list_of(size_t size) { return &lists[size / HEAD % LISTS]; }

void *malloc(size_t wanted) {
    const size_t size = (wanted + HEAD - 1) & ~(size_t)(HEAD - 1);
    for (block **p = list_of(size); *p; p = &(*p)->next)
        if ((*p)->size == size) {
            block *found = *p;
            *p = found->next;
            return (char *)found + HEAD;
        }
    block *fresh = (block *)embedded_heap_end;
    embedded_heap_end += HEAD + size;
    fresh->size = size;
    return (char *)fresh + HEAD;
}

void free(void *memory) {
    if (!memory) return;
    block *head = (block *)((char *)memory - HEAD), **list = list_of(head->size);
    head->next = *list;
    *list = head;
}

void embedded_construct(void) {
    for (constructor **p = init_array_start; p < init_array_end; p++) (*p)();
}

int __cxa_atexit(void (*)(void *), void *, void *) { return 0; }
void __cxa_pure_virtual(void) { __builtin_trap(); }
int snprintf(char *text, size_t size, const char *, ...) {
    if (size) *text = 0;
    return 0;
}
}

/* There is no clock. */
std::chrono::steady_clock::time_point std::chrono::steady_clock::now() noexcept { return {}; }

void *operator new(size_t size) { return malloc(size); }
void *operator new[](size_t size) { return malloc(size); }
void operator delete(void *memory) noexcept { free(memory); }
void operator delete[](void *memory) noexcept { free(memory); }
void operator delete(void *memory, size_t) noexcept { free(memory); }
void operator delete[](void *memory, size_t) noexcept { free(memory); }
