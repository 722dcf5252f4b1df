/* The threshold surface J = epsilon and the C2 extension beyond it (6.3.2, appendix B.3). */

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

#if IN_STRETCHES
static void extended_d(const double *d, const double *p, double *w) { extended(d, d, p, 1, w); }
#endif
#endif
