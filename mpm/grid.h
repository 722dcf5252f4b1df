/* Cells that hold particles, and a compact numbering of the nodes their splines touch.
 *
 * Particles are sorted by cell (the cell is named by its first node). Nodes are numbered line by line with the last
 * direction fastest, so that the N nodes of a stencil row are neighbours; a bit for each node of the bounding box
 * tells whether it is there, and counting bits gives its number. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
  int32_t low[D];    /* first node of the bounding box */
  int32_t nodes[D];  /* its nodes in each direction */
  int64_t words;     /* 64-bit words in a line */
} Box;

static inline int64_t cell_key(const Box *box, const int32_t *c) {
  int64_t key = 0;
  for (int d = 0; d < D; ++d) key = key * box->nodes[d] + (c[d] - box->low[d]);
  return key;
}

static inline void cell_of(const double *x, double inverse_h, int32_t *c) {
  for (int d = 0; d < D; ++d) c[d] = (int32_t)first_node(x[d] * inverse_h);
}

/* Bounding box of the particles' stencils; returns 0, or 1 + the index of a particle that is not at a finite place. */
int64_t extremal_box(int64_t n, const double *x, double h, Box *box) {
  const double inverse = 1 / h;
  int32_t low[D], high[D];
  for (int d = 0; d < D; ++d) {
    low[d] = INT32_MAX;
    high[d] = INT32_MIN;
  }
  for (int64_t p = 0; p < n; ++p) {
    int32_t c[D];
    for (int d = 0; d < D; ++d)
      if (!(fabs(x[D * p + d] * inverse) < 1e9)) return p + 1;
    cell_of(x + D * p, inverse, c);
    for (int d = 0; d < D; ++d) {
      if (c[d] < low[d]) low[d] = c[d];
      if (c[d] > high[d]) high[d] = c[d];
    }
  }
  for (int d = 0; d < D; ++d) {
    box->low[d] = n ? low[d] : 0;
    box->nodes[d] = n ? high[d] - low[d] + N : 0;
  }
  box->words = (box->nodes[D - 1] + 63) / 64;
  return 0;
}

/* Sorts by cell: order[n] is the permutation. Returns the number of occupied cells; cell c holds the sorted particles
 * start[c] ... start[c+1]-1 and begins at node base[c][D]. Within a cell particles stand by `ident`, so that the
 * order of a sum does not depend on a particle's history. `scratch` has 3 n words. jumps[0]: how many particles do
 * not stand next to the one before them. */
int64_t extremal_sort(int64_t n, const double *x, const int64_t *ident, double h, const Box *box, int32_t *order,
                      int32_t *start, int32_t *base, uint64_t *scratch, int64_t *jumps) {
  uint64_t *key = scratch, *other = scratch + n;
  int32_t *from = order, *to = (int32_t *)(scratch + 2 * n), *home = order;
  const double inverse = 1 / h;
  uint64_t all = 0;
  for (int64_t p = 0; p < n; ++p) {
    int32_t c[D];
    cell_of(x + D * p, inverse, c);
    key[p] = (uint64_t)cell_key(box, c);
    all |= key[p];
    from[p] = (int32_t)p;
  }
  enum { BITS = 11, BUCKETS = 1 << BITS };
  for (int shift = 0; shift < 64 && (all >> shift); shift += BITS) {
    int64_t count[BUCKETS + 1] = {0};
    for (int64_t p = 0; p < n; ++p) ++count[((key[p] >> shift) & (BUCKETS - 1)) + 1];
    for (int b = 0; b < BUCKETS; ++b) count[b + 1] += count[b];
    for (int64_t p = 0; p < n; ++p) {
      const int64_t at = count[(key[p] >> shift) & (BUCKETS - 1)]++;
      other[at] = key[p];
      to[at] = from[p];
    }
    uint64_t *k = key;
    key = other;
    other = k;
    int32_t *o = from;
    from = to;
    to = o;
  }
  if (from != home) memcpy(home, from, n * sizeof(int32_t));
  int64_t cells = 0;
  for (int64_t p = 0; p < n; ++p)
    if (p == 0 || key[p] != key[p - 1]) {
      uint64_t rest = key[p];
      for (int d = D - 1; d >= 0; --d) {
        base[D * cells + d] = box->low[d] + (int32_t)(rest % (uint64_t)box->nodes[d]);
        rest /= (uint64_t)box->nodes[d];
      }
      start[cells++] = (int32_t)p;
    }
  start[cells] = (int32_t)n;
  for (int64_t c = 0; c < cells; ++c)
    for (int64_t p = start[c] + 1; p < start[c + 1]; ++p) {
      const int32_t one = home[p];
      int64_t q = p;
      for (; q > start[c] && ident[home[q - 1]] > ident[one]; --q) home[q] = home[q - 1];
      home[q] = one;
    }
  *jumps = 0;
  for (int64_t p = 1; p < n; ++p) *jumps += home[p] != home[p - 1] + 1;
  return cells;
}

