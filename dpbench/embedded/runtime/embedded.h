/* What a shim of a solver implements. All arrays are the caller's; P and A are row by row. */

#ifndef EMBEDDED_H
#define EMBEDDED_H

#ifdef EMBEDDED_FLOAT
typedef float real;
#else
typedef double real;
#endif

typedef struct {
    int n, m;       /* variables, rows of A */
    int block;      /* variables of a control increment; 0: a start is not shifted */
    int changed;    /* 1: P, A, lb or ub of this step are new */
    int status;     /* written by the solver: 0 solved, else its own code */
    int iterations; /* written by the solver; -1: it counts none */
    int active;     /* written by the solver: rows of its working set; -1: it has none */
    int unused;
    real *P, *q, *A, *l, *u, *lb, *ub; /* n×n, n, m×n, m, m, n, n */
    real *z;                           /* n: written by the solver */
} embedded_qp;

#ifdef __cplusplus
extern "C" {
/* Construct static objects; the first call of a set-up in C++. */
void embedded_construct(void);
#endif

/* Set the solver up on the QP of the first step; returns 0, or what it refused. Not counted. */
int embedded_set_up(embedded_qp *qp);
/* Take a step's q, l and u, and what else changed, solve, and write z. Counted. */
int embedded_step(embedded_qp *qp);

#ifdef __cplusplus
}
#endif

#endif
