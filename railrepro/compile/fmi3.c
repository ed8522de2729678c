/* FMI 3.0 co-simulation around fmi.c. Names, types and signatures are those of the standard's header files, (c) MODELISAR
   consortium and Modelica Association Project "FMI", 2-clause BSD licence; the declarations are written anew. */

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef void *fmi3Instance;
typedef void *fmi3Environment;
typedef uint32_t fmi3Reference;
typedef const char *fmi3String;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef void (*fmi3Logger)(fmi3Environment, fmi3Status, fmi3String, fmi3String);
typedef void (*fmi3Callback)(void);  /* of callbacks that are never called */

static void tell(const host_t *host, status_t status, const char *category, const char *text) {
  ((fmi3Logger)host->logger)(host->environment, (fmi3Status)status, category, text);
}

const char *fmi3GetVersion(void) { return "3.0"; }
fmi3Status fmi3SetDebugLogging(fmi3Instance i, bool on, size_t n, const fmi3String names[]) { return fmi3OK; }

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, bool visible, bool logging,
                                         bool events, bool early, const fmi3Reference needed[], size_t n,
                                         fmi3Environment environment, fmi3Logger logger, fmi3Callback intermediate) {
  return instantiate(token, (host_t){tell, (void (*)(void))logger, environment});
}
static fmi3Instance refuse(fmi3Environment environment, fmi3Logger logger) {
  const host_t host = {tell, (void (*)(void))logger, environment};
  return report(&host, STATUS_ERROR, "this unit is for co-simulation only"), NULL;
}
fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources, bool visible, bool logging,
                                          fmi3Environment environment, fmi3Logger logger) {
  return refuse(environment, logger);
}
fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token, fmi3String resources, bool visible,
                                               bool logging, fmi3Environment environment, fmi3Logger logger,
                                               fmi3Callback clock, fmi3Callback lock, fmi3Callback unlock) {
  return refuse(environment, logger);
}
void fmi3FreeInstance(fmi3Instance i) { free(i); }
fmi3Status fmi3EnterInitializationMode(fmi3Instance i, bool t, double tolerance, double start, bool s, double stop) {
  return ((instance_t *)i)->time = start, fmi3OK;
}
fmi3Status fmi3ExitInitializationMode(fmi3Instance i) { return begin(&((instance_t *)i)->unit), fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance i) { return fmi3OK; }
fmi3Status fmi3Reset(fmi3Instance i) { return restart(i), fmi3OK; }

fmi3Status fmi3GetFloat64(fmi3Instance i, const fmi3Reference r[], size_t n, double v[], size_t nv) {
  return nv == n ? (fmi3Status)get_numbers(i, r, n, v) : (fmi3Status)complain(i, "all variables are scalars");
}
fmi3Status fmi3SetFloat64(fmi3Instance i, const fmi3Reference r[], size_t n, const double v[], size_t nv) {
  return nv == n ? (fmi3Status)set_numbers(i, r, n, v) : (fmi3Status)complain(i, "all variables are scalars");
}

fmi3Status fmi3DoStep(fmi3Instance c, double time, double step, bool keep, bool *event, bool *terminate, bool *early,
                      double *reached) {
  instance_t *i = c;
  i->time = time;
  const fmi3Status status = (fmi3Status)do_step(i, time, step);
  *event = *terminate = *early = false, *reached = i->time;
  return status;
}

#define UNUSED(name, type) \
  fmi3Status fmi3Get##name(fmi3Instance i, const fmi3Reference r[], size_t n, type v[], size_t nv) { \
    return n ? fmi3Error : fmi3OK; \
  } \
  fmi3Status fmi3Set##name(fmi3Instance i, const fmi3Reference r[], size_t n, type const v[], size_t nv) { \
    return n ? fmi3Error : fmi3OK; \
  }
UNUSED(Float32, float)
UNUSED(Int8, int8_t)
UNUSED(UInt8, uint8_t)
UNUSED(Int16, int16_t)
UNUSED(UInt16, uint16_t)
UNUSED(Int32, int32_t)
UNUSED(UInt32, uint32_t)
UNUSED(Int64, int64_t)
UNUSED(UInt64, uint64_t)
UNUSED(Boolean, bool)
UNUSED(String, fmi3String)

