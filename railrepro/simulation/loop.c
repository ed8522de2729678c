/* The 1 kHz control cycle between a car and a control law: measure, control, record, step. Knows nothing of either: functions
   from other shared objects and buffers that they share. Starts after call.h. */

/* A slower controller of one gear that is compiled code: torque held from its state, readings and base torque. */
typedef struct {
  double (*sample)(void *, const double *, const double *, double);
  void *self;
  const double *state, *read, *base;
  double *held;
} planner_slot_t;

typedef struct {
  const void *car;
  int (*measure)(const void *);
  int (*advance)(const void *);
  call_t law;
  /* from the car's outputs to the law, from both to the log, from the law's next memory to its present one */
  const copy_t *sensed, *logged, *carried;
  casadi_int n_sensed, n_logged, n_carried;
  const double *margins;
  casadi_int n_margins;
  /* what the slower controllers see in the first cycle and later ones; they are sampled every so many cycles */
  const copy_t *first, *later;
  casadi_int n_first, n_later;
  const planner_slot_t *planners;
  casadi_int n_planners, every;
} loop_t;

static void copy(const copy_t *copies, casadi_int n) {
  for (casadi_int i = 0; i < n; ++i) memcpy(copies[i].to, copies[i].from, (size_t)copies[i].n * sizeof(double));
}

/* Returns the number of finished control cycles; a margin that is not positive, a value that is not finite or a failing
   function ends the run before the step (its row is still in the log). */
casadi_int loop_run(const loop_t *loop, casadi_int n, double *row, casadi_int before) {
  for (casadi_int k = 0; k < n; ++k) {
    if (loop->measure(loop->car)) return k;
    if (loop->n_planners && (before + k) % loop->every == 0) {
      before + k ? copy(loop->later, loop->n_later) : copy(loop->first, loop->n_first);
      for (casadi_int i = 0; i < loop->n_planners; ++i) {
        const planner_slot_t *p = loop->planners + i;
        *p->held = p->sample(p->self, p->state, p->read, *p->base);
      }
    }
    copy(loop->sensed, loop->n_sensed);
    if (evaluate(&loop->law)) return k;
    int finite = 1;
    for (casadi_int i = 0; i < loop->n_logged; ++i) {
      const copy_t *log = loop->logged + i;
      memcpy(row, log->from, (size_t)log->n * sizeof(double));
      for (casadi_int j = 0; j < log->n; ++j) finite = finite && isfinite(row[j]);
      row += log->n;
    }
    for (casadi_int i = 0; i < loop->n_margins; ++i)
      if (!(loop->margins[i] > 0)) return k;
    if (!finite || loop->advance(loop->car)) return k;
    copy(loop->carried, loop->n_carried);
  }
  return n;
}
