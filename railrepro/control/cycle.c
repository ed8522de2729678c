/* The control cycle of both gears, without memory allocation: the control law every millisecond, and before it, when they are
   due, the torques of the slower controllers. It needs call.h, the generated law, the sizes and indices of cycle.py, and a
   slower controller: planner_memory_t and planner_sample, from slots.c or from an export. */

typedef struct {
  /* measured quantities (SI) at the indices MEASURED_..., and commanded torques (N m) at TORQUE_... */
  double measured[N_INPUT], torque[N_OUTPUT];
  /* at the indices PARAMETER_..., the gains of the law first */
  double parameters[N_PARAMETER];
  const double *cells;  /* rows of the route, a table that the caller may replace */
  double cell_start, cell_step;
  casadi_int n_cells;
  double rows[GEARS * N_CELL_COLUMNS], held[GEARS], memory[N_MEMORY], next[N_MEMORY];
  /* logged quantities, and margins to the limits of a run */
  double record[N_RECORD], margins[N_MARGIN];
  /* cycles so far; period of the slower controllers (cycles), 0 without them */
  casadi_int cycles, every;
  planner_memory_t planner[GEARS];
} controller_t;

/* Compute the torques of the slower controllers from measured or, with sensors, from estimated states. */
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

/* Compute `torque` from `measured`. The result is not 0 when the law fails. */
static int controller_command(controller_t *c) {
  for (int g = 0; g < GEARS; ++g) {
    const double p = c->measured[g * GEAR_MEASURED];
    const double *row = row_at(c->cells, p, c->cell_start, c->cell_step, c->n_cells, N_CELL_COLUMNS);
    memcpy(c->rows + g * N_CELL_COLUMNS, row, N_CELL_COLUMNS * sizeof(double));
  }
  if (c->every && c->cycles % c->every == 0) controller_plan(c);
  const double *in[] = {c->measured, c->rows, c->held, c->parameters, c->memory};
  double *out[] = {c->torque, c->next, c->record, c->margins};
  return control_law(in, out, 0, 0, 0);
}

/* Go on to the next cycle. */
static void controller_keep(controller_t *c) {
  memcpy(c->memory, c->next, sizeof c->memory);
  ++c->cycles;
}
