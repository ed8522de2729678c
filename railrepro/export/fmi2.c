/* A car or a controller as an FMU for co-simulation (FMI 2.0). Starts after its own C: fmu_t with members FMU_INPUTS, FMU_OUTPUTS,
   FMU_PARAMETERS; reset, begin, advance. Value references: outputs, inputs, parameters. Names are those of the standard's header
   files, (c) MODELISAR consortium and Modelica Association Project "FMI", 2-clause BSD licence; the declarations are written anew. */

#include <stdlib.h>

typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef struct {
  void (*logger)(void *, const char *, fmi2Status, const char *, const char *, ...);
  void *allocate, *release, *finished, *environment;
} callbacks_t;

enum { FIRST_INPUT = N_OUTPUT, FIRST_PARAMETER = N_OUTPUT + N_INPUT, END = FIRST_PARAMETER + N_PARAMETER };

typedef struct {
  callbacks_t callbacks;
  int begun;  /* from here on parameters are fixed */
  fmu_t fmu;
} instance_t;

static fmi2Status refused(const instance_t *i, const char *text) {
  if (i->callbacks.logger) i->callbacks.logger(i->callbacks.environment, FMU_NAME, fmi2Error, "logStatusError", text);
  return fmi2Error;
}

/* The variable of a value reference, NULL beyond the last one. */
static double *variable(instance_t *i, unsigned reference) {
  if (reference < FIRST_INPUT) return i->fmu.FMU_OUTPUTS + reference;
  if (reference < FIRST_PARAMETER) return i->fmu.FMU_INPUTS + (reference - FIRST_INPUT);
  return reference < END ? i->fmu.FMU_PARAMETERS + (reference - FIRST_PARAMETER) : NULL;
}

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
void fmi2FreeInstance(instance_t *i) { free(i); }

instance_t *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const callbacks_t *callbacks) {
  instance_t *i = calloc(1, sizeof *i);
  if (i && callbacks) i->callbacks = *callbacks;
  if (i) reset(&i->fmu);
  return i;
}

fmi2Status fmi2ExitInitializationMode(instance_t *i) {
  begin(&i->fmu), i->begun = 1;
  return fmi2OK;
}

fmi2Status fmi2Reset(instance_t *i) {
  reset(&i->fmu), i->begun = 0;
  return fmi2OK;
}

fmi2Status fmi2GetReal(instance_t *i, const unsigned r[], size_t n, double v[]) {
  for (size_t k = 0; k < n; ++k) {
    const double *from = variable(i, r[k]);
    if (!from) return refused(i, "unknown value reference");
    v[k] = *from;
  }
  return fmi2OK;
}

fmi2Status fmi2SetReal(instance_t *i, const unsigned r[], size_t n, const double v[]) {
  for (size_t k = 0; k < n; ++k) {
    double *to = variable(i, r[k]);
    if (!to || r[k] < FIRST_INPUT || (i->begun && r[k] >= FIRST_PARAMETER))
      return refused(i, "only inputs can be set, and parameters before initialisation ends");
    if (!(LOWEST[r[k] - FIRST_INPUT] <= v[k] && v[k] <= HIGHEST[r[k] - FIRST_INPUT]))
      return refused(i, "a value is out of the range that modelDescription.xml states");
    *to = v[k];
  }
  return fmi2OK;
}

fmi2Status fmi2DoStep(instance_t *i, double time, double step, int keep) {
  const double count = step / PERIOD, steps = floor(count + 0.5);
  if (!(steps >= 1 && steps <= 1e9 && fabs(count - steps) <= 1e-6))
    return refused(i, "the communication step must be a whole number of ms");
  const char *failed = advance(&i->fmu, (casadi_int)steps);
  return failed ? refused(i, failed) : fmi2OK;
}

/* Accepted without effect, as there are no variables of these types, and not offered; further arguments are not looked at. */
#define STUB(name, status) fmi2Status fmi2##name(void *c, ...) { return status; }
STUB(SetDebugLogging, fmi2OK) STUB(SetupExperiment, fmi2OK) STUB(EnterInitializationMode, fmi2OK) STUB(Terminate, fmi2OK)
STUB(GetInteger, fmi2OK) STUB(GetBoolean, fmi2OK) STUB(GetString, fmi2OK)
STUB(SetInteger, fmi2OK) STUB(SetBoolean, fmi2OK) STUB(SetString, fmi2OK)
STUB(GetFMUstate, fmi2Error) STUB(SetFMUstate, fmi2Error) STUB(FreeFMUstate, fmi2Error)
STUB(SerializeFMUstate, fmi2Error) STUB(DeSerializeFMUstate, fmi2Error) STUB(SerializedFMUstateSize, fmi2Error)
STUB(SetRealInputDerivatives, fmi2Error) STUB(GetRealOutputDerivatives, fmi2Error) STUB(GetDirectionalDerivative, fmi2Error)
STUB(CancelStep, fmi2Error) STUB(GetStatus, fmi2Error) STUB(GetRealStatus, fmi2Error) STUB(GetIntegerStatus, fmi2Error)
STUB(GetBooleanStatus, fmi2Error) STUB(GetStringStatus, fmi2Error)
