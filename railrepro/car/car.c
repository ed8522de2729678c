/* The car between its tables: look up where it is, evaluate its outputs, step. Starts after call.h, the generated functions
   car_coordinates, car_output and car_step, and the sizes of component.py. */

typedef struct {
  /* present state, and where a step writes the next one; commands of the motors, outputs, `equations.PARAMETERS` */
  double state[N_STATE], next[N_STATE], torque[WHEELS], measured[N_OUTPUT], parameters[N_PAR];
  /* length of a step (s) */
  double period;
  /* cells of the track at the bodies and of the contact table at the wheels, as looked up last */
  double rows[BODIES][N_CELL], contacts[WHEELS][N_CONTACT];
  const double *track, *profile;
  double track_start, track_step, profile_start, profile_step;
  casadi_int track_cells, profile_cells;
  /* steps in an advance, each with its look-up */
  casadi_int substeps;
} car_t;

/* Cells of all tables at the present state. */
void car_look_up(car_t *car) {
  double at[BODIES + WHEELS];
  const double *in[] = {car->state, *car->rows, car->parameters};
  double *out[] = {at};
  car_coordinates(in, out, 0, 0, 0);
  for (int i = 0; i < BODIES; ++i) {
    const double *row = row_at(car->track, at[i], car->track_start, car->track_step, car->track_cells, N_CELL);
    memcpy(car->rows[i], row, sizeof car->rows[i]);
  }
  for (int i = 0; i < WHEELS; ++i) {
    const double *row =
        row_at(car->profile, at[BODIES + i], car->profile_start, car->profile_step, car->profile_cells, N_CONTACT);
    memcpy(car->contacts[i], row, sizeof car->contacts[i]);
  }
}

/* Outputs at the present state. */
void car_measure(car_t *car) {
  car_look_up(car);
  const double *in[] = {car->state, car->torque, *car->rows, *car->contacts, car->parameters};
  double *out[] = {car->measured};
  car_output(in, out, 0, 0, 0);
}

static void next_state(car_t *car) {
  const double *in[] = {car->state, car->torque, *car->rows, *car->contacts, car->parameters, &car->period};
  double *out[] = {car->next, 0};  /* not the estimate of the error */
  car_step(in, out, 0, 0, 0);
}

/* One control cycle from where the car was looked up last. */
void car_advance(car_t *car) {
  for (casadi_int k = 0; k < car->substeps; ++k) {
    if (k) car_look_up(car);
    next_state(car);
    memcpy(car->state, car->next, sizeof car->state);
  }
}

/* Steps with held inputs, as long as each state stays below `largest`; returns how many were taken. */
casadi_int car_run(car_t *car, casadi_int n, double largest) {
  for (casadi_int k = 0; k < n; ++k) {
    car_look_up(car);
    next_state(car);
    for (int i = 0; i < N_STATE; ++i)
      if (!(fabs(car->next[i]) < largest)) return k;
    memcpy(car->state, car->next, sizeof car->state);
  }
  return n;
}
