/* The 1 kHz exchange between plant and fast control law: look up, measure, control, record, step.
   Knows nothing of railways: four generated functions that share buffers, and tables of cells. */

static int look_up(const call_t *coordinates, const double *places, const lookup_t *lookups, casadi_int n) {
  if (evaluate(coordinates)) return 1;
  for (casadi_int i = 0; i < n; ++i) {
    const lookup_t *t = lookups + i;
    const double *row = row_at(t->cells, places[i], t->start, t->step, t->n, t->width);
    memcpy(t->row, row, (size_t)t->width * sizeof(double));
  }
  return 0;
}

/* Outputs at the present state. */
int railrepro_measure(const call_t *calls, const double *places, const lookup_t *lookups, casadi_int n_lookups) {
  return look_up(calls, places, lookups, n_lookups) || evaluate(calls + 1);
}

/* calls: coordinates, output, law, step. Returns the number of finished exchanges; a margin that is not positive, a
   value that is not finite or a failing function ends the run before the step (its row is still in the log). */
casadi_int railrepro_run(casadi_int n_steps, const call_t *calls, const double *places, const lookup_t *lookups,
                         casadi_int n_lookups, const double *margins, casadi_int n_margins, const copy_t *log,
                         casadi_int n_log, double *rows, const copy_t *carry, casadi_int n_carry) {
  casadi_int width = 0;
  for (casadi_int i = 0; i < n_log; ++i) width += log[i].n;
  for (casadi_int k = 0; k < n_steps; ++k) {
    if (look_up(calls, places, lookups, n_lookups) || evaluate(calls + 1) || evaluate(calls + 2)) return k;
    double *row = rows + k * width;
    int finite = 1;
    for (casadi_int i = 0; i < n_log; ++i) {
      memcpy(row, log[i].from, (size_t)log[i].n * sizeof(double));
      for (casadi_int j = 0; j < log[i].n; ++j) finite = finite && isfinite(row[j]);
      row += log[i].n;
    }
    for (casadi_int i = 0; i < n_margins; ++i)
      if (!(margins[i] > 0)) return k;
    if (!finite || evaluate(calls + 3)) return k;
    for (casadi_int i = 0; i < n_carry; ++i)
      memcpy(carry[i].to, carry[i].from, (size_t)carry[i].n * sizeof(double));
  }
  return n_steps;
}
