/* The car with its tables: look up their rows, evaluate the outputs, step. Comes after call.h, the generated functions
   car_coordinates, car_output and car_step, and the sizes from component.py. */

typedef struct {
  /* present state and the one after a step; torque commands (N m), outputs, `equations.PARAMETERS` */
  double state[N_STATE], next[N_STATE], torque[WHEELS], measured[N_OUTPUT], parameters[N_PAR];
  /* length of a step (s) */
  double period;
  /* rows of the track at the bodies and of the contact table at the wheels, from the last look-up */
  double rows[BODIES][N_CELL], contacts[WHEELS][N_CONTACT];
  const double *track, *profile;
  double track_start, track_step, profile_start, profile_step;
  casadi_int track_cells, profile_cells;
  /* steps in a control cycle */
  casadi_int substeps;
} car_t;

/* Look up the rows of all tables at the present state. */
void car_look_up(car_t *car) {
  double at[BODIES + WHEELS];
  const double *in[] = {car->state, *car->rows, car->parameters};
  double *out[] = {at};
  car_coordinates(in, out, 0, 0, 0);
  for (int i = 0; i < BODIES; ++i)
    memcpy(car->rows[i], row_at(car->track, at[i], car->track_start, car->track_step, car->track_cells, N_CELL), sizeof *car->rows);
  const double start = car->profile_start, step = car->profile_step, *shift = at + BODIES;
  for (int i = 0; i < WHEELS; ++i)
    memcpy(car->contacts[i], row_at(car->profile, shift[i], start, step, car->profile_cells, N_CONTACT), sizeof *car->contacts);
}

/* Evaluate the outputs at the present state. */
void car_measure(car_t *car) {
  car_look_up(car);
  const double *in[] = {car->state, car->torque, *car->rows, *car->contacts, car->parameters};
  double *out[] = {car->measured};
  car_output(in, out, 0, 0, 0);
}

/* Compute the state after a step, with the rows from the last look-up, into `next`. */
void car_next(car_t *car) {
  const double *in[] = {car->state, car->torque, *car->rows, *car->contacts, car->parameters, &car->period};
  double *out[] = {car->next};
  car_step(in, out, 0, 0, 0);
}

/* Advance by one control cycle; its first step uses the rows from the last look-up. */
void car_advance(car_t *car) {
  for (casadi_int k = 0; k < car->substeps; ++k) {
    if (k) car_look_up(car);
    car_next(car);
    memcpy(car->state, car->next, sizeof car->state);
  }
}
