/* Energy, stress and stress derivative of an extended isotropic law at many points.
 *
 * The law-specific half (D, LAW_PARAMETERS, IN_STRETCHES, SKIPS_SVD, EXTENSION_..., base, base4, direct, below_n)
 * is written by symbolic.py and stands before this file. Points are taken W at a time so that the singular value
 * decomposition, the dearest part, runs in vector registers.
 *
 * Conventions: F = U diag(s) V^T with U, V rotations, s1 >= s2 >= |s3|, the last one carries the sign of det F.
 * Tensors are flattened by rows. Parameters of a point: those of the law, then epsilon, then k.
 */
#include <math.h>
#include <float.h>
#include <string.h>

#define W 8
#define DD (D * D)
#define PAIRS (D * (D - 1) / 2)
#define DENOMINATOR 1e-6 /* appendix B.1: smallest |si + sj| to divide by */
#define EPS p[LAW_PARAMETERS]

static const int PAIR[3][3] = {{0, 1, 2}, {0, 2, 1}, {1, 2, 0}}; /* i, j and, in 3D, the third */

/* What a law says at given stretches: psi, its gradient and Hessian in them, and the two quotients
 * (gi - gj)/(si - sj), (gi + gj)/(si + sj) of appendix B.1 for each pair. */
typedef struct {
  double psi, g[D], h[D][D], minus[PAIRS], plus[PAIRS];
} Response;

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

static void quotients(const double *s, Response *r, int have_minus) {
  for (int q = 0; q < PAIRS; ++q) {
    const int i = PAIR[q][0], j = PAIR[q][1];
    const double gap = s[i] - s[j], sum = s[i] + s[j];
    if (!have_minus) {
      /* the quotient tends to h_ii - h_ij; the switch keeps both errors under 1e-10 */
      if (fabs(gap) > 1e-5 * (1 + fabs(s[i])))
        r->minus[q] = (r->g[i] - r->g[j]) / gap;
      else
        r->minus[q] = 0.5 * (r->h[i][i] + r->h[j][j]) - r->h[i][j];
    }
    r->plus[q] = (r->g[i] + r->g[j]) / (fabs(sum) > DENOMINATOR ? sum : copysign(DENOMINATOR, sum));
  }
}

/* w = psi, psi_k, psi_kl in the coordinates of d; `second`: second derivatives are wanted, here and below */
static void in_d(const double *w, const double *s, int second, Response *r) {
  r->psi = w[0];
  for (int i = 0; i < D; ++i) r->g[i] = w[1 + i];
  if (!second) return;
  for (int i = 0, n = 1 + D; i < D; ++i) {
    for (int j = i; j < D; ++j) r->h[i][j] = r->h[j][i] = w[n++];
  }
  quotients(s, r, 0);
}

#if IN_STRETCHES
#define from_coordinates(w, s, d, second, r) ((void)(d), in_d(w, s, second, r))
#else
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
  quotients(s, r, 1);
}
#endif

static void base_response(const double *s, const double *d, const double *p, int second, Response *r) {
  double y[D], w[1 + D + D * (D + 1) / 2];
  coordinates(d, y);
  base(y, p, w);
  from_coordinates(w, s, d, second, r);
}

/* ---- the threshold surface J = epsilon ---------------------------------------------------------------------- */

#if defined(EXTENSION_C2) || defined(EXTENSION_IFE)
/* The s in (0, 1) with det(1 + s d) = eps (B.3.3): 1/s is the largest root of (1-eps) x^3 + e1 x^2 + e2 x + e3. */
static double threshold_root(const double *d, double eps) {
  const double a = 1 - eps;
#if D == 2
  const double b = d[0] + d[1], c = d[0] * d[1], root = sqrt(fmax(b * b - 4 * a * c, 0));
  return b > 0 ? -(b + root) / (2 * c) : 2 * a / (root - b);
#else
  const double b = (d[0] + d[1] + d[2]) / a, c = (d[0] * d[1] + d[1] * d[2] + d[0] * d[2]) / a,
               e = d[0] * d[1] * d[2] / a, shift = b / 3, m = shift * shift - c / 3,
               n = shift * (shift * shift - 0.5 * c) + 0.5 * e; /* x = t - shift, t^3 - 3 m t + 2 n = 0 */
  const double disc = n * n - m * m * m;
  double x;
  if (disc <= 0) {
    const double t = sqrt(fmax(m, 0));
    x = 2 * t * cos(acos(fmax(-1, fmin(1, t > 0 ? -n / (t * t * t) : 0))) / 3) - shift;
  } else {
    const double t = -copysign(cbrt(fabs(n) + sqrt(disc)), n);
    x = t + (t != 0 ? m / t : 0) - shift;
  }
  x = fmax(x, 1);
  for (int k = 0; k < 3; ++k) { /* the closed form loses digits where roots are close: polish */
    const double f = ((x + b) * x + c) * x + e, df = (3 * x + 2 * b) * x + c;
    if (df > 0) x = fmax(x - f / df, 1);
  }
  return 1 / x;
#endif
}
#endif

