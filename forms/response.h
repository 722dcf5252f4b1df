/* An extended law in the space of stretches: energy, gradient, Hessian and the quotients of appendix B.1.
 *
 * Needs the law-specific half written by symbolic.py (see kernel.c). */
#include <math.h>

/* What a law says at given stretches: psi, its gradient and Hessian in them, and the two quotients
 * (gi - gj)/(si - sj), (gi + gj)/(si + sj) of appendix B.1 for each pair. */
typedef struct {
  double psi, g[D], h[D][D], minus[PAIRS], plus[PAIRS];
} Response;

enum { DERIVATIVES = 1 + D + D * (D + 1) / 2 }; /* psi, psi_k, psi_kl with k <= l */

/* derivatives in d of a law or of one region of its C1 extension */
typedef void (*Region)(const double *d, const double *p, double *w);

static double product(const double *s) {
  double J = 1;
  for (int i = 0; i < D; ++i) J *= s[i];
  return J;
}

/* ---- from coordinates y to stretches ------------------------------------------------------------------------ */

static void coordinates(const double *d, double *y) {
#if IN_STRETCHES
  for (int i = 0; i < D; ++i) y[i] = d[i];
#elif D == 2
  y[0] = d[0] + d[1];
  y[1] = d[0] * d[1];
#else
  y[0] = d[0] + d[1] + d[2];
  y[1] = d[0] * d[1] + d[1] * d[2] + d[0] * d[2];
  y[2] = d[0] * d[1] * d[2];
#endif
}

static void plus_quotients(const double *s, Response *r) {
  for (int q = 0; q < PAIRS; ++q) {
    const int i = PAIR[q][0], j = PAIR[q][1];
    const double sum = s[i] + s[j];
    r->plus[q] = (r->g[i] + r->g[j]) / (fabs(sum) > DENOMINATOR ? sum : copysign(DENOMINATOR, sum));
  }
}

#if IN_STRETCHES || defined(EXTENSION_C1)
/* Nodes and weights of Gauss's rule of four points on (-1, 1), the positive half. */
static const double NODE[2] = {0.33998104358485626, 0.86113631159405258},
                    WEIGHT[2] = {0.65214515486254614, 0.34785484513745386};

static void second_derivatives(const double *w, double h[D][D]) {
  for (int i = 0, n = 1 + D; i < D; ++i)
    for (int j = i; j < D; ++j) h[i][j] = h[j][i] = w[n++];
}

/* Derivatives of (g_i - g_j) along i and against j, where stretches i and j are replaced by a and b. */
static void slopes(Region f, const double *d, const double *p, int i, int j, double a, double b, double out[2]) {
  double at[D], w[DERIVATIVES], h[D][D];
  for (int k = 0; k < D; ++k) at[k] = d[k];
  at[i] = a;
  at[j] = b;
  f(at, p, w);
  second_derivatives(w, h);
  out[0] = h[i][i] - h[i][j];
  out[1] = h[j][j] - h[i][j];
}

/* (g_i - g_j)/(d_i - d_j) for g symmetric in i and j. Where the two are close the quotient would lose digits: it is
 * the mean of a slope along the way from d_i = d_j, an even function of the distance. */
static double symmetric_quotient(Region f, const Response *r, const double *d, const double *p, int i, int j) {
  const double gap = d[i] - d[j], middle = 0.5 * (d[i] + d[j]), half = 0.5 * gap;
  if (fabs(gap) < 1e-8) return 0.5 * (r->h[i][i] + r->h[j][j]) - r->h[i][j];
  if (fabs(gap) < 0.05 * (2 + fabs(d[i]))) {
    double mean = 0, x[2];
    for (int n = 0; n < 2; ++n) {
      slopes(f, d, p, i, j, middle + NODE[n] * half, middle - NODE[n] * half, x);
      mean += 0.5 * WEIGHT[n] * (x[0] + x[1]);
    }
    slopes(f, d, p, i, j, middle + sqrt(1 / 3.0) * half, middle - sqrt(1 / 3.0) * half, x);
    const double size = fabs(r->h[i][i]) + fabs(r->h[j][j]) + fabs(r->h[i][j]);
    /* one point errs by half^4, two by half^8 */
    if (fabs(0.5 * (x[0] + x[1]) - mean) < 1e-7 * size) return mean;
  }
  return (r->g[i] - r->g[j]) / gap;
}

/* The same across d_i > edge > d_j, where the second derivatives jump: the way starts at d_i = d_j = edge. */
static double quotient_across(Region f, const Response *r, const double *d, const double *p, int i, int j,
                              double edge) {
  const double gap = d[i] - d[j], a = d[i] - edge, b = edge - d[j];
  if (gap > 0.02 * (1 + edge)) return (r->g[i] - r->g[j]) / gap;
  if (gap < 1e-300) return 0.5 * (r->h[i][i] + r->h[j][j]) - r->h[i][j];
  double mean = 0, x[2];
  for (int n = 0; n < 4; ++n) {
    const double t = 0.5 + (n % 2 ? 0.5 : -0.5) * NODE[n / 2];
    slopes(f, d, p, i, j, edge + t * a, edge - t * b, x);
    mean += 0.5 * WEIGHT[n / 2] * (x[0] * a + x[1] * b);
  }
  return mean / gap;
}

