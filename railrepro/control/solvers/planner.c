/* A sample of a predictive controller of one gear, without memory allocation: the linear time-variant problem, one real-time
   iteration of the nonlinear problem, or its iterations until convergence. All loops are limited. When a problem is not solved
   or a value is not finite, the controller follows the plan of the sample before. It needs riccati.c, interior.c and the
   indices THETA_… of the track parameters. */

enum { LINEAR, REAL_TIME, CONVERGED };
enum { MOST_ITERATIONS = 30 };
/* Largest change of a torque at convergence (N m). */
static const double TOLERANCE = 1e-4;

/* Limit a torque to the bound of the sample. */
static double bounded(const horizon_t *h, double torque) {
  return fmin(fmax(torque, -h->bound), h->bound);
}

/* Set state and base torque of the horizon, and the bound of the differential torque at this speed. */
static void enter(horizon_t *h, const double *x, double u_d) {
  double limit;
  const double *of[] = {x + STATE_xdot, h->par, h->drive};
  double *to[] = {&limit};
  torque_limit(of, to, 0, 0, 0);
  memcpy(h->x_hat, x, sizeof h->x_hat);
  h->u_d = u_d;
  h->bound = h->yielding ? limit : fmax(limit - fabs(u_d), 0);
}

/* Torque of the plan of the sample before at stage k of this sample. */
static double planned(const horizon_t *h, casadi_int k) {
  return bounded(h, h->stage[k + 1 < h->steps ? k + 1 : k].plan);
}

/* Compute the forecast and the trajectory about which the model is linearised. For the linear problem it is centred riding
   along the forecast. Else it is the trajectory of the sample before, one step later, with the desired state at its end; a
   first sample has the desired states. Linearise if this is done only once per sample. */
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

/* Set the measured state, corrected by the observed offset, and the base torque. Prepare the problem if it is not prepared. */
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
  for (casadi_int k = 0; k < h->steps; ++k) h->stage[k].plan = planned(h, k);  /* if the problem is not solved */
}

/* Torque (N m) of the solved problem, or if it was not solved of the plan of the sample before. */
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

/* Full Newton steps until no torque changes and the trajectory obeys the model. The result is not 0 if they do not converge. */
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

/* A sample for the closed loop, of the type sample_t of slots.c: torque (N m) at a measured state and a base torque. The
   readings are not used. Real-time iteration then prepares the next sample at the predicted state. */
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
