/* Copyright (C) 1993 by Sun Microsystems, Inc. All rights reserved.

   Developed at SunPro, a Sun Microsystems, Inc. business.
   Permission to use, copy, modify, and distribute this software is freely granted, provided that this notice is
   preserved. */

/* Elementary functions of generated C in place of the system's. They consist of products, sums, quotients and square roots
   without branches, so that they give the same bits with every compiler, library and processor of IEEE 754: one number at
   a time or, in the second copy of this text after lanes.h, several side by side. Errors stay below 2 units in the last
   place. sin, cos and tan return NaN beyond LARGEST_ANGLE. pow takes exponents up to 8 in magnitude and returns NaN for
   negative bases. Polynomials: FDLIBM 5.3, with the notice above. */

#include <math.h>
#include <string.h>

#ifndef LANES
#define LARGEST_ANGLE 1e8
#define NUMBER double
#define WORD unsigned long long
#define OWN(name) own_##name
static inline double own_all(double value) { return value; }
static inline WORD own_word(double x) { WORD w; return memcpy(&w, &x, sizeof w), w; }
static inline double own_number(WORD w) { double x; return memcpy(&x, &w, sizeof x), x; }
static inline double own_pick(int yes, double one, double other) { return yes ? one : other; }
static inline double own_sqrt(double x) { return sqrt(x); }
#else
#undef NUMBER
#undef WORD
#undef OWN
#define NUMBER lanes_t
#define WORD words_t
#define OWN(name) lanes_##name
#endif

static inline NUMBER OWN(fmin)(NUMBER x, NUMBER y) { return OWN(pick)(y != y, x, OWN(pick)(x < y, x, y)); }
static inline NUMBER OWN(fmax)(NUMBER x, NUMBER y) { return OWN(pick)(y != y, x, OWN(pick)(x > y, x, y)); }
static inline NUMBER OWN(fabs)(NUMBER x) { return OWN(number)(OWN(word)(x) & 0x7fffffffffffffffULL); }
static inline NUMBER OWN(sign)(NUMBER x) { return OWN(pick)(x < 0, OWN(all)(-1.0), OWN(pick)(x > 0, OWN(all)(1.0), x)); }

/* Nearest whole number (less than 51 bits), and a word with its last bits. */
#define ROUNDING 6755399441055744.0
static inline NUMBER OWN(whole)(NUMBER x) { return (x + ROUNDING) - ROUNDING; }
static inline WORD OWN(last_bits)(NUMBER whole) { return OWN(word)(whole + ROUNDING); }
/* The leading 26 bits: products of two such numbers are exact. */
static inline NUMBER OWN(lead)(NUMBER x) { return OWN(number)(OWN(word)(x) & 0xfffffffff8000000ULL); }
/* Rounding error of the product x y: the exact product less the rounded one. */
static inline NUMBER OWN(rest)(NUMBER x, NUMBER y, NUMBER product) {
  NUMBER x1 = OWN(lead)(x), y1 = OWN(lead)(y), x2 = x - x1, y2 = y - y1;
  return ((x1 * y1 - product) + x1 * y2 + x2 * y1) + x2 * y2;
}
/* Subtract part from *sum; add the rounding error to *low. */
static inline void OWN(less)(NUMBER *sum, NUMBER *low, NUMBER part) {
  NUMBER before = *sum, after = before - part, taken = before - after;
  *low += (before - (after + taken)) + (taken - part);
  *sum = after;
}

typedef struct { NUMBER sin, sin_low, cos, cos_low; WORD quarters; } OWN(turned);

