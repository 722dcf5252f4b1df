/* Between particles and nodes, a cell at a time: the stencil of a cell is gathered into (or scattered from) a small
 * block which stays in the first cache while the cell's particles are worked through.
 *
 * A row of the block is N nodes x D components, contiguous as in the node arrays. Weights factor: one direction after
 * the other, so that a row costs one multiplication and addition a number. */

#ifdef __AVX512F__
enum { VECTOR_BYTES = 64 };
#else
enum { VECTOR_BYTES = 32 };
#endif
enum { ROW = N * D, LENGTH = VECTOR_BYTES / sizeof(REAL), PARTS = (ROW + LENGTH - 1) / LENGTH, WIDE = PARTS * LENGTH };
typedef REAL Vector __attribute__((vector_size(VECTOR_BYTES)));

/* a row of the block, padded with zeros to whole vectors */
typedef union {
  Vector part[PARTS];
  REAL at[WIDE];
} Row;

#define EACH_ROW for (int r = 0; r < ROWS; ++r)
#define EACH_PART for (int v = 0; v < PARTS; ++v)

typedef struct {
  REAL w[D][N], dw[D][N]; /* weights, and derivatives times 1/h */
} Spline;

static inline void spline_at(const double *x, double inverse_h, Spline *s) {
  for (int d = 0; d < D; ++d) {
    double w[N], dw[N];
    weights(x[d] * inverse_h, w, dw);
    for (int a = 0; a < N; ++a) {
      s->w[d][a] = (REAL)w[a];
      s->dw[d][a] = (REAL)(dw[a] * inverse_h);
    }
  }
}

/* coefficient of row r: weight, and its derivative in each of the slow directions */
static inline REAL row_weight(const Spline *s, int r) { return D == 3 ? s->w[0][r / N] * s->w[1][r % N] : s->w[0][r]; }
static inline REAL row_slope0(const Spline *s, int r) { return D == 3 ? s->dw[0][r / N] * s->w[1][r % N] : s->dw[0][r]; }
static inline REAL row_slope1(const Spline *s, int r) { return s->w[0][r / N] * s->dw[1][r % N]; }

static inline void gather(const REAL *nodes, const int32_t *rows, Row *block) {
  EACH_ROW {
    block[r].part[PARTS - 1] = (Vector){0};
    memcpy(block[r].at, nodes + (int64_t)D * rows[r], ROW * sizeof(REAL));
  }
}

static inline void scatter(const Row *block, const int32_t *rows, REAL *nodes) {
  EACH_ROW {
    REAL *to = nodes + (int64_t)D * rows[r];
    for (int e = 0; e < ROW; ++e) to[e] += block[r].at[e];
  }
}

static inline void clear(Row *block) {
  EACH_ROW EACH_PART block[r].part[v] = (Vector){0};
}

/* g = sum over nodes of u (grad w)^T, by rows */
static inline void gradient(const Spline *s, const Row *block, REAL *g) {
  Row a0, a1, a2;
  EACH_PART a0.part[v] = a1.part[v] = a2.part[v] = (Vector){0};
  EACH_ROW {
    const REAL w = row_weight(s, r), w0 = row_slope0(s, r);
#if D == 3
    const REAL w1 = row_slope1(s, r);
    EACH_PART a1.part[v] += w1 * block[r].part[v];
#endif
    EACH_PART {
      a0.part[v] += w0 * block[r].part[v];
      a2.part[v] += w * block[r].part[v];
    }
  }
  for (int c = 0; c < D; ++c) {
    REAL s0 = 0, s1 = 0, s2 = 0;
    for (int k = 0; k < N; ++k) {
      s0 += s->w[D - 1][k] * a0.at[D * k + c];
      s1 += s->w[D - 1][k] * a1.at[D * k + c];
      s2 += s->dw[D - 1][k] * a2.at[D * k + c];
    }
    g[D * c] = s0;
    if (D == 3) g[D * c + 1] = s1;
    g[D * c + D - 1] = s2;
  }
}

/* block += t grad w, t by rows */
static inline void add_force(const Spline *s, const REAL *t, Row *block) {
  Row q0, q1, q2;
  q0.part[PARTS - 1] = q1.part[PARTS - 1] = q2.part[PARTS - 1] = (Vector){0};
  for (int k = 0; k < N; ++k)
    for (int c = 0; c < D; ++c) {
      q0.at[D * k + c] = s->w[D - 1][k] * t[D * c];
      q1.at[D * k + c] = s->w[D - 1][k] * t[D * c + 1];
      q2.at[D * k + c] = s->dw[D - 1][k] * t[D * c + D - 1];
    }
  EACH_ROW {
    const REAL w = row_weight(s, r), w0 = row_slope0(s, r);
#if D == 3
    const REAL w1 = row_slope1(s, r);
    EACH_PART block[r].part[v] += w0 * q0.part[v] + w1 * q1.part[v] + w * q2.part[v];
#else
    EACH_PART block[r].part[v] += w0 * q0.part[v] + w * q2.part[v];
#endif
  }
}
