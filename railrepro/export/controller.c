/* A controller of both gears with its road built in, without allocation: the control law every millisecond, and before it,
   every PLAN_STEPS, the torques of slower controllers. Knows nothing of railways. Starts after call.h, the generated law and
   the constants of the exported one; controller_plan is that of the slower controllers, where there are some. */

typedef struct {
  /* what is measured (SI), by the enumerated MEASURED_...; torques that follow (N m), by TORQUE_... */
  double measured[N_MEASURED], torque[N_TORQUE];
  /* by PARAMETER_..., the gains of the law first */
  double parameters[N_PARAMETER];
  /* the road, a table that the caller may exchange */
  const double *cells;
  double rows[GEARS * N_CELL_COLUMNS], held[GEARS], memory[N_MEMORY], next[N_MEMORY];
  const double *in[LAW_ARG];
  double *out[LAW_RES];
  casadi_int integers[LAW_IW + 1];
  double work[LAW_W + 1];
  casadi_int cycles;
#ifdef PLAN_STEPS
  planner_memory_t planner[GEARS];
#endif
} controller_t;

/* At the start of a run with the parameters as they are. */
void controller_start(controller_t *c) {
  memset(c->memory, 0, sizeof c->memory), memset(c->held, 0, sizeof c->held), c->cycles = 0;
#ifdef PLAN_STEPS
  for (int g = 0; g < GEARS; ++g) planner_reset(&c->planner[g], g, c->parameters, c->cells);
#endif
}

/* The same with all parameters as exported. */
void controller_reset(controller_t *c) {
  memset(c, 0, sizeof *c);
  memcpy(c->parameters, PARAMETERS, sizeof c->parameters);
  c->cells = CELLS;
  controller_start(c);
}

/* Road with set point and force demand of the parameters, in memory of the caller. */
void controller_lay(controller_t *c, double cells[N_CELLS * N_CELL_COLUMNS]) {
  const double *asked = c->parameters + PARAMETER_SET_POINT_KIND;
  memcpy(cells, CELLS, sizeof CELLS);
  for (double *row = cells; row < cells + N_CELLS * N_CELL_COLUMNS; row += N_CELL_COLUMNS) {
    const double *in[LAW_ARG] = {row + AT_P, asked};
    double *out[LAW_RES] = {row + AT_Y_REF};
    row[AT_FORCE] *= c->parameters[PARAMETER_FORCE_FACTOR];
    if (*asked >= 0) set_point(in, out, c->integers, c->work, 0);
  }
  c->cells = cells;
}

/* One control cycle: from `measured` to `torque`; not 0 when the law fails. */
int controller_step(controller_t *c) {
  for (int g = 0; g < GEARS; ++g) {
    const double *row = row_at(c->cells, c->measured[POSITIONS[g]], CELL_START, CELL_STEP, N_CELLS, N_CELL_COLUMNS);
    memcpy(c->rows + g * N_CELL_COLUMNS, row, N_CELL_COLUMNS * sizeof(double));
  }
#ifdef PLAN_STEPS
  if (c->cycles % PLAN_STEPS == 0)
    for (int g = 0; g < GEARS; ++g) {
      double state[N_STATES_OF_GEAR], readings[N_READINGS];
      const int sensed = ESTIMATED_IN_MEMORY && c->cycles;
      for (int i = 0; i < N_STATES_OF_GEAR; ++i)
        state[i] = sensed ? c->memory[ESTIMATED[g][i]] : c->measured[STATES_AT[g][i]];
      for (int i = 0; i < N_READINGS; ++i)
        readings[i] = sensed ? c->memory[READ[g][i]] : c->measured[READ_AT[g][i]];
      c->held[g] = planner_sample(&c->planner[g], state, readings, c->memory[BASE[g]]);
    }
#endif
  const double *in[] = {c->measured, c->rows, c->held, c->parameters, c->memory};
  double *out[] = {c->torque, c->next};
  memset(c->out, 0, sizeof c->out);  /* nobody reads what the law records */
  memcpy(c->in, in, sizeof in), memcpy(c->out, out, sizeof out);
  if (control_law(c->in, c->out, c->integers, c->work, 0)) return 1;
  memcpy(c->memory, c->next, sizeof c->memory);
  ++c->cycles;
  return 0;
}
