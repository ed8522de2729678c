/* A controller of both gears with its road built in, without allocation: the control law every millisecond, and before it,
   every PLAN_STEPS, the torques of slower controllers. Knows nothing of railways. Starts after call.h, the generated law and
   the constants of the exported one; with PLAN_STEPS also planner_memory_t, planner_reset and planner_sample. */

typedef struct {
  /* what is measured (SI), by the enumerated MEASURED_...; torques that follow (N m), by TORQUE_... */
  double measured[N_INPUT], torque[N_OUTPUT];
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

#ifdef PLAN_STEPS
/* Torques of the slower controllers from what is measured, or from what sensors and filter make of it. */
static void controller_plan(controller_t *c) {
  static const int read_of_state[N_READINGS] = READ_OF_STATE;
  for (int g = 0; g < GEARS; ++g) {
    const double *state = c->measured + g * GEAR_MEASURED, *memory = c->memory + g * GEAR_MEMORY, *read = memory + READ;
    double exact[N_READINGS];
    if (ESTIMATED && c->cycles) {
      state = memory + ESTIMATED;
    } else {
      for (int i = 0; i < N_READINGS; ++i) exact[i] = state[read_of_state[i]];
      read = exact;
    }
    c->held[g] = planner_sample(&c->planner[g], state, read, memory[BASE]);
  }
}
#endif

/* One control cycle: from `measured` to `torque`; not 0 when the law fails. */
int controller_step(controller_t *c) {
  for (int g = 0; g < GEARS; ++g) {
    const double p = c->measured[MEASURED_FRONT_P + g * GEAR_MEASURED];
    const double *row = row_at(c->cells, p, CELL_START, CELL_STEP, N_CELLS, N_CELL_COLUMNS);
    memcpy(c->rows + g * N_CELL_COLUMNS, row, N_CELL_COLUMNS * sizeof(double));
  }
#ifdef PLAN_STEPS
  if (c->cycles % PLAN_STEPS == 0) controller_plan(c);
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