#ifdef EXTENSION_C2
/* 6.3.2 in coordinates y, along the ray Y(t) = r(t) y, r_k = t^n_k (n_k = k for e, 1 for d):
 * psi = f + u f' + u^2/2 f'', f(t) = psi(Y(t)), u = 1 - s, and d psi / ds = u^2/2 f''' at fixed y. */
static void extended(const double *d, const double *y, const double *p, int second, double *w) {
  enum { H0 = 1 + D, T0 = H0 + D * (D + 1) / 2, A0 = T0 + D * (D + 1) * (D + 2) / 6 };
  double b[A0 + D * (D + 1) * (D + 2) * (D + 3) / 24];
  double Y[D], r[D], r1[D], r2[D], r3[D], v1[D], v2[D], v3[D];
  const double s = threshold_root(d, EPS), u = 1 - s, u2 = 0.5 * u * u;
  for (int k = 0; k < D; ++k) {
    const int n = IN_STRETCHES ? 1 : k + 1;
    r[k] = n == 1 ? s : n == 2 ? s * s : s * s * s;
    r1[k] = n == 1 ? 1 : n == 2 ? 2 * s : 3 * s * s;
    r2[k] = n == 1 ? 0 : n == 2 ? 2 : 6 * s;
    r3[k] = n == 3 ? 6 : 0;
    Y[k] = r[k] * y[k];
    v1[k] = r1[k] * y[k];
    v2[k] = r2[k] * y[k];
    v3[k] = r3[k] * y[k];
  }
  base4(Y, p, b);

  /* contractions of the symmetric derivative tensors with the ray's velocity v1 and acceleration v2 */
  double H[D][D], T1[D][D] = {{0}}, T2[D][D] = {{0}}, h1[D], h2[D], t11[D];
  for (int k = 0, n = H0; k < D; ++k)
    for (int l = k; l < D; ++l) H[k][l] = H[l][k] = b[n++];
  for (int k = 0, n = T0; k < D; ++k)
    for (int l = k; l < D; ++l)
      for (int m = l; m < D; ++m, ++n) {
        T1[k][l] += b[n] * v1[m];
        T2[k][l] += b[n] * v2[m];
        if (m != l) {
          T1[k][m] += b[n] * v1[l];
          T2[k][m] += b[n] * v2[l];
        }
        if (k != l) {
          T1[l][m] += b[n] * v1[k];
          T2[l][m] += b[n] * v2[k];
        }
      }
  for (int k = 0; k < D; ++k)
    for (int l = 0; l < k; ++l) {
      T1[k][l] = T1[l][k];
      T2[k][l] = T2[l][k];
    }
  double f1 = 0, f2 = 0, f3 = 0;
  for (int k = 0; k < D; ++k) {
    h1[k] = h2[k] = t11[k] = 0;
    for (int l = 0; l < D; ++l) {
      h1[k] += H[k][l] * v1[l];
      h2[k] += H[k][l] * v2[l];
      t11[k] += T1[k][l] * v1[l];
    }
    f1 += b[1 + k] * v1[k];
    f2 += h1[k] * v1[k] + b[1 + k] * v2[k];
    f3 += t11[k] * v1[k] + 3 * h1[k] * v2[k] + b[1 + k] * v3[k];
  }

  /* the root s(y): p(s, y) = 0 */
  double pk[D], pks[D], pkl[D][D] = {{0}}, ps = 0, pss = 0, sk[D];
#if IN_STRETCHES
  double q[D];
  for (int i = 0; i < D; ++i) q[i] = 1 + s * d[i];
  for (int i = 0; i < D; ++i) {
    double others = 1, slope = 0;
    for (int j = 0; j < D; ++j) {
      if (j == i) continue;
      others *= q[j];
      double rest = 1;
      for (int m = 0; m < D; ++m)
        if (m != i && m != j) rest *= q[m];
      slope += d[j] * rest;
      pkl[i][j] = s * s * rest;
    }
    pk[i] = s * others;
    pks[i] = others + s * slope;
    ps += d[i] * others;
    pss += d[i] * slope;
  }
#else
  for (int k = 0; k < D; ++k) {
    pk[k] = r[k];
    pks[k] = r1[k];
    ps += v1[k];
    pss += v2[k];
  }
#endif
  for (int k = 0; k < D; ++k) sk[k] = -pk[k] / ps;

  const double gs = u2 * f3;
  w[0] = b[0] + u * f1 + u2 * f2;
  for (int k = 0; k < D; ++k) {
    const double d1 = h1[k] * r[k] + b[1 + k] * r1[k],
                 d2 = t11[k] * r[k] + 2 * h1[k] * r1[k] + h2[k] * r[k] + b[1 + k] * r2[k];
    w[1 + k] = b[1 + k] * r[k] + u * d1 + u2 * d2 + gs * sk[k];
  }
  if (!second) return;

  double A11[D][D] = {{0}}, gks[D], f4 = 0;
  for (int k = 0, n = A0; k < D; ++k)
    for (int l = k; l < D; ++l)
      for (int m = l; m < D; ++m)
        for (int o = m; o < D; ++o, ++n) {
          /* every distinct place of (k, l, m, o) in A[.][.][v1][v1]: choose the first two, the rest is contracted */
          const int x[4] = {k, l, m, o};
          for (int i = 0; i < 4; ++i)
            for (int j = 0; j < 4; ++j) {
              if (i == j || (i > 0 && x[i] == x[i - 1])) continue;
              int q[2], c = 0;
              for (int e = 0; e < 4; ++e)
                if (e != i && e != j) q[c++] = e;
              const int repeated = j > 0 && x[j] == x[j - 1] && j - 1 != i;
              if (repeated) continue;
              A11[x[i]][x[j]] += b[n] * v1[x[q[0]]] * v1[x[q[1]]] * (x[q[0]] == x[q[1]] ? 1 : 2);
            }
        }
  for (int k = 0; k < D; ++k) {
    double a111 = 0, t12 = 0, h3 = 0;
    for (int l = 0; l < D; ++l) {
      a111 += A11[k][l] * v1[l];
      t12 += T1[k][l] * v2[l];
      h3 += H[k][l] * v3[l];
    }
    f4 += a111 * v1[k] + 6 * t11[k] * v2[k] + 3 * h2[k] * v2[k] + 4 * h1[k] * v3[k];
    gks[k] = u2 * (a111 * r[k] + 3 * (t11[k] * r1[k] + t12 * r[k] + h2[k] * r1[k] + h1[k] * r2[k]) + h3 * r[k] +
                   b[1 + k] * r3[k]);
  }
  const double gss = u2 * f4 - u * f3;
  for (int k = 0, n = 1 + D; k < D; ++k)
    for (int l = k; l < D; ++l) {
      const double rr = r[k] * r[l], rr1 = r[k] * r1[l] + r1[k] * r[l];
      const double d0 = H[k][l] * rr, d1 = T1[k][l] * rr + H[k][l] * rr1,
                   d2 = A11[k][l] * rr + 2 * T1[k][l] * rr1 + T2[k][l] * rr +
                        H[k][l] * (2 * r1[k] * r1[l] + r[k] * r2[l] + r2[k] * r[l]);
      const double skl = -(pkl[k][l] + pks[k] * sk[l] + pks[l] * sk[k] + pss * sk[k] * sk[l]) / ps;
      w[n++] = d0 + u * d1 + u2 * d2 + gks[k] * sk[l] + gks[l] * sk[k] + gss * sk[k] * sk[l] + gs * skl;
    }
}
#endif

