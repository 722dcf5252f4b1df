/* The laws in spatial form: neither F nor its rotation is carried, only W = sqrt(F_E F_E^T) and J_P.
 *
 * Fixed corotated energy (7.1), with G the velocity gradient times a time (delta F = G F):
 *     P F^T       = 2 mu (W^2 - W) + lambda (J-1) J I
 *     (C:GF) F^T  = 2 mu (G W - [w]x) W + lambda J (2J-1) tr(G) I - lambda J (J-1) G^T
 *     (tr(W) I - W) w = k,  k the axial vector of G W - (G W)^T     (delta R = [w]x R, appendix B.6)
 * Neo-Hookean energy:
 *     P F^T       = mu (b - I) + lambda ln(J) I,   b = W^2
 *     (C:GF) F^T  = mu G b + (mu - lambda ln J) G^T + lambda tr(G) I
 * Both are
 *     P F^T       = (a W - c I) W - e I
 *     (C:GF) F^T  = (a G W - c [w]x) W + d tr(G) I + e G^T
 * with four moduli a, c, d, e that a particle keeps during a step.
 * Symmetric matrices are stored as their upper triangle by rows. */

enum { FIXED_COROTATED = 0, NEO_HOOKEAN = 1 };
enum { MODULI = 4 };

/* one body's parameters as Python gives them */
typedef struct {
  double mu, lambda, hardening, least, largest, cap; /* stretches are kept in [least, largest]; see `hard` */
  double wave_speed;                                 /* at rest */
  int32_t energy, plastic;
} Law;

static const int SYM[3][3] = {{0, 1, 2}, {1, D == 3 ? 3 : 2, 4}, {2, 4, 5}};

/* particles that are worked on together, an entry of a vector each */
enum { LANES = 8 };
typedef REAL Lanes __attribute__((vector_size(LANES * sizeof(REAL))));
typedef __typeof__(__builtin_choose_expr(sizeof(REAL) == 8, (int64_t)0, (int32_t)0)) Whole; /* as large as REAL */
typedef Whole Mask __attribute__((vector_size(LANES * sizeof(REAL))));

/* yes where `where` holds (all bits are set), else no */
static inline Lanes choose(Mask where, Lanes yes, Lanes no) {
  return (Lanes)((where & (Mask)yes) | (~where & (Mask)no));
}

static inline Lanes larger(Lanes a, Lanes b) { return choose(a > b, a, b); }

static inline double hard(const Law *law, double plastic) { /* (7.2); the exponent is capped */
  return law->plastic ? exp(fmax(-law->cap, fmin(law->cap, law->hardening * (1 - plastic)))) : 1;
}

static inline double determinant(const double *s) {
#if D == 2
  return s[0] * s[2] - s[1] * s[1];
#else
  return s[0] * (s[3] * s[5] - s[4] * s[4]) - s[1] * (s[1] * s[5] - s[4] * s[2]) + s[2] * (s[1] * s[4] - s[3] * s[2]);
#endif
}

/* t = P F^T, all D x D entries */
static inline void kirchhoff(const Lanes *moduli, const Lanes *w, Lanes *t) {
  for (int i = 0; i < D; ++i)
    for (int j = i; j < D; ++j) {
      Lanes sum = -moduli[1] * w[SYM[i][j]];
      for (int k = 0; k < D; ++k) sum += moduli[0] * w[SYM[i][k]] * w[SYM[k][j]];
      if (i == j) sum -= moduli[3];
      t[D * i + j] = t[D * j + i] = sum;
    }
}

/* y = (C : G F) F^T */
static inline void linearised(const Lanes *moduli, const Lanes *w, const Lanes *g, Lanes *y) {
  Lanes m[D * D], trace = g[0]; /* a G W - c [w]x */
  for (int d = 1; d < D; ++d) trace += g[(D + 1) * d];
  for (int i = 0; i < D; ++i)
    for (int j = 0; j < D; ++j) {
      m[D * i + j] = g[D * i] * w[SYM[0][j]];
      for (int k = 1; k < D; ++k) m[D * i + j] += g[D * i + k] * w[SYM[k][j]];
    }
#if D == 2
  const Lanes turn = moduli[1] * (m[2] - m[1]) / (w[0] + w[2]);
  for (int e = 0; e < D * D; ++e) m[e] *= moduli[0];
  m[1] += turn;
  m[2] -= turn;
#else
  const Lanes k0 = m[7] - m[5], k1 = m[2] - m[6], k2 = m[3] - m[1];
  const Lanes a = w[3] + w[5], b = w[0] + w[5], c = w[0] + w[3]; /* tr(W) I - W */
  const Lanes p = -w[1], q = -w[2], r = -w[4];
  const Lanes c00 = b * c - r * r, c01 = q * r - p * c, c02 = p * r - q * b;
  const Lanes scale = moduli[1] / (a * c00 + p * c01 + q * c02);
  const Lanes turn0 = scale * (c00 * k0 + c01 * k1 + c02 * k2);
  const Lanes turn1 = scale * (c01 * k0 + (a * c - q * q) * k1 + (p * q - a * r) * k2);
  const Lanes turn2 = scale * (c02 * k0 + (p * q - a * r) * k1 + (a * b - p * p) * k2);
  for (int e = 0; e < D * D; ++e) m[e] *= moduli[0];
  m[5] += turn0;
  m[7] -= turn0;
  m[2] -= turn1;
  m[6] += turn1;
  m[1] += turn2;
  m[3] -= turn2;
#endif
  for (int i = 0; i < D; ++i)
    for (int j = 0; j < D; ++j) {
      Lanes sum = moduli[3] * g[D * j + i];
      for (int k = 0; k < D; ++k) sum += m[D * i + k] * w[SYM[k][j]];
      y[D * i + j] = i == j ? sum + moduli[2] * trace : sum;
    }
}

/* det(1 + g) */
static inline Lanes change_of_volume(const Lanes *g) {
#if D == 2
  return (1 + g[0]) * (1 + g[3]) - g[1] * g[2];
#else
  return (1 + g[0]) * ((1 + g[4]) * (1 + g[8]) - g[5] * g[7]) - g[1] * (g[3] * (1 + g[8]) - g[5] * g[6]) +
         g[2] * (g[3] * g[7] - (1 + g[4]) * g[6]);
#endif
}
