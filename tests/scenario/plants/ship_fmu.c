/* dpbench's ship in calm water as an FMU: the same Runge-Kutta steps, written a second time.
 *
 *     eta' = R(psi) nu,   M nu' + D nu = tau + R(psi)^T b(t),   b_i = A_i sin(2 pi t / T_i + p_i)
 *
 * FMI is 2 or 3. MINV and MINV_D are lists of 9 numbers, FORCE and ANGLE what 1 of an input, or of
 * an angle, is in SI. The value references are those of `list_variables` in fmus.py. Faults begin
 * at FAULT_TIME; where COUNTER names a file, in every instance but the first of a test.
 */
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

enum { STATE = 6, SUBSTEPS = 10 };
enum { INPUT = 0, OUTPUT = 3, START = 9, AMPLITUDE = 15, PERIOD = 18, PHASE = 21, FAULT = 24 };
enum { FAULT_TIME = 25, COUNT = 26 };
enum { NO_FAULT, FAILS, HANGS, CRASHES, FAILS_AT_START, NOT_A_NUMBER };

typedef struct {
    double v[COUNT];
    double s[STATE];
    long number;
} Ship;

static const double inverse_mass[9] = {MINV}, damping[9] = {MINV_D};

static void derivative(const Ship *ship, const double *s, double t, double *out) {
    const double *v = ship->v, c = cos(s[5]), sn = sin(s[5]), pi = acos(-1.0);
    double b[3];
    for (int i = 0; i < 3; i++)
        b[i] = v[AMPLITUDE + i] * sin(2.0 * pi * t / v[PERIOD + i] + v[PHASE + i]);
    const double f[3] = {FORCE * v[0] + c * b[0] + sn * b[1], FORCE * v[1] - sn * b[0] + c * b[1],
                         FORCE * v[2] + b[2]};
    for (int i = 0; i < 3; i++) {
        out[i] = 0.0;
        for (int j = 0; j < 3; j++)
            out[i] += inverse_mass[3 * i + j] * f[j] - damping[3 * i + j] * s[j];
    }
    out[3] = c * s[0] - sn * s[1];
    out[4] = sn * s[0] + c * s[1];
    out[5] = s[2];
}

static void write_outputs(Ship *ship) {
    for (int i = 0; i < STATE; i++)
        ship->v[OUTPUT + i] = ship->s[i] / (i == 2 || i == 5 ? ANGLE : 1.0);
}

static void initialise(Ship *ship) {
    for (int i = 0; i < STATE; i++)
        ship->s[i] = ship->v[START + i] * (i == 2 || i == 5 ? ANGLE : 1.0);
    write_outputs(ship);
}

static int advance(Ship *ship, double t, double step) {
    double k[4][STATE], mid[STATE], h = step / SUBSTEPS, *s = ship->s;
    bool due = t >= ship->v[FAULT_TIME] && ship->number > 1;
    int fault = due ? (int)ship->v[FAULT] : NO_FAULT;
    if (fault == FAILS) return 3;
    for (volatile int forever = fault == HANGS; forever;) {
    }
    if (fault == CRASHES) abort();
    for (int i = 0; i < SUBSTEPS; i++, t += h) {
        derivative(ship, s, t, k[0]);
        for (int j = 0; j < STATE; j++) mid[j] = s[j] + 0.5 * h * k[0][j];
        derivative(ship, mid, t + 0.5 * h, k[1]);
        for (int j = 0; j < STATE; j++) mid[j] = s[j] + 0.5 * h * k[1][j];
        derivative(ship, mid, t + 0.5 * h, k[2]);
        for (int j = 0; j < STATE; j++) mid[j] = s[j] + h * k[2][j];
        derivative(ship, mid, t + h, k[3]);
        for (int j = 0; j < STATE; j++)
            s[j] += h / 6.0 * (k[0][j] + 2.0 * k[1][j] + 2.0 * k[2][j] + k[3][j]);
    }
    write_outputs(ship);
    if (fault == NOT_A_NUMBER) ship->v[OUTPUT] = NAN;
    return 0;
}

static void *make(void) {
    Ship *ship = calloc(1, sizeof *ship);
    for (int i = 0; i < 3; i++) ship->v[PERIOD + i] = 60.0;
    FILE *counter = *COUNTER ? fopen(COUNTER, "a") : NULL;
    ship->number = 2;
    if (counter) {
        fputc('x', counter);
        ship->number = ftell(counter);
        fclose(counter);
    }
    return ship;
}

static int set(Ship *ship, const unsigned *refs, size_t n, const double *values) {
    for (size_t i = 0; i < n; i++) ship->v[refs[i]] = values[i];
    return 0;
}

static int get(const Ship *ship, const unsigned *refs, size_t n, double *values) {
    for (size_t i = 0; i < n; i++) values[i] = ship->v[refs[i]];
    return 0;
}

static int start(Ship *ship) {
    initialise(ship);
    return ship->v[FAULT] == FAILS_AT_START ? 3 : 0;
}

#if FMI == 2
#define NAME(end) fmi2##end
void *fmi2Instantiate(const char *a, int b, const char *c, const char *d, const void *e, int f, int g) {
    return make();
}
int fmi2SetupExperiment(void *s, int a, double b, double c, int d, double e) { return 0; }
int fmi2EnterInitializationMode(void *s) { return 0; }
int fmi2SetReal(void *s, const unsigned *r, size_t n, const double *v) { return set(s, r, n, v); }
int fmi2GetReal(void *s, const unsigned *r, size_t n, double *v) { return get(s, r, n, v); }
int fmi2DoStep(void *s, double t, double h, int a) { return advance(s, t, h); }
#else
#define NAME(end) fmi3##end
void *fmi3InstantiateCoSimulation(const char *a, const char *b, const char *c, bool d, bool e, bool f,
                                  bool g, const unsigned *h, size_t i, void *j, void *k, void *l) {
    return make();
}
int fmi3EnterInitializationMode(void *s, bool a, double b, double c, bool d, double e) { return 0; }
int fmi3SetFloat64(void *s, const unsigned *r, size_t n, const double *v, size_t m) {
    return set(s, r, n, v);
}
int fmi3GetFloat64(void *s, const unsigned *r, size_t n, double *v, size_t m) {
    return get(s, r, n, v);
}
int fmi3DoStep(void *s, double t, double h, bool a, bool *event, bool *ended, bool *early,
               double *last) {
    *event = *ended = *early = false;
    *last = t + h;
    return advance(s, t, h);
}
#endif
int NAME(ExitInitializationMode)(void *s) { return start(s); }
int NAME(Terminate)(void *s) { return 0; }
void NAME(FreeInstance)(void *s) { free(s); }
