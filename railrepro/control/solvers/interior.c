/* An interior point method on the same recursion, for problems whose active sets do not settle: some fifteen Newton steps
   whatever the bounds. Starts after riccati.c.

   Every bound has a slack and a multiplier, both above zero; the product of the two is driven towards zero. In the recursion
   a weight and a slope stand for all bounds of a stage. A lateral bound is soft: its multiplier widens its slack.

   Source: Mehrotra 1992 (predictor and corrector); Rao, Wright and Rawlings 1998 (recursion). */

/* Bounds 0 and 1 are those of the torque of stage k, 2 and 3 those of the lateral position of stage k + 1. */
enum { LATERAL = 2, BOUNDS = 4, MOST_STEPS = 40 };
static const double SIGN[BOUNDS] = {1, -1, 1, -1};
#define EACH_BOUND for (casadi_int i = 0, at = 0; i < BOUNDS; ++i) for (casadi_int k = 0; k < h->steps; ++k, ++at)

/* Step of the bounded quantity in dx, du. */
static double step_of(const horizon_t *h, casadi_int i, casadi_int k) {
  return i < LATERAL ? h->du[k] : h->dx[(k + 1) * N + STATE_y_TrAx];
}

/* Room that a rigid bound leaves after the step in dx, du. */
static double rigid_slack(const horizon_t *h, casadi_int i, casadi_int k) {
  const double limit = i < LATERAL ? h->bound : h->tuning[TUNING_lateral_bound];
  const double value = i < LATERAL ? h->u[k] : h->x[(k + 1) * N + STATE_y_TrAx];
  return limit - SIGN[i] * (value + step_of(h, i, k));
}

/* Weights and slopes of the recursion that lead slack times multiplier to their targets. */
static void stand_for_bounds(const horizon_t *h, const double *softness) {
  memset(h->barrier, 0, (h->steps + 1) * BOUNDS * sizeof(double));
  EACH_BOUND {
    double *barrier = h->barrier + (i < LATERAL ? k * BOUNDS : (k + 1) * BOUNDS + LATERAL);
    const double slack = h->slack[at], multiplier = h->multiplier[at];
    const double wide = slack + multiplier * softness[i], weight = multiplier / wide;
    barrier[0] += weight;
    barrier[1] += SIGN[i] * (multiplier + (h->target[at] - multiplier * slack) / wide) - weight * h->inner[at];
  }
}

/* One Newton step: dx, du, and how slack and multiplier change on the way. `again` after a step with other targets. */
static int interior_step(const horizon_t *h, const double *softness, int again) {
  casadi_int last = h->steps;
  stand_for_bounds(h, softness);
  const double *end[] = {h->x + last * N, h->x_d + last * N, h->barrier + last * BOUNDS, h->tuning};
  double *cost[] = {h->cost_matrix + last * N * N, h->cost_vector + last * N};
  if (call(&h->barrier_terminal, end, 4, cost, 2)) return 1;
  for (casadi_int k = last; k-- > 0;) {
    const double *in[] = {h->cost_matrix + (k + 1) * N * N, h->cost_vector + (k + 1) * N, h->x + (k + 1) * N,
                          h->x_next + k * N, h->a + k * N_A, h->b + k * N, h->u + k, h->barrier + k * BOUNDS, h->x + k * N,
                          h->x_d + k * N, h->tuning};
    double *all[] = {h->cost_matrix + k * N * N, h->cost_vector + k * N, h->feedback + k * N, h->feedforward + k};
    double *changed[] = {h->cost_vector + k * N, h->feedforward + k};
    if (again ? call(&h->barrier_again, in, 11, changed, 2) : call(&h->barrier_backward, in, 11, all, 4)) return 1;
  }
  if (forward(h)) return 1;
  ++*h->passes;
  EACH_BOUND {
    const double slack = h->slack[at], multiplier = h->multiplier[at];
    const double moved = SIGN[i] * (step_of(h, i, k) - h->inner[at]), lack = h->target[at] - multiplier * slack;
    h->multiplier_step[at] = (lack + multiplier * moved) / (slack + multiplier * softness[i]);
    h->slack_step[at] = h->multiplier_step[at] * softness[i] - moved;
  }
  return 0;
}

