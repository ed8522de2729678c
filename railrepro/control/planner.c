/* A predictive controller of one gear without allocation: real-time iteration of the nonlinear problem, or the linear
   time-variant one, as railrepro.control.nmpc and ltv_mpc do it. A sample has a largest time: active sets that do not settle
   are found by a limited number of interior points; when these fail, or a value is not finite, the plan of before serves,
   one sample later. Starts after riccati.c, interior.c and the constants of the settings. */

enum { FUNCTIONS = 9 };

typedef struct {
  horizon_t h;
  double x_hat[N], offset, expected_y;
  int started, expected;
  casadi_int failures;
  double x_d[(STEPS + 1) * N], theta[(STEPS + 1) * N_THETA], x[(STEPS + 1) * N], u[STEPS], plan[STEPS];
  double x_next[STEPS * N], a[STEPS * N_A], b[STEPS * N], cost_matrix[(STEPS + 1) * N * N], cost_vector[(STEPS + 1) * N];
  double feedback[STEPS * N], feedforward[STEPS], dx[(STEPS + 1) * N], du[STEPS], slope[STEPS], fixed[STEPS];
  double side[STEPS + 1], inner[BOUNDS * STEPS], room[BOUNDS * STEPS], force[BOUNDS * STEPS], room_step[BOUNDS * STEPS];
  double force_step[BOUNDS * STEPS], target[BOUNDS * STEPS], stands[BOUNDS * (STEPS + 1)], passes;
  const double *arg[FUNCTIONS][PLAN_ARG];
  double *res[FUNCTIONS][PLAN_RES];
  casadi_int iw[FUNCTIONS][PLAN_IW + 1];
  double w[FUNCTIONS][PLAN_W + 1];
} planner_t;

static void planner_reset(planner_t *p, int gear) {
  static const casadi_fn functions[FUNCTIONS] = {preview_place,   preview_stage,     riccati_terminal, riccati_backward,
                                                 riccati_forward, barrier_stiffness, barrier_terminal, barrier_backward,
                                                 barrier_again};
  memset(p, 0, sizeof *p);
  call_t calls[FUNCTIONS];
  for (int i = 0; i < FUNCTIONS; ++i) calls[i] = (call_t){functions[i], p->arg[i], p->res[i], p->iw[i], p->w[i]};
  p->h = (horizon_t){STEPS, N_CELLS, MOST_SETS, CELL_START, CELL_STEP, CELLS,
                     calls[0], calls[1], calls[2], calls[3], calls[4], calls[5], calls[6], calls[7], calls[8],
                     p->x_hat, NOMINAL + gear * N_NOMINAL, MODEL, TUNING, 0, 0, AFFINE,
                     p->x_d, p->theta, p->x, p->u, p->x_next, p->a, p->b, p->cost_matrix, p->cost_vector,
                     p->feedback, p->feedforward, p->dx, p->du, p->slope, p->fixed, p->side,
                     p->inner, p->room, p->force, p->room_step, p->force_step, p->target, p->stands, &p->passes};
}

static double torque_bound(double u_d) { return YIELDING ? TORQUE_LIMIT : fmax(TORQUE_LIMIT - fabs(u_d), 0); }

/* Put a state, a base torque and the forecast from there into the horizon. */
static int look_ahead(planner_t *p, const double *x, double u_d) {
  memmove(p->x_hat, x, sizeof p->x_hat);
  p->h.u_d = u_d, p->h.bound = torque_bound(u_d);
  return horizon_forecast(&p->h);
}

static void clip(planner_t *p) {
  for (int k = 0; k < STEPS; ++k) p->u[k] = fmin(fmax(p->u[k], -p->h.bound), p->h.bound);
}

static int failed(planner_t *p) {
  memset(p->fixed, 0, sizeof p->fixed), memset(p->side, 0, sizeof p->side);
  return ++p->failures, 1;
}

/* State with the yaw angle corrected by the observed offset. */
static void observe(planner_t *p, double *x) {
  if (OBSERVER <= 0) return;
  if (p->expected && x[STATE_xdot] > 1) p->offset += OBSERVER * (x[STATE_y_TrAx] - p->expected_y) / (x[STATE_xdot] * PLAN_PERIOD);
  x[STATE_psi_TrAx] += p->offset;
}

#ifdef LINEAR

/* Differential torque (N m) from measured states and base torque: the model in centred riding along the forecast. */
static double planner_plan(planner_t *p, const double *measured, double base) {
  double x[N], start[STEPS];
  memcpy(x, measured, sizeof x);
  observe(p, x);
  int bad = look_ahead(p, x, INFORMED ? base : 0);
  memcpy(start, p->plan, sizeof start);
  memmove(start, start + 1, (STEPS - 1) * sizeof(double));
  memset(p->x, 0, sizeof p->x), memset(p->u, 0, sizeof p->u);
  for (int k = 0; k <= STEPS; ++k) {
    double *at = p->x + k * N;
    const double *to = p->x_d + k * N, *road = p->theta + k * N_THETA;
    at[STATE_x] = to[STATE_x], at[STATE_xdot] = to[STATE_xdot];
    if (AFFINE) at[STATE_psi_Ax] = road[THETA_psi_Tr], at[STATE_psidot_Ax] = road[THETA_dpsi_dp] * to[STATE_xdot];
  }
  horizon_linearise(&p->h);
  bad = bad || horizon_solve(&p->h) ? failed(p) : 0;
  for (int k = 0; k < STEPS; ++k) p->plan[k] = fmin(fmax(bad ? start[k] : p->du[k], -p->h.bound), p->h.bound);
  p->expected = !bad;
  p->expected_y = p->x[N + STATE_y_TrAx] + p->dx[N + STATE_y_TrAx];
  return p->plan[0];
}

#else

static void prepare(planner_t *p, const double *expected, double u_d) {
  double x[N];
  memcpy(x, expected, sizeof x);
  look_ahead(p, x, u_d);
  if (p->started) {
    memmove(p->x, p->x + N, STEPS * N * sizeof(double));
    memcpy(p->x + STEPS * N, p->x_d + STEPS * N, N * sizeof(double));
  } else
    memcpy(p->x, p->x_d, sizeof p->x);
  memcpy(p->x, x, sizeof x);
  memmove(p->u, p->u + 1, (STEPS - 1) * sizeof(double));
  horizon_linearise(&p->h);
}

/* Differential torque (N m) from measured states and base torque. */
static double planner_plan(planner_t *p, const double *measured, double base) {
  const double u_d = INFORMED ? base : 0;
  double x[N];
  memcpy(x, measured, sizeof x);
  observe(p, x);
  if (!p->started) prepare(p, x, u_d);
  memcpy(p->x_hat, x, sizeof x);
  p->h.u_d = u_d, p->h.bound = torque_bound(u_d);
  if (horizon_solve(&p->h))
    clip(p), p->started = 0, failed(p);
  else
    horizon_apply(&p->h), p->started = 1;
  const double torque = p->u[0];
  p->expected = p->started;
  if (p->started) {
    double expected[N];
    memcpy(expected, p->x + N, sizeof expected);
    p->expected_y = expected[STATE_y_TrAx];
    prepare(p, expected, u_d);
  }
  return torque;
}

#endif
