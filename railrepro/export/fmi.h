/* What all FMUs share before their own C: where an FMU speaks to its importer. Starts after
   call.h and the constants of an FMU, FMU_NAME its name. */

#include <stdlib.h>

typedef enum { STATUS_OK, STATUS_WARNING, STATUS_DISCARD, STATUS_ERROR } status_t;  /* the numbers of FMI 2.0 */

/* The importer: `tell` knows what its logger takes. */
typedef struct host_t {
  void (*tell)(const struct host_t *, status_t, const char *category, const char *text);
  void (*logger)(void);
  void *environment;
} host_t;

static status_t report(const host_t *host, status_t status, const char *text) {
  if (host->logger) host->tell(host, status, status == STATUS_WARNING ? "logStatusWarning" : "logStatusError", text);
  return status;
}
