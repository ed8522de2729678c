/* A sample of a predictive controller of one gear without allocation: the linear time-variant problem, real-time iteration
   of the nonlinear one, or its iterations until they converge. A sample has a largest time: active sets that do not settle
   are found by a limited number of interior points; when these fail, or a value is not finite, the plan of the sample
   before serves, one step later. Starts after riccati.c, interior.c and the indices of track parameters by name (THETA_…). */

enum { LINEAR, REAL_TIME, CONVERGED };
enum { MOST_ITERATIONS = 30 };
/* Converged when no torque moves by more than this (N m). */
static const double TOLERANCE = 1e-4;

/* Torque within the bound of the sample. */
static double bounded(const horizon_t *h, double torque) {
  return fmin(fmax(torque, -h->bound), h->bound);
}

/* Put a state and a base torque into the horizon, and the bound of the differential torque at its speed. */
static void enter(horizon_t *h, const double *x, double u_d) {
  double limit;
  const double *of[] = {x + STATE_xdot, h->par, h->drive};
  double *to[] = {&limit};
  torque_limit(of, to, 0, 0, 0);
  memcpy(h->x_hat, x, sizeof h->x_hat);
  h->u_d = u_d;
  h->bound = h->yielding ? limit : fmax(limit - fabs(u_d), 0);
}

/* Torque of the plan before at stage k of this sample, one step later. */
static double planned(const horizon_t *h, casadi_int k) {
  return bounded(h, h->stage[k + 1 < h->steps ? k + 1 : k].plan);
}

/* Forecast, and the trajectory about which the model is linearised, for the linear problem centred riding along the forecast;
   else that of the sample before, one step later, its end on the desired state, and at the start the desired states.
   Linearises when that is done once only. */
static void prepare(horizon_t *h) {
  horizon_forecast(h);
  for (casadi_int k = 0; k <= h->steps; ++k) {
    stage_t *s = h->stage + k;
    if (h->mode == LINEAR) {
      memset(s->x, 0, sizeof s->x), s->u = 0;
      s->x[STATE_x] = s->x_d[STATE_x], s->x[STATE_xdot] = s->x_d[STATE_xdot];
      s->x[STATE_psi_Ax] = h->affine * s->theta[THETA_psi_Tr];
      s->x[STATE_psidot_Ax] = h->affine * s->theta[THETA_dpsi_dp] * s->x_d[STATE_xdot];
    } else {
      memcpy(s->x, h->started && k < h->steps ? s[1].x : s->x_d, sizeof s->x);
      if (k < h->steps) s->u = planned(h, k);
    }
  }
  if (h->mode != LINEAR) memcpy(h->stage->x, h->x_hat, sizeof h->x_hat);
  if (h->mode != CONVERGED) horizon_linearise(h);
}

/* Take in the measured state, corrected by the observed offset, and the base torque; do what is not prepared yet. */
void planner_begin(horizon_t *h, const double *measured, double base) {
  const casadi_int prepared = h->mode == REAL_TIME && h->started;
  double *x = h->x_hat;
  enter(h, measured, h->informed ? base : 0);
  if (h->observer > 0) {
    if (h->started && x[STATE_xdot] > 1)
      h->offset += h->observer * (x[STATE_y_TrAx] - h->expected_y) / (x[STATE_xdot] * h->tuning[TUNING_period]);
    x[STATE_psi_TrAx] += h->offset;
  }
  if (!prepared) prepare(h);
  for (casadi_int k = 0; k < h->steps; ++k) h->stage[k].plan = planned(h, k);  /* serves when the problem is not solved */
}

/* Torque (N m) from the problem, or when it was not solved from the plan of the sample before. */
double planner_take(horizon_t *h, int failed) {
  stage_t *end = h->stage + h->steps;
  if (!failed && h->mode == REAL_TIME) horizon_apply(h);
  if (!failed) h->expected_y = h->stage[1].x[STATE_y_TrAx] + (h->mode == LINEAR ? h->stage[1].dx[STATE_y_TrAx] : 0);
  for (stage_t *s = h->stage; s < end; ++s) {
    if (failed) s->fixed = s[1].side = 0;
    s->plan = bounded(h, failed ? s->plan : h->mode == LINEAR ? s->du : s->u);
  }
  h->started = !failed;
  h->fallbacks += failed != 0;
  return h->stage->plan;
}

/* Newton iterations with full steps until no torque moves and the trajectory obeys the model; not 0 when they do not end. */
static int converge(horizon_t *h) {
  for (; h->iterations <= MOST_ITERATIONS; ++h->iterations) {
    horizon_linearise(h);
    if (horizon_solve(h)) return 1;
    double moved = 0, gap = 0;
    for (const stage_t *s = h->stage; s < h->stage + h->steps; ++s) {
      moved = fmax(moved, fabs(s->du));
      for (int i = 0; i < N; ++i) gap = fmax(gap, fabs(s->x_next[i] - s[1].x[i]));
    }
    horizon_apply(h);
    if (moved < TOLERANCE && gap < 1e-9) return 0;
  }
  h->iterations = MOST_ITERATIONS;
  return 1;
}

/* A sample as the closed loop asks for it, see sample_t of slots.c: torque (N m) at a measured state and a base torque.
   Readings are not needed, the states were made of them. Real-time iteration then prepares the next sample, at the state
   that it expects. */
double planner_sample(void *planner, const double *state, const double *readings, double base) {
  horizon_t *h = planner;
  (void)readings;
  planner_begin(h, state, base);
  h->iterations = 1;
  const double torque = planner_take(h, h->mode == CONVERGED ? converge(h) : horizon_solve(h));
  if (h->mode == REAL_TIME && h->started) {
    enter(h, h->stage[1].x, h->u_d);
    prepare(h);
  }
  return torque;
}
