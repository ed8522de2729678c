/* The functions of FMI 2.0 for co-simulation. They follow the C source of a car or a controller, which defines fmu_t with its members
   FMU_INPUTS, FMU_OUTPUTS, FMU_PARAMETERS, the macro FMU_COUNT, and reset, begin, advance. Value references count outputs, inputs,
   parameters. The names are those of the standard's header files, (c) MODELISAR consortium and Modelica Association Project "FMI",
   2-clause BSD licence; the declarations are new. */

#include <stdlib.h>

typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef struct {
  void (*logger)(void *, const char *, fmi2Status, const char *, const char *, ...);
  void *allocate, *release, *finished, *environment;
} callbacks_t;

enum { CO_SIMULATION = 1, INSTANTIATED = 1, INITIALISING = 2, STEPPING = 4, TERMINATED = 8 };
enum { FIRST_INPUT = N_OUTPUT, FIRST_PARAMETER = N_OUTPUT + N_INPUT, END = FIRST_PARAMETER + N_PARAMETER };

/* The state, which can be copied. The GUID identifies it as a state of this FMU. */
typedef struct {
  char guid[sizeof FMU_GUID];
  int phase;
  double start, stop;
  casadi_int cycles;  /* of 1 ms, since the start */
  fmu_t fmu;
} state_t;

typedef struct {
  callbacks_t callbacks;
  state_t now;
} instance_t;

static fmi2Status refused(const instance_t *i, const char *text) {
  if (i->callbacks.logger) i->callbacks.logger(i->callbacks.environment, FMU_NAME, fmi2Error, "logStatusError", text);
  return fmi2Error;
}
#define ONLY(phases, call) if (!(i->now.phase & (phases))) return refused(i, "fmi2" call " is out of order")

/* The variable of a value reference; NULL if there is none. */
static double *variable(instance_t *i, unsigned reference) {
  fmu_t *u = &i->now.fmu;
  if (reference < FIRST_INPUT) return u->FMU_OUTPUTS + reference;
  if (reference < FIRST_PARAMETER) return u->FMU_INPUTS + (reference - FIRST_INPUT);
  return reference < END ? u->FMU_PARAMETERS + (reference - FIRST_PARAMETER) : NULL;
}

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
void fmi2FreeInstance(instance_t *i) { free(i); }

fmi2Status fmi2Reset(instance_t *i) {
  reset(&i->now.fmu), memcpy(i->now.guid, FMU_GUID, sizeof FMU_GUID);
  i->now.phase = INSTANTIATED, i->now.start = 0, i->now.stop = INFINITY, i->now.cycles = 0;
  return fmi2OK;
}

instance_t *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const callbacks_t *callbacks) {
  instance_t *i = calloc(1, sizeof *i);
  if (i && callbacks) i->callbacks = *callbacks;
  if (i && type == CO_SIMULATION && guid && !strcmp(guid, FMU_GUID)) return fmi2Reset(i), i;
  if (i) refused(i, type == CO_SIMULATION ? "the GUID is not that of this FMU, " FMU_GUID : "this FMU is for co-simulation only");
  return free(i), NULL;
}

fmi2Status fmi2SetupExperiment(instance_t *i, int with_tolerance, double tolerance, double start, int with_stop, double stop) {
  ONLY(INSTANTIATED, "SetupExperiment");
  i->now.start = start, i->now.stop = with_stop ? stop : INFINITY;
  return fmi2OK;
}

#define MOVE(call, from, to, action) \
  fmi2Status fmi2##call(instance_t *i) { ONLY(from, #call); return action, i->now.phase = to, fmi2OK; }
MOVE(EnterInitializationMode, INSTANTIATED, INITIALISING, (void)0)
MOVE(ExitInitializationMode, INITIALISING, STEPPING, begin(&i->now.fmu))
MOVE(Terminate, STEPPING, TERMINATED, (void)0)

fmi2Status fmi2GetReal(instance_t *i, const unsigned r[], size_t n, double v[]) {
  for (size_t k = 0; k < n; ++k) {
    const double *from = variable(i, r[k]);
    if (!from) return refused(i, "unknown value reference");
    v[k] = *from;
  }
  return fmi2OK;
}

