/* Energy, stress and stress derivative of an extended isotropic law at many points.
 *
 * The law-specific half (D, LAW_PARAMETERS, IN_STRETCHES, SKIPS_SVD, EXTENSION_..., base, base4, direct, below_n)
 * is written by symbolic.py and includes this file at its end. Points are taken W at a time so that the singular value
 * decomposition, the dearest part, runs in vector registers.
 *
 * Conventions: F = U diag(s) V^T with U, V rotations, s1 >= s2 >= |s3|, the last one carries the sign of det F.
 * Tensors are flattened by rows. Parameters of a point: those of the law, then epsilon, then k.
 */
#include <math.h>
#include <string.h>

#define W 8
#define DD (D * D)
#define PAIRS (D * (D - 1) / 2)
#define DENOMINATOR 1e-6 /* appendix B.1: smallest |si + sj| to divide by */
#define EPS p[LAW_PARAMETERS]
#define FAR_J 0.5 /* J under which a law without extension is asked in the coordinates that vanish at s = 0 */

static const int PAIR[3][3] = {{0, 1, 2}, {0, 2, 1}, {1, 2, 0}}; /* i, j and, in 3D, the third */

#include "response.h"
#include "stretches.h"

/* ---- projection and assembly of dP/dF ------------------------------------------------------------------------ */

/* The nearest positive semidefinite matrix to the symmetric h (cyclic Jacobi, negative eigenvalues cut). */
static void project(double h[D][D]) {
#if D == 2
  const double m2 = h[0][0] * h[1][1] - h[0][1] * h[1][0];
  if (h[0][0] > 0 && m2 >= 0) return;
#else
  const double m2 = h[0][0] * h[1][1] - h[0][1] * h[1][0];
  const double m3 = h[2][2] * m2 + h[0][2] * (h[1][0] * h[2][1] - h[1][1] * h[2][0]) -
                    h[1][2] * (h[0][0] * h[2][1] - h[0][1] * h[2][0]);
  if (h[0][0] > 0 && m2 > 0 && m3 >= 0) return;
#endif
  double q[D][D] = {{0}}, a[D][D];
  for (int i = 0; i < D; ++i) q[i][i] = 1;
  memcpy(a, h, sizeof(a));
  for (int sweep = 0; sweep < 10; ++sweep) {
    double off = 0, all = 0;
    for (int i = 0; i < D; ++i)
      for (int j = 0; j < D; ++j) {
        all += a[i][j] * a[i][j];
        if (i != j) off += a[i][j] * a[i][j];
      }
    if (!(off > 1e-32 * all)) break;
    for (int n = 0; n < PAIRS; ++n) {
      const int i = PAIR[n][0], j = PAIR[n][1];
      const double c = a[i][j], half = 0.5 * (a[j][j] - a[i][i]), root = sqrt(half * half + c * c);
      if (root == 0) continue;
      const double t = c / (half < 0 ? half - root : half + root), cs = 1 / sqrt(1 + t * t), sn = cs * t;
      for (int k = 0; k < D; ++k) {
        const double x = a[k][i], y = a[k][j], v = q[k][i], w = q[k][j];
        a[k][i] = cs * x - sn * y;
        a[k][j] = sn * x + cs * y;
        q[k][i] = cs * v - sn * w;
        q[k][j] = sn * v + cs * w;
      }
      for (int k = 0; k < D; ++k) {
        const double x = a[i][k], y = a[j][k];
        a[i][k] = cs * x - sn * y;
        a[j][k] = sn * x + cs * y;
      }
    }
  }
  for (int i = 0; i < D; ++i)
    for (int j = 0; j < D; ++j) {
      h[i][j] = 0;
      for (int k = 0; k < D; ++k) h[i][j] += q[i][k] * fmax(a[k][k], 0) * q[j][k];
    }
}

/* dP/dF = sum over the blocks of appendix B.1 in the frame of U and V */
static void tangent(Response *r, double U[D][D][W], double V[D][D][W], int l, int projected, double *A) {
  double q[DD][DD], scaled[DD][DD];
  if (projected) {
    project(r->h);
    for (int n = 0; n < PAIRS; ++n) {
      r->minus[n] = fmax(r->minus[n], 0);
      r->plus[n] = fmax(r->plus[n], 0);
    }
  }
  for (int i = 0; i < D; ++i)
    for (int a = 0; a < D; ++a)
      for (int b = 0; b < D; ++b) q[i][D * a + b] = U[i][a][l] * V[i][b][l];
  for (int i = 0; i < D; ++i)
    for (int m = 0; m < DD; ++m) {
      double sum = 0;
      for (int j = 0; j < D; ++j) sum += r->h[i][j] * q[j][m];
      scaled[i][m] = sum;
    }
  for (int n = 0; n < PAIRS; ++n) {
    const int i = PAIR[n][0], j = PAIR[n][1], s = D + 2 * n, t = s + 1;
    for (int a = 0; a < D; ++a)
      for (int b = 0; b < D; ++b) {
        const double x = U[i][a][l] * V[j][b][l], y = U[j][a][l] * V[i][b][l];
        q[s][D * a + b] = x + y;
        q[t][D * a + b] = x - y;
        scaled[s][D * a + b] = 0.5 * r->minus[n] * (x + y);
        scaled[t][D * a + b] = 0.5 * r->plus[n] * (x - y);
      }
  }
  for (int m = 0; m < DD; ++m) {
    double row[DD] = {0};
    for (int k = 0; k < DD; ++k)
      for (int o = 0; o < DD; ++o) row[o] += q[k][m] * scaled[k][o];
    memcpy(A + DD * m, row, sizeof(row));
  }
}

