/* One sample of a predictive controller: forecast, linearise along the horizon, solve the quadratic problem by a Riccati
   recursion inside an active-set loop, repeat. Knows nothing of railways: generated functions and tables of cells.
   All arrays are row-major, one row per stage. Starts after call.h, lanes.h, the places of
   states and tuning by name (STATE_…, TUNING_…), the numbers of states N, of track parameters N_THETA, of columns of a
   cell N_CELL and of entries N_A of the matrix A, and the prediction model prediction_lanes. */

#include <stdio.h>
#ifndef DEBUG
#define DEBUG 0
#define CROSS 1e-5
#define TRIES 2
#endif
enum { FREE = 0, LOW = -1, HIGH = 1 };

typedef struct {
  casadi_int steps, n_cells, most_sets;
  double cell_start, cell_step;
  const double *cells;
  call_t place, preview, terminal, backward, forward, soft, barrier_end, barrier, corrector;
  /* inputs: measured state, nominal vehicle of the forecast and of the model, tuning; base torque, bound of the
     differential torque, printed switch */
  const double *x_hat, *nominal, *par, *tuning;
  double u_d, bound, affine;
  /* forecast and trajectory */
  double *x_d, *theta, *x, *u;
  /* model along the trajectory */
  double *x_next, *a, *b;
  /* recursion: cost-to-go matrix and vector, feedback, feed-forward, steps, slope of the cost in the torque, active sets */
  double *cost_matrix, *cost_vector, *feedback, *feedforward, *dx, *du, *slope, *fixed, *side;
  /* interior point: torque and lateral step, of every bound room, force and what their product shall be, weights and slopes
     that stand for the bounds in the recursion; number of recursions of the last problem */
  double *inner, *room, *force, *target, *stands, *passes;
} horizon_t;

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
    double *place[] = {at};
    if (call(&h->place, where, 4, place, 1)) return 1;
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

/* Solve with active sets until they rest: 0, or 1 when a value is not finite, or 2 when `most` did not suffice. */
static int settle(const horizon_t *h, casadi_int most) {
  for (casadi_int i = 0; i < most; ++i) {
    ++*h->passes;
    if (backward(h) || forward(h)) return 1;
    if (!revise(h)) return all_finite(h->dx, (h->steps + 1) * N) && all_finite(h->du, h->steps) ? 0 : 1;
  }
  return 2;
}

/* The bounds of a stage: of the torque that leaves it, of its lateral position; each has a high and a low side. */
enum { TORQUE = 0, LATERAL = 2, BOUNDS = 4 };
static const double SIGN[BOUNDS] = {1, -1, 1, -1};

static int bounded(const horizon_t *h, casadi_int k, int i) { return i < LATERAL ? k < h->steps : k > 0; }

/* Where the iterate is with respect to bound i of a stage: how far it may go on. */
static double room(const horizon_t *h, const double *at, casadi_int k, int i) {
  if (i < LATERAL) return h->bound - SIGN[i] * (h->u[k] + at[2 * k]);
  return h->tuning[TUNING_lateral_bound] - SIGN[i] * (h->x[k * N + STATE_y_TrAx] + at[2 * k + 1]);
}