#define NOT_OFFERED(name, ...) \
  fmi3Status fmi3##name(fmi3Instance i, ##__VA_ARGS__) { return fmi3Error; }
NOT_OFFERED(GetBinary, const fmi3Reference r[], size_t n, size_t sizes[], const uint8_t *v[], size_t nv)
NOT_OFFERED(SetBinary, const fmi3Reference r[], size_t n, const size_t sizes[], const uint8_t *const v[], size_t nv)
NOT_OFFERED(GetClock, const fmi3Reference r[], size_t n, bool v[])
NOT_OFFERED(SetClock, const fmi3Reference r[], size_t n, const bool v[])
NOT_OFFERED(GetNumberOfVariableDependencies, fmi3Reference r, size_t *n)
NOT_OFFERED(GetVariableDependencies, fmi3Reference r, size_t elements[], fmi3Reference of[], size_t theirs[], int kinds[],
            size_t n)
NOT_OFFERED(GetFMUState, void **s)
NOT_OFFERED(SetFMUState, void *s)
NOT_OFFERED(FreeFMUState, void **s)
NOT_OFFERED(SerializedFMUStateSize, void *s, size_t *n)
NOT_OFFERED(SerializeFMUState, void *s, uint8_t b[], size_t n)
NOT_OFFERED(DeserializeFMUState, const uint8_t b[], size_t n, void **s)
NOT_OFFERED(GetDirectionalDerivative, const fmi3Reference u[], size_t nu, const fmi3Reference k[], size_t nk,
            const double seed[], size_t ns, double v[], size_t nv)
NOT_OFFERED(GetAdjointDerivative, const fmi3Reference u[], size_t nu, const fmi3Reference k[], size_t nk,
            const double seed[], size_t ns, double v[], size_t nv)
NOT_OFFERED(EnterConfigurationMode)
NOT_OFFERED(ExitConfigurationMode)
NOT_OFFERED(GetIntervalDecimal, const fmi3Reference r[], size_t n, double v[], int q[])
NOT_OFFERED(GetIntervalFraction, const fmi3Reference r[], size_t n, uint64_t v[], uint64_t w[], int q[])
NOT_OFFERED(GetShiftDecimal, const fmi3Reference r[], size_t n, double v[])
NOT_OFFERED(GetShiftFraction, const fmi3Reference r[], size_t n, uint64_t v[], uint64_t w[])
NOT_OFFERED(SetIntervalDecimal, const fmi3Reference r[], size_t n, const double v[])
NOT_OFFERED(SetIntervalFraction, const fmi3Reference r[], size_t n, const uint64_t v[], const uint64_t w[])
NOT_OFFERED(SetShiftDecimal, const fmi3Reference r[], size_t n, const double v[])
NOT_OFFERED(SetShiftFraction, const fmi3Reference r[], size_t n, const uint64_t v[], const uint64_t w[])
NOT_OFFERED(EvaluateDiscreteStates)
NOT_OFFERED(UpdateDiscreteStates, bool *more, bool *terminate, bool *nominals, bool *values, bool *defined, double *next)
NOT_OFFERED(EnterEventMode)
NOT_OFFERED(EnterContinuousTimeMode)
NOT_OFFERED(CompletedIntegratorStep, bool keep, bool *event, bool *terminate)
NOT_OFFERED(SetTime, double time)
NOT_OFFERED(SetContinuousStates, const double v[], size_t n)
NOT_OFFERED(GetContinuousStateDerivatives, double v[], size_t n)
NOT_OFFERED(GetEventIndicators, double v[], size_t n)
NOT_OFFERED(GetContinuousStates, double v[], size_t n)
NOT_OFFERED(GetNominalsOfContinuousStates, double v[], size_t n)
NOT_OFFERED(GetNumberOfEventIndicators, size_t *n)
NOT_OFFERED(GetNumberOfContinuousStates, size_t *n)
NOT_OFFERED(EnterStepMode)
NOT_OFFERED(GetOutputDerivatives, const fmi3Reference r[], size_t n, const int32_t o[], double v[], size_t nv)
NOT_OFFERED(ActivateModelPartition, fmi3Reference clock, double time)
