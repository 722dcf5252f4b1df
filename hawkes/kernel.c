/* Recursions over slots: an admissible pair for an event is a slot.
 *
 * Slots stand event by event in the order of time, `start[j]` ... `start[j+1]-1` those of event j; `pair` is the
 * slot's timeline. `decay` is exp(-omega dt) since the timeline's slot before (0 for its first), so that sums over all
 * others of a timeline, sum_l x_l exp(-omega |t_j - t_l|), need two multiplications a slot: a forward and a backward
 * recursion with one number for each timeline (`past`, `future`, zero at the start). Exponentials of whole times,
 * which overflow, never occur. Events at equal times count as (3.3) says: each pair of them once. */
#include <math.h>
#include <stdint.h>
#include <string.h>

static inline double quiet(double x) { return x < 1e-300 ? 0 : x; } /* denormal numbers are slow */

/* b = mu + theta omega sum over complete events of exp(-omega |dt|) (3.3), and `decay`.
 *
 * event[e]: the event's number among those with slots, or -1; complete[e]: the timeline of a complete event without
 * slots, or -1. `sum` and `last` have an entry for each timeline. */
void extremal_prepare(int64_t events, const double *time, const int32_t *complete, const int32_t *event,
                      const int64_t *start, const int32_t *pair, int64_t pairs, const double *mu,
                      const double *coupling, const double *omega, double *sum, double *last, double *b,
                      double *decay) {
  for (int64_t i = 0; i < pairs; ++i) {
    sum[i] = 0;
    last[i] = -INFINITY;
  }
  for (int64_t e = 0; e < events; ++e) {
    const int32_t i = complete[e], j = event[e];
    if (i >= 0) {
      sum[i] = sum[i] * quiet(exp(omega[i] * (last[i] - time[e]))) + 1;
      last[i] = time[e];
    }
    if (j >= 0)
      for (int64_t s = start[j]; s < start[j + 1]; ++s) {
        const int32_t k = pair[s];
        b[s] = mu[k] + coupling[k] * sum[k] * quiet(exp(omega[k] * (last[k] - time[e])));
      }
  }
  for (int64_t i = 0; i < pairs; ++i) {
    sum[i] = 0;
    last[i] = INFINITY;
  }
  for (int64_t e = events - 1; e >= 0; --e) {
    const int32_t i = complete[e], j = event[e];
    if (i >= 0) {
      sum[i] = sum[i] * quiet(exp(omega[i] * (time[e] - last[i]))) + 1;
      last[i] = time[e];
    }
    if (j >= 0)
      for (int64_t s = start[j]; s < start[j + 1]; ++s) {
        const int32_t k = pair[s];
        b[s] += coupling[k] * sum[k] * quiet(exp(omega[k] * (time[e] - last[k])));
      }
  }
  for (int64_t i = 0; i < pairs; ++i) last[i] = -INFINITY;
  for (int64_t e = 0; e < events; ++e)
    if (event[e] >= 0)
      for (int64_t s = start[event[e]]; s < start[event[e] + 1]; ++s) {
        const int32_t k = pair[s];
        decay[s] = quiet(exp(omega[k] * (last[k] - time[e])));
        last[k] = time[e];
      }
}

/* out = 2 A x (3.20): theta omega sum over the timeline's other slots of x exp(-omega |dt|) */
void extremal_couple(int64_t slots, const int32_t *pair, const double *decay, int64_t pairs, const double *coupling,
                     const double *x, double *scratch, double *out) {
  memset(scratch, 0, pairs * sizeof(double));
  for (int64_t s = 0; s < slots; ++s) {
    const int32_t i = pair[s];
    const double past = scratch[i] * decay[s];
    out[s] = past;
    scratch[i] = past + x[s];
  }
  memset(scratch, 0, pairs * sizeof(double));
  for (int64_t s = slots - 1; s >= 0; --s) {
    const int32_t i = pair[s];
    const double future = scratch[i];
    out[s] = coupling[i] * (out[s] + future);
    scratch[i] = (future + x[s]) * decay[s];
  }
}

/* future[s] = sum over the timeline's later slots of x exp(-omega dt) */
void extremal_later(int64_t slots, const int32_t *pair, const double *decay, int64_t pairs, const double *x,
                    double *scratch, double *future) {
  memset(scratch, 0, pairs * sizeof(double));
  for (int64_t s = slots - 1; s >= 0; --s) {
    const int32_t i = pair[s];
    future[s] = scratch[i];
    scratch[i] = (scratch[i] + x[s]) * decay[s];
  }
}

/* Event by event, x_j = g_j / |g_j|: the maximum of (3.20) over one column, the others fixed. `future` is that of
 * extremal_later and is overwritten. Returns the largest change of a weight. */
double extremal_sweep(int64_t events, const int64_t *start, const int32_t *pair, const double *decay, int64_t pairs,
                      const double *coupling, const double *b, double *scratch, double *future, double *x) {
  double change = 0;
  memset(scratch, 0, pairs * sizeof(double));
  for (int64_t j = 0; j < events; ++j) {
    double square = 0;
    for (int64_t s = start[j]; s < start[j + 1]; ++s) {
      const int32_t i = pair[s];
      const double past = scratch[i] * decay[s], g = b[s] + coupling[i] * (past + future[s]);
      scratch[i] = past;
      future[s] = g;
      square += g * g;
    }
    const double scale = square > 0 ? 1 / sqrt(square) : 0;
    for (int64_t s = start[j]; s < start[j + 1]; ++s) {
      const double to = scale > 0 ? scale * future[s] : x[s];
      change = fmax(change, fabs(to - x[s]));
      x[s] = to;
      scratch[pair[s]] += to;
    }
  }
  return change;
}

/* out_j = sum over the slots of event j of u v */
void extremal_columns(int64_t events, const int64_t *start, const double *u, const double *v, double *out) {
  for (int64_t j = 0; j < events; ++j) {
    double sum = 0;
    for (int64_t s = start[j]; s < start[j + 1]; ++s) sum += u[s] * v[s];
    out[j] = sum;
  }
}

/* out = factor_j u + other_j v for the slots of event j */
void extremal_combine(int64_t events, const int64_t *start, const double *factor, const double *u,
                      const double *other, const double *v, double *out) {
  for (int64_t j = 0; j < events; ++j)
    for (int64_t s = start[j]; s < start[j + 1]; ++s) out[s] = factor[j] * u[s] + other[j] * v[s];
}

/* max_g[j] = the largest g/x of the event's slots, 0/0 counting as 0 and g/0 as infinity */
void extremal_ratio(int64_t events, const int64_t *start, const double *g, const double *x, double *out) {
  for (int64_t j = 0; j < events; ++j) {
    double most = 0;
    for (int64_t s = start[j]; s < start[j + 1]; ++s)
      if (g[s] > 0) most = fmax(most, x[s] > 0 ? g[s] / x[s] : INFINITY);
    out[j] = most;
  }
}
