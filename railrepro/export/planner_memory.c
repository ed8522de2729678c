/* Memory of a predictive controller. Its size is a constant. It follows planner.c and the constants of the settings. */

typedef struct {
  horizon_t h;
  stage_t stage[STEPS + 1];
} planner_memory_t;

static void planner_reset(planner_memory_t *m, int gear, const double *parameters) {
  memset(m, 0, sizeof *m), m->h = PLANNERS[gear], m->h.observer = parameters[PARAMETER_OBSERVER];
}

static void planner_link(planner_memory_t *m, int gear, const double *parameters, const double *cells) {
  m->h.nominal = parameters + PARAMETER_FORECAST_FRONT_ACCELERATION_PER_TORQUE + gear * N_NOMINAL;
  m->h.par = parameters + PARAMETER_BELIEF_M, m->h.tuning = parameters + PARAMETER_COST_Q_X;
  m->h.drive = parameters + DRIVE, m->h.cells = cells, m->h.stage = m->stage;
}
