/* One sample of a predictive controller: forecast, linearise along the horizon, solve the quadratic problem by a Riccati
   recursion inside an active-set loop. Knows nothing of railways: generated functions and tables of cells.
   Starts after call.h, lanes.h, the generated functions of riccati.py, the indices of states and tuning by name (STATE_…,
   TUNING_…), the numbers of states N, of track parameters N_THETA, of bounds of a stage BOUNDS, of columns of a cell N_CELL
   and of entries N_A of the matrix A, the length of a cell CELL_STEP, and the prediction model prediction_lanes. */

enum { FREE = 0, LOW = -1, HIGH = 1 };

typedef struct {
  /* forecast, trajectory, torque of the plan (N m) */
  double x_d[N], theta[N_THETA], x[N], u, plan;
  /* model along the trajectory */
  double x_next[N], a[N_A], b[N];
  /* recursion: cost-to-go matrix and vector, feedback, feed-forward, steps, slope of the cost in the torque, active sets */
  double cost_matrix[N * N], cost_vector[N], feedback[N], feedforward, dx[N], du, slope, fixed, side;
  /* interior.c: of every bound step of what it bounds, slack and multiplier, their steps, and what their product shall
     become; weights and slopes that stand for the bounds in the recursion */
  double inner[BOUNDS], slack[BOUNDS], multiplier[BOUNDS], slack_step[BOUNDS], multiplier_step[BOUNDS], target[BOUNDS];
  double barrier[BOUNDS];
} stage_t;

/* A predictive controller of one gear. */
typedef struct {
  casadi_int steps, most_sets, n_cells, mode, yielding, informed;
  double cell_start, affine, observer;
  /* cells of the route; numbers of forecast, model, problem and drive */
  const double *cells, *nominal, *par, *tuning, *drive;
  stage_t *stage;  /* steps + 1 of them */
  /* problem: measured state, base torque, bound of the differential torque */
  double x_hat[N], u_d, bound;
  /* observed offset of the yaw angle, lateral position that is expected next */
  double offset, expected_y;
  /* whether the last sample was solved, so that the next one starts from it; its iterations; samples that were not solved;
     recursions that the last problem took */
  casadi_int started, iterations, fallbacks, passes;
} horizon_t;

static const double *cell_at(const horizon_t *h, double p) {
  return row_at(h->cells, p, h->cell_start, CELL_STEP, h->n_cells, N_CELL);
}

/* Desired states x_d and track parameters theta of all stages. */
void horizon_forecast(horizon_t *h) {
  for (casadi_int k = 0; k <= h->steps; ++k) {
    double t = (double)k * h->tuning[TUNING_period], at[2];
    const double *where[] = {h->x_hat, &h->u_d, &t, h->nominal};
    double *position[] = {at};
    preview_position(where, position, 0, 0, 0);
    const double *ahead[] = {h->x_hat, &h->u_d, &t, h->nominal, cell_at(h, at[0]), cell_at(h, at[1])};
    double *stage[] = {h->stage[k].x_d, h->stage[k].theta};
    preview_stage(ahead, stage, 0, 0, 0);
  }
}

/* Next state and its derivatives at every stage of the trajectory, several stages side by side. */
void horizon_linearise(horizon_t *h) {
  for (casadi_int first = 0; first < h->steps; first += LANES) {
    lanes_t x[N], u, theta[N_THETA], x_next[N], a[N_A], b[N];
    for (casadi_int i = 0; i < LANES; ++i) {
      /* the last group repeats the last stage */
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

/* Move torques onto or off their bound and stages onto or off the soft lateral bound; returns how many moved. */
static casadi_int revise(horizon_t *h) {
  const double y_bound = h->tuning[TUNING_lateral_bound];
  casadi_int moved = 0;
  for (stage_t *s = h->stage; s < h->stage + h->steps; ++s) {
    double u = s->u + s->du, fixed = s->fixed;
    if (fixed == FREE)
      fixed = u > h->bound ? HIGH : u < -h->bound ? LOW : FREE;
    else if (fixed * s->slope > 0)  /* the cost falls towards the inside */
      fixed = FREE;
    if (fixed != s->fixed) s->fixed = fixed, ++moved;
    double y = s[1].x[STATE_y_TrAx] + s[1].dx[STATE_y_TrAx], side = y > y_bound ? 1 : y < -y_bound ? -1 : 0;
    if (side != s[1].side) s[1].side = side, ++moved;
  }
  return moved;
}

/* Try `most` active sets, from those found; returns like horizon_solve. */
static int settle(horizon_t *h, casadi_int most) {
  const double *end = h->stage[h->steps].dx;
  for (casadi_int tried = 0; tried < most; ++tried) {
    ++h->passes;
    backward(h), forward(h);
    if (revise(h)) continue;
    for (int i = 0; i < N; ++i)  /* what is not finite on the way stays so to the end */
      if (!isfinite(end[i])) return 1;
    return 0;
  }
  return 2;
}

/* Take the steps dx, du; torques stay within their bound. */
void horizon_apply(horizon_t *h) {
  for (casadi_int k = 0; k <= h->steps; ++k) {
    stage_t *s = h->stage + k;
    for (int i = 0; i < N; ++i) s->x[i] += s->dx[i];
    if (k < h->steps) s->u = fmin(fmax(s->u + s->du, -h->bound), h->bound);
  }
}
