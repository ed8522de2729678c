/* The exchange of loop.c for LANES cars side by side: every number of a car stands beside those of the others, and functions
   of `codegen.wide_text` work on all at once; only look-ups and the log go car by car. A car behaves as alone, to the bit.
   Starts after lanes.h, call.h, car.c. */

typedef void (*wide_fn)(const lanes_t *const *, lanes_t *const *);
typedef struct { wide_fn evaluate; const lanes_t *const *arg; lanes_t *const *res; } wide_t;
/* Numbers of each car, and where they stand side by side. */
typedef struct { lanes_t *wide; casadi_int n; double *own[LANES]; } beside_t;
typedef struct {
  wide_t coordinates, output, law, step;
  const car_t *car[LANES];
  const beside_t *all;
  casadi_int n_all;
  /* for each look-up the buffer of its cell, and the share of a second table */
  const lanes_t *places;
  lanes_t *const *rows;
  const lanes_t *const *shares;
  lanes_t *state, *measured, *memory;
  const lanes_t *next_state, *outputs, *record, *next_memory, *margins;
  casadi_int n_state, n_memory, n_outputs, n_record, n_margins, n_measured;
  /* places among the outputs of what is measured */
  const casadi_int *sensed;
} side_by_side_t;

static void wide_call(const wide_t *f) { f->evaluate(f->arg, f->res); }

static void look_up_wide(const side_by_side_t *s) {
  wide_call(&s->coordinates);
  for (casadi_int i = 0; i < s->car[0]->n_lookups; ++i)
    for (int l = 0; l < LANES; ++l) {
      const lookup_t *t = s->car[l]->lookups + i;
      const double place = s->places[i][l], *row = row_at(t->cells, place, t->start, t->step, t->n, t->width);
      for (casadi_int j = 0; j < t->width; ++j) s->rows[i][j][l] = row[j];
      if (!t->other || s->shares[i][0][l] == 0) continue;
      row = row_at(t->other, place, t->start, t->step, t->n, t->width);
      for (casadi_int j = 0; j < t->width; ++j) s->rows[i][j][l] += s->shares[i][0][l] * (row[j] - s->rows[i][j][l]);
    }
}

static void move(const side_by_side_t *s, int lane, int back) {
  for (const beside_t *b = s->all; b < s->all + s->n_all; ++b)
    for (casadi_int i = 0; i < b->n; ++i)
      if (back) b->own[lane][i] = b->wide[i][lane];
      else b->wide[i][lane] = b->own[lane][i];
}

/* Log of one car; whether it goes on. */
static int log_lane(const side_by_side_t *s, int lane, double *row) {
  double odd = 0;
  for (casadi_int i = 0; i < s->n_outputs; ++i) row[i] = s->outputs[i][lane], odd += row[i] - row[i];
  row += s->n_outputs;
  for (casadi_int i = 0; i < s->n_record; ++i) row[i] = s->record[i][lane], odd += row[i] - row[i];
  for (casadi_int i = 0; i < s->n_margins; ++i)
    if (!(s->margins[i][lane] > 0)) return 0;
  return odd == 0;
}

/* Up to n exchanges of the cars that have a log; done[l] as `loop_run` returns it. Cars without a log repeat another one. */
void lanes_run(const side_by_side_t *s, casadi_int n, double *const *log, casadi_int *done) {
  int live[LANES], any = 0;
  for (int l = 0; l < LANES; ++l) move(s, l, 0), any += live[l] = log[l] != 0, done[l] = n;
  for (casadi_int k = 0; k < n && any; ++k) {
    for (casadi_int step = 0; step < s->car[0]->substeps; ++step) {
      look_up_wide(s);
      if (step == 0) {
        wide_call(&s->output);
        for (casadi_int i = 0; i < s->n_measured; ++i) s->measured[i] = s->outputs[s->sensed[i]];
        wide_call(&s->law);
        for (int l = 0; l < LANES; ++l)
          if (live[l] && !log_lane(s, l, log[l] + k * (s->n_outputs + s->n_record)))
            move(s, l, 1), live[l] = 0, done[l] = k, --any;
      }
      wide_call(&s->step);
      memcpy(s->state, s->next_state, (size_t)s->n_state * sizeof(lanes_t));
    }
    memcpy(s->memory, s->next_memory, (size_t)s->n_memory * sizeof(lanes_t));
  }
  for (int l = 0; l < LANES; ++l)
    if (live[l]) move(s, l, 1);
}
