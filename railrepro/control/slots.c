/* Slower controllers as pointers to functions: (memory, states of the gear, its readings, base torque (N m)) -> differential
   torque (N m). */

typedef double (*sample_t)(void *, const double *, const double *, double);
typedef struct { sample_t sample; void *self; } planner_memory_t;

static void planner_reset(planner_memory_t *m, int gear, const double *parameters) {}
static void planner_link(planner_memory_t *m, int gear, const double *parameters, const double *cells) {}

static double planner_sample(const planner_memory_t *m, const double *state, const double *readings, double base) {
  return m->sample(m->self, state, readings, base);
}
