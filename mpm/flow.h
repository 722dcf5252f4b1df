/* Deformation update with return mapping (7.6, 7.11, 7.12), and energies.
 *
 * b = (1 + dt G) W^2 (1 + dt G)^T; its eigenvalues are the squares of the trial stretches. Plastic bodies clamp them,
 * J_P takes the rest. Elastic bodies need no eigenvectors: W = sqrt(b) by the theorem of Cayley and Hamilton. */

/* Particles are worked on in PAIRS of vectors, so that one computes while the other waits for a square root. */
enum { PAIR = 3, MANY = PAIR * LANES };
#define EACH_LANE for (int l = 0; l < LANES; ++l)
#define EACH_VECTOR for (int v = 0; v < PAIR; ++v)

static inline Lanes root(Lanes a) {
  Lanes r;
  EACH_LANE r[l] = sqrt(a[l]);
  return r;
}

/* the rotation of axes i and j that makes entry ij of `a` vanish; ik and jk are the entries beside it */
static inline void turn(Lanes a[SYMS][PAIR], Lanes q[D][D][PAIR], int i, int j, int ii, int jj, int ij, int ik,
                        int jk) {
  EACH_VECTOR {
    const Lanes c = a[ij][v], half = 0.5 * (a[jj][v] - a[ii][v]), length = root(half * half + c * c), none = {0};
    const Lanes all = half + choose(half < 0, -length, length);
    const Lanes sum = choose(all * all > 1e-200, all, none + 1); /* tan = c / sum */
    const Lanes scale = 1 / root(sum * sum + c * c), t = c / sum, cs = sum * scale, sn = c * scale;
    a[ii][v] -= t * c;
    a[jj][v] += t * c;
    a[ij][v] = none;
    if (D == 3) {
      const Lanes x = a[ik][v], y = a[jk][v];
      a[ik][v] = cs * x - sn * y;
      a[jk][v] = sn * x + cs * y;
    }
    for (int k = 0; k < D; ++k) {
      const Lanes x = q[k][i][v], y = q[k][j][v];
      q[k][i][v] = cs * x - sn * y;
      q[k][j][v] = sn * x + cs * y;
    }
  }
}

/* a = q diag(e) q^T by Jacobi's rotations, for MANY symmetric matrices at once; a becomes diag(e) */
static inline void eigen(Lanes a[SYMS][PAIR], Lanes q[D][D][PAIR]) {
  for (int i = 0; i < D; ++i)
    for (int j = 0; j < D; ++j) EACH_VECTOR q[i][j][v] = (Lanes){0} + (i == j);
#if D == 2
  turn(a, q, 0, 1, 0, 2, 1, 1, 1);
#else
  for (int sweep = 0; sweep < 5; ++sweep) {
    Mask left = {0}; /* a sweep squares what is left, relative to the trace */
    EACH_VECTOR left |= a[1][v] * a[1][v] + a[2][v] * a[2][v] + a[4][v] * a[4][v] >
                        1e-34 * a[0][v] * a[0][v] + 1e-34 * a[3][v] * a[3][v] + 1e-34 * a[5][v] * a[5][v];
    int64_t any = 0;
    EACH_LANE any |= left[l];
    if (!any) break;
    turn(a, q, 0, 1, 0, 3, 1, 2, 4);
    turn(a, q, 0, 2, 0, 5, 2, 1, 4);
    turn(a, q, 1, 2, 3, 5, 4, 1, 2);
  }
#endif
}

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

