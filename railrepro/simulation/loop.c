/* The 1 kHz control cycle between a car and a control law: measure, control, record, step. Knows nothing of either: functions
   from other shared objects and buffers that they share. Starts after call.h and the macros STATES and READINGS. */

/* A slower controller of one gear that is compiled code: torque held from its states, readings and base torque. `seen` has the
   addresses of states and readings. */
typedef struct {
  double (*sample)(void *, const double *, const double *, double);
  void *self;
  double *held;
  const double *base;
  const double *const *seen;
} planner_slot_t;

typedef struct { double *values; casadi_int n; } vector_t;

typedef struct {
  const void *car;
  int (*measure)(const void *);
  int (*advance)(const void *);
  call_t law;
  /* the law measures some of the car's outputs, whose addresses are in `sensed` */
  const double *const *sensed;
  vector_t measured;
  /* what the log keeps, and margins to the limits of the run */
  vector_t outputs, record, margins;
  /* from the law's next memory to its present one */
  copy_t carried;
  /* sampled every so many cycles */
  const planner_slot_t *planners;
  casadi_int n_planners, every;
} loop_t;

static void gather(double *to, const double *const *from, casadi_int n) {
  for (casadi_int i = 0; i < n; ++i) to[i] = *from[i];
}

static void plan(const planner_slot_t *slot) {
  double seen[STATES + READINGS];
  gather(seen, slot->seen, STATES + READINGS);
  *slot->held = slot->sample(slot->self, seen, seen + STATES, *slot->base);
}

/* Copies a vector into the log; whether all of it is finite. */
static int record(const vector_t *vector, double **row) {
  int finite = 1;
  for (casadi_int i = 0; i < vector->n; ++i) {
    *(*row)++ = vector->values[i];
    finite = finite && isfinite(vector->values[i]);
  }
  return finite;
}

/* Returns the number of finished control cycles; a margin that is not positive, a value that is not finite or a failing
   function ends the run before the step (its row is still in the log). */
casadi_int loop_run(const loop_t *loop, casadi_int n, double *row, casadi_int before) {
  for (casadi_int k = 0; k < n; ++k) {
    if (loop->measure(loop->car)) return k;
    if (loop->n_planners && (before + k) % loop->every == 0)
      for (casadi_int i = 0; i < loop->n_planners; ++i) plan(loop->planners + i);
    gather(loop->measured.values, loop->sensed, loop->measured.n);
    if (evaluate(&loop->law)) return k;
    int finite = record(&loop->outputs, &row);
    finite = record(&loop->record, &row) && finite;
    for (casadi_int i = 0; i < loop->margins.n; ++i)
      if (!(loop->margins.values[i] > 0)) return k;
    if (!finite || loop->advance(loop->car)) return k;
    memcpy(loop->carried.to, loop->carried.from, (size_t)loop->carried.n * sizeof(double));
  }
  return n;
}
