/* The 1 kHz control cycle with the car: measure, control, record, step. Knows nothing of either: the car consists of functions
   from another shared object and buffers. Starts after cycle.c and the indices MEASURED_OF_OUTPUT. */

typedef void (*car_fn)(void *);

typedef struct {
  void *car;
  car_fn measure, advance;
  /* of the car: commands of its motors, and outputs, some of which the law measures */
  double *torque;
  const double *outputs;
  casadi_int n_outputs;
  controller_t control;
} loop_t;

/* Returns the number of finished control cycles; a margin that is not positive, as is none of a number that is not finite,
   ends the run before the step (its row is still in the log). So does a failing law. */
casadi_int loop_run(loop_t *loop, casadi_int n, double *row) {
  static const int measured_of_output[N_INPUT] = MEASURED_OF_OUTPUT;
  controller_t *c = &loop->control;
  for (casadi_int k = 0; k < n; ++k, row += loop->n_outputs + N_RECORD) {
    loop->measure(loop->car);
    for (int i = 0; i < N_INPUT; ++i) c->measured[i] = loop->outputs[measured_of_output[i]];
    if (controller_command(c)) return k;
    memcpy(loop->torque, c->torque, sizeof c->torque);
    memcpy(row, loop->outputs, (size_t)loop->n_outputs * sizeof *row);
    memcpy(row + loop->n_outputs, c->record, sizeof c->record);
    for (int i = 0; i < N_MARGIN; ++i)
      if (!(c->margins[i] > 0)) return k;
    loop->advance(loop->car);
    controller_keep(c);
  }
  return n;
}
