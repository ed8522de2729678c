/* A sample of a predictive controller of one gear without allocation: the linear time-variant problem, real-time iteration
   of the nonlinear one, or its iterations until they converge. A sample has a largest time: active sets that do not settle
   are found by a limited number of interior points; when these fail, or a value is not finite, the plan of the sample
   before serves, one step later. Starts after riccati.c, interior.c and the indices of track parameters by name (THETA_…). */

enum { LINEAR, REAL_TIME, CONVERGED };
enum { MOST_ITERATIONS = 30 };
/* Converged when no torque moves by more than this (N m). */
static const double TOLERANCE = 1e-4;

typedef struct {
  horizon_t *h;
  /* torques (N m) of the plan */
  double *plan;
  /* torque limit of a motor over the speed, from the numbers of the drive */
  call_t limit;
  const double *drive;
  double observer, torque_limit;
  casadi_int yielding, informed, mode;
  /* observed offset of the yaw angle, lateral position that is expected next */
  double offset, expected_y;
  /* whether the last sample was solved, so that the next one starts from it; its iterations; samples that were not */
  casadi_int started, iterations, fallbacks;
} planner_t;

/* Torque within the bound of the sample. */
static double bounded(const horizon_t *h, double torque) {
  return fmin(fmax(torque, -h->bound), h->bound);
}

/* Torque limit of a motor (N m) at a speed (m/s). */
static double limit_at(const planner_t *p, double speed) {
  double limit = 0;
  const double *of[] = {&speed, p->h->par, p->drive};
  double *to[] = {&limit};
  return call(&p->limit, of, 3, to, 1) ? 0 : limit;
}

/* Put a state and a base torque into the horizon; the state may be one of its trajectory. */
static void enter(const planner_t *p, const double *x, double u_d) {
  memmove(p->h->x_hat, x, N * sizeof(double));
  p->h->u_d = u_d;
  p->h->bound = p->yielding ? p->torque_limit : fmax(p->torque_limit - fabs(u_d), 0);
}

/* Centred riding along the forecast, about which the linear problem linearises. */
static void ride(const horizon_t *h) {
  memset(h->x, 0, (size_t)(h->steps + 1) * N * sizeof(double)), memset(h->u, 0, (size_t)h->steps * sizeof(double));
  for (casadi_int k = 0; k <= h->steps; ++k) {
    double *at = h->x + k * N;
    const double *to = h->x_d + k * N, *track = h->theta + k * N_THETA;
    at[STATE_x] = to[STATE_x], at[STATE_xdot] = to[STATE_xdot];
    if (h->affine) at[STATE_psi_Ax] = track[THETA_psi_Tr], at[STATE_psidot_Ax] = track[THETA_dpsi_dp] * to[STATE_xdot];
  }
}

/* Torque of the plan before at stage k of this sample, one step later. */
static double planned(const planner_t *p, casadi_int k) {
  return bounded(p->h, p->plan[k + 1 < p->h->steps ? k + 1 : k]);
}

/* Trajectory and torques of the sample before one step later, its end on the desired state; the desired states at the
   start. */
static void start_warm(const planner_t *p) {
  const horizon_t *h = p->h;
  if (p->started) {
    memmove(h->x, h->x + N, (size_t)h->steps * N * sizeof(double));
    memcpy(h->x + h->steps * N, h->x_d + h->steps * N, N * sizeof(double));
  } else
    memcpy(h->x, h->x_d, (size_t)(h->steps + 1) * N * sizeof(double));
  memcpy(h->x, h->x_hat, N * sizeof(double));
  for (casadi_int k = 0; k < h->steps; ++k) h->u[k] = planned(p, k);
}

/* Forecast and trajectory of the sample whose state has been entered, linearised when that is done once only. */
static void prepare(const planner_t *p) {
  const horizon_t *h = p->h;
  horizon_forecast(h);
  if (p->mode == LINEAR)
    ride(h);
  else
    start_warm(p);
  if (p->mode != CONVERGED) horizon_linearise(h);
}

/* Take in the measured state, corrected by the observed offset, and the base torque; do what is not prepared yet. */
void planner_begin(planner_t *p, const double *measured, double base) {
  const casadi_int prepared = p->mode == REAL_TIME && p->started;
  double x[N];
  memcpy(x, measured, sizeof x);
  p->torque_limit = limit_at(p, x[STATE_xdot]);
  if (p->observer > 0) {
    if (p->started && x[STATE_xdot] > 1)
      p->offset += p->observer * (x[STATE_y_TrAx] - p->expected_y) / (x[STATE_xdot] * p->h->tuning[TUNING_period]);
    x[STATE_psi_TrAx] += p->offset;
  }
  enter(p, x, p->informed ? base : 0);
  if (!prepared) prepare(p);
  for (casadi_int k = 0; k < p->h->steps; ++k) p->plan[k] = planned(p, k);  /* serves when the problem is not solved */
}

/* Torque (N m) from the problem, or when it was not solved from the plan of the sample before. */
double planner_take(planner_t *p, int failed) {
  const horizon_t *h = p->h;
  if (failed) {
    memset(h->fixed, 0, (size_t)h->steps * sizeof(double)), memset(h->side, 0, (size_t)(h->steps + 1) * sizeof(double));
  } else {
    if (p->mode == REAL_TIME) horizon_apply(h);
    memcpy(p->plan, p->mode == LINEAR ? h->du : h->u, (size_t)h->steps * sizeof(double));
    p->expected_y = h->x[N + STATE_y_TrAx] + (p->mode == LINEAR ? h->dx[N + STATE_y_TrAx] : 0);
  }
  for (casadi_int k = 0; k < h->steps; ++k) p->plan[k] = bounded(h, p->plan[k]);
  p->started = !failed;
  p->fallbacks += failed != 0;
  return p->plan[0];
}

/* Newton iterations with full steps until no torque moves and the trajectory obeys the model; not 0 when they do not end. */
static int converge(planner_t *p) {
  const horizon_t *h = p->h;
  for (; p->iterations <= MOST_ITERATIONS; ++p->iterations) {
    horizon_linearise(h);
    if (horizon_solve(h)) return 1;
    double moved = 0, gap = 0;
    for (casadi_int k = 0; k < h->steps; ++k) {
      moved = fmax(moved, fabs(h->du[k]));
      for (int i = 0; i < N; ++i) gap = fmax(gap, fabs(h->x_next[k * N + i] - h->x[(k + 1) * N + i]));
    }
    horizon_apply(h);
    if (moved < TOLERANCE && gap < 1e-9) return 0;
  }
  p->iterations = MOST_ITERATIONS;
  return 1;
}

/* Torque (N m) at a measured state and a base torque. */
double planner_plan(planner_t *p, const double *measured, double base) {
  planner_begin(p, measured, base);
  p->iterations = 1;
  return planner_take(p, p->mode == CONVERGED ? converge(p) : horizon_solve(p->h));
}

/* What of the next sample can be done before its state is measured: real-time iteration expects the planned one. */
void planner_prepare(planner_t *p) {
  if (p->mode != REAL_TIME || !p->started) return;
  enter(p, p->h->x + N, p->h->u_d);
  prepare(p);
}

/* A sample as the closed loop asks for it, see planner_slot_t of loop.c; readings are not needed, the states were made of
   them. */
double planner_sample(void *planner, const double *state, const double *readings, double base) {
  (void)readings;
  const double torque = planner_plan(planner, state, base);
  planner_prepare(planner);
  return torque;
}
