/* Several numbers side by side in vector registers, for functions of `codegen.lanes_text`. */

#include <math.h>

enum { LANES = 4 };
typedef double lanes_t __attribute__((vector_size(LANES * sizeof(double))));

static inline lanes_t lanes(double value) {
  lanes_t all;
  for (int i = 0; i < LANES; ++i) all[i] = value;
  return all;
}

#define LANES_FUNCTION(name) \
  static inline lanes_t lanes_##name(lanes_t at) { \
    for (int i = 0; i < LANES; ++i) at[i] = name(at[i]); \
    return at; \
  }
LANES_FUNCTION(sin)
LANES_FUNCTION(cos)
LANES_FUNCTION(tan)

