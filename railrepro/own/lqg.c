/* A sample of the controller of lqg.py for one running gear. Starts after call.h and the constants that lqg.py defines. */

/* A design at one speed, as lqg.py lays it out: the model, the regulator, what each filter makes of a reading, the smoother. */
typedef struct {
  double a[MODEL][MODEL], b[MODEL], e[MODEL][KNOWN], feedback[MODEL + SENT], ahead[TAPS][KNOWN + 1];
  struct { double read[FREE][SIGNALS], inverse[SIGNALS][SIGNALS], size; } filter[FILTERS];
  double smooth[LAGS][2][SIGNALS];
} lqg_design_t;

typedef struct lqg {
  casadi_int speeds, cells, rows;
  double behind, torque_limit, acceleration, gravity, base, partner, memory, start;
  const lqg_design_t *designs;
  const double *route;
  double *rails;  /* their offset and direction along the track, as the gear in front found them */
  struct lqg *follower;
  double torques[TORQUES];  /* sent, last first */
  /* of the filters, the second of which believes in rough rails */
  double state[FILTERS][FREE], weight[FILTERS], share[FILTERS], surprise[SIGNALS], known_until;
  casadi_int started;
} lqg_t;

/* Known inputs at a place that is passed at a speed; set point over the rails, and curvature of the track. */
static double lqg_known_at(const lqg_t *g, double p, double v, double *known, double *curvature) {
  const double *c = row_at(g->route, p, g->start, CELL, g->cells, WIDTH);
  const double *o = row_at(g->route, p + g->partner, g->start, CELL, g->cells, WIDTH);
  const double d = p - c[AT_p], od = p + g->partner - o[AT_p];
  const double kappa = c[AT_kappa] + c[AT_dkappa] * d, heading = c[AT_psi] + (c[AT_kappa] + c[AT_dkappa] * d / 2) * d;
  const double other = o[AT_psi] + (o[AT_kappa] + o[AT_dkappa] * od / 2) * od;
  const double y_ref = c[AT_y_ref] + d * (c[AT_dy_ref] + d * (c[AT_ddy_ref] / 2 + d * c[AT_dddy_ref] / 6));
  const double place = fmin(fmax((fmin(p, g->known_until) - g->start) / PITCH, 0), (double)g->rows - 1.001);
  const double share = place - floor(place), *rail = g->rails + 2 * (casadi_int)place;
  *curvature = kappa;
  known[K_SIDE] = g->gravity * (c[AT_phi] + c[AT_dphi] * d) - v * v * kappa;
  known[K_TURNING] = v * v * c[AT_dkappa];
  known[K_ROLLING] = v * c[AT_dphi];
  known[K_HEADING] = (heading - other) / 2;
  known[K_SLEWING] = v * (kappa - o[AT_kappa] - o[AT_dkappa] * od) / 2;
  known[K_RAIL_OFFSET] = rail[0] + share * (rail[2] - rail[0]);
  /* without direction where the gear in front has not been */
  known[K_RAIL_RATE] = p > g->known_until ? 0 : v * (rail[1] + share * (rail[3] - rail[1]));
  return y_ref + known[K_RAIL_OFFSET];
}

/* Update every filter by the reading, and the share of each by how well it had expected it. */
static void lqg_update(lqg_t *g, const lqg_design_t *d, const double *read, double v) {
  double best = -INFINITY, total = 0;
  for (int f = 0; f < FILTERS; ++f) {
    double *x = g->state[f], square = 0;
    const double expected[SIGNALS] = {x[0] - x[RAIL], x[2] - x[RAIL + 1] / v + x[BIAS], x[3] + x[BIAS + 1]};
    double surprise[SIGNALS];
    for (int i = 0; i < SIGNALS; ++i) g->surprise[i] = surprise[i] = read[i] - expected[i];
    for (int i = 0; i < SIGNALS; ++i)
      for (int j = 0; j < SIGNALS; ++j) square += surprise[i] * d->filter[f].inverse[i][j] * surprise[j];
    for (int i = 0; i < FREE; ++i)
      for (int j = 0; j < SIGNALS; ++j) x[i] += d->filter[f].read[i][j] * surprise[j];
    g->weight[f] += -PERIOD / g->memory * g->weight[f] - (square + d->filter[f].size) / 2;
    best = fmax(best, g->weight[f]);
  }
  for (int f = 0; f < FILTERS; ++f) total += g->share[f] = exp(g->weight[f] - best);
  for (int f = 0; f < FILTERS; ++f) g->share[f] /= total;
}

