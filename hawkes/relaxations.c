/* Rounds over the events for other normalisations of the weights than (3.5)'s. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

static int descending(const void *a, const void *b) {
  const double x = *(const double *)a, y = *(const double *)b;
  return (x < y) - (x > y);
}

/* all weight on the first of the largest */
static void corner(int64_t n, const double *g, double *x) {
  int64_t best = 0;
  for (int64_t s = 1; s < n; ++s)
    if (g[s] > g[best]) best = s;
  memset(x, 0, n * sizeof(double));
  x[best] = 1;
}

/* max g.x with sum x^p = 1: x ~ g^(1/(p-1)) */
static void power(int64_t n, const double *g, double most, double p, double *x) {
  double sum = 0;
  for (int64_t s = 0; s < n; ++s) {
    x[s] = pow(g[s] / most, 1 / (p - 1));
    sum += pow(x[s], p);
  }
  const double scale = pow(sum, -1 / p);
  for (int64_t s = 0; s < n; ++s) x[s] *= scale;
}

/* max g.x with sum f x^2 + (1-f) x = 1: x = (g/l - (1-f)) / 2f where positive; `sorted` has room for n */
static void hybrid(int64_t n, const double *g, double most, double f, double *sorted, double *x) {
  const double d = 1 - f;
  memcpy(sorted, g, n * sizeof(double));
  qsort(sorted, n, sizeof(double), descending);
  double square = 0, l = most;
  for (int64_t s = 0; s < n && (s == 0 || sorted[s] > l * d); ++s) {
    square += sorted[s] / most * (sorted[s] / most);
    l = most * sqrt(square / (4 * f + (double)(s + 1) * d * d));
  }
  for (int64_t s = 0; s < n; ++s) x[s] = fmax(0, (g[s] / l - d) / (2 * f));
}

/* Event by event, the x_j that maximises g_j . x_j under the constraint; see extremal_sweep. Power p where f is nan.
 * `room` has two entries for each slot of the largest event. Returns the largest change. */
double extremal_relax(int64_t events, const int64_t *start, const int32_t *pair, const double *decay, int64_t pairs,
                      const double *coupling, const double *b, double p, double f, double *scratch, double *future,
                      double *room, double *x) {
  double change = 0;
  memset(scratch, 0, pairs * sizeof(double));
  for (int64_t j = 0; j < events; ++j) {
    const int64_t first = start[j], n = start[j + 1] - first;
    double most = 0;
    for (int64_t s = first; s < first + n; ++s) {
      const int32_t i = pair[s];
      const double past = scratch[i] * decay[s];
      scratch[i] = past;
      future[s] = b[s] + coupling[i] * (past + future[s]);
      most = fmax(most, future[s]);
    }
    if (most > 0) {
      double *sorted = room, *old = room + n;
      memcpy(old, x + first, n * sizeof(double));
      if (isnan(f) ? p == 1 : f <= 0)
        corner(n, future + first, x + first);
      else if (isnan(f))
        power(n, future + first, most, p, x + first);
      else
        hybrid(n, future + first, most, f, sorted, x + first);
      for (int64_t s = 0; s < n; ++s) change = fmax(change, fabs(x[first + s] - old[s]));
    }
    for (int64_t s = first; s < first + n; ++s) scratch[pair[s]] += x[s];
  }
  return change;
}
