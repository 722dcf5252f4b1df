/* The laws in spatial form: neither F nor its rotation is carried, only W = sqrt(F_E F_E^T) and J_P.
 *
 * Fixed corotated energy (7.1), with G the velocity gradient times a time (delta F = G F):
 *     P F^T       = 2 mu (W^2 - W) + lambda (J-1) J I
 *     (C:GF) F^T  = 2 mu (G W - [w]x) W + lambda J (2J-1) tr(G) I - lambda J (J-1) G^T
 *     (tr(W) I - W) w = k,  k the axial vector of G W - (G W)^T     (delta R = [w]x R, appendix B.6)
 * Neo-Hookean energy:
 *     P F^T       = mu (b - I) + lambda ln(J) I,   b = W^2
 *     (C:GF) F^T  = mu G b + (mu - lambda ln J) G^T + lambda tr(G) I
 * Symmetric matrices are stored as their upper triangle by rows. */

enum { FIXED_COROTATED = 0, NEO_HOOKEAN = 1 };

/* one body's parameters as Python gives them */
typedef struct {
  double mu, lambda, hardening, least, largest, cap; /* stretches are kept in [least, largest]; see `hard` */
  int32_t energy, plastic;
} Law;

static const int SYM[3][3] = {{0, 1, 2}, {1, D == 3 ? 3 : 2, 4}, {2, 4, 5}};

static inline double hard(const Law *law, double plastic) {
  /* (7.2); the exponent is capped, the same cap in force and Hessian because both come through here */
  return law->plastic ? exp(fmax(-law->cap, fmin(law->cap, law->hardening * (1 - plastic)))) : 1;
}

static inline double determinant(const REAL *s) {
#if D == 2
  return s[0] * s[2] - s[1] * s[1];
#else
  return s[0] * (s[3] * s[5] - s[4] * s[4]) - s[1] * (s[1] * s[5] - s[4] * s[2]) + s[2] * (s[1] * s[4] - s[3] * s[2]);
#endif
}

static inline void square(const REAL *w, REAL *b) {
#if D == 2
  b[0] = w[0] * w[0] + w[1] * w[1];
  b[1] = w[1] * (w[0] + w[2]);
  b[2] = w[1] * w[1] + w[2] * w[2];
#else
  b[0] = w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
  b[1] = w[0] * w[1] + w[1] * w[3] + w[2] * w[4];
  b[2] = w[0] * w[2] + w[1] * w[4] + w[2] * w[5];
  b[3] = w[1] * w[1] + w[3] * w[3] + w[4] * w[4];
  b[4] = w[1] * w[2] + w[3] * w[4] + w[4] * w[5];
  b[5] = w[2] * w[2] + w[4] * w[4] + w[5] * w[5];
#endif
}

/* t = P F^T, symmetric; mu, lambda already hardened */
static inline void kirchhoff(int energy, REAL mu, REAL lambda, const REAL *w, REAL *t) {
  REAL b[SYMS];
  const REAL J = determinant(w);
  square(w, b);
  const REAL pressure = energy == NEO_HOOKEAN ? lambda * log(J) - mu : lambda * (J - 1) * J;
  for (int k = 0; k < SYMS; ++k) t[k] = energy == NEO_HOOKEAN ? mu * b[k] : 2 * mu * (b[k] - w[k]);
  for (int d = 0; d < D; ++d) t[SYM[d][d]] += pressure;
}

/* y = (C : G F) F^T */
static inline void linearised(int energy, REAL mu, REAL lambda, const REAL *w, const REAL *g, REAL *y) {
  const REAL J = determinant(w);
  REAL trace = 0, side, turned, swap;
  for (int d = 0; d < D; ++d) trace += g[(D + 1) * d];
  if (energy == NEO_HOOKEAN) {
    REAL b[SYMS];
    square(w, b);
    for (int i = 0; i < D; ++i)
      for (int j = 0; j < D; ++j) {
        REAL sum = 0;
        for (int k = 0; k < D; ++k) sum += g[D * i + k] * b[SYM[k][j]];
        y[D * i + j] = mu * sum + (mu - lambda * (REAL)log(J)) * g[D * j + i];
      }
    for (int d = 0; d < D; ++d) y[(D + 1) * d] += lambda * trace;
    return;
  }
  REAL m[D * D]; /* G W - [w]x */
  for (int i = 0; i < D; ++i)
    for (int j = 0; j < D; ++j) {
      REAL sum = 0;
      for (int k = 0; k < D; ++k) sum += g[D * i + k] * w[SYM[k][j]];
      m[D * i + j] = sum;
    }
#if D == 2
  turned = (m[2] - m[1]) / (w[0] + w[2]);
  m[1] += turned;
  m[2] -= turned;
  (void)side;
  (void)swap;
#else
  const REAL k0 = m[7] - m[5], k1 = m[2] - m[6], k2 = m[3] - m[1];
  const REAL a = w[3] + w[5], b = w[0] + w[5], c = w[0] + w[3]; /* tr(W) I - W */
  const REAL p = -w[1], q = -w[2], r = -w[4];
  const REAL c00 = b * c - r * r, c01 = q * r - p * c, c02 = p * r - q * b;
  const REAL inverse = 1 / (a * c00 + p * c01 + q * c02);
  side = (c00 * k0 + c01 * k1 + c02 * k2) * inverse;
  turned = (c01 * k0 + (a * c - q * q) * k1 + (p * q - a * r) * k2) * inverse;
  swap = (c02 * k0 + (p * q - a * r) * k1 + (a * b - p * p) * k2) * inverse;
  m[5] += side;
  m[7] -= side;
  m[2] -= turned;
  m[6] += turned;
  m[1] += swap;
  m[3] -= swap;
#endif
  const REAL dilation = lambda * J * (2 * J - 1) * trace, transposed = lambda * J * (J - 1);
  for (int i = 0; i < D; ++i)
    for (int j = 0; j < D; ++j) {
      REAL sum = 0;
      for (int k = 0; k < D; ++k) sum += m[D * i + k] * w[SYM[k][j]];
      y[D * i + j] = 2 * mu * sum - transposed * g[D * j + i];
    }
  for (int d = 0; d < D; ++d) y[(D + 1) * d] += dilation;
}
