/* The active-set method of the paper (eq. 30-32) for small dense quadratic programs.
 *
 *     minimise ½ zᵀP z + qᵀz   subject to   low ≤ C z ≤ high,   C = [I; A],   P positive definite
 *
 * C99, no allocation, no library but sqrt and fabs. Compile active_set_setup.c, which includes the
 * other files; active_set.c alone where P and A stay (active_set_place_step). The caller gives all memory:
 *
 *     active_set s;
 *     active_set_place(&s, n, m, reals, integers);     lengths: ACTIVE_SET_REALS, ACTIVE_SET_INTEGERS
 *     active_set_factorise(&s, P, A);                  once, and for every new P
 *     each step: write s.q, s.low, s.high;  active_set_solve(&s);  read s.z, s.lam
 *
 * Rows of C are numbered i = 0 … n+m−1: the bounds of the n variables, then the m rows of A. A
 * multiplier lam[i] is positive at high[i] and negative at low[i], so that P z + q + Cᵀlam = 0.
 * Compile with -DACTIVE_SET_FLOAT for single precision, and never with -ffast-math. */

#ifndef ACTIVE_SET_H
#define ACTIVE_SET_H

#include <stddef.h>

#ifdef ACTIVE_SET_FLOAT
typedef float as_real;
#else
typedef double as_real;
#endif

/* What a solve returns if it is not the number of iterations, 0 or more. */
enum {
    ACTIVE_SET_NOT_FINITE = -1, /* q or P⁻¹q is no number */
    ACTIVE_SET_CROSSED = -2,    /* low > high, or a limit is NaN */
    ACTIVE_SET_INFEASIBLE = -3, /* lam is a Farkas ray: by `refine` a proof, checked by multiplication */
    ACTIVE_SET_INACCURATE = -4, /* z is near an optimum, or rounding decides where that is */
    ACTIVE_SET_FAILED = -5      /* no usable z */
};

/* What active_set_factorise returns. */
enum { ACTIVE_SET_OK = 0, ACTIVE_SET_DATA_NOT_FINITE = 1, ACTIVE_SET_NOT_DEFINITE = 2 };

enum { ACTIVE_SET_CANDIDATES = 8 };

/* What a look at all rows finds: the rows not active that are beyond a limit by most over their
 * length, worst first, of those that are by more than noise and the rounding of the limit; whether
 * others are near one; whether one has two equal limits; whether limits cross. */
typedef struct {
    int count, near, equal, crossed, rows[ACTIVE_SET_CANDIDATES];
    as_real by[ACTIVE_SET_CANDIDATES];
} active_set_view;

typedef struct active_set active_set;
struct active_set { /* what is used most comes first: on Arm its offsets are shorter instructions */
    int n, m;         /* variables, rows of A */
    int count;        /* active rows */
    int iterations;   /* of the last solve: rows brought in or dropped */
    /* The step: written by the caller before a solve. */
    as_real *q;          /* n */
    as_real *low, *high; /* n+m; infinite where there is no limit */
    /* The answer. */
    as_real *z;   /* n+m: z, then A z */
    as_real *lam; /* n+m */
    /* Memory from step to step, and scratch. */
    as_real *base;       /* n: −P⁻¹q, the optimum without limits */
    as_real *L;          /* n(n+1)/2: Cholesky factor of H_WW, rows packed, 1/L_kk on it */
    int *active;         /* n: W, the active rows as they came */
    int *side;           /* n+m: +1 active at high, −1 at low, 0 not active */
    as_real *R, *T;      /* n, indexed as `active` */
    as_real *r, *e, *z_low, *lam_low, *r_low; /* n */
    as_real *from, *to;  /* n: of one part */
    /* Constants of P and A: may lie in read-only memory. */
    const as_real *G;    /* n+m × n, row i is (P⁻¹ c_i)ᵀ; the first n rows are P⁻¹ */
    const as_real *unit; /* n+m: 1/√H_ii, the length of a row in the norm of P⁻¹ */
    const as_real *a;    /* entries of A that are not zero, row after row */
    const int *column;   /* and their columns */
    const int *first;    /* m+1: where a row begins in these two */
    const int *parent;   /* m: a row before it whose entries begin those of this row; −1: none does */
    const int *rest;     /* m: its first entry after these */
    const int *order;    /* n: variables that P couples, part after part, then the rest */
    const int *sizes;    /* n: at the first variable of a part of this order, how many it has */
    const as_real *blocks; /* P⁻¹ of each part, one after the other: outside of them it is zero */
    const as_real *P;    /* n × n */
    int coupled;         /* how many variables P couples with others */
    int warm;            /* 1: start from the active set of the step before */
    int block;           /* variables of a control increment, by which hildreth.c moves its start */
    int stale;           /* 1: there is no set to start from */
    as_real longest, steepest, largest, widest; /* max √H_ii, Σ|P| of a row, max |A|, Σ|P⁻¹| of a row */
    as_real loss;        /* of a gradient of size 1, by rounding in P⁻¹ */
    active_set_view found; /* not on the stack, which is short on small computers */
    int (*refine)(active_set *, int); /* set by active_set_place; 0: no answer is refined */
};

/* Lengths of the two arrays that active_set_place divides, and of those of active_set_place_step. */
#define ACTIVE_SET_STEP_REALS(n, m) (4 * ((n) + (m)) + (n) * ((n) + 1) / 2 + 11 * (n))
#define ACTIVE_SET_STEP_INTEGERS(n, m) (2 * (n) + (m))
#define ACTIVE_SET_REALS(n, m) \
    (ACTIVE_SET_STEP_REALS(n, m) + ((n) + (m)) + (n) * (3 * (n) + 2 * (m)))
#define ACTIVE_SET_INTEGERS(n, m) \
    (ACTIVE_SET_STEP_INTEGERS(n, m) + 3 * (m) + 1 + 2 * (n) + (m) * (n))

void active_set_place(active_set *s, int n, int m, as_real *reals, int *integers);
/* Where P stays, its constants can be computed elsewhere and lie in read-only memory: give n, m and
 * all of them, place the memory of a step alone, and solve without active_set_factorise. active_set.c
 * is enough then, without `refine`, and P is not read: z is as good as P⁻¹ is, an answer whose active
 * rows are off their limits is INACCURATE, and a contradiction is found but not proved. */
void active_set_place_step(active_set *s, as_real *reals, int *integers);
/* Have answers refined after that, as active_set_place does: compile active_set_care.c instead. */
void active_set_let_refine(active_set *s);
int active_set_factorise(active_set *s, const as_real *P, const as_real *A);
/* New rows of A with the P of before; the active set stays. */
int active_set_replace_rows(active_set *s, const as_real *A);
int active_set_solve(active_set *s);
/* Residuals of z and lam over what is allowed: an optimum up to 1. */
as_real active_set_excess(active_set *s);
/* Whether lam proves that no z keeps the limits. */
int active_set_is_proof(active_set *s);

#endif