static double product(const double *s) {
  double J = 1;
  for (int i = 0; i < D; ++i) J *= s[i];
  return J;
}

/* The extended law at stretches s. */
static void response(const double *s, const double *p, int second, Response *r) {
  double d[D];
  for (int i = 0; i < D; ++i) d[i] = s[i] - 1;
#if defined(EXTENSION_C2)
  if (product(s) < EPS) {
    double y[D], w[1 + D + D * (D + 1) / 2];
    coordinates(d, y);
    extended(d, y, p, second, w);
    from_coordinates(w, s, d, second, r);
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
    double w[1 + D + D * (D + 1) / 2];
    if (below == 1) below_1(d, p, w);
    if (below == 2) below_2(d, p, w);
#if D == 3
    if (below == 3) below_3(d, p, w);
#endif
    in_d(w, s, second, r);
    return;
  }
#endif
  base_response(s, d, p, second, r);
}

/* ---- singular values of W matrices -------------------------------------------------------------------------- */

#if D == 3
#define LANES for (int l = 0; l < W; ++l)

static void rotate(double B[3][3][W], double V[3][3][W], int i, int j, double *off) {
  double cs[W], sn[W];
  LANES {
    const double a = B[i][0][l] * B[i][0][l] + B[i][1][l] * B[i][1][l] + B[i][2][l] * B[i][2][l];
    const double b = B[j][0][l] * B[j][0][l] + B[j][1][l] * B[j][1][l] + B[j][2][l] * B[j][2][l];
    const double c = B[i][0][l] * B[j][0][l] + B[i][1][l] * B[j][1][l] + B[i][2][l] * B[j][2][l];
    const double half = 0.5 * (b - a), root = sqrt(half * half + c * c);
    const double t = c / ((half < 0 ? half - root : half + root) + (root == 0 ? 1 : 0));
    cs[l] = 1 / sqrt(1 + t * t);
    sn[l] = cs[l] * t;
    const double relative = c * c - 1e-31 * a * b;
    off[l] = relative > 0 ? 1 : off[l];
  }
  for (int k = 0; k < 3; ++k) LANES {
      const double x = B[i][k][l], y = B[j][k][l], v = V[i][k][l], w = V[j][k][l];
      B[i][k][l] = cs[l] * x - sn[l] * y;
      B[j][k][l] = sn[l] * x + cs[l] * y;
      V[i][k][l] = cs[l] * v - sn[l] * w;
      V[j][k][l] = sn[l] * v + cs[l] * w;
    }
}

