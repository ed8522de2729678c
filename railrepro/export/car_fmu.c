/* The car as an FMU. Starts after car.c and the constants of the exported route, contact table and vehicle; fmi2.c
   follows. */

#define FMU_INPUTS car.torque
#define FMU_OUTPUTS car.measured
#define FMU_PARAMETERS parameters

typedef struct {
  car_t car;
  double parameters[N_PARAMETER];
  int told;
  const char *said;
} fmu_t;

static void reset(fmu_t *u) {
  memset(u, 0, sizeof *u);
  u->car = CAR, u->car.track = CELLS, u->car.profile = CONTACTS;
  memcpy(u->parameters, PARAMETERS, sizeof u->parameters), memcpy(u->car.parameters, PARAMETERS, sizeof u->car.parameters);
  memcpy(u->car.state, START, sizeof START);
  car_look_up(&u->car);  /* the look-up of contacts uses the irregularities of the rows found before */
  car_measure(&u->car);
}

/* At rest on its wheels as its parameters have it, and outputs before the first step. */
static void begin(fmu_t *u) {
  if (memcmp(u->parameters, PARAMETERS, sizeof u->parameters)) {
    const double *in[] = {u->parameters, u->parameters + PARAMETER_SPEED};
    double *out[] = {u->car.state};
    memcpy(u->car.parameters, u->parameters, sizeof u->car.parameters);
    car_rest(in, out, 0, 0, 0);
    car_look_up(&u->car);
  }
  car_measure(&u->car);
}

/* 0, 1 where a gear derailed, 3 where the step failed: the numbers of FMI 2.0, with `said`. */
static int advance(fmu_t *u, casadi_int steps) {
  const double *y = u->car.measured;
  u->said = "a state of the car left all bounds";
  if (car_run(&u->car, steps, LARGEST_STATE) < steps) return 3;
  car_measure(&u->car);
  if (u->told || (fabs(y[FRONT_Y]) < DERAILED && fabs(y[REAR_Y]) < DERAILED)) return 0;
  u->told = 1, u->said = "a gear derailed, what follows means nothing";
  return 1;
}