/* Largest part of the step on which slacks and multipliers stay positive, at most the whole. */
static double interior_share(const horizon_t *h) {
  double share = 1;
  for (casadi_int at = 0; at < BOUNDS * h->steps; ++at) {
    if (h->slack[at] + share * h->slack_step[at] < 0) share = -h->slack[at] / h->slack_step[at];
    if (h->multiplier[at] + share * h->multiplier_step[at] < 0) share = -h->multiplier[at] / h->multiplier_step[at];
  }
  return share;
}

/* Mean product of slack and multiplier after part of the step. */
static double gap_after(const horizon_t *h, double share) {
  double all = 0;
  for (casadi_int at = 0; at < BOUNDS * h->steps; ++at)
    all += (h->slack[at] + share * h->slack_step[at]) * (h->multiplier[at] + share * h->multiplier_step[at]);
  return all / (double)(BOUNDS * h->steps);
}

/* Take part of the step. Torques whose slack shrinks faster than their multiplier are taken to be at the bound. */
static void interior_advance(const horizon_t *h, double share) {
  memset(h->fixed, 0, h->steps * sizeof(double)), memset(h->side, 0, (h->steps + 1) * sizeof(double));
  EACH_BOUND {
    const double slack = h->slack[at] + share * h->slack_step[at];
    const double multiplier = h->multiplier[at] + share * h->multiplier_step[at];
    h->inner[at] += share * (step_of(h, i, k) - h->inner[at]);
    if (i < LATERAL) {
      if (slack * h->multiplier[at] < multiplier * h->slack[at]) h->fixed[k] = SIGN[i];
    } else if (SIGN[i] * (h->x[(k + 1) * N + STATE_y_TrAx] + h->inner[at]) > h->tuning[TUNING_lateral_bound])
      h->side[k + 1] = SIGN[i];
    h->slack[at] = slack, h->multiplier[at] = multiplier;
  }
}

/* Begin without torque, every product of slack and multiplier the same; returns it, or 0 where there is no interior. */
static double interior_enter(const horizon_t *h, double stiffness) {
  double gap = 0;
  for (casadi_int k = 0; k < h->steps; ++k) gap += fabs(h->slope[k]) * h->bound;
  memset(h->feedback, 0, h->steps * N * sizeof(double));
  for (casadi_int k = 0; k < h->steps; ++k) h->feedforward[k] = -h->u[k];
  if (forward(h)) return 0;
  for (casadi_int i = LATERAL; i < BOUNDS; ++i)
    for (casadi_int k = 0; k < h->steps; ++k) {
      const double beyond = fmax(-rigid_slack(h, i, k), 0);
      gap += stiffness * beyond * beyond;
    }
  gap /= (double)h->steps;
  EACH_BOUND {
    const double slack = rigid_slack(h, i, k);
    h->inner[at] = step_of(h, i, k);
    h->multiplier[at] = i < LATERAL ? gap / slack : (sqrt(slack * slack + 4 * gap / stiffness) - slack) * stiffness / 2;
    h->slack[at] = i < LATERAL ? slack : slack + h->multiplier[at] / stiffness;
  }
  return gap;
}

/* Minimiser of the quadratic problem about the trajectory; returns like horizon_solve. Near the end the active sets are
   known and tried, so that the minimiser is that of the recursion. */
static int interior(const horizon_t *h) {
  double stiffness = 0;
  const double *of[] = {h->tuning};
  double *to[] = {&stiffness};
  if (call(&h->barrier_stiffness, of, 1, to, 1)) return 1;
  if (!(h->bound > 0 && stiffness > 0)) return 2;
  const double softness[BOUNDS] = {0, 0, 1 / stiffness, 1 / stiffness}, begin = interior_enter(h, stiffness);
  double gap = begin;
  for (int count = 0; count < MOST_STEPS && gap > 1e-14 * begin; ++count) {
    memset(h->target, 0, BOUNDS * h->steps * sizeof(double));
    if (interior_step(h, softness, 0)) return 1;
    const double left = gap_after(h, interior_share(h)) / gap, target = left * left * left * gap;
    for (casadi_int at = 0; at < BOUNDS * h->steps; ++at)
      h->target[at] = target - h->slack_step[at] * h->multiplier_step[at];
    if (interior_step(h, softness, 1)) return 1;
    const double share = fmin(1, 0.995 * interior_share(h));
    gap = gap_after(h, share);
    interior_advance(h, share);
    const int code = gap < 1e-5 * begin ? settle(h, 2) : 2;
    if (code != 2) return code;
  }
  return 2;
}