static void order(double B[3][3][W], double V[3][3][W], double n[3][W], int i, int j) {
  double swap[W];
  LANES swap[l] = n[i][l] < n[j][l] ? 1 : 0;
  for (int k = 0; k < 3; ++k) LANES {
      const double x = B[i][k][l], y = B[j][k][l], v = V[i][k][l], w = V[j][k][l];
      B[i][k][l] = swap[l] > 0 ? y : x;
      B[j][k][l] = swap[l] > 0 ? -x : y; /* the sign keeps V a rotation */
      V[i][k][l] = swap[l] > 0 ? w : v;
      V[j][k][l] = swap[l] > 0 ? -v : w;
    }
  LANES {
    const double x = n[i][l], y = n[j][l];
    n[i][l] = swap[l] > 0 ? y : x;
    n[j][l] = swap[l] > 0 ? x : y;
  }
}

/* One-sided Jacobi: columns of B = F V made orthogonal. U, V are [column][row][lane]. */
static void singular_values(double F[DD][W], double U[3][3][W], double s[3][W], double V[3][3][W]) {
  double B[3][3][W], n[3][W], off[W];
  for (int i = 0; i < 3; ++i)
    for (int k = 0; k < 3; ++k) LANES {
        B[i][k][l] = F[3 * k + i][l];
        V[i][k][l] = i == k;
      }
  for (int sweep = 0; sweep < 12; ++sweep) {
    double any = 0;
    LANES off[l] = 0;
    rotate(B, V, 0, 1, off);
    rotate(B, V, 0, 2, off);
    rotate(B, V, 1, 2, off);
    LANES any += off[l];
    if (any == 0) break;
  }
  for (int i = 0; i < 3; ++i)
    LANES n[i][l] = sqrt(B[i][0][l] * B[i][0][l] + B[i][1][l] * B[i][1][l] + B[i][2][l] * B[i][2][l]);
  order(B, V, n, 0, 1);
  order(B, V, n, 0, 2);
  order(B, V, n, 1, 2);
  for (int i = 0; i < 2; ++i)
    for (int k = 0; k < 3; ++k) LANES U[i][k][l] = B[i][k][l] / (n[i][l] > 0 ? n[i][l] : 1);
  LANES { /* ranks zero and one leave U open: take what makes R = U V^T nearest to where it was free */
    if (n[0][l] == 0) {
      for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) U[i][k][l] = V[i][k][l];
    } else if (n[1][l] <= 1e-290 || n[1][l] < 1e-30 * n[0][l]) {
      int small = 0;
      for (int k = 1; k < 3; ++k)
        if (fabs(U[0][k][l]) < fabs(U[0][small][l])) small = k;
      double other[3], length = 0;
      for (int k = 0; k < 3; ++k) other[k] = (k == small) - U[0][small][l] * U[0][k][l];
      for (int k = 0; k < 3; ++k) length += other[k] * other[k];
      for (int k = 0; k < 3; ++k) U[1][k][l] = other[k] / sqrt(length);
    }
  }
  for (int k = 0; k < 3; ++k) LANES {
      const int a = (k + 1) % 3, b = (k + 2) % 3;
      U[2][k][l] = U[0][a][l] * U[1][b][l] - U[0][b][l] * U[1][a][l];
    }
  LANES {
    s[0][l] = n[0][l];
    s[1][l] = n[1][l];
    s[2][l] = U[2][0][l] * B[2][0][l] + U[2][1][l] * B[2][1][l] + U[2][2][l] * B[2][2][l];
  }
}
#else
#define LANES for (int l = 0; l < W; ++l)

