/* Deformation update with return mapping (7.6, 7.11, 7.12), and energies.
 *
 * b = (1 + dt G) W^2 (1 + dt G)^T; its eigenvalues are the squares of the trial stretches. Plastic bodies clamp them,
 * J_P takes the rest. Elastic bodies need no eigenvectors: W = sqrt(b) by the theorem of Cayley and Hamilton. */

enum { LANES = 8 }; /* particles a vector register holds */

#define EACH_LANE for (int l = 0; l < LANES; ++l)

#if D == 3
static inline void turn(double a[6][LANES], double q[3][3][LANES], int i, int j, int ii, int jj, int ij, int ik, int jk) {
  EACH_LANE {
    const double c = a[ij][l], half = 0.5 * (a[jj][l] - a[ii][l]), root = sqrt(half * half + c * c);
    const double t = c / ((half < 0 ? half - root : half + root) + (root == 0 ? 1 : 0));
    const double cs = 1 / sqrt(1 + t * t), sn = cs * t, x = a[ik][l], y = a[jk][l];
    a[ii][l] -= t * c;
    a[jj][l] += t * c;
    a[ij][l] = 0;
    a[ik][l] = cs * x - sn * y;
    a[jk][l] = sn * x + cs * y;
    for (int k = 0; k < 3; ++k) {
      const double v = q[k][i][l], w = q[k][j][l];
      q[k][i][l] = cs * v - sn * w;
      q[k][j][l] = sn * v + cs * w;
    }
  }
}

/* a = q diag(e) q^T for LANES symmetric matrices at once */
static void eigen(double a[6][LANES], double q[3][3][LANES], double e[3][LANES]) {
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) EACH_LANE q[i][j][l] = i == j;
  for (int sweep = 0; sweep < 5; ++sweep) {
    double off = 0; /* the largest of all lanes, relative to the lane's trace: a sweep squares it */
    EACH_LANE off = fmax(off, (fabs(a[1][l]) + fabs(a[2][l]) + fabs(a[4][l])) / (a[0][l] + a[3][l] + a[5][l]));
    if (off <= 1e-17) break;
    turn(a, q, 0, 1, 0, 3, 1, 2, 4);
    turn(a, q, 0, 2, 0, 5, 2, 1, 4);
    turn(a, q, 1, 2, 3, 5, 4, 1, 2);
  }
  EACH_LANE {
    e[0][l] = a[0][l];
    e[1][l] = a[3][l];
    e[2][l] = a[5][l];
  }
}
#else
static void eigen(double a[3][LANES], double q[2][2][LANES], double e[2][LANES]) {
  EACH_LANE {
    const double c = a[1][l], half = 0.5 * (a[2][l] - a[0][l]), root = sqrt(half * half + c * c);
    const double t = c / ((half < 0 ? half - root : half + root) + (root == 0 ? 1 : 0));
    const double cs = 1 / sqrt(1 + t * t), sn = cs * t;
    e[0][l] = a[0][l] - t * c;
    e[1][l] = a[2][l] + t * c;
    q[0][0][l] = cs;
    q[0][1][l] = sn;
    q[1][0][l] = -sn;
    q[1][1][l] = cs;
  }
}
#endif

/* sqrt of symmetric positive b without eigenvectors */
static void square_root(const double *b, double *w) {
#if D == 2
  const double J = sqrt(fmax(b[0] * b[2] - b[1] * b[1], 0)), trace = sqrt(b[0] + b[2] + 2 * J);
  w[0] = (b[0] + J) / trace;
  w[1] = b[1] / trace;
  w[2] = (b[2] + J) / trace;
#else
  const double m = (b[0] + b[3] + b[5]) / 3, x = b[0] - m, y = b[3] - m, z = b[5] - m;
  const double p = (x * x + y * y + z * z + 2 * (b[1] * b[1] + b[2] * b[2] + b[4] * b[4])) / 6, root = sqrt(p);
  const double det = x * (y * z - b[4] * b[4]) - b[1] * (b[1] * z - b[4] * b[2]) + b[2] * (b[1] * b[4] - y * b[2]);
  const double r = p > 0 ? fmax(-1, fmin(1, det / (2 * p * root))) : 0, angle = acos(r) / 3;
  double s[3], square[6];
  for (int k = 0; k < 3; ++k) s[k] = sqrt(fmax(m + 2 * root * cos(angle + k * 2.0943951023931953), 0));
  const double i1 = s[0] + s[1] + s[2], i2 = s[0] * s[1] + s[1] * s[2] + s[0] * s[2], i3 = s[0] * s[1] * s[2];
  const double scale = 1 / (i1 * i2 - i3), one = i1 * i3, two = i1 * i1 - i2;
  square[0] = b[0] * b[0] + b[1] * b[1] + b[2] * b[2];
  square[1] = b[0] * b[1] + b[1] * b[3] + b[2] * b[4];
  square[2] = b[0] * b[2] + b[1] * b[4] + b[2] * b[5];
  square[3] = b[1] * b[1] + b[3] * b[3] + b[4] * b[4];
  square[4] = b[1] * b[2] + b[3] * b[4] + b[4] * b[5];
  square[5] = b[2] * b[2] + b[4] * b[4] + b[5] * b[5];
  for (int k = 0; k < 6; ++k) w[k] = scale * (two * b[k] - square[k]);
  for (int d = 0; d < 3; ++d) w[SYM[d][d]] += scale * one;
#endif
}

