/* An interior point method on the same recursion, for problems in which the active-set method does not converge. It takes some
   15 Newton steps, whatever the bounds. It needs riccati.c.

   Each bound has a slack and a multiplier, both above zero, whose product goes to zero. In the recursion a weight and a slope
   represent all bounds of a stage. A lateral bound is soft: its slack grows with its multiplier.

   Source: Mehrotra 1992 (predictor and corrector); Rao, Wright and Rawlings 1998 (recursion). */

/* Bounds 0 and 1 are for the torque of stage k, 2 and 3 for the lateral position of stage k + 1. */
enum { LATERAL = 2, MOST_STEPS = 40 };
static const double SIGN[BOUNDS] = {1, -1, 1, -1};
#define EACH_BOUND for (int i = 0; i < BOUNDS; ++i) for (stage_t *s = h->stage; s < h->stage + h->steps; ++s)

/* Step of the bounded quantity in dx, du. */
static double step_of(const stage_t *s, int i) { return i < LATERAL ? s->du : s[1].dx[STATE_y_TrAx]; }

/* Slack of a bound after the step in dx, du, if the bound were rigid. */
static double rigid_slack(const horizon_t *h, const stage_t *s, int i) {
  const double limit = i < LATERAL ? h->bound : h->tuning[TUNING_lateral_bound];
  return limit - SIGN[i] * ((i < LATERAL ? s->u : s[1].x[STATE_y_TrAx]) + step_of(s, i));
}

/* Clear the terms that represent bounds, and release all bounds. */
static void release(horizon_t *h) {
  for (stage_t *s = h->stage; s <= h->stage + h->steps; ++s) {
    memset(s->barrier, 0, sizeof s->barrier);
    s->fixed = s->side = 0;
  }
}

/* Compute a Newton step towards the targets of slack times multiplier: dx, du, and the steps of slacks and multipliers. */
static void interior_step(horizon_t *h, const double *softness) {
  release(h);
  EACH_BOUND {
    double *barrier = i < LATERAL ? s->barrier : s[1].barrier + LATERAL;
    const double slack = s->slack[i], multiplier = s->multiplier[i];
    const double wide = slack + multiplier * softness[i], weight = multiplier / wide;
    barrier[0] += weight;
    barrier[1] += SIGN[i] * (multiplier + (s->target[i] - multiplier * slack) / wide) - weight * s->inner[i];
  }
  backward(h), forward(h);
  release(h);
  ++h->passes;
  EACH_BOUND {
    const double slack = s->slack[i], multiplier = s->multiplier[i];
    const double moved = SIGN[i] * (step_of(s, i) - s->inner[i]), lack = s->target[i] - multiplier * slack;
    s->multiplier_step[i] = (lack + multiplier * moved) / (slack + multiplier * softness[i]);
    s->slack_step[i] = s->multiplier_step[i] * softness[i] - moved;
  }
}

/* Largest fraction of the step at which slacks and multipliers stay positive, at most 1. */
static double interior_share(const horizon_t *h) {
  double share = 1;
  EACH_BOUND {
    if (s->slack[i] + share * s->slack_step[i] < 0) share = -s->slack[i] / s->slack_step[i];
    if (s->multiplier[i] + share * s->multiplier_step[i] < 0) share = -s->multiplier[i] / s->multiplier_step[i];
  }
  return share;
}

/* Mean product of slack and multiplier after a fraction of the step. */
static double gap_after(const horizon_t *h, double share) {
  double all = 0;
  EACH_BOUND all += (s->slack[i] + share * s->slack_step[i]) * (s->multiplier[i] + share * s->multiplier_step[i]);
  return all / (double)(BOUNDS * h->steps);
}

/* Take a fraction of the step. The bound of a torque is then active if its slack shrinks faster than its multiplier, a lateral
   bound if the position exceeds it. */
static void interior_advance(horizon_t *h, double share) {
  EACH_BOUND {
    const double slack = s->slack[i] + share * s->slack_step[i];
    const double multiplier = s->multiplier[i] + share * s->multiplier_step[i];
    s->inner[i] += share * (step_of(s, i) - s->inner[i]);
    if (i < LATERAL) {
      if (slack * s->multiplier[i] < multiplier * s->slack[i]) s->fixed = SIGN[i];
    } else if (SIGN[i] * (s[1].x[STATE_y_TrAx] + s->inner[i]) > h->tuning[TUNING_lateral_bound])
      s[1].side = SIGN[i];
    s->slack[i] = slack, s->multiplier[i] = multiplier;
  }
}

/* Start without torque and with equal products of slack and multiplier; returns the product, or 0 without an interior. */
static double interior_enter(horizon_t *h, double stiffness) {
  double gap = 0;
  for (stage_t *s = h->stage; s < h->stage + h->steps; ++s) {
    gap += fabs(s->slope) * h->bound;
    memset(s->feedback, 0, sizeof s->feedback), s->feedforward = -s->u;
  }
  forward(h);
  EACH_BOUND {
    const double beyond = i < LATERAL ? 0 : fmax(-rigid_slack(h, s, i), 0);
    gap += stiffness * beyond * beyond;
  }
  gap /= (double)h->steps;
  EACH_BOUND {
    const double slack = rigid_slack(h, s, i);
    s->inner[i] = step_of(s, i);
    s->multiplier[i] = i < LATERAL ? gap / slack : (sqrt(slack * slack + 4 * gap / stiffness) - slack) * stiffness / 2;
    s->slack[i] = i < LATERAL ? slack : slack + s->multiplier[i] / stiffness;
  }
  return gap;
}

/* Find the steps dx, du that minimise the quadratic problem about the trajectory. It starts from the present active set. If
   h->most_sets of them are not enough, the interior point method takes over and near its end tries the active set that it has
   found, so that the minimiser is exact.
   Returns 0, or 1 when a value is not finite, or 2 when no minimiser was found. */
int horizon_solve(horizon_t *h) {
  const double *t = h->tuning;
  const double stiffness = t[TUNING_bound_weight] * t[TUNING_q_y_TrAx] * t[TUNING_period];
  h->passes = 0;
  int code = settle(h, h->most_sets);
  if (code != 2 || !(h->bound > 0 && stiffness > 0)) return code;
  const double softness[BOUNDS] = {0, 0, 1 / stiffness, 1 / stiffness}, begin = interior_enter(h, stiffness);
  double gap = begin;
  for (int count = 0; code == 2 && count < MOST_STEPS && gap > 1e-14 * begin; ++count) {
    EACH_BOUND s->target[i] = 0;
    interior_step(h, softness);
    const double left = gap_after(h, interior_share(h)) / gap, target = left * left * left * gap;
    EACH_BOUND s->target[i] = target - s->slack_step[i] * s->multiplier_step[i];
    interior_step(h, softness);
    const double share = fmin(1, 0.995 * interior_share(h));
    gap = gap_after(h, share);
    interior_advance(h, share);
    if (gap < 1e-5 * begin) code = settle(h, 2);
  }
  return code;
}