/* Sine and cosine within an eighth of a turn with their rounding errors, and the number of quarter turns taken off. */
static inline OWN(turned) OWN(turn)(NUMBER x) {
  NUMBER n = OWN(whole)(x * 0x1.45f306dc9c883p-1), r = x - n * 0x1.921fb54000000p+0, t = OWN(all)(0.0);
  /* pi/2 in parts of 27 bits: their products with n below 2^26 are exact */
  OWN(less)(&r, &t, n * 0x1.10b4610000000p-30);
  OWN(less)(&r, &t, n * 0x1.a626330000000p-58);
  t -= n * 0x1.45c06e0e68948p-86;
  r = OWN(pick)(OWN(fabs)(x) <= LARGEST_ANGLE, r, OWN(all)(NAN));
  NUMBER z = r * r, v = z * r, w = z * z, half = 0.5 * z;
  NUMBER s = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * (2.75573137070700676789e-06
             + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)));
  NUMBER c = z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * 2.48015872894767294178e-05))
             + w * w * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11));
  NUMBER sl = v * -1.66666666666666324348e-01 - (z * (0.5 * t - v * s) - t), one = 1.0 - half;
  NUMBER cl = ((1.0 - one) - half) + (z * c - r * t);
  NUMBER sine = r + sl, cosine = one + cl;
  return (OWN(turned)){sine, sl - (sine - r), cosine, cl - (cosine - one), OWN(last_bits)(n)};
}
static inline NUMBER OWN(quarter)(OWN(turned) at, WORD quarters) {
  NUMBER value = OWN(pick)((quarters & 1) != 0, at.cos, at.sin);
  return OWN(number)(OWN(word)(value) ^ (quarters & 2) << 62);
}
/* Sine and cosine of one angle together: generated code asks for both. */
#ifndef LANES
typedef double own_pair_t __attribute__((vector_size(16)));
static __attribute__((const, noinline)) own_pair_t own_both(double x) {
  own_turned at = own_turn(x);
  return (own_pair_t){own_quarter(at, at.quarters), own_quarter(at, at.quarters + 1)};
}
static inline double own_sin(double x) { return own_both(x)[0]; }
static inline double own_cos(double x) { return own_both(x)[1]; }
#else
typedef struct { lanes_t sin, cos; } lanes_pair_t;
static __attribute__((noinline)) lanes_pair_t lanes_both(lanes_t x) {
  lanes_turned at = lanes_turn(x);
  return (lanes_pair_t){lanes_quarter(at, at.quarters), lanes_quarter(at, at.quarters + 1)};
}
#endif
static NUMBER OWN(tan)(NUMBER x) {
  OWN(turned) at = OWN(turn)(x);
  NUMBER n = OWN(pick)((at.quarters & 1) != 0, -at.cos, at.sin), d = OWN(pick)((at.quarters & 1) != 0, at.sin, at.cos);
  NUMBER nl = OWN(pick)((at.quarters & 1) != 0, -at.cos_low, at.sin_low);
  NUMBER dl = OWN(pick)((at.quarters & 1) != 0, at.sin_low, at.cos_low), q = n / d, p = q * d;
  return q + (((n - p) - OWN(rest)(q, d, p)) + nl - q * dl) / d;
}

static NUMBER OWN(atan)(NUMBER x) {
  NUMBER a = OWN(fabs)(x), n = a, d = OWN(all)(1.0), high = OWN(all)(0.0), low = high;
#define FROM(limit, above, below, turn, rest) \
  n = OWN(pick)(a >= limit, above, n), d = OWN(pick)(a >= limit, below, d); \
  high = OWN(pick)(a >= limit, OWN(all)(turn), high), low = OWN(pick)(a >= limit, OWN(all)(rest), low);
  FROM(0.4375, 2.0 * a - 1.0, 2.0 + a, 4.63647609000806093515e-01, 2.26987774529616870924e-17)
  FROM(0.6875, a - 1.0, a + 1.0, 7.85398163397448278999e-01, 3.06161699786838301793e-17)
  FROM(1.1875, a - 1.5, 1.0 + 1.5 * a, 9.82793723247329054082e-01, 1.39033110312309984516e-17)
  FROM(2.4375, OWN(all)(-1.0), a, 1.57079632679489655800e+00, 6.12323399573676603587e-17)
#undef FROM
  NUMBER t = n / d, z = t * t, w = z * z;
  NUMBER odd = z * (3.33333333333329318027e-01 + w * (1.42857142725034663711e-01 + w * (9.09088713343650656196e-02
               + w * (6.66107313738753120669e-02 + w * (4.97687799461593236017e-02 + w * 1.62858201153657823623e-02)))));
  NUMBER even = w * (-1.99999999998764832476e-01 + w * (-1.11111104054623557880e-01 + w * (-7.69187620504482999495e-02
                + w * (-5.83357013379057348645e-02 + w * -3.65315727442169155270e-02))));
  NUMBER value = high - ((t * (odd + even) - low) - t);
  return OWN(number)(OWN(word)(value) | (OWN(word)(x) & 0x8000000000000000ULL));
}

static NUMBER OWN(asin)(NUMBER x) {
  const double quarter = 7.85398163397448278999e-01, low = 6.12323399573676603587e-17;
  NUMBER a = OWN(fabs)(x), z = OWN(pick)(a < 0.5, x * x, (1.0 - a) * 0.5);
  NUMBER p = z * (1.66666666666666657415e-01 + z * (-3.25565818622400915405e-01 + z * (2.01212532134862925881e-01
             + z * (-4.00555345006794114027e-02 + z * (7.91534994289814532176e-04 + z * 3.47933107596021167570e-05)))));
  NUMBER q = 1.0 + z * (-2.40339491173441421878e+00 + z * (2.02094576023350569471e+00
             + z * (-6.88283971605453293030e-01 + z * 7.70381505559019352791e-02)));
  NUMBER r = p / q, s = OWN(sqrt)(z), f = OWN(lead)(s), c = (z - f * f) / (s + f + 1e-300);
  NUMBER far = quarter - (2.0 * s * r - (low - 2.0 * c) - (quarter - 2.0 * f));
  NUMBER value = OWN(pick)(a < 0.5, a + a * r, far);
  return OWN(number)(OWN(word)(value) | (OWN(word)(x) & 0x8000000000000000ULL));
}

