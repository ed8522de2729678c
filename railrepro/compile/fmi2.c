/* FMI 2.0 co-simulation interface around a unit: unit_t with `inputs`, outputs `y` and `callbacks`; connect, reset, begin and
   advance. Value references: outputs first, then inputs. */

static fmi2Status complain(unit_t *u, const char *text) { return report(u->callbacks, fmi2Error, text); }

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) { return fmi2OK; }

fmi2Component fmi2Instantiate(fmi2String name, int type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
  if (type != 1) return report(callbacks, fmi2Error, "this unit is for co-simulation only"), NULL;
  if (!guid || strcmp(guid, GUID)) return report(callbacks, fmi2Error, "the GUID is not that of this unit"), NULL;
  unit_t *u = calloc(1, sizeof(unit_t));
  if (u) u->callbacks = callbacks, connect(u), reset(u);
  return u;
}
void fmi2FreeInstance(fmi2Component c) { free(c); }
fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean t, fmi2Real tol, fmi2Real start, fmi2Boolean s, fmi2Real stop) {
  return fmi2OK;
}
fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return begin(c), fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { return reset(c), fmi2OK; }

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real values[]) {
  unit_t *u = c;
  for (size_t i = 0; i < n; ++i) {
    if (r[i] >= N_OUTPUT + N_INPUT) return complain(u, "unknown value reference");
    values[i] = r[i] < N_OUTPUT ? u->y[r[i]] : u->inputs[r[i] - N_OUTPUT];
  }
  return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real values[]) {
  unit_t *u = c;
  for (size_t i = 0; i < n; ++i) {
    if (r[i] < N_OUTPUT || r[i] >= N_OUTPUT + N_INPUT) return complain(u, "only " INPUTS_TEXT " can be set");
    if (!(fabs(values[i]) <= LARGEST_INPUT)) return complain(u, INPUT_TEXT);
    u->inputs[r[i] - N_OUTPUT] = values[i];
  }
  return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean keep) {
  unit_t *u = c;
  const double count = step / PERIOD, steps = floor(count + 0.5);
  if (!(steps >= 1 && steps <= 1e9 && fabs(count - steps) <= 1e-6))
    return complain(u, "the communication step must be a whole number of ms");
  return advance(u, (casadi_int)steps);
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