/* w = psi, psi_k, psi_kl in d; `second`: second derivatives are wanted, here and below. The last `below` stretches
 * are under `edge` + 1. */
static void in_d(Region f, const double *w, const double *s, const double *d, const double *p, int second, int below,
                 double edge, Response *r) {
  r->psi = w[0];
  for (int i = 0; i < D; ++i) r->g[i] = w[1 + i];
  if (!second) return;
  second_derivatives(w, r->h);
  for (int q = 0; q < PAIRS; ++q) {
    const int i = PAIR[q][0], j = PAIR[q][1], across = i < D - below && j >= D - below;
    r->minus[q] = across ? quotient_across(f, r, d, p, i, j, edge) : symmetric_quotient(f, r, d, p, i, j);
  }
  plus_quotients(s, r);
}
#endif

#if !IN_STRETCHES
/* `d`: the numbers whose elementary symmetric polynomials are the coordinates */
static void from_coordinates(const double *w, const double *s, const double *d, int second, Response *r) {
  double c[D][D], wy[D][D]; /* c[k][i] = d e_k / d s_i */
  r->psi = w[0];
  for (int i = 0; i < D; ++i) {
    c[0][i] = 1;
#if D == 2
    c[1][i] = d[1 - i];
#else
    const double a = d[(i + 1) % 3], b = d[(i + 2) % 3];
    c[1][i] = a + b;
    c[2][i] = a * b;
#endif
  }
  for (int i = 0; i < D; ++i) {
    r->g[i] = 0;
    for (int k = 0; k < D; ++k) r->g[i] += w[1 + k] * c[k][i];
  }
  if (!second) return;
  for (int k = 0, n = 1 + D; k < D; ++k)
    for (int l = k; l < D; ++l) wy[k][l] = wy[l][k] = w[n++];
  for (int i = 0; i < D; ++i)
    for (int j = 0; j < D; ++j) {
      double sum = 0;
      for (int k = 0; k < D; ++k)
        for (int l = 0; l < D; ++l) sum += wy[k][l] * c[k][i] * c[l][j];
      r->h[i][j] = sum;
    }
  for (int q = 0; q < PAIRS; ++q) {
    const int i = PAIR[q][0], j = PAIR[q][1];
#if D == 2
    const double mixed = w[2];
#else
    const double mixed = w[2] + w[3] * d[PAIR[q][2]];
#endif
    r->h[i][j] += mixed;
    r->h[j][i] += mixed;
    r->minus[q] = -mixed; /* g_i - g_j = -(psi_e2 + psi_e3 d_k)(s_i - s_j): no cancellation */
  }
  plus_quotients(s, r);
}
#endif

/* The law itself. Coordinates that vanish at rest lose their digits far from it: where a law without extension is
 * asked about a nearly flat state, those that vanish at s = 0 are taken. */
static void base_response(const double *s, const double *d, const double *p, int second, Response *r) {
  double y[D], w[DERIVATIVES];
#if FAR
  if (product(s) < FAR_J) {
    coordinates(s, y);
    base_far(y, p, w);
    from_coordinates(w, s, s, second, r);
    return;
  }
#endif
  coordinates(d, y);
  base(y, p, w);
#if IN_STRETCHES
  in_d(base, w, s, d, p, second, 0, 0, r);
#else
  from_coordinates(w, s, d, second, r);
#endif
}

#include "threshold.h"

/* The extended law at stretches s. */
static void response(const double *s, const double *p, int second, Response *r) {
  double d[D];
  for (int i = 0; i < D; ++i) d[i] = s[i] - 1;
#if defined(EXTENSION_C2)
  if (product(s) < EPS) {
    double y[D], w[DERIVATIVES];
    coordinates(d, y);
    extended(d, y, p, second, w);
#if IN_STRETCHES
    in_d(extended_d, w, s, d, p, second, 0, 0, r);
#else
    from_coordinates(w, s, d, second, r);
#endif
    return;
  }
#elif defined(EXTENSION_IFE)
  if (product(s) < EPS) {
    /* Irving et al.: stress continued linearly from q, its derivative frozen there; there is no energy, psi is
     * the work along the ray from q */
    const double t = threshold_root(d, EPS);
    double q[D], dq[D], beyond[D];
    for (int i = 0; i < D; ++i) {
      dq[i] = t * d[i];
      q[i] = 1 + dq[i];
      beyond[i] = (1 - t) * d[i];
    }
    base_response(q, dq, p, 1, r);
    for (int i = 0; i < D; ++i) {
      double more = 0;
      for (int j = 0; j < D; ++j) more += r->h[i][j] * beyond[j];
      r->psi += (r->g[i] + 0.5 * more) * beyond[i];
      r->g[i] += more; /* the rows of h stay those at q */
    }
    return;
  }
#elif defined(EXTENSION_C1)
  int below = 0;
  for (int i = 0; i < D; ++i) below += s[i] < EPS;
  if (below) {
#if D == 2
    const Region regions[] = {below_1, below_2}, region = regions[below - 1];
#else
    const Region regions[] = {below_1, below_2, below_3}, region = regions[below - 1];
#endif
    double w[DERIVATIVES];
    region(d, p, w);
    in_d(region, w, s, d, p, second, below, EPS - 1, r);
    return;
  }
#endif
  base_response(s, d, p, second, r);
}
