/* Several numbers side by side in vector registers, for functions of `compile.lanes`; elementary.c comes before and after
   it. A mask has all bits set where it is true. */

#include <math.h>

#ifndef LANES
#define LANES 4
#endif
typedef double lanes_t __attribute__((vector_size(LANES * sizeof(double))));
typedef unsigned long long words_t __attribute__((vector_size(LANES * sizeof(double))));

static inline lanes_t lanes_all(double value) {
  lanes_t all;
  for (int i = 0; i < LANES; ++i) all[i] = value;
  return all;
}
static inline lanes_t lanes_of(double one, double other) { return (lanes_t){one, other}; }
static inline words_t lanes_word(lanes_t x) { return (words_t)x; }
static inline lanes_t lanes_number(words_t w) { return (lanes_t)w; }

#define lanes_pick(yes, one, other) lanes_chosen((words_t)(yes), one, other)
static inline lanes_t lanes_chosen(words_t yes, lanes_t one, lanes_t other) {
  return (lanes_t)((yes & (words_t)one) | (~yes & (words_t)other));
}

static inline lanes_t lanes_sqrt(lanes_t x) {
  for (int i = 0; i < LANES; ++i) x[i] = sqrt(x[i]);
  return x;
}
