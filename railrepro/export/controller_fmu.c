/* A controller as an FMU. It follows controller.c; fmi2.c follows it. */

#define FMU_INPUTS measured
#define FMU_OUTPUTS torque
#define FMU_PARAMETERS parameters
#define FMU_COUNT FALLBACKS

typedef controller_t fmu_t;

static void reset(fmu_t *u) { controller_reset(u); }
static void begin(fmu_t *u) { controller_start(u); }

/* Advance by control cycles, in which the inputs are constant. Returns NULL, or the reason of a failure. */
static const char *advance(fmu_t *u, casadi_int steps) {
  for (casadi_int k = 0; k < steps; ++k)
    if (controller_step(u) > CONTROLLER_FELL_BACK) return "the control law gave no finite number: all torques are 0";
  return NULL;
}
