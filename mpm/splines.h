/* B-spline weights on the grid: N nodes a direction, 4 for the cubic spline of 7.3, 3 for the quadratic one.
 *
 * `x` is a coordinate divided by h; the first node is `first_node(x)`. Written so that no weight is ever negative:
 * the expanded polynomials round below zero where a weight vanishes, and a negative mass ends in nan. */
#include <math.h>

static inline double first_node(double x) { return N == 4 ? floor(x) - 1 : floor(x - 0.5); }

static inline void weights(double x, double *w, double *dw) {
#if N == 4
  const double t = x - floor(x), s = 1 - t;
  w[0] = s * s * s / 6;
  w[1] = 2.0 / 3 - t * t * (1 - 0.5 * t);
  w[2] = 2.0 / 3 - s * s * (1 - 0.5 * s);
  w[3] = t * t * t / 6;
  dw[0] = -0.5 * s * s;
  dw[1] = t * (1.5 * t - 2);
  dw[2] = s * (2 - 1.5 * s);
  dw[3] = 0.5 * t * t;
#else
  const double t = x - first_node(x) - 1, l = 0.5 - t, r = 0.5 + t; /* t in [-1/2, 1/2) from the middle node */
  w[0] = 0.5 * l * l;
  w[1] = 0.75 - t * t;
  w[2] = 0.5 * r * r;
  dw[0] = -l;
  dw[1] = -2 * t;
  dw[2] = r;
#endif
}
