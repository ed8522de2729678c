/* The car between its tables: look up where it is, evaluate its outputs, step. Knows nothing of railways: three generated
   functions that share buffers, and tables of cells. Starts after call.h. */

typedef struct {
  call_t coordinates, output, step;
  /* places that `coordinates` finds, one for each look-up */
  const double *places;
  const lookup_t *lookups;
  casadi_int n_lookups;
  /* present state, and where `step` writes the next one */
  double *state;
  const double *next;
  casadi_int n_states;
  /* steps in an advance, each with its look-up */
  casadi_int substeps;
} car_t;

/* Cells of all tables at the present state. */
int car_look_up(const car_t *car) {
  if (evaluate(&car->coordinates)) return 1;
  for (casadi_int i = 0; i < car->n_lookups; ++i) {
    const lookup_t *t = car->lookups + i;
    const double *row = row_at(t->cells, car->places[i], t->start, t->step, t->n, t->width);
    memcpy(t->row, row, (size_t)t->width * sizeof(double));
  }
  return 0;
}

/* Outputs at the present state. */
int car_measure(const car_t *car) { return car_look_up(car) || evaluate(&car->output); }

/* One control cycle from where the car was looked up last. */
int car_advance(const car_t *car) {
  casadi_int k = 0;
  do {
    if ((k && car_look_up(car)) || evaluate(&car->step)) return 1;
    memcpy(car->state, car->next, (size_t)car->n_states * sizeof(double));
  } while (++k < car->substeps);
  return 0;
}

/* Steps with held inputs, as long as each state stays below `largest`; returns how many were taken. */
casadi_int car_run(const car_t *car, casadi_int n, double largest) {
  for (casadi_int k = 0; k < n; ++k) {
    if (car_look_up(car) || evaluate(&car->step)) return k;
    for (casadi_int i = 0; i < car->n_states; ++i)
      if (!(fabs(car->next[i]) < largest)) return k;
    memcpy(car->state, car->next, (size_t)car->n_states * sizeof(double));
  }
  return n;
}
