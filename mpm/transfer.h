/* Between particles and nodes, a cell at a time: the stencil of a cell is gathered into (or scattered from) a block
 * which stays in registers and the first cache while the cell's particles are worked through, LANES at a time.
 *
 * A vector of the block holds one component of as many nodes as fit: the nodes of the last direction side by side,
 * WIDE nodes of the first one; the middle direction of three has vectors of its own. Hence a particle costs one
 * vector of weights for the first and last direction together, and numbers for the middle one. */

#ifdef __AVX512F__
enum { VECTOR_BYTES = 64 };
#else
enum { VECTOR_BYTES = 32 };
#endif
enum { LENGTH = VECTOR_BYTES / sizeof(REAL), WIDE = LENGTH / 4, GROUPS = (N + WIDE - 1) / WIDE };
enum { MIDDLE = D == 3 ? N : 1 };
typedef REAL Vector __attribute__((vector_size(VECTOR_BYTES)));
/* whole numbers that choose entries of vectors */
typedef Whole Index __attribute__((vector_size(VECTOR_BYTES)));
typedef Whole Four __attribute__((vector_size(4 * sizeof(REAL))));

typedef union {
  Vector part[GROUPS];
  Quad row[GROUPS * WIDE];
} Plane;

/* one component at the nodes of a stencil */
typedef struct {
  Plane middle[MIDDLE];
} Block;

typedef struct {
  Plane here, slope0, slope2; /* weights of first and last direction, and their derivatives in the one and the other */
  REAL w[4], dw[4];           /* of the middle direction */
} Spline;

#define EACH_GROUP for (int g = 0; g < GROUPS; ++g)
#define EACH_MIDDLE for (int j = 0; j < MIDDLE; ++j)
#define EACH_COMPONENT for (int c = 0; c < D; ++c)

static inline void spline_at(const double *x, double inverse_h, Spline *s) {
  Quad w[D], dw[D];
  for (int d = 0; d < D; ++d) {
    weights(x[d] * inverse_h, w + d, dw + d);
    dw[d] *= (REAL)inverse_h;
  }
  for (int i = 0; i < GROUPS * WIDE; ++i) {
    s->here.row[i] = w[0][i] * w[D - 1];
    s->slope0.row[i] = dw[0][i] * w[D - 1];
    s->slope2.row[i] = w[0][i] * dw[D - 1];
  }
  if (D == 3) {
    memcpy(s->w, w + 1, sizeof(Quad));
    memcpy(s->dw, dw + 1, sizeof(Quad));
  }
}

/* N nodes with D components each, taken apart by component */
static inline void apart(const REAL *from, Quad *to) {
  Quad a, b;
  REAL all[4 * D] = {0};
  memcpy(all, from, N * D * sizeof(REAL));
  memcpy(&a, all, sizeof(Quad));
  memcpy(&b, all + 4, sizeof(Quad));
#if D == 3
  Quad c;
  memcpy(&c, all + 8, sizeof(Quad));
  to[0] = __builtin_shuffle(__builtin_shuffle(a, b, (Four){0, 3, 6, 0}), c, (Four){0, 1, 2, 5});
  to[1] = __builtin_shuffle(__builtin_shuffle(a, b, (Four){1, 4, 7, 0}), c, (Four){0, 1, 2, 6});
  to[2] = __builtin_shuffle(__builtin_shuffle(a, b, (Four){2, 5, 0, 0}), c, (Four){0, 1, 4, 7});
#else
  to[0] = __builtin_shuffle(a, b, (Four){0, 2, 4, 6});
  to[1] = __builtin_shuffle(a, b, (Four){1, 3, 5, 7});
#endif
}

/* to[node][component] += from[component][node] */
static inline void together(const Quad *from, REAL *to) {
  const Quad x = from[0], y = from[1];
  Quad out[D];
#if D == 3
  const Quad z = from[2];
  out[0] = __builtin_shuffle(__builtin_shuffle(x, y, (Four){0, 4, 0, 1}), z, (Four){0, 1, 4, 3});
  out[1] = __builtin_shuffle(__builtin_shuffle(y, z, (Four){1, 5, 0, 2}), x, (Four){0, 1, 6, 3});
  out[2] = __builtin_shuffle(__builtin_shuffle(z, y, (Four){2, 0, 7, 3}), x, (Four){0, 7, 2, 3});
#else
  out[0] = __builtin_shuffle(x, y, (Four){0, 4, 1, 5});
  out[1] = __builtin_shuffle(x, y, (Four){2, 6, 3, 7});
#endif
  REAL all[N * D], sum[N * D];
  memcpy(all, out, sizeof(all));
  memcpy(sum, to, sizeof(sum));
  for (int e = 0; e < N * D; ++e) sum[e] += all[e];
  memcpy(to, sum, sizeof(sum));
}

static inline void gather(const REAL *nodes, const int32_t *rows, Block *block) {
  if (N != 4) memset(block, 0, D * sizeof(Block));
  for (int i = 0; i < N; ++i) EACH_MIDDLE {
    Quad one[D];
    apart(nodes + (int64_t)D * rows[i * MIDDLE + j], one);
    EACH_COMPONENT block[c].middle[j].row[i] = one[c];
  }
}

