/* The car as an FMU. Starts after car.c and the constants of the exported route, contact table and vehicle; fmi2.c
   follows. */

enum { LOOKUPS = BODIES + WHEELS, POINTERS = 16, INTEGERS = 256, WORK = 65536 };

typedef struct {
  double x[N_STATE], next[N_STATE], error[N_STATE], inputs[N_INPUT], y[N_OUTPUT], places[LOOKUPS], period;
  double rows[BODIES * N_CELL], contacts[WHEELS * N_CONTACT], parameters[N_PARAMETER];
  lookup_t lookups[LOOKUPS];
  const double *in[3][POINTERS];
  double *out[3][POINTERS];
  casadi_int integers[INTEGERS];
  double work[WORK];
  car_t car;
  int told;
  const char *said;
} fmu_t;

static call_t bind(fmu_t *u, int function, casadi_fn evaluate) {
  return (call_t){evaluate, u->in[function], u->out[function], u->integers, u->work};
}

/* Let the generated functions share the buffers of the FMU. */
static void connect(fmu_t *u) {
  const double *in[3][6] = {{u->x, u->rows, u->parameters},
                            {u->x, u->inputs, u->rows, u->contacts, u->parameters},
                            {u->x, u->inputs, u->rows, u->contacts, u->parameters, &u->period}};
  double *out[3][2] = {{u->places}, {u->y}, {u->next, u->error}};
  for (int i = 0; i < 3; ++i) memcpy(u->in[i], in[i], sizeof in[i]), memcpy(u->out[i], out[i], sizeof out[i]);
  for (int i = 0; i < BODIES; ++i)
    u->lookups[i] = (lookup_t){CELLS, CELL_START, CELL_STEP, N_CELLS, N_CELL, u->rows + i * N_CELL};
  for (int i = 0; i < WHEELS; ++i)
    u->lookups[BODIES + i] =
        (lookup_t){CONTACTS, CONTACT_START, CONTACT_STEP, N_CONTACTS, N_CONTACT, u->contacts + i * N_CONTACT};
  u->car = (car_t){bind(u, 0, car_coordinates), bind(u, 1, car_output), bind(u, 2, car_step),
                   u->places, u->lookups, LOOKUPS, u->x, u->next, N_STATE};
}

static void reset(fmu_t *u) {
  memcpy(u->x, START, sizeof u->x);
  memcpy(u->parameters, PARAMETERS, sizeof u->parameters);
  memset(u->inputs, 0, sizeof u->inputs);
  memset(u->rows, 0, sizeof u->rows);
  u->period = PERIOD, u->told = 0;
  car_look_up(&u->car);  /* the look-up of contacts uses the irregularities of the rows found before */
  car_measure(&u->car);
}

/* At rest on its wheels as its parameters have it, and outputs before the first step. */
static void begin(fmu_t *u) {
  if (memcmp(u->parameters, PARAMETERS, sizeof u->parameters)) {
    const double *in[POINTERS] = {u->parameters, u->parameters + PARAMETER_SPEED};
    double *out[POINTERS] = {u->x};
    car_rest(in, out, u->integers, u->work, 0);
    car_look_up(&u->car);
  }
  car_measure(&u->car);
}

/* 0, 1 where a gear derailed, 3 where the step failed: the numbers of FMI 2.0, with `said`. */
static int advance(fmu_t *u, casadi_int steps) {
  u->said = "a state of the car left all bounds";
  if (car_run(&u->car, steps, LARGEST_STATE) < steps) return 3;
  car_measure(&u->car);
  if (u->told || (fabs(u->y[FRONT_Y]) < DERAILED && fabs(u->y[REAR_Y]) < DERAILED)) return 0;
  u->told = 1, u->said = "a gear derailed, what follows means nothing";
  return 1;
}
