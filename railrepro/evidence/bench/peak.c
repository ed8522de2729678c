/* What the processor can at most: independent products and sums in registers, side by side and one by one. Starts after lanes.h. */

enum { CHAINS = 12 };

/* Products and sums on CHAINS vectors of LANES numbers, `rounds` times. */
double peak_lanes(long rounds) {
  lanes_t at[CHAINS], all = lanes_all(0);
  for (int i = 0; i < CHAINS; ++i) at[i] = lanes_all(1 + i);
  const lanes_t factor = lanes_all(0.999999), more = lanes_all(1e-6);
  for (long k = 0; k < rounds; ++k)
#pragma GCC unroll 12
    for (int i = 0; i < CHAINS; ++i) at[i] = at[i] * factor + more;
  for (int i = 0; i < CHAINS; ++i) all += at[i];
  return all[0] + all[1] + all[2] + all[3];
}

#if defined(__GNUC__) && !defined(__clang__)
__attribute__((optimize("no-tree-vectorize")))
#endif
double peak_single(long rounds) {
  double at[CHAINS], all = 0;
  for (int i = 0; i < CHAINS; ++i) at[i] = 1 + i;
  for (long k = 0; k < rounds; ++k)
#pragma GCC unroll 12
    for (int i = 0; i < CHAINS; ++i) at[i] = at[i] * 0.999999 + 1e-6;
  for (int i = 0; i < CHAINS; ++i) all += at[i];
  return all;
}
