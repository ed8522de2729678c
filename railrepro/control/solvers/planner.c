/* A sample of a predictive controller of one gear without allocation: real-time iteration of the nonlinear problem, or the
   linear time-variant one. A sample has a largest time: active sets that do not settle are found by a limited number of
   interior points; when these fail, or a value is not finite, the plan of before serves, one sample later.
   Starts after riccati.c, interior.c and the places of track parameters by name (THETA_…). */

typedef struct {
  horizon_t *h;
  /* measured state in the horizon, torques (N m) of the plan */
  double *x_hat, *plan;
  double observer, torque_limit;
  casadi_int yielding, informed, linear;
  /* observed offset of the yaw angle, lateral position that is expected next */
  double offset, expected_y;
  casadi_int started, expected;
} planner_t;

/* Put a state, a base torque and the forecast from there into the horizon. */
static void look_ahead(const planner_t *p, const double *x, double u_d) {
  memmove(p->x_hat, x, N * sizeof(double));
  p->h->u_d = u_d, p->h->bound = p->yielding ? p->torque_limit : fmax(p->torque_limit - fabs(u_d), 0);
  horizon_forecast(p->h);
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

/* Linearise for a sample, about the trajectory of before one sample later, its end on the desired state. */
static void prepare(const planner_t *p, const double *expected, double u_d) {
  const horizon_t *h = p->h;
  double x[N];
  memcpy(x, expected, sizeof x);
  look_ahead(p, x, u_d);
  if (p->started) {
    memmove(h->x, h->x + N, (size_t)h->steps * N * sizeof(double));
    memcpy(h->x + h->steps * N, h->x_d + h->steps * N, N * sizeof(double));
  } else
    memcpy(h->x, h->x_d, (size_t)(h->steps + 1) * N * sizeof(double));
  memcpy(h->x, x, sizeof x);
  memmove(h->u, h->u + 1, (size_t)(h->steps - 1) * sizeof(double));
  horizon_linearise(h);
}

/* Solve the problem of a measured state and a base torque; returns like horizon_solve. */
int planner_solve(planner_t *p, const double *measured, double base) {
  double x[N], u_d = p->informed ? base : 0;
  memcpy(x, measured, sizeof x);
  if (p->observer > 0) {
    if (p->expected && x[STATE_xdot] > 1)
      p->offset += p->observer * (x[STATE_y_TrAx] - p->expected_y) / (x[STATE_xdot] * p->h->tuning[TUNING_period]);
    x[STATE_psi_TrAx] += p->offset;
  }
  if (p->linear) {
    look_ahead(p, x, u_d);
    ride(p->h);
    horizon_linearise(p->h);
  } else {
    if (!p->started) prepare(p, x, u_d);
    memcpy(p->x_hat, x, sizeof x);
    p->h->u_d = u_d, p->h->bound = p->yielding ? p->torque_limit : fmax(p->torque_limit - fabs(u_d), 0);
  }
  return horizon_solve(p->h);
}

/* Torque (N m) from a solved problem, or with code != 0 from the plan of before. */
double planner_take(planner_t *p, int code) {
  const horizon_t *h = p->h;
  const double *next = h->x + N;
  if (code) memset(h->fixed, 0, (size_t)h->steps * sizeof(double)), memset(h->side, 0, (size_t)(h->steps + 1) * sizeof(double));
  if (p->linear) {
    memmove(p->plan, p->plan + 1, (size_t)(h->steps - 1) * sizeof(double));
    for (casadi_int k = 0; k < h->steps; ++k) p->plan[k] = fmin(fmax(code ? p->plan[k] : h->du[k], -h->bound), h->bound);
  } else {
    if (!code) horizon_apply(h);
    for (casadi_int k = 0; k < h->steps; ++k) p->plan[k] = h->u[k] = fmin(fmax(h->u[k], -h->bound), h->bound);
  }
  p->started = p->expected = !code;
  p->expected_y = next[STATE_y_TrAx] + (p->linear ? h->dx[N + STATE_y_TrAx] : 0);
  return p->plan[0];
}

/* What of the next sample can be done before its state is measured. */
void planner_prepare(planner_t *p) {
  if (!p->linear && p->started) prepare(p, p->h->x + N, p->h->u_d);
}