/* dst[p][bytes] = src[order[p]][bytes] */
void extremal_permute(int64_t n, const int32_t *order, int64_t bytes, const char *src, char *dst) {
  if (bytes == 8) {
    for (int64_t p = 0; p < n; ++p) ((uint64_t *)dst)[p] = ((const uint64_t *)src)[order[p]];
  } else if (bytes == 24) {
    for (int64_t p = 0; p < n; ++p) memcpy(dst + 24 * p, src + 24 * (int64_t)order[p], 24);
  } else if (bytes == 48) {
    for (int64_t p = 0; p < n; ++p) memcpy(dst + 48 * p, src + 48 * (int64_t)order[p], 48);
  } else {
    for (int64_t p = 0; p < n; ++p) memcpy(dst + bytes * p, src + bytes * (int64_t)order[p], bytes);
  }
}

static inline int64_t line_of(const Box *box, const int32_t *node) {
  int64_t line = 0;
  for (int d = 0; d < D - 1; ++d) line = line * box->nodes[d] + (node[d] - box->low[d]);
  return line;
}

static int64_t node_number(const Box *box, const uint64_t *bits, const int32_t *offset, const int32_t *node) {
  const int64_t k = node[D - 1] - box->low[D - 1], word = line_of(box, node) * box->words + (k >> 6);
  const uint64_t bit = (uint64_t)1 << (k & 63);
  if (!(bits[word] & bit)) return -1;
  return offset[word] + __builtin_popcountll(bits[word] & (bit - 1));
}

/* Sets the bits of all nodes of the cells' stencils and counts them: returns the number of nodes. bits must be 0. */
int64_t extremal_number(int64_t cells, const int32_t *base, const Box *box, uint64_t *bits, int32_t *offset) {
  for (int64_t c = 0; c < cells; ++c) {
    int32_t node[D];
    const int64_t k = base[D * c + D - 1] - box->low[D - 1];
    for (int r = 0; r < ROWS; ++r) {
      node[0] = base[D * c] + (D == 3 ? r / N : r);
      if (D == 3) node[1] = base[D * c + 1] + r % N;
      const int64_t word = line_of(box, node) * box->words + (k >> 6);
      const int shift = k & 63;
      bits[word] |= (((uint64_t)1 << N) - 1) << shift;
      if (shift > 64 - N) bits[word + 1] |= (((uint64_t)1 << N) - 1) >> (64 - shift);
    }
  }
  int64_t lines = box->words, count = 0;
  for (int d = 0; d < D - 1; ++d) lines *= box->nodes[d];
  for (int64_t w = 0; w < lines; ++w) {
    offset[w] = (int32_t)count;
    count += __builtin_popcountll(bits[w]);
  }
  return count;
}

/* rows[cells][ROWS]: number of the first node of each row of a cell's stencil; node[count][D]: where the nodes are. */
void extremal_rows(int64_t cells, const int32_t *base, const Box *box, const uint64_t *bits, const int32_t *offset,
                   int32_t *rows, int32_t *node) {
  for (int64_t c = 0; c < cells; ++c)
    for (int r = 0; r < ROWS; ++r) {
      int32_t at[D];
      at[0] = base[D * c] + (D == 3 ? r / N : r);
      if (D == 3) at[1] = base[D * c + 1] + r % N;
      at[D - 1] = base[D * c + D - 1];
      rows[ROWS * c + r] = (int32_t)node_number(box, bits, offset, at);
    }
  int64_t lines = 1, count = 0;
  for (int d = 0; d < D - 1; ++d) lines *= box->nodes[d];
  for (int64_t l = 0; l < lines; ++l)
    for (int64_t w = 0; w < box->words; ++w)
      for (uint64_t rest = bits[l * box->words + w]; rest; rest &= rest - 1) {
        int64_t line = l;
        for (int d = D - 2; d >= 0; --d) {
          node[D * count + d] = box->low[d] + (int32_t)(line % box->nodes[d]);
          line /= box->nodes[d];
        }
        node[D * count++ + D - 1] = box->low[D - 1] + (int32_t)(64 * w + __builtin_ctzll(rest));
      }
}

/* Numbers of given nodes, -1 where there is none. */
void extremal_find(int64_t count, const int32_t *node, const Box *box, const uint64_t *bits, const int32_t *offset,
                   int32_t *number) {
  for (int64_t q = 0; q < count; ++q) {
    int inside = 1;
    for (int d = 0; d < D; ++d) {
      const int32_t k = node[D * q + d] - box->low[d];
      inside = inside && k >= 0 && k < box->nodes[d];
    }
    number[q] = inside ? (int32_t)node_number(box, bits, offset, node + D * q) : -1;
  }
}
