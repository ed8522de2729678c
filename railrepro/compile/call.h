/* Preamble of all hand-written C. Generated functions take arrays of pointers to their arguments and results; those of
   scalar operations need no memory. */

#include <math.h>
#include <string.h>

#ifndef casadi_int
#define casadi_int long long int
#endif
typedef int (*casadi_fn)(const double **, double **, casadi_int *, double *, int);

/* Row of the cell that contains the coordinate p; outside the table the first or last row, for NaN the first. */
static const double *row_at(const double *cells, double p, double start, double step, casadi_int n, casadi_int width) {
  double cell = floor((p - start) / step);
  if (!(cell > 0)) cell = 0;
  if (cell > (double)(n - 1)) cell = (double)(n - 1);
  return cells + (casadi_int)cell * width;
}