static inline void scatter(const Block *block, const int32_t *rows, REAL *nodes) {
  for (int i = 0; i < N; ++i) EACH_MIDDLE {
    Quad one[D];
    EACH_COMPONENT one[c] = block[c].middle[j].row[i];
    together(one, nodes + (int64_t)D * rows[i * MIDDLE + j]);
  }
}

/* the same for one number a node */
static inline void scatter_scalar(const Block *block, const int32_t *rows, REAL *nodes) {
  for (int i = 0; i < N; ++i) EACH_MIDDLE {
    REAL *to = nodes + rows[i * MIDDLE + j];
    for (int k = 0; k < N; ++k) to[k] += block->middle[j].row[i][k];
  }
}

/* Of each pair of entries of a and of b that are `step` apart their sum, a's and b's by turns */
static inline Vector merge(Vector a, Vector b, int step) {
  const Whole count[16] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
  Index l;
  memcpy(&l, count, sizeof(l));
  const Index first = (l & ~step) + (l & step) * (LENGTH / step);
  return __builtin_shuffle(a, b, first) + __builtin_shuffle(a, b, first + step);
}

/* out[p] = sum of the entries of v[p], which is lost */
static inline void sums(Vector v[LANES], Lanes *out) {
  for (int p = 0; p < LANES; p += 2) v[p] = merge(v[p], v[p + 1], 1);
  for (int p = 0; p < LANES; p += 4) v[p] = merge(v[p], v[p + 2], 2);
  if (LENGTH > 4) v[0] = merge(v[0], v[4], LENGTH > 4 ? 4 : 1);
  if (sizeof(Vector) <= sizeof(Lanes)) {
    for (int p = 0; p < LANES; p += LENGTH) memcpy((REAL *)out + p, v + p, sizeof(Vector));
  } else {
    Lanes half[2];
    memcpy(half, v, sizeof(half));
    *out = half[0] + half[1];
  }
}

/* g[D a + b] = sum over nodes of u_a dw/dx_b, of `count` particles; the last one stands for those that are not there */
static inline void gradients(int count, const Spline *splines, const Block *u, Lanes *g) {
  Vector part[D * D][LANES];
  for (int l = 0; l < count; ++l) {
    const Spline *s = splines + l;
    EACH_COMPONENT {
      Vector g0 = {0}, g1 = {0}, g2 = {0};
      EACH_GROUP {
        Vector w = {0}, dw = {0};
        if (D == 2) w = u[c].middle[0].part[g];
        else EACH_MIDDLE {
          w += s->w[j] * u[c].middle[j].part[g];
          dw += s->dw[j] * u[c].middle[j].part[g];
        }
        g0 += w * s->slope0.part[g];
        g1 += dw * s->here.part[g];
        g2 += w * s->slope2.part[g];
      }
      part[D * c][l] = g0;
      if (D == 3) part[D * c + 1][l] = g1;
      part[D * c + D - 1][l] = g2;
    }
  }
  for (int l = count; l < LANES; ++l)
    for (int e = 0; e < D * D; ++e) part[e][l] = part[e][count - 1];
  for (int e = 0; e < D * D; ++e) sums(part[e], g + e);
}

/* v[a] = sum over nodes of u_a w */
static inline void values(int count, const Spline *splines, const Block *u, Lanes *v) {
  Vector part[D][LANES];
  for (int l = 0; l < count; ++l) {
    const Spline *s = splines + l;
    EACH_COMPONENT {
      Vector sum = {0};
      EACH_GROUP {
        Vector w = {0};
        if (D == 2) w = u[c].middle[0].part[g];
        else EACH_MIDDLE w += s->w[j] * u[c].middle[j].part[g];
        sum += w * s->here.part[g];
      }
      part[c][l] = sum;
    }
  }
  for (int l = count; l < LANES; ++l) EACH_COMPONENT part[c][l] = part[c][count - 1];
  EACH_COMPONENT sums(part[c], v + c);
}

/* block += t grad w of `count` particles, t by rows */
static inline void add_forces(int count, const Spline *splines, const Lanes *t, Block *block) {
  const REAL *entry = (const REAL *)t;
  EACH_GROUP {
    Vector sum[D][MIDDLE];
    EACH_COMPONENT EACH_MIDDLE sum[c][j] = block[c].middle[j].part[g];
    for (int l = 0; l < count; ++l) {
      const Spline *s = splines + l;
      const Vector here = s->here.part[g], slope0 = s->slope0.part[g], slope2 = s->slope2.part[g];
      EACH_COMPONENT {
        const REAL *row = entry + LANES * D * c + l;
        const Vector ends = row[0] * slope0 + row[LANES * (D - 1)] * slope2;
        if (D == 2) sum[c][0] += ends;
        else {
          const Vector middle = row[LANES] * here;
          EACH_MIDDLE sum[c][j] += s->w[j] * ends + s->dw[j] * middle;
        }
      }
    }
    EACH_COMPONENT EACH_MIDDLE block[c].middle[j].part[g] = sum[c][j];
  }
}
