/* The car as an FMU. It follows car.c and the constants of route, contact table and vehicle; fmi2.c follows it. */

#define FMU_INPUTS car.torque
#define FMU_OUTPUTS car.measured
#define FMU_PARAMETERS parameters
#define FMU_COUNT(u) 0

typedef struct {
  car_t car;
  double parameters[N_PARAMETER];
} fmu_t;

/* Start at rest on the wheels with the present parameters, and compute the outputs before the first step. */
static void begin(fmu_t *u) {
  const double *in[] = {u->parameters, u->parameters + PARAMETER_SPEED};
  double *out[] = {u->car.state};
  memcpy(u->car.parameters, u->parameters, sizeof u->car.parameters);
  car_rest(in, out, 0, 0, 0);
  car_look_up(&u->car);  /* a look-up uses the irregularities that the look-up before it found */
  car_measure(&u->car);
}

static void reset(fmu_t *u) {
  memset(u, 0, sizeof *u);
  u->car = CAR, u->car.track = CELLS, u->car.profile = CONTACTS;
  memcpy(u->parameters, PARAMETERS, sizeof u->parameters);
  begin(u);
}

/* Advance by steps of 1 ms. Returns NULL, or the reason of a failure. Sets its pointers to tables, as u may be a copy. */
static const char *advance(fmu_t *u, casadi_int steps) {
  u->car.track = CELLS, u->car.profile = CONTACTS;
  for (casadi_int k = 0; k < steps; ++k) {
    car_advance(&u->car);
    for (int i = 0; i < N_STATE; ++i)
      if (!(fabs(u->car.state[i]) < LARGEST_STATE)) return "a state of the car left all bounds: its outputs are meaningless";
  }
  car_measure(&u->car);
  return NULL;
}
