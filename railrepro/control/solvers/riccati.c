/* One sample of a predictive controller: forecast, linearise along the horizon, solve the quadratic problem by a Riccati
   recursion inside an active-set loop. Knows nothing of railways: generated functions and tables of cells.
   All arrays are row-major, one row per stage. Starts after call.h, lanes.h, the indices of
   states and tuning by name (STATE_…, TUNING_…), the numbers of states N, of track parameters N_THETA, of columns of a
   cell N_CELL and of entries N_A of the matrix A, and the prediction model prediction_lanes. */

enum { FREE = 0, LOW = -1, HIGH = 1 };

typedef struct {
  casadi_int steps, n_cells, most_sets;
  double cell_start, cell_step;
  const double *cells;
  call_t position, preview, terminal, backward, forward, barrier_stiffness, barrier_terminal, barrier_backward, barrier_again;
  /* inputs: measured state, nominal vehicle of the forecast and of the model, tuning; base torque, bound of the
     differential torque, printed switch */
  double *x_hat;
  const double *nominal, *par, *tuning;
  double u_d, bound, affine;
  /* forecast and trajectory */
  double *x_d, *theta, *x, *u;
  /* model along the trajectory */
  double *x_next, *a, *b;
  /* recursion: cost-to-go matrix and vector, feedback, feed-forward, steps, slope of the cost in the torque, active sets */
  double *cost_matrix, *cost_vector, *feedback, *feedforward, *dx, *du, *slope, *fixed, *side;
  /* interior.c: of every bound step of what it bounds, slack and multiplier, their steps, and what their product shall
     become; weights and slopes that stand for the bounds in the recursion */
  double *inner, *slack, *multiplier, *slack_step, *multiplier_step, *target, *barrier;
  /* recursions that the last problem took */
  double *passes;
} horizon_t;

static int interior(const horizon_t *h);

static int call(const call_t *f, const double *const *arguments, int n_arguments, double *const *results, int n_results) {
  for (int i = 0; i < n_arguments; ++i) f->arg[i] = arguments[i];
  for (int i = 0; i < n_results; ++i) f->res[i] = results[i];
  return f->evaluate(f->arg, f->res, f->iw, f->w, 0);
}

static const double *cell_at(const horizon_t *h, double p) {
  return row_at(h->cells, p, h->cell_start, h->cell_step, h->n_cells, N_CELL);
}

/* Desired states x_d and track parameters theta of all stages. */
int horizon_forecast(const horizon_t *h) {
  for (casadi_int k = 0; k <= h->steps; ++k) {
    double t = (double)k * h->tuning[TUNING_period], at[2];
    const double *where[] = {h->x_hat, &h->u_d, &t, h->nominal};
    double *position[] = {at};
    if (call(&h->position, where, 4, position, 1)) return 1;
    const double *ahead[] = {h->x_hat, &h->u_d, &t, h->nominal, cell_at(h, at[0]), cell_at(h, at[1])};
    double *stage[] = {h->x_d + k * N, h->theta + k * N_THETA};
    if (call(&h->preview, ahead, 6, stage, 2)) return 1;
  }
  return 0;
}

/* Next state and its derivatives at every stage of the trajectory, several stages side by side. */
void horizon_linearise(const horizon_t *h) {
  for (casadi_int first = 0; first < h->steps; first += LANES) {
    lanes_t x[N], u, theta[N_THETA], x_next[N], a[N_A], b[N];
    for (casadi_int i = 0; i < LANES; ++i) {
      casadi_int k = first + i < h->steps ? first + i : h->steps - 1;  /* the last group repeats the last stage */
      for (int j = 0; j < N; ++j) x[j][i] = h->x[k * N + j];
      for (int j = 0; j < N_THETA; ++j) theta[j][i] = h->theta[k * N_THETA + j];
      u[i] = h->u[k];
    }
    prediction_lanes(x, &u, &h->u_d, theta, h->par, h->tuning + TUNING_period, &h->affine, x_next, a, b);
    for (casadi_int i = 0; i < LANES && first + i < h->steps; ++i) {
      casadi_int k = first + i;
      for (int j = 0; j < N; ++j) h->x_next[k * N + j] = x_next[j][i], h->b[k * N + j] = b[j][i];
      for (int j = 0; j < N_A; ++j) h->a[k * N_A + j] = a[j][i];
    }
  }
}

