/* Steps of a sample of a predictive controller: forecast, linearisation along the horizon, and a Riccati recursion inside an
   active-set method for the quadratic problem. It needs call.h, lanes.h, the generated functions of riccati.py, the prediction
   model prediction_lanes, the indices STATE_… and TUNING_…, and the numbers of states N, of track parameters N_THETA, of bounds
   of a stage BOUNDS, of columns of a cell N_CELL and of entries of the matrix A N_A, with the length of a cell CELL_STEP. */

enum { FREE = 0, LOW = -1, HIGH = 1 };

typedef struct {
  /* forecast, trajectory, torque of the plan (N m) */
  double x_d[N], theta[N_THETA], x[N], u, plan;
  /* model along the trajectory */
  double x_next[N], a[N_A], b[N];
  /* recursion: cost-to-go, feedback, feed-forward, steps, derivative of the cost by the torque, active bounds */
  double cost_matrix[N * N], cost_vector[N], feedback[N], feedforward, dx[N], du, slope, fixed, side;
  /* interior.c: for each bound the step of the bounded quantity, slack and multiplier with their steps, and the target of their
     product; weights and slopes that represent the bounds in the recursion */
  double inner[BOUNDS], slack[BOUNDS], multiplier[BOUNDS], slack_step[BOUNDS], multiplier_step[BOUNDS], target[BOUNDS];
  double barrier[BOUNDS];
} stage_t;

/* A predictive controller of one gear. */
typedef struct {
  casadi_int steps, most_sets, n_cells, mode, yielding, informed, previewed;
  double cell_start, affine, observer;
  /* cells of the route; numbers of forecast, model, problem and drive */
  const double *cells, *nominal, *par, *tuning, *drive;
  stage_t *stage;  /* steps + 1 of them */
  /* measured state, base torque, bound of the differential torque */
  double x_hat[N], u_d, bound;
  /* observed offset of the yaw angle, predicted lateral position of the next sample */
  double offset, expected_y;
  /* whether the last sample was solved, so that the next one starts from it; its iterations; number of samples that were not
     solved; recursions in the last problem */
  casadi_int started, iterations, fallbacks, passes;
} horizon_t;

static const double *cell_at(const horizon_t *h, double p) {
  return row_at(h->cells, p, h->cell_start, CELL_STEP, h->n_cells, N_CELL);
}

/* Compute desired states x_d and track parameters theta of all stages. */
void horizon_forecast(horizon_t *h) {
  for (casadi_int k = 0; k <= h->steps; ++k) {
    double t = (double)k * h->tuning[TUNING_period], at[2];
    const double *where[] = {h->x_hat, &h->u_d, &t, h->nominal};
    double *position[] = {at};
    preview_position(where, position, 0, 0, 0);
    const double *ahead[] = {h->x_hat, &h->u_d, &t, h->nominal, cell_at(h, at[0]), cell_at(h, at[1])};
    double *stage[] = {h->stage[k].x_d, h->stage[k].theta};
    preview_stage(ahead, stage, 0, 0, 0);
    if (h->previewed) continue;
    double *x_d = h->stage[k].x_d;
    x_d[STATE_y_TrAx] = h->stage->x_d[STATE_y_TrAx], x_d[STATE_psi_TrAx] = 0;
    x_d[STATE_psi_Ax] = h->stage[k].theta[THETA_psi_Tr];
    x_d[STATE_psidot_Ax] = h->stage[k].theta[THETA_dpsi_dp] * x_d[STATE_xdot];
  }
}