/* ---- the points ----------------------------------------------------------------------------------------------- */

/* J - 1 from the displacement gradient, without the cancellation of det F - 1 */
static double volume_change(double G[DD][W], int l) {
#if D == 2
  return G[0][l] + G[3][l] + G[0][l] * G[3][l] - G[1][l] * G[2][l];
#else
  const double m01 = G[0][l] * G[4][l] - G[1][l] * G[3][l], m02 = G[0][l] * G[8][l] - G[2][l] * G[6][l],
               m12 = G[4][l] * G[8][l] - G[5][l] * G[7][l];
  const double det = G[0][l] * m12 - G[1][l] * (G[3][l] * G[8][l] - G[5][l] * G[6][l]) +
                     G[2][l] * (G[3][l] * G[7][l] - G[4][l] * G[6][l]);
  return G[0][l] + G[4][l] + G[8][l] + m01 + m02 + m12 + det;
#endif
}

/* C - I = G + G^T + G^T G */
static void strain(double G[DD][W], int l, double E[D][D]) {
  for (int i = 0; i < D; ++i)
    for (int j = 0; j < D; ++j) {
      double sum = G[D * i + j][l] + G[D * j + i][l];
      for (int k = 0; k < D; ++k) sum += G[D * k + i][l] * G[D * k + j][l];
      E[i][j] = sum;
    }
}

#if SKIPS_SVD
#if FAR
/* C (to E) and I1, I2, J (to y) of F */
static void invariants(double F[D][D], double C[D][D], double *y) {
  double trace = 0, squares = 0;
  for (int i = 0; i < D; ++i)
    for (int j = 0; j < D; ++j) {
      C[i][j] = 0;
      for (int k = 0; k < D; ++k) C[i][j] += F[k][i] * F[k][j];
      trace += i == j ? C[i][j] : 0;
      squares += C[i][j] * C[i][j];
    }
  y[0] = trace;
  y[1] = 0.5 * (trace * trace - squares);
#if D == 2
  y[2] = F[0][0] * F[1][1] - F[0][1] * F[1][0];
#else
  y[2] = F[0][0] * (F[1][1] * F[2][2] - F[1][2] * F[2][1]) - F[0][1] * (F[1][0] * F[2][2] - F[1][2] * F[2][0]) +
         F[0][2] * (F[1][0] * F[2][1] - F[1][1] * F[2][0]);
#endif
}
#endif

/* P = 2 psi_I1 F + 2 psi_I2 (I1 F - F C) + psi_J cof F; returns 0 where the extension needs the stretches. */
static int without_stretches(double G[DD][W], int l, const double *p, double *psi, double *P) {
  double y[3] = {0, 0, 0}, w[4], E[D][D], F[D][D];
  for (int i = 0; i < D; ++i)
    for (int j = 0; j < D; ++j) F[i][j] = G[D * i + j][l] + (i == j);
  y[2] = volume_change(G, l);
  strain(G, l, E);
  for (int i = 0; i < D; ++i) y[0] += E[i][i];
#if D == 3
  double squares = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) squares += E[i][j] * E[i][j];
  y[1] = 2 * y[0] + 0.5 * (y[0] * y[0] - squares);
  double trace = 2 + y[0]; /* of C less the part that multiplies E below */
#endif
#if defined(EXTENSION_C2) || defined(EXTENSION_IFE)
  if (!(1 + y[2] >= EPS)) return 0;
#elif defined(EXTENSION_C1)
  /* J > 0 and J^2 >= eps^2 I2 (3D), eps^2 I1 (2D) bound every stretch from below by eps. Then J >= eps^D, which keeps
   * rounding in J and I2 from passing a point where both vanish. */
  const double J = 1 + y[2], floor = D == 3 ? EPS * EPS * EPS : EPS * EPS;
  if (!(J >= floor && J * J >= EPS * EPS * (D == 3 ? 3 + y[1] : 2 + y[0]))) return 0;
#endif
#if FAR
  if (1 + y[2] < FAR_J) {
    invariants(F, E, y); /* of F and C themselves; E becomes C */
#if D == 3
    trace = y[0];
#endif
    direct_far(y, p, w);
  } else
