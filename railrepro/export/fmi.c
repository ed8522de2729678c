/* What all FMUs share after their own C: fmu_t with `inputs`, outputs `y`, `parameters` and `host`; connect, reset, begin
   and advance. fmi2.c follows and only translates. Value references: outputs, inputs, parameters. */

enum { FIRST_INPUT = N_OUTPUT, FIRST_PARAMETER = N_OUTPUT + N_INPUT, END = FIRST_PARAMETER + N_PARAMETER };

typedef struct {
  host_t host;
  int begun;
  fmu_t fmu;
} instance_t;

static status_t complain(instance_t *i, const char *text) { return report(&i->host, STATUS_ERROR, text); }

/* NULL, and a sentence, where the token is not that of the FMU. */
static instance_t *instantiate(const char *token, host_t host) {
  if (!token || strcmp(token, GUID)) return report(&host, STATUS_ERROR, "the GUID is not that of this FMU"), NULL;
  instance_t *i = calloc(1, sizeof(instance_t));
  if (i) i->host = host, i->fmu.host = &i->host, connect(&i->fmu), reset(&i->fmu);
  return i;
}

static status_t get_numbers(instance_t *i, const unsigned references[], size_t n, double values[]) {
  for (size_t k = 0; k < n; ++k) {
    const unsigned r = references[k];
    if (r >= END) return complain(i, "unknown value reference");
    values[k] = r < FIRST_INPUT ? i->fmu.y[r] : r < FIRST_PARAMETER ? i->fmu.inputs[r - FIRST_INPUT] : i->fmu.parameters[r - FIRST_PARAMETER];
  }
  return STATUS_OK;
}

static status_t set_numbers(instance_t *i, const unsigned references[], size_t n, const double values[]) {
  for (size_t k = 0; k < n; ++k) {
    const unsigned r = references[k];
    if (r < FIRST_INPUT || r >= END) return complain(i, "only " INPUTS_TEXT " and parameters can be set");
    const int p = (int)r - FIRST_PARAMETER;
    if (p < 0 && !(fabs(values[k]) <= LARGEST_INPUT)) return complain(i, INPUT_TEXT);
    if (p >= 0 && i->begun) return complain(i, "a parameter is set before initialisation ends, not later");
    if (p >= 0 && !(LOWEST[p] <= values[k] && values[k] <= HIGHEST[p]))
      return complain(i, "a parameter is out of the range that modelDescription.xml states");
    if (p < 0) i->fmu.inputs[r - FIRST_INPUT] = values[k];
    else i->fmu.parameters[p] = values[k];
  }
  return STATUS_OK;
}

static status_t start(instance_t *i) { return i->begun = 1, begin(&i->fmu), STATUS_OK; }
static status_t start_anew(instance_t *i) { return i->begun = 0, reset(&i->fmu), STATUS_OK; }

static status_t do_step(instance_t *i, double step) {
  const double count = step / PERIOD, steps = floor(count + 0.5);
  if (!(steps >= 1 && steps <= 1e9 && fabs(count - steps) <= 1e-6))
    return complain(i, "the communication step must be a whole number of ms");
  return advance(&i->fmu, (casadi_int)steps);
}