static inline NUMBER OWN(power_of_two)(NUMBER whole) { return OWN(number)(OWN(last_bits)(whole + 1023.0) << 52); }

/* exp(x + rest). */
static NUMBER OWN(exponential)(NUMBER x, NUMBER rest) {
  x = OWN(pick)(x > 710.0, OWN(all)(710.0), OWN(pick)(x < -746.0, OWN(all)(-746.0), x));
  NUMBER k = OWN(whole)(x * 1.44269504088896338700e+00), high = x - k * 6.93147180369123816490e-01;
  NUMBER low = k * 1.90821492927058770002e-10 - rest, r = high - low, z = r * r, v = z * z;
  NUMBER odd = z * (1.66666666666666019037e-01 + v * (6.61375632143793436117e-05 + v * 4.13813679705723846039e-08));
  NUMBER c = r - (odd + v * (-2.77777777770155933842e-03 + v * -1.65339022054652515390e-06));
  NUMBER value = 1.0 + ((r * c / (2.0 - c) - low) + high), half = OWN(whole)(0.5 * k);
  return value * OWN(power_of_two)(half) * OWN(power_of_two)(k - half);
}
static NUMBER OWN(exp)(NUMBER x) { return OWN(exponential)(x, OWN(all)(0.0)); }

/* Natural logarithm, and in *rest its rounding error. */
static NUMBER OWN(logarithm)(NUMBER x, NUMBER *rest) {
  const double least = 0x1p-1022;
  NUMBER positive = OWN(pick)(x < least, x * 0x1p54, x);
  WORD w = OWN(word)(positive) + (0x3ff0000000000000ULL - 0x3fe6a09e00000000ULL);
  NUMBER k = OWN(number)(w >> 52 | 0x4330000000000000ULL) - (0x1p52 + 1023.0);
  k = OWN(pick)(x < least, k - 54.0, k);
  NUMBER m = OWN(number)((w & 0x000fffffffffffffULL) + 0x3fe6a09e00000000ULL);
  NUMBER f = m - 1.0, d = m + 1.0, inverse = 1.0 / d, s = f * inverse, s1 = OWN(lead)(s), d1 = OWN(lead)(d), d2 = (d - d1) + (m - (d - 1.0));
  NUMBER s2 = ((f - s1 * d1) - s1 * d2) * inverse, z = s * s, v = z * z;
  NUMBER odd = z * (6.666666666666735130e-01 + v * (2.857142874366239149e-01 + v * (1.818357216161805012e-01
               + v * 1.479819860511658591e-01)));
  NUMBER r = odd + v * (3.999999999940941908e-01 + v * (2.222219843214978396e-01 + v * 1.531383769920937332e-01));
  NUMBER twos = k * 6.93147180369123816490e-01, high = twos + 2.0 * s1;
  NUMBER low = (2.0 * s1 - (high - twos)) + ((2.0 * s2 + s * r) + k * 1.90821492927058770002e-10), sum = high + low;
  *rest = low - (sum - high);
  sum = OWN(pick)(x == 0.0, OWN(all)(-INFINITY), OWN(pick)((x < 0.0) | (x != x), OWN(all)(NAN), sum));
  return OWN(pick)(x == INFINITY, x, sum);
}
static NUMBER OWN(log)(NUMBER x) { NUMBER rest; return OWN(logarithm)(x, &rest); }
static NUMBER OWN(pow)(NUMBER x, NUMBER y) {
  NUMBER low, high = OWN(logarithm)(x, &low), product = y * high, rest = OWN(rest)(y, high, product) + y * low;
  NUMBER value = OWN(exponential)(product, OWN(pick)(OWN(fabs)(product) < 1e3, rest, OWN(all)(0.0)));
  return OWN(pick)(y == 0.0, OWN(all)(1.0), value);
}

#ifndef LANES
#define sin(x) own_sin(x)
#define cos(x) own_cos(x)
#define tan(x) own_tan(x)
#define asin(x) own_asin(x)
#define atan(x) own_atan(x)
#define exp(x) own_exp(x)
#define log(x) own_log(x)
#define pow(x, y) own_pow(x, y)
#define fmin(x, y) own_fmin(x, y)
#define fmax(x, y) own_fmax(x, y)
#endif
