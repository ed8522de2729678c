/* A controller of both gears with its route. It follows cycle.c and the constants of the export. */

enum { CONTROLLER_OK, CONTROLLER_FELL_BACK, CONTROLLER_REFUSED, CONTROLLER_FAILED };

/* Start a run with the present parameters. */
void controller_start(controller_t *c) {
  memset(c->memory, 0, sizeof c->memory), memset(c->held, 0, sizeof c->held), c->cycles = 0;
  for (int g = 0; g < GEARS; ++g) planner_reset(&c->planner[g], g, c->parameters);
}

/* Start a run with the parameters as exported. */
void controller_reset(controller_t *c) {
  memset(c, 0, sizeof *c);
  memcpy(c->parameters, PARAMETERS, sizeof c->parameters);
  c->cell_start = CELL_START, c->cell_step = CELL_STEP, c->n_cells = N_CELLS, c->every = PLAN_STEPS;
  controller_start(c);
}

/* Whether n values, none of them NaN, are in their ranges, the first in entry `first` of LOWEST and HIGHEST. */
static int permitted(const double *values, int first, int n) {
  while (n-- > 0)
    if (!(LOWEST[first + n] <= values[n] && values[n] <= HIGHEST[first + n])) return 0;
  return 1;
}

/* Compute `torque` from `measured`: one control cycle. Returns one of the constants above. Sets its pointers to tables, as c may
   be a copy. */
int controller_step(controller_t *c) {
  const casadi_int before = FALLBACKS(c);
  c->cells = CELLS;
  for (int g = 0; g < GEARS; ++g) planner_link(&c->planner[g], g, c->parameters, c->cells);
  const int refused = !permitted(c->measured, 0, N_INPUT) || !permitted(c->parameters, N_INPUT, N_PARAMETER);
  if (refused || controller_command(c) || !(c->margins[MARGIN_FRONT_TORQUE] > 0 && c->margins[MARGIN_REAR_TORQUE] > 0)) {
    memset(c->torque, 0, sizeof c->torque);
    return refused ? CONTROLLER_REFUSED : CONTROLLER_FAILED;
  }
  controller_keep(c);
  return FALLBACKS(c) > before ? CONTROLLER_FELL_BACK : CONTROLLER_OK;
}
