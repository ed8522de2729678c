/* The car as an FMU. Starts after car.c and the constants of the exported route, contact table and vehicle; fmi2.c follows. */

#define FMU_INPUTS car.torque
#define FMU_OUTPUTS car.measured
#define FMU_PARAMETERS parameters
#define FMU_COUNT(u) 0

typedef struct {
  car_t car;
  double parameters[N_PARAMETER];
} fmu_t;

/* At rest on its wheels as its parameters have it, and outputs before the first step. */
static void begin(fmu_t *u) {
  const double *in[] = {u->parameters, u->parameters + PARAMETER_SPEED};
  double *out[] = {u->car.state};
  memcpy(u->car.parameters, u->parameters, sizeof u->car.parameters);
  car_rest(in, out, 0, 0, 0);
  car_look_up(&u->car);  /* the look-up of contacts uses the irregularities of the rows found before */
  car_measure(&u->car);
}

static void reset(fmu_t *u) {
  memset(u, 0, sizeof *u);
  u->car = CAR, u->car.track = CELLS, u->car.profile = CONTACTS;
  memcpy(u->parameters, PARAMETERS, sizeof u->parameters);
  begin(u);
}

/* NULL, or a sentence where the step failed. Finds its tables anew: u may be a copy. */
static const char *advance(fmu_t *u, casadi_int steps) {
  u->car.track = CELLS, u->car.profile = CONTACTS;
  for (casadi_int k = 0; k < steps; ++k) {
    car_advance(&u->car);
    for (int i = 0; i < N_STATE; ++i)
      if (!(fabs(u->car.state[i]) < LARGEST_STATE)) return "a state of the car left all bounds, what follows means nothing";
  }
  car_measure(&u->car);
  return NULL;
}
