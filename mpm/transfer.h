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
  REAL w[N], dw[N]; /* of the last direction: weights, and derivatives times 1/h */
  /* of each row: weight, and its derivative in each of the slow directions */
  REAL row[ROWS], slope0[ROWS], slope1[ROWS];
} Spline;

static inline void spline_at(const double *x, double inverse_h, Spline *s) {
  REAL w[D][N], dw[D][N];
  for (int d = 0; d < D; ++d) {
    double exact[N], slope[N];
    weights(x[d] * inverse_h, exact, slope);
    for (int a = 0; a < N; ++a) {
      w[d][a] = (REAL)exact[a];
      dw[d][a] = (REAL)(slope[a] * inverse_h);
    }
  }
  for (int a = 0; a < N; ++a) {
    s->w[a] = w[D - 1][a];
    s->dw[a] = dw[D - 1][a];
#if D == 3
    for (int b = 0; b < N; ++b) {
      s->row[N * a + b] = w[0][a] * w[1][b];
      s->slope0[N * a + b] = dw[0][a] * w[1][b];
      s->slope1[N * a + b] = w[0][a] * dw[1][b];
    }
#else
    s->row[a] = w[0][a];
    s->slope0[a] = dw[0][a];
    s->slope1[a] = 0;
#endif
  }
}

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
    const REAL w = s->row[r], w0 = s->slope0[r];
#if D == 3
    const REAL w1 = s->slope1[r];
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
      s0 += s->w[k] * a0.at[D * k + c];
      s1 += s->w[k] * a1.at[D * k + c];
      s2 += s->dw[k] * a2.at[D * k + c];
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
      q0.at[D * k + c] = s->w[k] * t[D * c];
      q1.at[D * k + c] = s->w[k] * t[D * c + 1];
      q2.at[D * k + c] = s->dw[k] * t[D * c + D - 1];
    }
  EACH_ROW {
    const REAL w = s->row[r], w0 = s->slope0[r];
#if D == 3
    const REAL w1 = s->slope1[r];
    EACH_PART block[r].part[v] += w0 * q0.part[v] + w1 * q1.part[v] + w * q2.part[v];
#else
    EACH_PART block[r].part[v] += w0 * q0.part[v] + w * q2.part[v];
#endif
  }
}
