/* FMI 2.0 co-simulation around fmi.c. Names, types and signatures are those of the standard's header files, (c) MODELISAR
   consortium and Modelica Association Project "FMI", 2-clause BSD licence; the declarations are written anew. */

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

static void tell(const host_t *host, status_t status, const char *category, const char *text) {
  ((fmi2Logger)host->logger)(host->environment, FMU_NAME, (fmi2Status)status, category, text);
}

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) { return fmi2OK; }

fmi2Component fmi2Instantiate(fmi2String name, int type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
  const host_t host = {tell, callbacks ? (void (*)(void))callbacks->logger : NULL, callbacks ? callbacks->environment : NULL};
  if (type != 1) return report(&host, STATUS_ERROR, "this FMU is for co-simulation only"), NULL;
  return instantiate(guid, host);
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean t, fmi2Real tol, fmi2Real start, fmi2Boolean s, fmi2Real stop) {
  return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return (fmi2Status)start(c); }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { return (fmi2Status)start_anew(c); }
fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
  return (fmi2Status)get_numbers(c, r, n, v);
}
fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) {
  return (fmi2Status)set_numbers(c, r, n, v);
}
fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean keep) {
  return (fmi2Status)do_step(c, step);
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