/* U = 1 + dt G, b = U W^2 U^T */
static inline void push(Lanes grad[D * D][PAIR], double dt, Lanes w[SYMS][PAIR], Lanes b[SYMS][PAIR]) {
  EACH_VECTOR {
    Lanes m[D * D];
    for (int i = 0; i < D; ++i)
      for (int j = 0; j < D; ++j) {
        Lanes sum = grad[D * i][v] * w[SYM[0][j]][v];
        for (int k = 1; k < D; ++k) sum += grad[D * i + k][v] * w[SYM[k][j]][v];
        m[D * i + j] = w[SYM[i][j]][v] + dt * sum;
      }
    for (int i = 0; i < D; ++i)
      for (int j = i; j < D; ++j) {
        Lanes sum = m[D * i] * m[D * j];
        for (int k = 1; k < D; ++k) sum += m[D * i + k] * m[D * j + k];
        b[SYM[i][j]][v] = sum;
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

/* What the next step needs: the moduli of snow.h, hardened and times the volume; fastest: the largest entry of a
 * velocity, and the fastest elastic wave. */
void extremal_moduli(int64_t n, const double *velocity, const double *stretch, const double *plastic,
                     const double *volume, const double *stiffness, const int32_t *body, const Law *laws,
                     double *moduli, double *fastest) {
  double speed = 0, wave = 0;
  for (int64_t p = 0; p < n; ++p) {
    const Law *law = laws + body[p];
    const double factor = stiffness[p] * hard(law, plastic[p]), J = determinant(stretch + SYMS * p);
    const double mu = factor * law->mu * volume[p], lambda = factor * law->lambda * volume[p];
    double *m = moduli + MODULI * p;
    if (law->energy == NEO_HOOKEAN) {
      m[0] = mu;
      m[1] = 0;
      m[2] = lambda;
      m[3] = mu - lambda * log(J);
    } else {
      m[0] = m[1] = 2 * mu;
      m[2] = lambda * J * (2 * J - 1);
      m[3] = lambda * J * (1 - J);
    }
    const double square = factor * law->wave_speed * law->wave_speed;
    wave = square > wave ? square : wave;
    for (int d = 0; d < D; ++d) {
      const double size = fabs(velocity[D * p + d]);
      speed = size > speed ? size : speed;
    }
  }
  fastest[0] = speed;
  fastest[1] = sqrt(wave);
}

/* x += dt v (step 10) */
void extremal_move(int64_t n, double dt, const double *velocity, double *x) {
  for (int64_t e = 0; e < D * n; ++e) x[e] += dt * velocity[e];
}

/* stretches kept within what the law allows, w made of them; change = how much volume goes into J_P */
static inline void clamp(Lanes b[SYMS][PAIR], Lanes low[PAIR], Lanes high[PAIR], Lanes trial[D][PAIR],
                         Lanes kept[D][PAIR], Lanes w[SYMS][PAIR], Lanes change[PAIR]) {
  Lanes a[SYMS][PAIR], q[D][D][PAIR];
  memcpy(a, b, sizeof(a));
  eigen(a, q);
  EACH_VECTOR {
    Lanes all = (Lanes){0} + 1;
    for (int d = 0; d < D; ++d) {
      const Lanes square = a[SYM[d][d]][v], s = root(choose(square > 0, square, (Lanes){0}));
      trial[d][v] = s;
      kept[d][v] = choose(s > low[v], choose(s < high[v], s, high[v]), low[v]);
      all *= s / kept[d][v];
    }
    change[v] = all;
    for (int i = 0; i < D; ++i)
      for (int j = i; j < D; ++j) {
        Lanes sum = q[i][0][v] * kept[0][v] * q[j][0][v];
        for (int d = 1; d < D; ++d) sum += q[i][d][v] * kept[d][v] * q[j][d][v];
        w[SYM[i][j]][v] = sum;
      }
  }
}

/* Step 7 of 7.3.1 for all particles; adds what plastic flow takes from the elastic energy to *dissipated [J]. */
void extremal_flow(int64_t n, const double *grad, double dt, const double *volume, const double *stiffness,
                   const int32_t *body, const Law *laws, double *stretch, double *plastic, double *dissipated) {
  for (int64_t first = 0; first < n; first += MANY) {
    const int count = n - first < MANY ? (int)(n - first) : MANY;
    Lanes g[D * D][PAIR], w[SYMS][PAIR], b[SYMS][PAIR], low[PAIR], high[PAIR], trial[D][PAIR], kept[D][PAIR];
    Lanes change[PAIR];
    double(*at)[MANY] = (double(*)[MANY])w, (*grads)[MANY] = (double(*)[MANY])g; /* at[k][l]: of particle first + l */
    int flows = 0, stays = 0;
    for (int l = 0; l < MANY; ++l) {
      const int64_t p = first + (l < count ? l : 0);
      const Law *law = laws + body[p];
      for (int e = 0; e < D * D; ++e) grads[e][l] = grad[D * D * p + e];
      for (int k = 0; k < SYMS; ++k) at[k][l] = stretch[SYMS * p + k];
      ((double *)low)[l] = law->least;
      ((double *)high)[l] = law->largest;
      flows |= law->plastic;
      stays |= !law->plastic;
    }
    push(g, dt, w, b);
    if (flows) clamp(b, low, high, trial, kept, w, change);
    for (int l = 0; l < count && flows; ++l) {
      const int64_t p = first + l;
      const Law *law = laws + body[p];
      const double grown = ((double *)change)[l];
      if (!law->plastic || grown == 1) continue;
      double before[D], after[D];
      for (int d = 0; d < D; ++d) {
        before[d] = ((double *)trial[d])[l];
        after[d] = ((double *)kept[d])[l];
      }
      *dissipated += stiffness[p] * volume[p] * (hard(law, plastic[p]) * energy_density(law, before) -
                                                 hard(law, plastic[p] * grown) * energy_density(law, after));
      plastic[p] *= grown;
    }
    for (int l = 0; l < count && stays; ++l)
      if (!laws[body[first + l]].plastic) {
        double one[SYMS], rooted[SYMS];
        for (int k = 0; k < SYMS; ++k) one[k] = ((double *)b[k])[l];
        square_root(one, rooted);
        for (int k = 0; k < SYMS; ++k) at[k][l] = rooted[k];
      }
    for (int l = 0; l < count; ++l)
      for (int k = 0; k < SYMS; ++k) stretch[SYMS * (first + l) + k] = at[k][l];
  }
}

/* Elastic energy of each particle [J] (7.1) */
void extremal_energy(int64_t n, const double *stretch, const double *plastic, const double *volume,
                     const double *stiffness, const int32_t *body, const Law *laws, double *energy) {
  for (int64_t p = 0; p < n; ++p) {
    const Law *law = laws + body[p];
    const double *w = stretch + SYMS * p, scale = stiffness[p] * hard(law, plastic[p]) * volume[p];
    const double J = determinant(w);
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
