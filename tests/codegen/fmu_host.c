/* A simulator of a few lines: steps an FMU's library with the inputs of a file.
 *
 *     fmu_host VERSION LIBRARY GUID SAMPLE_S INPUTS COMMANDS N_IN N_OUT
 *
 * INPUTS has rows of N_IN doubles, for the references 0 .. N_IN - 1; COMMANDS becomes rows of N_OUT
 * doubles, of the references that follow. Exit 0, or the number of the call that failed.
 */
#include <stdio.h>
#include <stdlib.h>
#ifdef _WIN32
#include <windows.h>
#define OPEN(path) LoadLibraryA(path)
#define FIND(library, name) GetProcAddress(library, name)
typedef HMODULE Library;
#else
#include <dlfcn.h>
#define OPEN(path) dlopen(path, RTLD_NOW)
#define FIND(library, name) dlsym(library, name)
typedef void *Library;
#endif
#include <stdbool.h>

enum { MOST = 64 };

typedef struct {
    void (*log)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
} Callbacks;

static void log_2(void *a, const char *b, int c, const char *d, const char *e, ...) {
    (void)a, (void)b, (void)c, (void)d, fprintf(stderr, "%s\n", e);
}
static void log_3(void *a, int b, const char *c, const char *d) {
    (void)a, (void)b, (void)c, fprintf(stderr, "%s\n", d);
}

static Callbacks callbacks = {log_2, calloc, free, NULL, NULL};

#define CALL(type, name) ((type)(void *)FIND(library, name))

/* Instantiate and initialise; NULL on failure. */
static void *start(Library library, int version, const char *guid) {
    typedef void *(*New2)(const char *, int, const char *, const char *, Callbacks *, int, int);
    typedef void *(*New3)(const char *, const char *, const char *, bool, bool, bool, bool,
                          const unsigned *, size_t, void *,
                          void (*)(void *, int, const char *, const char *), void *);
    typedef int (*Set2)(void *, int, double, double, int, double);
    typedef int (*Set3)(void *, bool, double, double, bool, double);
    typedef int (*Plain)(void *);
    void *fmu;
    if (version == 2) {
        fmu = CALL(New2, "fmi2Instantiate")("it", 1, guid, "", &callbacks, 0, 1);
        if (!fmu || CALL(Set2, "fmi2SetupExperiment")(fmu, 0, 0.0, 0.0, 0, 0.0)
            || CALL(Plain, "fmi2EnterInitializationMode")(fmu)
            || CALL(Plain, "fmi2ExitInitializationMode")(fmu))
            return NULL;
        return fmu;
    }
    fmu = CALL(New3, "fmi3InstantiateCoSimulation")("it", guid, "", false, true, false, false, NULL,
                                                   0, NULL, log_3, NULL);
    if (!fmu || CALL(Set3, "fmi3EnterInitializationMode")(fmu, false, 0.0, 0.0, false, 0.0)
        || CALL(Plain, "fmi3ExitInitializationMode")(fmu))
        return NULL;
    return fmu;
}

/* Set inputs, do one step, get commands; 0 or the number of the call that failed. */
static int step(Library library, int version, void *fmu, double now, double sample, size_t n_in,
                const double *inputs, size_t n_out, double *commands) {
    typedef int (*Set2)(void *, const unsigned *, size_t, const double *);
    typedef int (*Get2)(void *, const unsigned *, size_t, double *);
    typedef int (*Do2)(void *, double, double, int);
    typedef int (*Set3)(void *, const unsigned *, size_t, const double *, size_t);
    typedef int (*Get3)(void *, const unsigned *, size_t, double *, size_t);
    typedef int (*Do3)(void *, double, double, bool, bool *, bool *, bool *, double *);
    unsigned references[MOST];
    for (unsigned i = 0; i < MOST; i++) references[i] = i;
    bool event, ended, early;
    double last;
    if (version == 2) {
        if (CALL(Set2, "fmi2SetReal")(fmu, references, n_in, inputs)) return 11;
        if (CALL(Do2, "fmi2DoStep")(fmu, now, sample, 1)) return 12;
        return CALL(Get2, "fmi2GetReal")(fmu, references + n_in, n_out, commands) ? 13 : 0;
    }
    if (CALL(Set3, "fmi3SetFloat64")(fmu, references, n_in, inputs, n_in)) return 11;
    if (CALL(Do3, "fmi3DoStep")(fmu, now, sample, true, &event, &ended, &early, &last)) return 12;
    return CALL(Get3, "fmi3GetFloat64")(fmu, references + n_in, n_out, commands, n_out) ? 13 : 0;
}

int main(int argc, char **argv) {
    if (argc != 9) return 2;
    int version = atoi(argv[1]), code = 0;
    Library library = OPEN(argv[2]);
    if (!library) return 3;
    double sample = atof(argv[4]), inputs[MOST], commands[MOST];
    FILE *source = fopen(argv[5], "rb"), *sink = fopen(argv[6], "wb");
    size_t n_in = (size_t)atoi(argv[7]), n_out = (size_t)atoi(argv[8]);
    if (!source || !sink || n_in + n_out > MOST) return 4;
    void *fmu = start(library, version, argv[3]);
    if (!fmu) return 5;
    for (int k = 0; !code && fread(inputs, sizeof *inputs, n_in, source) == n_in; k++) {
        code = step(library, version, fmu, k * sample, sample, n_in, inputs, n_out, commands);
        fwrite(commands, sizeof *commands, n_out, sink);
    }
    fclose(sink);
    return code;
}