fmi2Status fmi2GetInteger(instance_t *i, const unsigned r[], size_t n, int v[]) {
  for (size_t k = 0; k < n; ++k)
    if (r[k] < N_COUNTER) v[k] = (int)FMU_COUNT(&i->now.fmu);
    else return refused(i, "unknown value reference");
  return fmi2OK;
}

fmi2Status fmi2SetReal(instance_t *i, const unsigned r[], size_t n, const double v[]) {
  ONLY(INSTANTIATED | INITIALISING | STEPPING, "SetReal");
  for (size_t k = 0; k < n; ++k) {
    double *to = variable(i, r[k]);
    if (!to || r[k] < FIRST_INPUT || (i->now.phase == STEPPING && r[k] >= FIRST_PARAMETER))
      return refused(i, "only inputs can be set, and parameters before initialisation ends");
    if (!(LOWEST[r[k] - FIRST_INPUT] <= v[k] && v[k] <= HIGHEST[r[k] - FIRST_INPUT]))
      return refused(i, NEEDED[r[k] - FIRST_INPUT]);
    *to = v[k];
  }
  return fmi2OK;
}

fmi2Status fmi2DoStep(instance_t *i, double time, double step, int keep) {
  const double count = step / PERIOD, steps = floor(count + 0.5), now = i->now.start + PERIOD * (double)i->now.cycles;
  ONLY(STEPPING, "DoStep");
  if (!(steps >= 1 && steps <= 1e9 && fabs(count - steps) <= 1e-6))
    return refused(i, "the communication step must be a whole number of ms");
  if (!(fabs(time - now) <= PERIOD / 10)) return refused(i, "the communication point is not the end of the step before");
  if (now + PERIOD * steps > i->now.stop + PERIOD / 10) return refused(i, "the step ends after the stop time");
  const char *failed = advance(&i->now.fmu, (casadi_int)steps);
  if (failed) return refused(i, failed);
  i->now.cycles += (casadi_int)steps;
  return fmi2OK;
}

fmi2Status fmi2GetFMUstate(instance_t *i, state_t **state) {
  if (!*state && !(*state = malloc(sizeof **state))) return refused(i, "there is no memory for a state");
  **state = i->now;
  return fmi2OK;
}
fmi2Status fmi2SetFMUstate(instance_t *i, const state_t *state) { return i->now = *state, fmi2OK; }
fmi2Status fmi2FreeFMUstate(instance_t *i, state_t **state) { return free(*state), *state = NULL, fmi2OK; }
fmi2Status fmi2SerializedFMUstateSize(instance_t *i, const state_t *state, size_t *n) { return *n = sizeof *state, fmi2OK; }
fmi2Status fmi2SerializeFMUstate(instance_t *i, const state_t *state, char bytes[], size_t size) {
  return size < sizeof *state ? refused(i, "a state needs more bytes") : (memcpy(bytes, state, sizeof *state), fmi2OK);
}
fmi2Status fmi2DeSerializeFMUstate(instance_t *i, const char bytes[], size_t size, state_t **state) {
  if (size != sizeof **state || memcmp(bytes, FMU_GUID, sizeof FMU_GUID)) return refused(i, "these bytes are no state of this FMU");
  if (fmi2GetFMUstate(i, state)) return fmi2Error;
  memcpy(*state, bytes, size);
  return fmi2OK;
}

/* Functions without effect, as there are no variables of these types, and functions that are not supported. */
#define STUB(name, status) fmi2Status fmi2##name(void *c, ...) { return status; }
STUB(SetDebugLogging, fmi2OK) STUB(GetBoolean, fmi2OK) STUB(GetString, fmi2OK)
STUB(SetInteger, fmi2OK) STUB(SetBoolean, fmi2OK) STUB(SetString, fmi2OK)
STUB(SetRealInputDerivatives, fmi2Error) STUB(GetRealOutputDerivatives, fmi2Error) STUB(GetDirectionalDerivative, fmi2Error)
STUB(CancelStep, fmi2Error) STUB(GetStatus, fmi2Error) STUB(GetRealStatus, fmi2Error) STUB(GetIntegerStatus, fmi2Error)
STUB(GetBooleanStatus, fmi2Error) STUB(GetStringStatus, fmi2Error)
