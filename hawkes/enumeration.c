/* Sums of (3.1) over all ways of filling in the incomplete events.
 *
 * The likelihood is a product over timelines, each factor depending only on which incomplete events lie on its
 * timeline. The sum over allocations is therefore a product of set functions, and costs 3^n for each timeline instead
 * of K^n in all. Extended precision is for its range of exponents, which products of n intensities need. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* ln L of one timeline for each subset of its `count` incomplete events: m events in the order of time, the bit of
 * each or -1 for a complete one, `decay` since the one before; cost: what each subtracts (compensator) or 0. */
void extremal_subsets(int64_t m, const double *decay, const int32_t *bit, const double *cost, double mu,
                      double coupling, int64_t count, double *out) {
  for (int64_t subset = 0; subset < (int64_t)1 << count; ++subset) {
    double sum = 0, product = 1, logarithm = 0;
    for (int64_t e = 0; e < m; ++e) {
      sum *= decay[e];
      if (bit[e] >= 0 && !(subset >> bit[e] & 1)) continue;
      product *= mu + coupling * sum;
      logarithm -= cost[e];
      sum += 1;
      if (product < 1e-100 || product > 1e100) {
        logarithm += log(product);
        product = 1;
      }
    }
    out[subset] = logarithm + log(product);
  }
}

/* to[M] = sum over the subsets S of M that lie in `allowed` of from[M - S] factor[S] */
static void multiply(int64_t full, int64_t allowed, const long double *factor, const long double *from,
                     long double *to) {
  for (int64_t set = 0; set <= full; ++set) {
    const int64_t most = set & allowed;
    long double total = 0;
    for (int64_t part = most;; part = (part - 1) & most) {
      total += from[set - part] * factor[part];
      if (!part) break;
    }
    to[set] = total;
  }
}

/* Sums over all allocations: out[i][j] those with event j on timeline i. Timeline i takes the events of the set
 * allowed[i]; its ln L for each subset of them, numbered by their bits put side by side, begins at table[first[i]].
 * Returns 0 where every allocation is impossible, -1 where memory does not do. Each column of out sums to 1. */
int64_t extremal_allocations(int64_t timelines, int64_t n, const int64_t *allowed, const int64_t *first,
                             const double *table, double *out) {
  const int64_t size = (int64_t)1 << n, full = size - 1;
  long double *space = malloc((2 * timelines + 4) * size * sizeof(long double)); /* far below what ln L needs */
  if (!space) return -1;
  long double *factor = space, *before = factor + timelines * size, *after = before + (timelines + 1) * size;
  long double *spare = after + size;
  memset(space, 0, (2 * timelines + 4) * size * sizeof(long double));
  for (int64_t i = 0; i < timelines; ++i) {
    double top = -INFINITY;
    const double *row = table + first[i];
    int64_t k = 0;
    for (int64_t part = 0;; part = (part - allowed[i]) & allowed[i]) {
      top = fmax(top, row[k++]);
      if (part == allowed[i]) break;
    }
    k = 0;
    for (int64_t part = 0;; part = (part - allowed[i]) & allowed[i]) {
      factor[i * size + part] = top > -INFINITY ? expl((long double)row[k] - top) : 0;
      k++;
      if (part == allowed[i]) break;
    }
  }
  before[0] = after[0] = 1;
  for (int64_t i = 0; i < timelines; ++i)
    multiply(full, allowed[i], factor + i * size, before + i * size, before + (i + 1) * size);
  const long double total = before[timelines * size + full];
  for (int64_t i = timelines - 1; i >= 0 && total > 0; --i) {
    const long double *mine = factor + i * size, *others = before + i * size;
    for (int64_t j = 0; j < n; ++j) out[i * n + j] = 0;
    for (int64_t part = allowed[i]; part; part = (part - 1) & allowed[i]) {
      const int64_t rest = full - part;
      long double sum = 0;
      for (int64_t set = rest;; set = (set - 1) & rest) {
        sum += others[set] * after[rest - set];
        if (!set) break;
      }
      for (int64_t j = 0; j < n; ++j)
        if (part >> j & 1) out[i * n + j] += (double)(mine[part] * sum / total);
    }
    multiply(full, allowed[i], mine, after, spare);
    memcpy(after, spare, size * sizeof(long double));
  }
  free(space);
  return total > 0;
}