/* One Newton step of the interior point method: torques and states that follow from the targets, in dx, du. */
static int aim(const horizon_t *h, const double *soft, int corrects) {
  for (casadi_int k = 0; k <= h->steps; ++k) {
    double *stands = h->stands + k * BOUNDS;
    memset(stands, 0, BOUNDS * sizeof(double));
    for (int i = 0; i < BOUNDS; ++i) {
      const casadi_int at = k * BOUNDS + i;
      const int group = i < LATERAL ? TORQUE : LATERAL;
      if (!bounded(h, k, i)) continue;
      const double wide = h->room[at] + h->force[at] * soft[i], weight = h->force[at] / wide;
      stands[group] += weight;
      stands[group + 1] += SIGN[i] * (h->force[at] + (h->target[at] - h->force[at] * h->room[at]) / wide);
    }
    stands[1] -= stands[0] * h->inner[2 * k], stands[3] -= stands[2] * h->inner[2 * k + 1];
  }
  casadi_int k = h->steps;
  const double *end[] = {h->x + k * N, h->x_d + k * N, h->stands + k * BOUNDS, h->tuning};
  double *cost[] = {h->cost_matrix + k * N * N, h->cost_vector + k * N};
  if (call(&h->barrier_end, end, 4, cost, 2)) return 1;
  while (k-- > 0) {
    const double *in[] = {h->cost_matrix + (k + 1) * N * N, h->cost_vector + (k + 1) * N, h->x + (k + 1) * N,
                          h->x_next + k * N, h->a + k * N_A, h->b + k * N, h->u + k, h->stands + k * BOUNDS, h->x + k * N,
                          h->x_d + k * N, h->tuning};
    double *out[] = {h->cost_matrix + k * N * N, h->cost_vector + k * N, h->feedback + k * N, h->feedforward + k};
    if (corrects ? call(&h->corrector, in, 11, (double *[]){out[1], out[3]}, 2) : call(&h->barrier, in, 11, out, 4)) return 1;
  }
  ++*h->passes;
  return forward(h);
}

/* Steps of room and force of a bound on the way to dx, du. */
static void steps_of(const horizon_t *h, const double *soft, casadi_int k, int i, double *d_room, double *d_force) {
  const casadi_int at = k * BOUNDS + i;
  const double step = i < LATERAL ? h->du[k] - h->inner[2 * k] : h->dx[k * N + STATE_y_TrAx] - h->inner[2 * k + 1];
  const double lack = h->target[at] - h->force[at] * h->room[at];
  *d_force = (lack + h->force[at] * SIGN[i] * step) / (h->room[at] + h->force[at] * soft[i]);
  *d_room = *d_force * soft[i] - SIGN[i] * step;
}

#define EACH_BOUND for (casadi_int k = 0; k <= h->steps; ++k) for (int i = 0; i < BOUNDS; ++i) if (bounded(h, k, i))

/* Largest part of the way to dx, du on which rooms and forces stay positive. */
static double farthest(const horizon_t *h, const double *soft) {
  double share = 1, d_room, d_force;
  EACH_BOUND {
    steps_of(h, soft, k, i, &d_room, &d_force);
    if (h->room[k * BOUNDS + i] + share * d_room < 0) share = -h->room[k * BOUNDS + i] / d_room;
    if (h->force[k * BOUNDS + i] + share * d_force < 0) share = -h->force[k * BOUNDS + i] / d_force;
  }
  return share;
}

