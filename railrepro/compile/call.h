/* A generated function with its memory, and a table of uniform cells; the one preamble of all hand-written C here. */

#include <math.h>
#include <string.h>

#ifndef casadi_int
#define casadi_int long long int
#endif
typedef int (*casadi_fn)(const double **, double **, casadi_int *, double *, int);
typedef struct { casadi_fn evaluate; const double **arg; double **res; casadi_int *iw; double *w; } call_t;
typedef struct {
  const double *cells;
  double start, step;
  casadi_int n, width;
  double *row;
} lookup_t;
typedef struct { double *to; const double *from; casadi_int n; } copy_t;

/* Row of the cell that holds coordinate p; outside the table the first or last one, the first also where p is NaN. */
static const double *row_at(const double *cells, double p, double start, double step, casadi_int n, casadi_int width) {
  double cell = floor((p - start) / step);
  if (!(cell > 0)) cell = 0;
  if (cell > (double)(n - 1)) cell = (double)(n - 1);
  return cells + (casadi_int)cell * width;
}

static int evaluate(const call_t *call) { return call->evaluate(call->arg, call->res, call->iw, call->w, 0); }

