/* Types of FMI 2.0 and what a unit tells its importer. Starts after call.h and the constants of a unit, UNIT its name. */

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

static fmi2Status report(const fmi2CallbackFunctions *callbacks, fmi2Status status, const char *text) {
  const char *category = status == fmi2Warning ? "logStatusWarning" : "logStatusError";
  if (callbacks && callbacks->logger) callbacks->logger(callbacks->environment, UNIT, status, category, text);
  return status;
}