static void singular_values(double F[DD][W], double U[2][2][W], double s[2][W], double V[2][2][W]) {
  LANES {
    const double a = F[0][l], b = F[1][l], c = F[2][l], d = F[3][l];
    const double x = 0.5 * (a + d), y = 0.5 * (c - b), u = 0.5 * (a - d), v = 0.5 * (c + b);
    const double first = hypot(x, y) + hypot(u, v);
    const double plus = atan2(y, x), minus = atan2(v, u);
    const double left = 0.5 * (plus + minus), right = 0.5 * (minus - plus);
    s[0][l] = first;
    s[1][l] = first > 0 ? (a * d - b * c) / first : 0;
    U[0][0][l] = cos(left);
    U[0][1][l] = sin(left);
    U[1][0][l] = -U[0][1][l];
    U[1][1][l] = U[0][0][l];
    V[0][0][l] = cos(right);
    V[0][1][l] = sin(right);
    V[1][0][l] = -V[0][1][l];
    V[1][1][l] = V[0][0][l];
  }
}
#endif

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
/* P = 2 psi_I1 F + 2 psi_I2 (I1 F - F C) + psi_J cof F; returns 0 where the extension needs the stretches. */
static int without_stretches(double G[DD][W], int l, const double *p, double *psi, double *P) {
  double y[3] = {0, 0, 0}, w[4], E[D][D], F[D][D];
  y[2] = volume_change(G, l);
  strain(G, l, E);
  for (int i = 0; i < D; ++i) y[0] += E[i][i];
#if D == 3
  double squares = 0;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) squares += E[i][j] * E[i][j];
  y[1] = 2 * y[0] + 0.5 * (y[0] * y[0] - squares);
#endif
#if defined(EXTENSION_C2) || defined(EXTENSION_IFE)
  if (!(1 + y[2] >= EPS)) return 0;
#elif defined(EXTENSION_C1)
  /* J > 0 and J^2 >= eps^2 I2 (3D), eps^2 I1 (2D) bound every stretch from below by eps */
  if (!(1 + y[2] > 0 && (1 + y[2]) * (1 + y[2]) >= EPS * EPS * (D == 3 ? 3 + y[1] : 2 + y[0]))) return 0;
#endif
  direct(y, p, w);
  if (psi) *psi = w[0];
  if (!P) return 1;
  for (int i = 0; i < D; ++i)
    for (int j = 0; j < D; ++j) F[i][j] = G[D * i + j][l] + (i == j);
  for (int i = 0; i < D; ++i)
    for (int j = 0; j < D; ++j) {
      double sum = 2 * w[1] * F[i][j];
#if D == 3
      double fe = 0;
      for (int k = 0; k < 3; ++k) fe += F[i][k] * E[k][j];
      sum += 2 * w[2] * ((2 + y[0]) * F[i][j] - fe); /* I1 F - F C with C = I + E */
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
