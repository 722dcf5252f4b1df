/* B-splines on the grid: N nodes a direction, 4 for the cubic spline of 7.3, 3 for the quadratic one.
 *
 * The weights of a direction stand in one vector of four, the last of the quadratic one being zero. All pieces have the
 * same form: w = A + q^2 (B + C q) with q the distance to a knot. So written no weight is ever negative: the expanded
 * polynomials round below zero where a weight vanishes, and a negative mass ends in nan. */
#include <math.h>

typedef REAL Quad __attribute__((vector_size(4 * sizeof(REAL))));

static inline double first_node(double x) { return N == 4 ? floor(x) - 1 : floor(x - 0.5); }

/* Weights at x (a coordinate divided by h) of the nodes from `first_node(x)` on, and their derivatives by x. */
static inline void weights(double x, Quad *w, Quad *dw) {
#if N == 4
  const REAL third = (REAL)(1.0 / 3), sixth = (REAL)(1.0 / 6);
  const Quad sign = {-1, 1, -1, 1}, offset = {1, 0, 1, 0};
  const Quad A = {0, 2 * third, 2 * third, 0}, B = {0, -1, -1, 0}, C = {sixth, 0.5, 0.5, sixth};
  const REAL t = (REAL)(x - floor(x));
#else
  const Quad sign = {-1, 1, 1, 0}, offset = {0.5, 0, 0.5, 0}, A = {0, 0.75, 0, 0}, B = {0.5, -1, 0.5, 0}, C = {0};
  const REAL t = (REAL)(x - first_node(x) - 1); /* in [-1/2, 1/2) from the middle node */
#endif
  const Quad q = offset + sign * t;
  *w = A + q * q * (B + C * q);
  *dw = sign * q * (2 * B + 3 * C * q);
}