#endif
    direct(y, p, w);
  if (psi) *psi = w[0];
  if (!P) return 1;
  for (int i = 0; i < D; ++i)
    for (int j = 0; j < D; ++j) {
      double sum = 2 * w[1] * F[i][j];
#if D == 3
      double fe = 0;
      for (int k = 0; k < 3; ++k) fe += F[i][k] * E[k][j];
      sum += 2 * w[2] * (trace * F[i][j] - fe); /* I1 F - F C with C = I + E */
      const int i1 = (i + 1) % 3, i2 = (i + 2) % 3, j1 = (j + 1) % 3, j2 = (j + 2) % 3;
      const double cof = F[i1][j1] * F[i2][j2] - F[i1][j2] * F[i2][j1];
#else
      const double cof = (i == j ? 1 : -1) * F[1 - i][1 - j];
#endif
      P[D * i + j] = sum + w[3] * cof;
    }
  return 1;
}
#endif

/* Evaluates n points, `per_cell` of them in a row with the same parameters (stride 0: the same everywhere).
 * grad[n][DD] is the displacement gradient. psi[n], P[n][DD], A[n][DD][DD] may be NULL. Returns how many points
 * were done without their stretches. */
long extremal_evaluate(long n, long per_cell, const double *grad, const double *parameters, long stride, double *psi,
                       double *P, double *A, int projected) {
  long skipped = 0;
  for (long start = 0; start < n; start += W) {
    const int count = n - start < W ? (int)(n - start) : W;
    double G[DD][W], F[DD][W], U[D][D][W], s[D][W], V[D][D][W];
    int done[W] = {0}, left = count;
    for (int l = 0; l < W; ++l) {
      const double *g = grad + DD * (start + (l < count ? l : 0));
      for (int k = 0; k < DD; ++k) G[k][l] = g[k];
    }
#if SKIPS_SVD
    if (!A)
      for (int l = 0; l < count; ++l) {
        const double *p = parameters + stride * ((start + l) / per_cell);
        done[l] = without_stretches(G, l, p, psi ? psi + start + l : 0, P ? P + DD * (start + l) : 0);
        left -= done[l];
      }
    skipped += count - left;
    if (!left) continue;
#endif
    for (int k = 0; k < DD; ++k) LANES F[k][l] = G[k][l] + (k % (D + 1) == 0);
    LANES { /* 1 + grad u is known to 1e-16: the rotation of less than 1e-12 would be that of rounding */
      double size = 0;
      for (int k = 0; k < DD; ++k) size += F[k][l] * F[k][l];
      for (int k = 0; k < DD; ++k) F[k][l] = size < 1e-24 ? 0 : F[k][l];
    }
    singular_values(F, U, s, V);
    for (int l = 0; l < count; ++l) {
      if (done[l]) continue;
      const double *p = parameters + stride * ((start + l) / per_cell);
      double stretches[D];
      Response r;
      for (int i = 0; i < D; ++i) stretches[i] = s[i][l];
      response(stretches, p, A != 0, &r);
      if (psi) psi[start + l] = r.psi;
      if (P)
        for (int a = 0; a < D; ++a)
          for (int b = 0; b < D; ++b) {
            double sum = 0;
            for (int i = 0; i < D; ++i) sum += r.g[i] * U[i][a][l] * V[i][b][l];
            P[DD * (start + l) + D * a + b] = sum;
          }
      if (A) tangent(&r, U, V, l, projected, A + DD * DD * (start + l));
    }
  }
  return skipped;
}

/* stretches[n][D], and U[n][D][D], V[n][D][D] (rows, columns) unless NULL */
void extremal_stretches(long n, const double *grad, double *stretches, double *left, double *right) {
  for (long start = 0; start < n; start += W) {
    const int count = n - start < W ? (int)(n - start) : W;
    double F[DD][W], U[D][D][W], s[D][W], V[D][D][W];
    for (int l = 0; l < W; ++l) {
      const double *g = grad + DD * (start + (l < count ? l : 0));
      for (int k = 0; k < DD; ++k) F[k][l] = g[k] + (k % (D + 1) == 0);
    }
    singular_values(F, U, s, V);
    for (int l = 0; l < count; ++l)
      for (int i = 0; i < D; ++i) {
        stretches[D * (start + l) + i] = s[i][l];
        for (int k = 0; left && k < D; ++k) {
          left[DD * (start + l) + D * k + i] = U[i][k][l];
          right[DD * (start + l) + D * k + i] = V[i][k][l];
        }
      }
  }
}

/* The law in stretch space: psi[n], gradient[n][D], hessian[n][D][D] at s[n][D]; for contours and tests. */
void extremal_response(long n, const double *s, const double *p, double *psi, double *gradient, double *hessian) {
  for (long k = 0; k < n; ++k) {
    Response r;
    response(s + D * k, p, 1, &r);
    psi[k] = r.psi;
    memcpy(gradient + D * k, r.g, sizeof(r.g));
    memcpy(hessian + DD * k, r.h, sizeof(r.h));
  }
}
