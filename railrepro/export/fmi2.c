/* A car or a controller as an FMU for co-simulation (FMI 2.0). Starts after its own C: fmu_t with `said` and the
   members FMU_INPUTS, FMU_OUTPUTS, FMU_PARAMETERS; reset, begin, and advance, which returns a status. Value references:
   outputs, inputs, parameters. Names, types and signatures are those of the standard's header files, (c) MODELISAR consortium and Modelica
   Association Project "FMI", 2-clause BSD licence; the declarations are written anew. */

#include <stdlib.h>

typedef void *fmi2Component;
typedef unsigned int fmi2ValueReference;
typedef int fmi2Boolean;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef const char *fmi2String;
typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef void (*fmi2Logger)(void *, fmi2String, fmi2Status, fmi2String, fmi2String, ...);
typedef struct {
  fmi2Logger logger;
  void *(*allocate)(size_t, size_t);
  void (*release)(void *);
  void *finished, *environment;
} fmi2CallbackFunctions;

enum { FIRST_INPUT = N_OUTPUT, FIRST_PARAMETER = N_OUTPUT + N_INPUT, END = FIRST_PARAMETER + N_PARAMETER };

typedef struct {
  fmi2Logger logger;
  void *environment;
  int begun;
  fmu_t fmu;
} instance_t;

static fmi2Status say(const instance_t *i, fmi2Status status, const char *text) {
  const char *category = status == fmi2Warning ? "logStatusWarning" : "logStatusError";
  if (i->logger) i->logger(i->environment, FMU_NAME, status, category, text);
  return status;
}

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) { return fmi2OK; }

/* NULL, and a sentence, where the type or the token is not that of the FMU. */
fmi2Component fmi2Instantiate(fmi2String name, int type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
  instance_t *i = calloc(1, sizeof *i);
  if (!i) return NULL;
  if (callbacks) i->logger = callbacks->logger, i->environment = callbacks->environment;
  if (type == 1 && guid && !strcmp(guid, GUID)) {
    reset(&i->fmu);
    return i;
  }
  say(i, fmi2Error, type == 1 ? "the GUID is not that of this FMU" : "this FMU is for co-simulation only");
  free(i);
  return NULL;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean t, fmi2Real tol, fmi2Real start, fmi2Boolean s, fmi2Real stop) {
  return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
  instance_t *i = c;
  i->begun = 1, begin(&i->fmu);
  return fmi2OK;
}
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) {
  instance_t *i = c;
  i->begun = 0, reset(&i->fmu);
  return fmi2OK;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
  const instance_t *i = c;
  for (size_t k = 0; k < n; ++k) {
    if (r[k] >= END) return say(i, fmi2Error, "unknown value reference");
    v[k] = r[k] < FIRST_INPUT ? i->fmu.FMU_OUTPUTS[r[k]]
         : r[k] < FIRST_PARAMETER ? i->fmu.FMU_INPUTS[r[k] - FIRST_INPUT] : i->fmu.FMU_PARAMETERS[r[k] - FIRST_PARAMETER];
  }
  return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) {
  instance_t *i = c;
  for (size_t k = 0; k < n; ++k) {
    const int p = (int)r[k] - FIRST_PARAMETER;
    if (r[k] < FIRST_INPUT || r[k] >= END) return say(i, fmi2Error, "only " INPUTS_TEXT " and parameters can be set");
    if (p < 0 && !(fabs(v[k]) <= LARGEST_INPUT)) return say(i, fmi2Error, INPUT_TEXT);
    if (p >= 0 && i->begun) return say(i, fmi2Error, "a parameter is set before initialisation ends, not later");
    if (p >= 0 && !(LOWEST[p] <= v[k] && v[k] <= HIGHEST[p]))
      return say(i, fmi2Error, "a parameter is out of the range that modelDescription.xml states");
    *(p < 0 ? i->fmu.FMU_INPUTS + (r[k] - FIRST_INPUT) : i->fmu.FMU_PARAMETERS + p) = v[k];
  }
  return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean keep) {
  instance_t *i = c;
  const double count = step / PERIOD, steps = floor(count + 0.5);
  if (!(steps >= 1 && steps <= 1e9 && fabs(count - steps) <= 1e-6))
    return say(i, fmi2Error, "the communication step must be a whole number of ms");
  const int status = advance(&i->fmu, (casadi_int)steps);
  return status ? say(i, (fmi2Status)status, i->fmu.said) : fmi2OK;
}

#define UNUSED_GET(name, type) \
  fmi2Status name(fmi2Component c, const fmi2ValueReference r[], size_t n, type v[]) { return n ? fmi2Error : fmi2OK; }
UNUSED_GET(fmi2GetInteger, fmi2Integer)
UNUSED_GET(fmi2GetBoolean, fmi2Boolean)
UNUSED_GET(fmi2GetString, fmi2String)
UNUSED_GET(fmi2SetInteger, const fmi2Integer)
UNUSED_GET(fmi2SetBoolean, const fmi2Boolean)
UNUSED_GET(fmi2SetString, const fmi2String)

#define NOT_OFFERED(name, ...) \
  fmi2Status name(__VA_ARGS__) { return fmi2Error; }
NOT_OFFERED(fmi2GetFMUstate, fmi2Component c, void **s)
NOT_OFFERED(fmi2SetFMUstate, fmi2Component c, void *s)
NOT_OFFERED(fmi2FreeFMUstate, fmi2Component c, void **s)
NOT_OFFERED(fmi2SerializedFMUstateSize, fmi2Component c, void *s, size_t *n)
NOT_OFFERED(fmi2SerializeFMUstate, fmi2Component c, void *s, char b[], size_t n)
NOT_OFFERED(fmi2DeSerializeFMUstate, fmi2Component c, const char b[], size_t n, void **s)
NOT_OFFERED(fmi2GetDirectionalDerivative, fmi2Component c, const fmi2ValueReference u[], size_t nu,
            const fmi2ValueReference k[], size_t nk, const fmi2Real dk[], fmi2Real du[])
NOT_OFFERED(fmi2SetRealInputDerivatives, fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer o[],
            const fmi2Real v[])
NOT_OFFERED(fmi2GetRealOutputDerivatives, fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Integer o[],
            fmi2Real v[])
NOT_OFFERED(fmi2CancelStep, fmi2Component c)
NOT_OFFERED(fmi2GetStatus, fmi2Component c, int k, fmi2Status *v)
NOT_OFFERED(fmi2GetRealStatus, fmi2Component c, int k, fmi2Real *v)
NOT_OFFERED(fmi2GetIntegerStatus, fmi2Component c, int k, fmi2Integer *v)
NOT_OFFERED(fmi2GetBooleanStatus, fmi2Component c, int k, fmi2Boolean *v)
NOT_OFFERED(fmi2GetStringStatus, fmi2Component c, int k, fmi2String *v)
