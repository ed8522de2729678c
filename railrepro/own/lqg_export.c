/* The controllers of both gears in an exported one, see controller.c. Starts after lqg.c and its tables. */

typedef struct {
  lqg_t gear;
  double rails[2 * LQG_ROWS];
} planner_memory_t;

static void planner_reset(planner_memory_t *m, int gear, const double *parameters) {
  memset(m, 0, sizeof *m), m->gear = LQG_GEARS[gear];  /* its designs are tables */
}

static void planner_link(planner_memory_t *m, int gear, const double *parameters, const double *cells) {
  m->gear.designs = (const lqg_design_t *)LQG_DESIGNS, m->gear.route = cells, m->gear.rails = m->rails;
  if (gear == 0) m->gear.follower = &m[1].gear;
}

static double planner_sample(planner_memory_t *m, const double *state, const double *readings, double base) {
  return lqg_sample(&m->gear, state, readings, base);
}