/* Differential torque: the last one and the change that feedback and preview ask for, within the limit. */
static double lqg_steered(const lqg_t *g, const lqg_design_t *d, const double *x, double place, double v, double a) {
  double change = 0, known[KNOWN], curvature;
  for (int i = 0; i < MODEL; ++i) change += d->feedback[i] * x[i];
  for (int i = 0; i < SENT; ++i) change += d->feedback[MODEL + i] * g->torques[i];
  for (int k = 0; k < TAPS; ++k) {
    const double t = (double)k * TAP, driven = a < 0 ? fmin(t, -v / a) : t, *gain = d->ahead[k];
    change += gain[KNOWN] * lqg_known_at(g, place + (v + a / 2 * driven) * driven, v + a * driven, known, &curvature);
    for (int i = 0; i < KNOWN; ++i) change += gain[i] * known[i];
  }
  const double torque = g->torques[0] + change, limit = g->torque_limit;
  return torque > limit ? limit : torque < -limit ? -limit : torque;  /* fmin would make a limit of what is no number */
}

/* To the gear behind: the estimate of the rails here, and what the reading says of places that were passed. Nothing from
   before its route, or from a place that is no number. */
static void lqg_pass_on(const lqg_t *g, const lqg_design_t *d, double place, double v) {
  lqg_t *to = g->follower;
  if (!(place >= to->start)) return;
  const double *x = g->state[FILTERS - 1], share = g->share[FILTERS - 1];
  const casadi_int cell = (casadi_int)fmin(fmax((place - to->start) / PITCH, 0), (double)to->rows - 2);
  double *row = to->rails + 2 * cell;
  const int fresh = (double)cell > floor((to->known_until - to->start) / PITCH);
  for (int i = !fresh; i < 2; ++i) row[2 * i] = share * x[RAIL], row[2 * i + 1] = share * x[RAIL + 1] / v;
  for (casadi_int i = fresh; i <= cell; ++i) {
    const double lag = floor((place - to->start - (double)(cell - i) * PITCH) / (v * LAG) + 0.5);
    if (!(lag < LAGS)) break;
    for (int j = 0; j < 2; ++j)
      for (int k = 0; k < SIGNALS; ++k) row[j - 2 * i] += share * d->smooth[(int)lag][j][k] * g->surprise[k];
  }
  to->known_until = place;
}

/* Differential torque (N m) from measured states, readings (y, psi, r) and base torque per wheel. */
double lqg_sample(void *gear, const double *state, const double *readings, double base_torque) {
  lqg_t *g = gear;
  const double v = state[2], a = base_torque * g->acceleration, place = state[0] - g->behind * v;
  if (!(v >= LEAST_SPEED)) {  /* wheels that hardly turn cannot steer */
    g->started = 0;
    return v < LEAST_SPEED ? g->torques[0] : v;  /* no number for a speed that is none */
  }
  double known[KNOWN], x[FREE] = {0}, curvature;
  lqg_known_at(g, place, v, known, &curvature);
  const double read[SIGNALS] = {readings[0] + known[K_RAIL_OFFSET], readings[1] + known[K_RAIL_RATE] / v, readings[2] - v * curvature};
  const lqg_design_t *d = g->designs + (casadi_int)fmin(floor(log(v / LEAST_SPEED) / LOG_STEP + 0.5), (double)(g->speeds - 1));
  if (!g->started) {  /* without creepage and disturbance */
    const double begin[FREE] = {read[0], v * read[1], read[1], read[2], g->base / 2 * read[2], g->torques[0]};
    memset(g->weight, 0, sizeof g->weight);
    for (int f = 0; f < FILTERS; ++f) memcpy(g->state[f], begin, sizeof begin);
    g->started = 1;
  }
  lqg_update(g, d, read, v);
  for (int f = 0; f < FILTERS; ++f)
    for (int i = 0; i < FREE; ++i) x[i] += g->share[f] * g->state[f][i];

  if (g->follower) lqg_pass_on(g, d, place, v);
  const double torque = lqg_steered(g, d, x, place, v, a);
  memmove(g->torques + 1, g->torques, SENT * sizeof(double));
  g->torques[0] = torque;
  for (int f = 0; f < FILTERS; ++f) {  /* a period later, under the torque that acts */
    double next[MODEL];
    for (int i = 0; i < MODEL; ++i) {
      next[i] = d->b[i] * g->torques[LATE];
      for (int j = 0; j < MODEL; ++j) next[i] += d->a[i][j] * g->state[f][j];
      for (int j = 0; j < KNOWN; ++j) next[i] += d->e[i][j] * known[j];
    }
    memcpy(g->state[f], next, sizeof next);
  }
  return torque;
}
