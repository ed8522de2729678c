/* The control cycle of both gears without allocation: the control law every millisecond, and before it, every so many cycles,
   the torques of slower controllers. Knows nothing of railways. Starts after call.h, the generated law, the sizes and places
   of cycle.py, and planner_memory_t with planner_sample, a slower controller (slots.c, or that of an export). */

typedef struct {
  /* what is measured (SI), by the enumerated MEASURED_...; torques that follow (N m), by TORQUE_... */
  double measured[N_INPUT], torque[N_OUTPUT];
  /* by PARAMETER_..., the gains of the law first */
  double parameters[N_PARAMETER];
  const double *cells;  /* the road, a table that the caller may exchange */
  double cell_start, cell_step;
  casadi_int n_cells;
  double rows[GEARS * N_CELL_COLUMNS], held[GEARS], memory[N_MEMORY], next[N_MEMORY];
  /* what a log keeps, and margins to the limits of a run */
  double record[N_RECORD], margins[N_MARGIN];
  /* cycles from one plan of the slower controllers to the next, 0 where there are none */
  casadi_int cycles, every;
  planner_memory_t planner[GEARS];
} controller_t;

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

/* From `measured` to `torque`; not 0 when the law fails. */
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

/* On to the next cycle. */
static void controller_keep(controller_t *c) {
  memcpy(c->memory, c->next, sizeof c->memory);
  ++c->cycles;
}
