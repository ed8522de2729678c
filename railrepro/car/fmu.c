/* FMI 2.0 co-simulation interface around the generated car. Starts after car.c and the constants of the exported route,
   contact table and vehicle. Value references: outputs first, then the four torque commands. */

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

enum { LOOKUPS = BODIES + WHEELS, POINTERS = 16, INTEGERS = 256, WORK = 65536 };

typedef struct {
  double x[N_STATE], next[N_STATE], error[N_STATE], tau[WHEELS], y[N_OUTPUT], places[LOOKUPS], period;
  double rows[BODIES * N_CELL], contacts[WHEELS * N_CONTACT];
  lookup_t lookups[LOOKUPS];
  const double *in[3][POINTERS];
  double *out[3][POINTERS];
  casadi_int integers[INTEGERS];
  double work[WORK];
  car_t car;
  int told;
  const fmi2CallbackFunctions *callbacks;
} unit_t;

static call_t bind(unit_t *u, int function, casadi_fn evaluate) {
  return (call_t){evaluate, u->in[function], u->out[function], u->integers, u->work};
}

/* Let the generated functions share the buffers of the unit. */
static void connect(unit_t *u) {
  const double *in[3][6] = {{u->x, u->rows, PARAMETERS},
                            {u->x, u->tau, u->rows, u->contacts, PARAMETERS},
                            {u->x, u->tau, u->rows, u->contacts, PARAMETERS, &u->period}};
  double *out[3][2] = {{u->places}, {u->y}, {u->next, u->error}};
  for (int i = 0; i < 3; ++i) memcpy(u->in[i], in[i], sizeof in[i]), memcpy(u->out[i], out[i], sizeof out[i]);
  for (int i = 0; i < BODIES; ++i)
    u->lookups[i] = (lookup_t){CELLS, CELL_START, CELL_STEP, N_CELLS, N_CELL, u->rows + i * N_CELL};
  for (int i = 0; i < WHEELS; ++i)
    u->lookups[BODIES + i] =
        (lookup_t){CONTACTS, CONTACT_START, CONTACT_STEP, N_CONTACTS, N_CONTACT, u->contacts + i * N_CONTACT};
  u->car = (car_t){bind(u, 0, car_coordinates), bind(u, 1, car_output), bind(u, 2, car_step),
                   u->places, u->lookups, LOOKUPS, u->x, u->next, N_STATE};
}

static void reset(unit_t *u) {
  memcpy(u->x, START, sizeof u->x);
  memset(u->tau, 0, sizeof u->tau);
  memset(u->rows, 0, sizeof u->rows);
  u->period = PERIOD, u->told = 0;
  car_look_up(&u->car);  /* the look-up of contacts uses the irregularities of the rows found before */
  car_measure(&u->car);
}

static fmi2Status report(const fmi2CallbackFunctions *callbacks, fmi2Status status, const char *text) {
  const char *category = status == fmi2Warning ? "logStatusWarning" : "logStatusError";
  if (callbacks && callbacks->logger) callbacks->logger(callbacks->environment, "car", status, category, text);
  return status;
}

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
fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return car_measure(&((unit_t *)c)->car), fmi2OK; }
fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
fmi2Status fmi2Reset(fmi2Component c) { return reset(c), fmi2OK; }

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real values[]) {
  unit_t *u = c;
  for (size_t i = 0; i < n; ++i) {
    if (r[i] >= N_OUTPUT + WHEELS) return complain(u, "unknown value reference");
    values[i] = r[i] < N_OUTPUT ? u->y[r[i]] : u->tau[r[i] - N_OUTPUT];
  }
  return fmi2OK;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real values[]) {
  unit_t *u = c;
  for (size_t i = 0; i < n; ++i) {
    if (r[i] < N_OUTPUT || r[i] >= N_OUTPUT + WHEELS) return complain(u, "only the four torques can be set");
    if (!(fabs(values[i]) <= LARGEST_TORQUE)) return complain(u, "a torque must be a number of at most " TORQUE_TEXT);
    u->tau[r[i] - N_OUTPUT] = values[i];
  }
  return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean keep) {
  unit_t *u = c;
  const double count = step / PERIOD, steps = floor(count + 0.5);
  if (!(steps >= 1 && steps <= 1e9 && fabs(count - steps) <= 1e-6))
    return complain(u, "the communication step must be a whole number of ms");
  if (car_run(&u->car, (casadi_int)steps, LARGEST_STATE) < steps)
    return complain(u, "a state of the car left all bounds");
  car_measure(&u->car);
  if (!(fabs(u->y[FRONT_Y]) < DERAILED && fabs(u->y[REAR_Y]) < DERAILED) && !u->told)
    return u->told = 1, report(u->callbacks, fmi2Warning, "a gear left the rail, what follows means nothing");
  return fmi2OK;
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