static int interior(const horizon_t *h) {
  double soft[BOUNDS] = {0}, weight, d_room, d_force;
  const double *of[] = {h->tuning};
  double *to[] = {&weight};
  if (call(&h->soft, of, 1, to, 1)) return 1;
  soft[LATERAL] = soft[LATERAL + 1] = 1 / weight;
  double scale = 0;
  for (casadi_int k = 0; k < h->steps; ++k) scale += fabs(h->slope[k]) * h->bound / h->steps;
  memset(h->feedback, 0, h->steps * N * sizeof(double));
  for (casadi_int k = 0; k < h->steps; ++k) h->feedforward[k] = -h->u[k];
  if (forward(h)) return 1;
  for (casadi_int k = 0; k <= h->steps; ++k) h->inner[2 * k] = k < h->steps ? h->du[k] : 0, h->inner[2 * k + 1] = h->dx[k * N + STATE_y_TrAx];
  EACH_BOUND if (i >= LATERAL) {
    double beyond = fmax(-room(h, h->inner, k, i), 0);
    scale += weight * beyond * beyond / h->steps;
  }
  EACH_BOUND {
    double free = room(h, h->inner, k, i), force = i < LATERAL ? scale / free : (sqrt(free * free + 4 * scale / weight) - free) * weight / 2;
    h->force[k * BOUNDS + i] = force, h->room[k * BOUNDS + i] = free + force * soft[i];
  }
  double gap = scale;
  for (int count = 0; count < 40; ++count) {
    EACH_BOUND h->target[k * BOUNDS + i] = 0;
    if (aim(h, soft, 0)) return 1;
    double share = farthest(h, soft), reached = 0;
    EACH_BOUND {
      steps_of(h, soft, k, i, &d_room, &d_force);
      reached += (h->room[k * BOUNDS + i] + share * d_room) * (h->force[k * BOUNDS + i] + share * d_force);
    }
    reached /= 4 * h->steps;
    double ratio = reached / gap;
    EACH_BOUND {
      steps_of(h, soft, k, i, &d_room, &d_force);
      h->target[k * BOUNDS + i] = ratio * ratio * ratio * gap - d_room * d_force;
    }
    if (aim(h, soft, 1)) return 1;
    share = fmin(1, 0.995 * farthest(h, soft));
    double all = 0;
    EACH_BOUND {
      const casadi_int at = k * BOUNDS + i;
      steps_of(h, soft, k, i, &d_room, &d_force);
      double r = h->room[at] + share * d_room, f = h->force[at] + share * d_force;
      if (i < LATERAL) {
        const int active = r * h->force[at] < f * h->room[at];
        if (i == TORQUE) h->fixed[k] = 0;
        if (active) h->fixed[k] = SIGN[i];
      }
      h->room[at] = r, h->force[at] = f, all += r * f;
    }
    gap = all / (4 * h->steps);
    for (casadi_int k = 0; k <= h->steps; ++k) {
      if (k < h->steps) h->inner[2 * k] += share * (h->du[k] - h->inner[2 * k]);
      h->inner[2 * k + 1] += share * (h->dx[k * N + STATE_y_TrAx] - h->inner[2 * k + 1]);
      double y = h->x[k * N + STATE_y_TrAx] + h->inner[2 * k + 1], b = h->tuning[TUNING_lateral_bound];
      if (k) h->side[k] = y > b ? 1 : y < -b ? -1 : 0;
    }
    if (DEBUG) printf("%d gap %.2e share %.3f aff %.2e\n", count, gap / scale, share, ratio);
    if (gap < CROSS * scale) {
      int code = settle(h, TRIES);
      if (code != 2) return code;
    }
    if (!(gap > 1e-13 * scale)) break;
  }
  return 2;
}

/* Minimiser of the quadratic problem about the trajectory: steps dx, du. Starts from the active sets it finds, and goes
   over to descent when such sets come back, or are too many.
   Returns 0, or 1 when a value is not finite, or 2 when the active sets did not settle. */
int horizon_solve(const horizon_t *h) {
  *h->passes = 0;
  const int code = settle(h, h->most_sets);
  return code == 2 && h->most_sets ? interior(h) : code;
}

/* Take the steps dx, du; torques stay within their bound. */
void horizon_apply(const horizon_t *h) {
  for (casadi_int i = 0; i < (h->steps + 1) * N; ++i) h->x[i] += h->dx[i];
  for (casadi_int k = 0; k < h->steps; ++k) h->u[k] = fmin(fmax(h->u[k] + h->du[k], -h->bound), h->bound);
}

/* Up to `most` Newton iterations with full steps; stops when no torque moves by more than `tolerance` and the trajectory
   obeys the model. `iterations` counts them. Returns like horizon_solve, or 3 when it has not converged (most > 1). */
int horizon_iterate(const horizon_t *h, casadi_int most, double tolerance, casadi_int *iterations) {
  for (*iterations = 1; *iterations <= most; ++*iterations) {
    horizon_linearise(h);
    int failed = horizon_solve(h);
    if (failed) return failed;
    double moved = 0, gap = 0;
    for (casadi_int k = 0; k < h->steps; ++k) {
      moved = fmax(moved, fabs(h->du[k]));
      for (int i = 0; i < N; ++i) gap = fmax(gap, fabs(h->x_next[k * N + i] - h->x[(k + 1) * N + i]));
    }
    horizon_apply(h);
    if (moved < tolerance && gap < 1e-9) return 0;
  }
  *iterations = most;
  return most > 1 ? 3 : 0;
}