/* Compute the next state and its derivatives at all stages of the trajectory, several stages in one vector register. */
void horizon_linearise(horizon_t *h) {
  for (casadi_int first = 0; first < h->steps; first += LANES) {
    lanes_t x[N], u, theta[N_THETA], x_next[N], a[N_A], b[N];
    for (casadi_int i = 0; i < LANES; ++i) {
      /* the last stage fills the last group */
      const stage_t *s = h->stage + (first + i < h->steps ? first + i : h->steps - 1);
      for (int j = 0; j < N; ++j) x[j][i] = s->x[j];
      for (int j = 0; j < N_THETA; ++j) theta[j][i] = s->theta[j];
      u[i] = s->u;
    }
    prediction_lanes(x, &u, &h->u_d, theta, h->par, h->tuning + TUNING_period, &h->affine, x_next, a, b);
    for (casadi_int i = 0; i < LANES && first + i < h->steps; ++i) {
      stage_t *s = h->stage + first + i;
      for (int j = 0; j < N; ++j) s->x_next[j] = x_next[j][i], s->b[j] = b[j][i];
      for (int j = 0; j < N_A; ++j) s->a[j] = a[j][i];
    }
  }
}

static void backward(horizon_t *h) {
  stage_t *last = h->stage + h->steps;
  const double *end[] = {last->x, last->x_d, &last->side, last->barrier, h->tuning};
  double *cost[] = {last->cost_matrix, last->cost_vector};
  riccati_terminal(end, cost, 0, 0, 0);
  for (stage_t *s = last; s-- > h->stage;) {
    const double to_bound = s->fixed * h->bound - s->u;
    const double *in[] = {s[1].cost_matrix, s[1].cost_vector, s[1].x, s->x_next, s->a, s->b, &s->u, &s->fixed, &to_bound,
                          s->x, s->x_d, &s->side, s->barrier, h->tuning};
    double *out[] = {s->cost_matrix, s->cost_vector, s->feedback, &s->feedforward};
    riccati_backward(in, out, 0, 0, 0);
  }
}

static void forward(horizon_t *h) {
  for (int i = 0; i < N; ++i) h->stage->dx[i] = h->x_hat[i] - h->stage->x[i];
  for (stage_t *s = h->stage; s < h->stage + h->steps; ++s) {
    const double *in[] = {s->dx, s->feedback, &s->feedforward, s->x_next, s[1].x, s->a, s->b, s[1].cost_matrix,
                          s[1].cost_vector, &s->u, h->tuning};
    double *out[] = {s[1].dx, &s->du, &s->slope};
    riccati_forward(in, out, 0, 0, 0);
  }
}

/* Activate or release the bounds of torques and the soft lateral bound; returns the number of changes. */
static casadi_int revise(horizon_t *h) {
  const double y_bound = h->tuning[TUNING_lateral_bound];
  casadi_int moved = 0;
  for (stage_t *s = h->stage; s < h->stage + h->steps; ++s) {
    double u = s->u + s->du, fixed = s->fixed;
    if (fixed == FREE)
      fixed = u > h->bound ? HIGH : u < -h->bound ? LOW : FREE;
    else if (fixed * s->slope > 0)  /* the cost decreases away from the bound */
      fixed = FREE;
    if (fixed != s->fixed) s->fixed = fixed, ++moved;
    double y = s[1].x[STATE_y_TrAx] + s[1].dx[STATE_y_TrAx], side = y > y_bound ? 1 : y < -y_bound ? -1 : 0;
    if (side != s[1].side) s[1].side = side, ++moved;
  }
  return moved;
}

/* Try at most `most` active sets, starting from the present one; returns like horizon_solve. */
static int settle(horizon_t *h, casadi_int most) {
  const double *end = h->stage[h->steps].dx;
  for (casadi_int tried = 0; tried < most; ++tried) {
    ++h->passes;
    backward(h), forward(h);
    if (revise(h)) continue;
    for (int i = 0; i < N; ++i)  /* a value that is not finite reaches the end */
      if (!isfinite(end[i])) return 1;
    return 0;
  }
  return 2;
}

/* Add the steps dx, du to the trajectory. Torques stay within their bound. */
void horizon_apply(horizon_t *h) {
  for (casadi_int k = 0; k <= h->steps; ++k) {
    stage_t *s = h->stage + k;
    for (int i = 0; i < N; ++i) s->x[i] += s->dx[i];
    if (k < h->steps) s->u = fmin(fmax(s->u + s->du, -h->bound), h->bound);
  }
}