/* U = 1 + dt G, b = U W^2 U^T; returns det U */
static inline double push(const double *grad, double dt, const double *w, double *b) {
  double u[D * D], m[D * D];
  for (int i = 0; i < D; ++i)
    for (int j = 0; j < D; ++j) u[D * i + j] = dt * grad[D * i + j] + (i == j);
  for (int i = 0; i < D; ++i)
    for (int j = 0; j < D; ++j) {
      double sum = 0;
      for (int k = 0; k < D; ++k) sum += u[D * i + k] * w[SYM[k][j]];
      m[D * i + j] = sum;
    }
  for (int i = 0; i < D; ++i)
    for (int j = i; j < D; ++j) {
      double sum = 0;
      for (int k = 0; k < D; ++k) sum += m[D * i + k] * m[D * j + k];
      b[SYM[i][j]] = sum;
    }
#if D == 2
  return u[0] * u[3] - u[1] * u[2];
#else
  return u[0] * (u[4] * u[8] - u[5] * u[7]) - u[1] * (u[3] * u[8] - u[5] * u[6]) + u[2] * (u[3] * u[7] - u[4] * u[6]);
#endif
}

/* Smallest det(1 + dt G) and largest |dt G| entry: whether a step of dt may be taken. */
void extremal_look(int64_t n, const double *grad, double dt, double *least, double *largest) {
  const double identity[6] = {1, 0, D == 2 ? 1 : 0, 1, 0, 1};
  double b[SYMS];
  *least = INFINITY;
  *largest = 0;
  for (int64_t p = 0; p < n; ++p) {
    const double J = push(grad + D * D * p, dt, identity, b);
    if (!(J >= *least)) *least = J;
    for (int e = 0; e < D * D; ++e) {
      const double size = fabs(dt * grad[D * D * p + e]);
      if (!(size <= *largest)) *largest = size;
    }
  }
}

static inline double energy_density(const Law *law, const double *s) {
  double J = 1, shear = 0;
  for (int d = 0; d < D; ++d) {
    J *= s[d];
    shear += (s[d] - 1) * (s[d] - 1);
  }
  return law->mu * shear + 0.5 * law->lambda * (J - 1) * (J - 1);
}

/* Step 7 of 7.3.1 for all particles; adds what plastic flow takes from the elastic energy to *dissipated [J]. */
void extremal_flow(int64_t n, const double *grad, double dt, const double *volume, const double *stiffness,
                   const int32_t *body, const Law *laws, double *stretch, double *plastic, double *dissipated) {
  for (int64_t first = 0; first < n; first += LANES) {
    const int count = n - first < LANES ? (int)(n - first) : LANES;
    double a[SYMS][LANES], q[D][D][LANES], e[D][LANES];
    int flows = 0;
    for (int l = 0; l < LANES; ++l) {
      const int64_t p = first + (l < count ? l : 0);
      double b[SYMS];
      push(grad + D * D * p, dt, stretch + SYMS * p, b);
      for (int k = 0; k < SYMS; ++k) a[k][l] = b[k];
      if (l < count && laws[body[p]].plastic) flows = 1;
    }
    double kept[SYMS][LANES];
    memcpy(kept, a, sizeof(a));
    if (flows) eigen(a, q, e);
    for (int l = 0; l < count; ++l) {
      const int64_t p = first + l;
      const Law *law = laws + body[p];
      double *w = stretch + SYMS * p;
      if (!law->plastic) {
        double b[SYMS];
        for (int k = 0; k < SYMS; ++k) b[k] = kept[k][l];
        square_root(b, w);
        continue;
      }
      double s[D], trial[D], change = 1;
      for (int d = 0; d < D; ++d) {
        trial[d] = sqrt(fmax(e[d][l], 0));
        s[d] = fmax(law->least, fmin(law->largest, trial[d]));
        change *= trial[d] / s[d];
      }
      if (change != 1) {
        const double scale = stiffness[p] * volume[p];
        *dissipated += scale * (hard(law, plastic[p]) * energy_density(law, trial) -
                                hard(law, plastic[p] * change) * energy_density(law, s));
        plastic[p] *= change;
      }
      for (int i = 0; i < D; ++i)
        for (int j = i; j < D; ++j) {
          double sum = 0;
          for (int d = 0; d < D; ++d) sum += q[i][d][l] * s[d] * q[j][d][l];
          w[SYM[i][j]] = sum;
        }
    }
  }
}

/* Elastic energy of each particle [J] (7.1) */
void extremal_energy(int64_t n, const double *stretch, const double *plastic, const double *volume,
                     const double *stiffness, const int32_t *body, const Law *laws, double *energy) {
  for (int64_t p = 0; p < n; ++p) {
    const Law *law = laws + body[p];
    const double *w = stretch + SYMS * p, scale = stiffness[p] * hard(law, plastic[p]) * volume[p];
    const double J = D == 2 ? w[0] * w[2] - w[1] * w[1]
                            : w[0] * (w[3] * w[5] - w[4] * w[4]) - w[1] * (w[1] * w[5] - w[4] * w[2]) +
                                  w[2] * (w[1] * w[4] - w[3] * w[2]);
    double shear = 0;
    for (int i = 0; i < D; ++i)
      for (int j = 0; j < D; ++j) {
        const double away = w[SYM[i][j]] - (i == j);
        shear += law->energy == NEO_HOOKEAN ? w[SYM[i][j]] * w[SYM[i][j]] - (i == j) : away * away;
      }
    const double density = law->energy == NEO_HOOKEAN
                               ? 0.5 * law->mu * shear - law->mu * log(J) + 0.5 * law->lambda * log(J) * log(J)
                               : law->mu * shear + 0.5 * law->lambda * (J - 1) * (J - 1);
    energy[p] = scale * density;
  }
}
