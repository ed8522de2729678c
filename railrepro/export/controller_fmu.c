/* A controller as an FMU. Starts after controller.c; fmi2.c follows. */

#define FMU_INPUTS controller.measured
#define FMU_OUTPUTS controller.torque
#define FMU_PARAMETERS controller.parameters

typedef struct {
  controller_t controller;
  double cells[N_CELLS * N_CELL_COLUMNS];
  const char *said;
} fmu_t;

static void reset(fmu_t *u) { controller_reset(&u->controller); }

static void begin(fmu_t *u) { controller_lay(&u->controller, u->cells), controller_start(&u->controller); }

/* What is measured is held for all cycles of a step. */
static int advance(fmu_t *u, casadi_int steps) {
  u->said = "the control law failed";
  for (casadi_int k = 0; k < steps; ++k)
    if (controller_step(&u->controller)) return 3;
  return 0;
}