static int backward(const horizon_t *h) {
  casadi_int k = h->steps;
  const double *end[] = {h->x + k * N, h->x_d + k * N, h->side + k, h->tuning};
  double *cost[] = {h->cost_matrix + k * N * N, h->cost_vector + k * N};
  if (call(&h->terminal, end, 4, cost, 2)) return 1;
  while (k-- > 0) {
    const double to_bound = h->fixed[k] * h->bound - h->u[k];
    const double *in[] = {h->cost_matrix + (k + 1) * N * N, h->cost_vector + (k + 1) * N, h->x + (k + 1) * N,
                          h->x_next + k * N, h->a + k * N_A, h->b + k * N, h->u + k, h->fixed + k, &to_bound,
                          h->x + k * N, h->x_d + k * N, h->side + k, h->tuning};
    double *out[] = {h->cost_matrix + k * N * N, h->cost_vector + k * N, h->feedback + k * N, h->feedforward + k};
    if (call(&h->backward, in, 13, out, 4)) return 1;
  }
  return 0;
}

static int forward(const horizon_t *h) {
  for (int i = 0; i < N; ++i) h->dx[i] = h->x_hat[i] - h->x[i];
  for (casadi_int k = 0; k < h->steps; ++k) {
    const double *in[] = {h->dx + k * N, h->feedback + k * N, h->feedforward + k, h->x_next + k * N, h->x + (k + 1) * N,
                          h->a + k * N_A, h->b + k * N, h->cost_matrix + (k + 1) * N * N, h->cost_vector + (k + 1) * N,
                          h->u + k, h->tuning};
    double *out[] = {h->dx + (k + 1) * N, h->du + k, h->slope + k};
    if (call(&h->forward, in, 11, out, 3)) return 1;
  }
  return 0;
}

/* Move torques onto or off their bound and stages onto or off the soft lateral bound; returns how many moved. */
static casadi_int revise(const horizon_t *h) {
  casadi_int moved = 0;
  for (casadi_int k = 0; k < h->steps; ++k) {
    double u = h->u[k] + h->du[k], fixed = h->fixed[k];
    if (fixed == FREE)
      fixed = u > h->bound ? HIGH : u < -h->bound ? LOW : FREE;
    else if (fixed * h->slope[k] > 0)  /* the cost falls towards the inside */
      fixed = FREE;
    if (fixed != h->fixed[k]) h->fixed[k] = fixed, ++moved;
    double y = h->x[(k + 1) * N + STATE_y_TrAx] + h->dx[(k + 1) * N + STATE_y_TrAx];
    double y_bound = h->tuning[TUNING_lateral_bound], side = y > y_bound ? 1 : y < -y_bound ? -1 : 0;
    if (side != h->side[k + 1]) h->side[k + 1] = side, ++moved;
  }
  return moved;
}

static int all_finite(const double *values, casadi_int n) {
  for (casadi_int i = 0; i < n; ++i)
    if (!isfinite(values[i])) return 0;
  return 1;
}

/* Try `most` active sets, from those found; returns like horizon_solve. */
static int settle(const horizon_t *h, casadi_int most) {
  for (casadi_int i = 0; i < most; ++i) {
    ++*h->passes;
    if (backward(h) || forward(h)) return 1;
    if (!revise(h)) return all_finite(h->dx, (h->steps + 1) * N) && all_finite(h->du, h->steps) ? 0 : 1;
  }
  return 2;
}

/* Minimiser of the quadratic problem about the trajectory: steps dx, du. Starts from the active sets it finds; when a few
   more do not settle, the interior point method finds those of the minimiser.
   Returns 0, or 1 when a value is not finite, or 2 when no minimiser was found. */
int horizon_solve(const horizon_t *h) {
  *h->passes = 0;
  const int code = settle(h, h->most_sets);
  return code == 2 ? interior(h) : code;
}

/* Take the steps dx, du; torques stay within their bound. */
void horizon_apply(const horizon_t *h) {
  for (casadi_int i = 0; i < (h->steps + 1) * N; ++i) h->x[i] += h->dx[i];
  for (casadi_int k = 0; k < h->steps; ++k) h->u[k] = fmin(fmax(h->u[k] + h->du[k], -h->bound), h->bound);
}
