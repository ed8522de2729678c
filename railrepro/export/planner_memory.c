/* The memory of a planner and of its horizon, of a size that is known when it is compiled. Starts after planner.c and the
   constants of the settings. */

enum { FUNCTIONS = 10 };

typedef struct {
  planner_t p;
  horizon_t h;
  double x_hat[N], x_d[(STEPS + 1) * N], theta[(STEPS + 1) * N_THETA], x[(STEPS + 1) * N], u[STEPS], plan[STEPS];
  double x_next[STEPS * N], a[STEPS * N_A], b[STEPS * N], cost_matrix[(STEPS + 1) * N * N], cost_vector[(STEPS + 1) * N];
  double feedback[STEPS * N], feedforward[STEPS], dx[(STEPS + 1) * N], du[STEPS], slope[STEPS], fixed[STEPS];
  double side[STEPS + 1], inner[BOUNDS * STEPS], slack[BOUNDS * STEPS], multiplier[BOUNDS * STEPS];
  double slack_step[BOUNDS * STEPS], multiplier_step[BOUNDS * STEPS], target[BOUNDS * STEPS], barrier[BOUNDS * (STEPS + 1)], passes;
  const double *arg[FUNCTIONS][PLAN_ARG];
  double *res[FUNCTIONS][PLAN_RES];
  casadi_int iw[FUNCTIONS][PLAN_IW + 1];
  double w[FUNCTIONS][PLAN_W + 1];
} planner_memory_t;

static void planner_reset(planner_memory_t *m, int gear, const double *parameters, const double *cells) {
  static const casadi_fn functions[FUNCTIONS] = {preview_position, preview_stage,     riccati_terminal, riccati_backward,
                                                 riccati_forward,  barrier_stiffness, barrier_terminal, barrier_backward,
                                                 barrier_again,    torque_limit};
  memset(m, 0, sizeof *m);
  call_t calls[FUNCTIONS];
  for (int i = 0; i < FUNCTIONS; ++i) calls[i] = (call_t){functions[i], m->arg[i], m->res[i], m->iw[i], m->w[i]};
  m->h = (horizon_t){STEPS, N_CELLS, MOST_SETS, CELL_START, CELL_STEP, cells,
                     calls[0], calls[1], calls[2], calls[3], calls[4], calls[5], calls[6], calls[7], calls[8],
                     m->x_hat, parameters + PARAMETER_FORECAST_FRONT_ACCELERATION_PER_TORQUE + gear * N_NOMINAL,
                     parameters + PARAMETER_BELIEF_M, parameters + PARAMETER_COST_Q_X, 0, 0, AFFINE,
                     m->x_d, m->theta, m->x, m->u, m->x_next, m->a, m->b, m->cost_matrix, m->cost_vector,
                     m->feedback, m->feedforward, m->dx, m->du, m->slope, m->fixed, m->side,
                     m->inner, m->slack, m->multiplier, m->slack_step, m->multiplier_step, m->target, m->barrier,
                     &m->passes};
  m->p = (planner_t){&m->h, m->plan, calls[9], parameters + DRIVE, parameters[PARAMETER_OBSERVER], 0,
                     YIELDING, INFORMED, MODE, 0, 0, 0, 0, 0};
}
