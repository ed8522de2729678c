/* A controller of both gears with its road built in. Starts after cycle.c and the constants of the exported one. */

/* At the start of a run with the parameters as they are. */
void controller_start(controller_t *c) {
  memset(c->memory, 0, sizeof c->memory), memset(c->held, 0, sizeof c->held), c->cycles = 0;
  for (int g = 0; g < GEARS; ++g) planner_reset(&c->planner[g], g, c->parameters, c->cells);
}

/* The same with all parameters as exported. */
void controller_reset(controller_t *c) {
  memset(c, 0, sizeof *c);
  memcpy(c->parameters, PARAMETERS, sizeof c->parameters);
  c->cells = CELLS, c->cell_start = CELL_START, c->cell_step = CELL_STEP, c->n_cells = N_CELLS, c->every = PLAN_STEPS;
  controller_start(c);
}

/* One control cycle: from `measured` to `torque`; not 0 when the law fails. */
int controller_step(controller_t *c) {
  if (controller_command(c)) return 1;
  controller_keep(c);
  return 0;
}
