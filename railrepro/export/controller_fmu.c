/* A controller as an FMU. Starts after controller.c; fmi2.c follows. */

typedef struct {
  double inputs[N_INPUT], y[N_OUTPUT];
  double *parameters;  /* those of the controller */
  controller_t controller;
  double cells[N_CELLS * N_CELL_COLUMNS];
  const char *said;
} fmu_t;

static void connect(fmu_t *u) { u->parameters = u->controller.parameters; }

static void reset(fmu_t *u) {
  memset(u->inputs, 0, sizeof u->inputs);
  memset(u->y, 0, sizeof u->y);
  controller_reset(&u->controller);
}

static void begin(fmu_t *u) { controller_lay(&u->controller, u->cells), controller_start(&u->controller); }

/* What is measured is held for all cycles of a step. */
static int advance(fmu_t *u, casadi_int steps) {
  u->said = "the control law failed";
  memcpy(u->controller.measured, u->inputs, sizeof u->controller.measured);
  for (casadi_int k = 0; k < steps; ++k)
    if (controller_step(&u->controller)) return 3;
  memcpy(u->y, u->controller.torque, sizeof u->y);
  return 0;
}
